"""``pepper evaluate --log BUNDLE``: the first hour of a robot, from its archive to the page."""

import json
import shutil
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from pepper_driver.cli import evaluate_bundle
from pepper_driver.cli.app import run
from pepper_driver.config import load_robot
from pepper_driver.config.touch_prompts import TouchPrompt, TouchPrompts
from pepper_driver.evaluation.touch.ledger import Look
from pepper_driver.evaluation.touch.records import RobotRecord
from pepper_driver.first_hour.bundle import PLACES
from pepper_driver.first_hour.state import STATE, STEPS, save_state
from pepper_driver.log import LogWriter
from pepper_driver.observer.models.model_file import ModelSet, shipped
from pepper_driver.recording.record import record_labelled
from pepper_driver.robot import Pepper
from support.first_hour import finished_hour, make_hour, zip_of
from support.touch_records import drawn_robot

ROBOT = load_robot()
SENSOR = ROBOT.sensors.touch["Head/Touch/Front"]
PROMPTS = TouchPrompts(
    version=1,
    rest=1.0,
    time=2.0,
    touches=(
        TouchPrompt(say="My head.", link="Head", force=20.0),
        TouchPrompt(say="My head, hardly.", link="Head", force=2.0),
        TouchPrompt(say="My chest.", link="torso"),
    ),
)


def touch_twice(pepper: Pepper) -> None:
    for delay, force in ((1.3, 20.0), (3.3, 1.5)):
        pepper.push("Head", (-force, 0.0, 0.0), SENSOR.xyz, 0.8, delay=delay)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a rehearsed hour of `nominal`: the head is pushed twice, the second time hardly."""
    folder = tmp_path_factory.mktemp("hour")
    make_hour(folder)
    identity = Pepper("mujoco", observer=None).backend.info.identity
    models = ModelSet.load(shipped("fusion")["nominal"])
    replace(models, identity=identity).save(folder / PLACES["models"])
    hour = replace(finished_hour(), identity=identity, simulated=True, prompts=PROMPTS)
    hour = hour.done("free", {"false_contacts": 3}).reopened("free").begun("free").begun("free")
    save_state(folder / STATE, hour.done("free", {"false_contacts": 1}).done("pack", {}))
    for part in ("rest", "free"):
        with Pepper("mujoco", observer=None, log=folder / PLACES[part]) as pepper:
            if part == "free":  # someone touches it although it is to be left alone
                pepper.push("Head", (-8.0, 0.0, 0.0), SENSOR.xyz, 0.5, delay=0.5)
            pepper.run(1.5)
    record_labelled(
        "mujoco", folder / "touches.mcap", "head", prompts=PROMPTS, on_start=touch_twice
    )
    return folder


def evaluate(path: Path, tmp_path: Path, *more: str) -> tuple[int, dict[str, Any]]:
    results = tmp_path / "f.json"
    arguments = ["evaluate", "--observer", "fusion,error", "--workers", "1"]
    status = run([*arguments, "--json", str(results), "--log", str(path), *more])
    return status, json.loads(results.read_text())


def drawn_look() -> tuple[Look, tuple[RobotRecord, ...]]:
    middles = {"standing": {"head": {"fusion": 6.0}, "hand": {"fusion": 9.0}}}
    look = Look(
        look=3,
        begun=datetime(2026, 1, 2, tzinfo=UTC),
        ended=datetime(2026, 1, 2, tzinfo=UTC),
        commit="0" * 40,
        code="c",
        constants="c",
        suites="s",
        draws="100",
        state="complete",
        robots_done=1,
        robots=1,
    )
    return look, (drawn_robot(100, "nominal", middles, false={"fusion": 2.0}),)


def test_from_an_archive_to_the_page_with_the_last_look(
    bundle: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    look, records = drawn_look()
    begun = replace(look, look=4, state="begun", ended=None)
    monkeypatch.setattr(evaluate_bundle, "read_ledger", lambda _: (look, begun))
    monkeypatch.setattr(evaluate_bundle, "records_of_look", lambda *_: records)
    page = tmp_path / "docs" / "mine.md"
    archive = zip_of(bundle, tmp_path / "hour.zip")
    status, content = evaluate(archive, tmp_path, "--report", str(page))
    assert status == 0
    (one,) = content["bundles"]
    assert (one["simulated"], one["touches"], one["asked"]) == (True, 2, 3)
    assert one["pressed"] == {"free": {"Head/Touch/Front": 1}}
    assert one["attempts"] == {"free": 3}
    assert {observer["name"] for observer in content["observers"]} == {"fusion", "error"}
    fusion = content["observers"][0]
    # Its own models detect the push of 20 N; one of 1.5 N is hidden by friction.
    assert fusion["robots"][0]["detected"]["count"] == 1
    (cell,) = fusion["cells"]
    assert (cell["place"], cell["state"]) == ("head", "standing")
    assert [force["asked"] for force in cell["forces"]] == [2.0, 20.0]
    assert 2.0 < cell["n90"]["newtons"] <= 20.0
    (hours,) = (
        group["contacts"]["hours"]
        for group in fusion["false"]
        if (group["suite"], group["law"], group["by"]) == ("free", "all", "all")
    )
    assert 3600.0 * hours == pytest.approx(3.0, abs=0.3)
    text = page.read_text()
    assert "hour.zip: a SIMULATED robot, a rehearsal" in text
    assert "2 labelled touches of 3 asked for, marked by `head`" in text
    assert "There is no ground truth" in text
    assert (
        "the log `free` that is judged is attempt 3; 1 before ended early, 1 before made again (false contacts: 3)."
        in text
    )
    assert "Head/Touch/Front was pressed 1 times: someone may have touched" in text
    assert "## Compared with simulated robots" in text
    assert "look 3 (draws 100)" in text
    assert "simulated, `nominal`: N90 [N]" in text
    for section in ("Touch at a glance", "False contacts", "Limits", "Looks at the test robots"):
        assert f"## {section}" in text
    assert (tmp_path / "docs" / "mine" / "touch_map.png").exists()
    assert "a SIMULATED robot" in capsys.readouterr().out


def test_of_unknown_forces_fractions_and_no_n90(
    bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = shutil.copytree(bundle, tmp_path / "own")
    state = replace(finished_hour(), simulated=False, prompts=PROMPTS)
    identity = json.loads((bundle / STATE).read_text())["identity"]
    save_state(own / STATE, replace(state, identity=identity))
    prompts = replace(PROMPTS, touches=tuple(replace(t, force=None) for t in PROMPTS.touches[:2]))
    record_labelled("mujoco", own / "touches.mcap", "head", prompts=prompts, on_start=touch_twice)
    monkeypatch.setattr(evaluate_bundle, "read_ledger", lambda _: ())
    page = tmp_path / "mine.md"
    status, content = evaluate(own, tmp_path, "--report", str(page))
    assert status == 0
    (cell,) = content["observers"][0]["cells"]
    assert (cell["n90"], cell["forces"], cell["detected"]["count"]) == (None, [], 1)
    text = page.read_text()
    assert text.startswith("*All results here are from recordings.")
    assert "own: a REAL robot" in text
    assert "of none of them the force is known, so there are fractions and no N90" in text
    assert "| head, standing | 0.50 (0.09-0.91), 1 of 2 |" in text
    assert "No look at the simulated test robots is complete here" in text
    assert "Compared with simulated robots" not in text
    assert "In simulation: no result here is of a real robot" not in text


def test_a_bundle_whose_touches_have_no_label_is_reported_and_the_other_counts(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = shutil.copytree(bundle, tmp_path / "other")
    shutil.copy(bundle / "rest.mcap", other / "touches.mcap")
    status, content = evaluate(bundle, tmp_path, str(other))
    assert status == 1
    assert [one["robot"] for one in content["bundles"]] == [bundle.name]
    (failure,) = content["failures"]
    assert failure["title"] == str(other)
    assert "touches: this log has no labelled touch" in failure["reason"]
    assert "failed: " in capsys.readouterr().out


def without_touches(folder: Path) -> None:
    hour = finished_hour()
    for name in STEPS[: STEPS.index("touches")]:
        hour = hour.done(name, {})
    identity = json.loads((folder / STATE).read_text())["identity"]
    save_state(folder / STATE, replace(hour.reopened("touches"), identity=identity))


def of_another_robot(folder: Path) -> None:
    about = {"identity": "another", "cycle": str(ROBOT.cycle)}
    with LogWriter(folder / "free.mcap", ROBOT, about):
        pass


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        (without_touches, "step 'touches' is not done, so it has no touches.mcap"),
        (lambda folder: (folder / "models.json").unlink(), "models.json is missing"),
        (lambda folder: (folder / "models.json").write_text("{"), "models.json cannot be read"),
        (of_another_robot, "the files of two robots are mixed"),
        (lambda folder: (folder / STATE).write_text('{"format": 9}'), "format 9 is not the format"),
        (lambda folder: (folder / STATE).unlink(), "no first_hour.json"),
    ],
)
def test_a_bundle_that_is_not_whole_is_one_line(
    harm: Any,
    words: str,
    bundle: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    own = shutil.copytree(bundle, tmp_path / "own")
    harm(own)
    assert run(["evaluate", "--workers", "1", "--log", str(own)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
    assert str(own) in line


def test_what_does_not_go_together_is_one_line(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged = tmp_path / "x.zip"
    damaged.write_bytes(b"PK\x03\x04 no archive")
    cases = {
        (str(bundle), str(bundle / "rest.mcap")): "a log among bundles of a first hour",
        (str(bundle), str(bundle)): "this bundle is given twice",
        (str(bundle), "--models", str(bundle / "models.json")): "has the models of its own robot",
        (str(bundle), "--observer", "fusin"): "unknown observer 'fusin'",
        (str(damaged),): "is no archive of a first hour, or damaged",
        (str(tmp_path / "none.zip"),): "there is no such file or folder",
    }
    for arguments, words in cases.items():
        assert run(["evaluate", "--workers", "1", "--log", *arguments]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert words in line
