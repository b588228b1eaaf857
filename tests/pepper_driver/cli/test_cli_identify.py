"""``pepper identify``, as an operator meets it."""

import io
import json
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from pepper_driver.backends.mock import MockBackend
from pepper_driver.cli import identify as cli_identify
from pepper_driver.cli.app import run
from pepper_driver.config import PepperError, load_controller_settings
from pepper_driver.config.signals import raised_signals
from pepper_driver.controller import WholeBodyController
from pepper_driver.controller.report import ControllerStatus
from pepper_driver.identification import MANIFEST, DryRunError, load_recordings, plan_runs
from pepper_driver.identification import identify as identify_module
from pepper_driver.identification.measurements.program import Hand, held_weight
from pepper_driver.identification.runs import IdentificationRun, check_dry_run, perform
from pepper_driver.observer import ModelSet, Recording
from support.identification import (
    ROBOT,
    SHORT,
    InterruptedRobot,
    SlowRobot,
    recorded_elbows,
    short_files,
    use_backends,
)
from support.plant_files import save
from support.waiting import PATIENCE, wait_until

AFFINE = ["--model-type", "affine", "--calibration", "none"]
"""Where the models are not the subject: they are fitted at once, to runs of single joints."""


@pytest.fixture
def elbows(request: pytest.FixtureRequest) -> Path:
    return recorded_elbows(request)


def test_models_of_both_sides_are_written_and_recordings_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pepper_driver.cli.console.LINE_INTERVAL", 0.001)
    out, figures = tmp_path / "models.json", tmp_path / "fit.json"
    options = ["--joints", "LElbowRoll", "--workers", "1", *short_files(tmp_path)]
    assert run(["identify", "--out", str(out), "--json", str(figures), *options]) == 0
    models = ModelSet.load(out)
    assert set(models.models) == {"LElbowRoll", "RElbowRoll"}
    assert "--joints LElbowRoll --model-type fusion --seed 0" in models.created_by
    content = json.loads(figures.read_text())
    assert set(content["fit"]) == {"fusion", "affine", "cart", "closed form"}
    assert set(content["fit"]["affine"]) == set(models.models)
    assert content["recorded"] == ["LElbowRoll"]
    assert {"kind": "excitation", "joint": "LElbowRoll"}.items() <= content["warnings"][0].items()
    shown = capsys.readouterr().out
    assert "NRMSE" in shown
    assert "fitted to mirrored recordings: RElbowRoll" in shown
    assert "warning: LElbowRoll: too little excitation" in shown
    assert len(load_recordings(tmp_path / "models-recordings", ROBOT).calibration) == 4

    # It says beforehand how long it takes.
    lines = shown.splitlines()
    assert lines[0].startswith("runs of ")
    assert lines[0].endswith(" in robot time to record")
    runs = [line for line in lines if line.startswith("recording in simulation: LElbowRoll-")]
    assert runs
    assert all(" left" in line for line in runs)
    assert lines.count("fitting models") == 1
    assert max(map(lines.index, runs)) < lines.index("fitting models")


def test_other_models_are_fitted_to_the_same_recordings(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    elbows: Path,
) -> None:
    monkeypatch.setattr(identify_module, "perform", None)  # nothing is driven
    options = ["--fit-only", "--recordings", str(elbows), "--model-type", "cart"]
    options += ["--share-types", "--no-mirror"]
    assert run(["identify", "--out", str(tmp_path / "cart.json"), *options]) == 0
    models = ModelSet.load(tmp_path / "cart.json")
    assert models.kind == "cart"
    assert models.models["HeadPitch"] == models.models["LElbowRoll"]
    assert models.created_by.endswith("--no-mirror --share-types")
    assert "what shared models cost" in capsys.readouterr().out


def test_models_with_blind_joints_are_written_only_when_they_are_accepted(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    elbows: Path,
) -> None:
    monkeypatch.setattr(identify_module, "perform", None)  # nothing is driven
    out = tmp_path / "models.json"
    options = ["--fit-only", "--recordings", str(elbows), "--out", str(out)]
    assert run(["identify", *options]) == 0
    assert "N at the hand" in capsys.readouterr().out
    out.unlink()
    monkeypatch.setattr("pepper_driver.identification.sensitivity.MIN_FIT", 100.5)
    assert run(["identify", *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "LElbowRoll is blind" in line
    assert line.endswith(f"--recordings {elbows} --out {out} --accept-blind")
    assert not out.exists()
    # The command that is printed makes the models that were asked for.
    assert run(["identify", *options, "--no-mirror", "--share-types"]) == 2
    command = capsys.readouterr().err.partition("pepper identify")[2].split()
    assert command[-3:] == ["--accept-blind", "--no-mirror", "--share-types"]
    assert run(["identify", *command]) == 0
    assert "warning: LElbowRoll: is blind" in capsys.readouterr().out
    written = ModelSet.load(out)
    assert set(written.models) == {"LElbowRoll", "RElbowRoll", "HeadPitch"}
    assert written.created_by.endswith("--no-mirror --share-types")


def test_one_bad_joint_is_blind_and_does_not_cost_the_others(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    elbows: Path,
) -> None:
    monkeypatch.setattr(identify_module, "perform", None)  # nothing is driven
    out, right = tmp_path / "models.json", ROBOT.joint_index("RElbowRoll")
    for path in elbows.glob("RElbowRoll-*.npz"):
        run_ = Recording.load(path, ROBOT)
        position = run_.position.copy()
        position[:, right] -= 0.5
        replace(run_, position=position).save(path)
    options = ["--fit-only", "--recordings", str(elbows), "--out", str(out), "--workers", "1"]
    assert run(["identify", *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "RElbowRoll is blind: it has no model. RElbowRoll: it falls behind" in line
    assert run(["identify", *options, "--accept-blind"]) == 0
    assert "warning: RElbowRoll: is blind: it has no model" in capsys.readouterr().out
    assert set(ModelSet.load(out).models) == {"LElbowRoll", "HeadPitch"}


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--fit-only"], "no recordings there"),
        (["--fit-only", "--seed", "1"], "'--seed': with '--fit-only'"),
        (["--fit-only", "--backend", "mujoco"], "'--backend': with '--fit-only'"),
        (["--weight", "5"], "0.2 to 0.6 kg, got 5"),
        (["--weight", "nan"], "finite"),
        (["--weight", "0.5", "--no-measure"], "leave '--no-measure' out"),
        (["--weight", "0.5", "--fit-only"], "'--weight': with '--fit-only'"),
        (["--hand", "middle"], "middle"),
        (["--workers", "0"], "--workers"),
        (["--workers", "-2"], "workers"),
        (["--calibration", "demo"], "leave them out"),
        (["--recordings", "/dev/null/x"], "/dev/null/x"),
    ],
)
def test_a_wrong_option_is_one_line_and_code_2(
    options: list[str],
    word: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["identify", "--out", "x.json", *options]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert word in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_keeps_finished_runs_and_says_how_to_go_on(tmp_path: Path) -> None:
    out, folder = tmp_path / "models.json", tmp_path / "kept"
    command = [
        sys.executable,
        "-m",
        "pepper_driver",
        "identify",
        "--out",
        str(out),
        "--workers",
        "2",
    ]
    command += ["--joints", "LElbowRoll,LElbowYaw,LHand", "--recordings", str(folder)]
    process = subprocess.Popen(
        [*command, *short_files(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        # A busy machine takes long for the first run; a signal before it would keep none.
        assert wait_until(lambda: list(folder.glob("*.npz")), 20 * PATIENCE)
        process.send_signal(signal.SIGINT)
        shown, errors = process.communicate(timeout=60)  # which waits for the workers too
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 130
    assert errors == "pepper: interrupted\n"
    assert f"of 13 runs are kept in {folder}; the same command continues from there" in shown
    assert not out.exists()
    kept = [path.name for path in folder.iterdir() if not path.name.startswith(".")]
    assert 1 < len(kept) < 14


def test_other_signals_keep_finished_runs_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def terminated_in_the_second(uri: str, run: IdentificationRun, *, identity: str) -> Recording:
        if run.name != "HeadPitch-1":
            signal.raise_signal(signal.SIGTERM)
        return perform(uri, run)

    monkeypatch.setattr(identify_module, "perform", terminated_in_the_second)
    options = ["--joints", "HeadPitch", "--workers", "1", *AFFINE, *short_files(tmp_path)[:3]]
    with raised_signals():
        assert run(["identify", "--out", str(tmp_path / "m.json"), *options]) == 143
    captured = capsys.readouterr()
    assert captured.err == "pepper: terminated\n"
    folder = tmp_path / "m-recordings"
    assert (
        f"1 of 3 runs are kept in {folder}; the same command continues from there" in captured.out
    )
    assert not (tmp_path / "m.json").exists()
    assert {path.name for path in folder.iterdir()} == {MANIFEST, "HeadPitch-1.npz"}


REAL = ["--backend", "fake://robot", "--workers", "1"]


def test_the_operator_is_asked_before_legs_and_base_move(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = use_backends(monkeypatch, SlowRobot)
    monkeypatch.setattr(sys, "stdin", io.StringIO("y\nn\n"))
    options = ["--out", str(tmp_path / "m.json"), "--joints", "HeadPitch,KneePitch", *REAL]
    options += [*AFFINE[:2], *short_files(tmp_path)]
    assert run(["identify", *options]) == 130
    captured = capsys.readouterr()
    # The head without a word, one run of the knee; the second was refused.
    assert captured.out.count("the legs move") == 2
    assert "4 of 10 runs are kept" in captured.out
    assert captured.err.strip().splitlines()[-1] == "pepper: interrupted"
    assert [robot.calls[-1] for robot in made[1:]] == ["close"] * 4

    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert run(["identify", *options]) == 130, "no one answers"
    assert run(["identify", *options, "--yes"]) == 0
    assert set(ModelSet.load(tmp_path / "m.json").models) == {"HeadPitch", "KneePitch"}


@pytest.mark.parametrize("command", [["identify"], ["first-hour", "--label", "head"]])
def test_a_weight_needs_a_person_at_a_real_robot(
    command: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("pepper_driver.cli.identify.make_backend", lambda uri: SlowRobot())
    options = ["--backend", "fake://robot", "--weight", "0.5", "--yes"]
    assert run([*command, "--out", str(tmp_path / "x"), *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "leave '--yes' or '--weight' out" in line
    assert not list(tmp_path.iterdir())


def test_a_simulated_robot_holds_its_weight_without_a_person(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[str] = []

    def record(*_: object, **arguments: object) -> None:
        begun.append(str(arguments["weight"]))
        raise PepperError("here")

    monkeypatch.setattr("pepper_driver.cli.identify.record_joints", record)
    assert run(["identify", "--out", str(tmp_path / "x.json"), "--weight", "0.5", "--yes"]) == 2
    assert len(begun) == 1


def test_a_real_robot_is_closed_when_a_run_is_interrupted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = use_backends(monkeypatch, SlowRobot, SlowRobot, InterruptedRobot)
    options = ["--out", str(tmp_path / "m.json"), "--joints", "HeadPitch", *REAL, *AFFINE]
    assert run(["identify", *options, *short_files(tmp_path)[:3], "--yes"]) == 130
    assert "1 of 3 runs are kept" in capsys.readouterr().out
    assert made[-1].calls == ["open", "activate", "close"]
    assert {path.name for path in (tmp_path / "m-recordings").iterdir()} == {
        MANIFEST,
        "HeadPitch-1.npz",
    }


def test_all_runs_are_tried_dry_before_a_real_robot_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = use_backends(monkeypatch, SlowRobot)

    def refuse_the_last(run: object) -> None:
        if getattr(run, "name", "") == "calibration-4":
            raise DryRunError("run calibration-4 would fail")

    monkeypatch.setattr(identify_module, "check_dry_run", refuse_the_last)
    options = ["--out", str(tmp_path / "m.json"), "--joints", "HeadPitch", *REAL]
    assert run(["identify", *options, *short_files(tmp_path), "--yes"]) == 2
    assert "calibration-4 would fail" in capsys.readouterr().err
    assert len(made) == 1, "only asked who it is"


def test_legs_move_whatever_a_person_is_asked_for() -> None:
    knee, head = (plan_runs(ROBOT, [name], SHORT)[0] for name in ("KneePitch", "HeadPitch"))
    for run_, moves in ((knee, True), (head, False)):
        assert (run_.moves_legs, run_.after_weight().moves_legs) == (moves, moves)


def test_a_dry_run_passes_what_is_safe() -> None:
    check_dry_run(plan_runs(ROBOT, ["KneePitch"], SHORT)[-1])


def test_a_dry_run_refuses_what_the_controller_or_the_gate_would_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    knee = plan_runs(ROBOT, ["KneePitch"], SHORT)[0]
    lost = ControllerStatus(
        solver="relaxed", at_limit=(), active=(), violated=("balance at rest",), relaxed=()
    )
    with monkeypatch.context() as patch:
        patch.setattr(WholeBodyController, "status", lost)
        with pytest.raises(
            DryRunError,
            match=r"run KneePitch-1 would fail 0\.\d s after .*\(balance at rest\); nothing has moved",
        ):
            check_dry_run(knee)
    read = MockBackend.read
    monkeypatch.setattr(MockBackend, "read", lambda self: replace(read(self), age=0.2))
    with pytest.raises(DryRunError, match="the newest sample is 200 ms old; nothing has moved"):
        check_dry_run(knee)


def test_legs_are_not_moved_without_the_balance_constraint(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = use_backends(monkeypatch, SlowRobot)
    settings = load_controller_settings(ROBOT)
    loose = replace(settings, constraints=replace(settings.constraints, balance=False))
    monkeypatch.setattr(identify_module, "load_controller_settings", lambda robot: loose)
    options = ["--out", str(tmp_path / "m.json"), "--joints", "HipRoll", *REAL, "--yes"]
    assert run(["identify", *options, *short_files(tmp_path)]) == 2
    assert "'constraints.balance' is false" in capsys.readouterr().err
    assert len(made) == 1


def test_many_robots_are_identified_counted_and_taken_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Some draws have a gap that is wider than the range of the hand.
    plant = save(
        tmp_path, {"name": "mine", "extends": "random", "factors": {"half_gap": {"LHand": 50.0}}}
    )
    options = ["--out", str(tmp_path / "out"), "--joints", "LElbowRoll", "--workers", "2"]
    options += ["--backend", f"mujoco://?plant={plant}", "--json", str(tmp_path / "figures.json")]
    options += [*AFFINE, "--experiment", short_files(tmp_path)[2]]
    assert run(["identify", "--draws", "0-3", *options]) == 1
    content = json.loads((tmp_path / "figures.json").read_text())
    states = {draw: robot["state"] for draw, robot in content["robots"].items()}
    good = [draw for draw, state in states.items() if state == "identified"]
    failed = ", ".join(f"mine-{draw}" for draw, state in states.items() if state == "failed")
    assert (content["identified"], content["failed"]) == (len(good), 4 - len(good))
    assert 0 < len(good) < 4
    lines = capsys.readouterr().out.splitlines()
    counted = next(line for line in lines if "robots identified" in line)
    assert counted.startswith(f"{len(good)} of 4 robots identified; {len(good)} with warnings; ")
    assert counted.endswith(f"failed: {failed}")
    reasons = [line for line in lines if line.startswith("failed: mine-")]
    assert len(reasons) == 4 - len(good)
    assert all("the gap of LHand is wider than the joint's range" in line for line in reasons)
    for draw in good:
        robot = content["robots"][draw]
        assert set(robot["fit"]) == {"affine"}
        assert set(ModelSet.load(robot["file"]).models) == {"LElbowRoll", "RElbowRoll"}

    monkeypatch.setattr(
        "pepper_driver.identification.population.run_jobs", lambda *a, **k: iter(())
    )
    assert run(["identify", "--draws", ",".join(good), *options]) == 0
    shown = capsys.readouterr().out
    assert f"{len(good)} of {len(good)} robots identified, {len(good)} of them earlier" in shown


@pytest.mark.parametrize("hand", ["left", "right"])
def test_many_robots_are_identified_with_a_weight(
    hand: Hand, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[object] = []

    def identified(*_: object, **options: object) -> tuple[()]:
        asked.append(options["weight"])
        return ()

    monkeypatch.setattr(cli_identify, "identify_population", identified)
    options = ["--backend", "mujoco://?plant=random", "--draws", "0-1", "--out", str(tmp_path)]
    assert run(["identify", *options]) == 0
    assert run(["identify", *options, "--weight", "0.4", "--hand", hand]) == 0
    assert asked == [None, held_weight(0.4, hand)]


def test_ctrl_c_in_a_population_says_how_to_go_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(identify_module, "perform", interrupted)
    options = ["--backend", "mujoco://?plant=random", "--draws", "0-1", "--workers", "1", *AFFINE]
    code = run(["identify", "--out", str(tmp_path / "out"), *options])
    assert code == 130
    assert "0 of 2 robots are done; the same command continues" in capsys.readouterr().out
