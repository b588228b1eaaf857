"""``pepper evaluate`` as a user meets it: one short simulated episode, recordings, wrong input."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pepper_driver.cli import evaluate as command
from pepper_driver.cli.app import run
from pepper_driver.config import load_robot
from pepper_driver.config.evaluation import EvaluationSuites, load_evaluation
from pepper_driver.controller import Tick
from pepper_driver.evaluation import episodes
from pepper_driver.evaluation.touch import split
from pepper_driver.evaluation.touch.split import Judging
from pepper_driver.log import Label, LogWriter
from pepper_driver.loop import TickRecord
from pepper_driver.observer import Observation
from pepper_driver.robot import Pepper
from support.evaluation import at_once
from support.touch_robots import FAILS, identified, two_takes

ROBOT = load_robot()


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first experiment of Table I with one set-point that is pushed at, and no free motion before it."""
    whole = load_evaluation(ROBOT)
    first = replace(whole.suites["paper"][0], plants=("swaying",))
    experiments = {
        **whole.experiments,
        first.experiment: at_once(whole.experiments[first.experiment]),
    }

    def load(_: object) -> EvaluationSuites:
        return replace(whole, suites={"paper": (first,)}, experiments=experiments)

    monkeypatch.setattr(command, "load_evaluation", load)


@pytest.mark.usefixtures("short")
def test_a_episode_from_simulation_to_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results, page, cache = (
        tmp_path / "f.json",
        tmp_path / "docs" / "results.md",
        tmp_path / "episodes",
    )
    arguments = ["evaluate", "--suite", "paper", "--observer", "paper,oracle", "--workers", "1"]
    arguments += ["--json", str(results), "--cache", str(cache), "--report", str(page)]
    assert run(arguments) == 0
    shown = capsys.readouterr().out
    assert "in simulation" in shown
    assert "LSRoll, FP/FN/TP" in shown
    content = json.loads(results.read_text())
    assert set(content["modes"]) == {"paper-affine", "oracle"}
    for mode in content["modes"].values():
        table = mode["suites"]["paper"]["table1"]
        total = table["total"]
        assert total == table["LSRoll"]
        assert (total["fp"], total["fn"] + total["tp"]) == (0, 2)
    assert page.read_text().startswith("*All results here are simulated. `pepper evaluate --suite")
    assert (tmp_path / "docs" / "results" / "figure3.png").exists()
    # Once more from the cache: nothing is simulated, and the results are the same.
    again = tmp_path / "again.json"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(episodes, "_performed", None)
        assert run([*arguments[:7], "--cache", str(cache), "--json", str(again)]) == 0
    second = json.loads(again.read_text())
    assert second["modes"] == content["modes"]


@pytest.mark.usefixtures("short")
def test_a_failed_episode_is_reported_and_is_exit_code_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def falls(*_: object) -> None:
        raise episodes.EpisodeError("it tipped")

    monkeypatch.setattr(episodes, "_performed", falls)
    arguments = ["evaluate", "--suite", "paper", "--observer", "paper", "--workers", "1"]
    json_file = tmp_path / "f.json"
    assert run([*arguments, "--cache", str(tmp_path / "c"), "--json", str(json_file)]) == 1
    assert "failed: paper, LSRoll on swaying" in capsys.readouterr().out
    assert "it tipped" in json.loads(json_file.read_text())["failures"][0]["reason"]


def labelled(path: Path, *, labels: bool = True) -> Path:
    """A log in which the left arm is pushed from 1.0 to 1.8 s, with a label."""
    with Pepper("mujoco://?seed=3", observer=None, robot=ROBOT) as pepper:
        metadata = {"identity": pepper.backend.info.identity}
        with LogWriter(path, ROBOT, metadata, lossless=True) as log:
            start = pepper.time
            pepper.push("LForeArm", [0.0, 35.0, 0.0], duration=0.8, delay=1.0)

            def on_tick(tick: Tick, _: Observation | None) -> None:
                ends = []
                for after, phase in ((1.0, "onset"), (1.8, "release")):
                    late = tick.measurement.time - start - after
                    if labels and 0 <= late < ROBOT.cycle - 1e-9:
                        ends.append(
                            Label(
                                time=tick.measurement.time,
                                phase="onset" if phase == "onset" else "release",
                                source="key",
                                link="LForeArm",
                                joint="LShoulderRoll",
                            )
                        )
                log.append(TickRecord(tick=tick, labels=ends))

            pepper.run(3.0, on_tick=on_tick)
    return path


def observer_of(results: Path, name: str) -> dict[str, Any]:
    """Return the results of one observer of a file of results."""
    observers: list[dict[str, Any]] = json.loads(results.read_text())["observers"]
    return next(one for one in observers if one["name"] == name)


def false_of(observer: dict[str, Any]) -> dict[str, Any]:
    """Return all its false contacts."""
    groups: list[dict[str, Any]] = observer["false"]
    found: dict[str, Any] = next(
        group["contacts"]
        for group in groups
        if {group["suite"], group["law"], group["by"]} == {"all"}
    )
    return found


def test_labelled_recordings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, bare = labelled(tmp_path / "a.mcap"), labelled(tmp_path / "b.mcap", labels=False)
    results, page = tmp_path / "f.json", tmp_path / "r.md"
    arguments = ["evaluate", "--observer", "paper", "--workers", "1", "--json", str(results)]
    arguments += ["--report", str(page), "--log", str(log)]
    assert run(arguments) == 0
    observer = observer_of(results, "paper-affine")
    (robot,) = observer["robots"]
    assert (robot["detected"]["count"], robot["detected"]["of"]) == (1, 1)
    false = false_of(observer)
    assert false["begins"] == 0
    # Left arm 0.8 s and the grace of 0.3 s of the 3 s, the other three limbs all the time.
    assert 3600.0 * false["hours"] == pytest.approx(3.0 - 1.1 / 4.0, abs=0.03)
    text = page.read_text()
    assert "simulated" not in text.splitlines()[0]
    assert "1 of 1" in capsys.readouterr().out
    # A second one, without labels, is reported; the first still counts.
    assert run([*arguments, str(bare)]) == 1
    assert "has no labelled touch" in capsys.readouterr().out
    assert observer_of(results, "paper-affine")["robots"][0]["detected"]["count"] == 1


def test_a_simulated_run_needs_no_labels(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, results = tmp_path / "a.mcap", tmp_path / "f.json"
    with Pepper("mujoco://?seed=3", observer=None, robot=ROBOT, log=log) as pepper:
        pepper.push("LForeArm", [0.0, 29.0, 0.0], duration=0.8, delay=1.0)
        pepper.run(3.0)
        pepper.push("base_link", [1.0, 0.0, 0.0], duration=0.3)  # too light to be detected
        pepper.run(1.0)
    assert run(["evaluate", "--workers", "1", "--json", str(results), "--log", str(log)]) == 0
    assert "1 of 2" in capsys.readouterr().out
    observer = observer_of(results, "paper-affine")
    names = {one["name"] for one in json.loads(results.read_text())["observers"]}
    assert names == {"fusion", "paper-affine", "paper-cart", "momentum"}, "no oracle of a recording"
    (robot,) = observer["robots"]
    assert (robot["detected"]["count"], robot["detected"]["of"]) == (1, 2)
    assert false_of(observer)["begins"] == 0
    # N90 of each state is computed for the first observer alone.
    cells = observer_of(results, "fusion")["cells"]
    places = {cell["place"]: cell["detected"]["count"] for cell in cells}
    assert places == {"forearm": 1, "elsewhere": 0}


def test_robots_of_a_split_from_touch_to_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(split, "identify_population", identified)
    monkeypatch.setattr(Judging, "specs", two_takes)
    monkeypatch.setattr(command, "_reference", lambda *_: None)  # minutes
    results, page = tmp_path / "f.json", tmp_path / "r.md"
    arguments = ["evaluate", "--split", "development", "--draws", f"0,{FAILS}", "--workers", "1"]
    arguments += ["--observer", "fusion,momentum", "--folder", str(tmp_path / "work")]
    assert run([*arguments, "--json", str(results), "--report", str(page)]) == 1
    shown = capsys.readouterr().out
    assert "by the events of a program" in shown
    assert (
        f"failed: random {FAILS}: not identified, its touches count as not detected: it broke"
        in shown
    )
    content = json.loads(results.read_text())
    assert (content["split"], content["look"]) == ("development", None)
    for name in ("fusion", "momentum"):
        robots = {r["robot"]: r["detected"]["of"] for r in observer_of(results, name)["robots"]}
        assert set(robots) == {"random 0", f"random {FAILS}"}
    text = page.read_text()
    assert "Development split" in text
    assert "it broke" in text
    assert "![touch_map](r/touch_map.png)" in text
    assert (tmp_path / "r" / "touch_map.png").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--suite", "pper"], "unknown suite 'pper' (did you mean paper"),
        (["--suite", "paper,typs"], "unknown suite 'typs' (did you mean types"),
        (["--suite", "paper", "--observer", "papr"], "unknown mode 'papr' (did you mean paper"),
        (["--suite", "paper", "--models", "nowhere.json"], "nowhere.json: cannot be read"),
        (["--suite", "paper", "--report", "page.html"], "ends in .md"),
        (["--suite", "paper", "--json", "/proc/x.json"], "cannot be written"),
        (["--suite", "paper", "--cache", "/proc/x"], "cannot be made"),
        ([], "give either --suite or --log; suites: "),
        (["--suite", "paper", "--log", "x.mcap"], "give either --suite or --log"),
        (["paper"], "paper: recordings come after --log"),
        (["--draws", "0"], "--draws belongs to --split"),
        (["--split", "test", "--draws", "0"], "is judged whole: leave out --draws"),
        (["--split", "test", "--quick"], "is judged whole: leave out --quick"),
        (
            ["--split", "development", "--draws", "99-100"],
            "draw 100 is held out for the test split",
        ),
        (["--split", "development", "--draws", "3-1"], "ends before it begins"),
        (["--split", "development", "--suite", "touc"], "has the suites touch and free"),
        (["--split", "development", "--observer", "fusio"], "unknown observer 'fusio'"),
        (["--split", "development", "--log", "x.mcap"], "--log and --split exclude each other"),
        (["--split", "tset"], "tset"),
        (["--log", "no.mcap"], "no.mcap: cannot be read (there is no such file)"),
        (["--suite", "paper", "--workers", "0"], "workers"),
    ],
)
def test_wrong_input_is_one_line(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["evaluate", *arguments]) == 2
    reported = capsys.readouterr().err
    assert reported.count("\n") == 1
    assert words in reported
    assert not list(tmp_path.iterdir())
