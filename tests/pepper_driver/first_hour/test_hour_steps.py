"""Steps of a first hour on robots: what they record, and what is packed of it."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from pepper_driver.backends import BackendInfo
from pepper_driver.cli.app import run
from pepper_driver.cli.console import make_console
from pepper_driver.cli.first_hour import ConsoleDisplay
from pepper_driver.config import PepperError
from pepper_driver.config.files import set_aside, write_json
from pepper_driver.config.first_hour import load_first_hour
from pepper_driver.config.loading import package_file, read_yaml
from pepper_driver.doctor import Verdict, examine, try_motion
from pepper_driver.doctor.motion_test import make_pepper
from pepper_driver.first_hour import steps as steps_module
from pepper_driver.first_hour.bundle import ARCHIVE, open_bundle
from pepper_driver.first_hour.operator import Operator
from pepper_driver.first_hour.pack import pack_bundle
from pepper_driver.first_hour.plan import HourPlan, plan_hour, standing
from pepper_driver.first_hour.state import STATE, load_state, save_state
from pepper_driver.first_hour.steps import RobotSteps
from pepper_driver.identification import fit_folder, load_recordings
from pepper_driver.identification.identify import OnTouch, Repeat
from pepper_driver.identification.quality import Finding
from pepper_driver.log import LogWriter, read_log
from pepper_driver.log.topics import LogEvent
from pepper_driver.loop import Labelling
from pepper_driver.observer.models.model_file import ModelSet, shipped
from pepper_driver.robot import Pepper
from support.first_hour import INFO, ROBOT, finished_hour, make_hour

SERIAL = "AP990438A03Y12300042"
URI = "naoqis://anna@pepper-7.lab.example"


def tiny_plan(folder: Path) -> Path:
    """Write a plan with few joints, goals and touches; returns its file."""
    settings = read_yaml(package_file("first_hour.yaml"))
    for key in ("experiment", "calibration", "free"):
        content = read_yaml(package_file("experiments", f"{settings[key]}.yaml"))
        (goals,) = content["steps"][0].values()
        if key == "experiment":
            goals |= {"joints": ["LShoulderPitch"], "estimation_stiffness": [3.0]}
            goals |= {"sweeps": 2, "setpoints": 2, "dwell": [0.6, 1.2]}
        else:
            goals["count"] = 4
        settings[key] = str(folder / f"{key}.yaml")
        Path(settings[key]).write_text(yaml.safe_dump(content))
    prompts = {
        "version": 1,
        "rest": 1.0,
        "time": 2.0,
        "touches": [{"say": "My head.", "link": "Head"}, {"say": "My hand.", "link": "l_wrist"}],
    }
    settings |= {"prompts": str(folder / "prompts.yaml"), "rest": 2.0}
    Path(settings["prompts"]).write_text(yaml.safe_dump(prompts))
    plan = folder / "plan.yaml"
    plan.write_text(yaml.safe_dump(settings))
    return plan


def hour_plan(path: Path) -> HourPlan:
    return plan_hour(ROBOT, load_first_hour(path), label="head")


def test_with_models_the_robot_stands_moves_asks_and_all_is_packed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, plan = tmp_path / "hour", tiny_plan(tmp_path)
    hour = make_hour(folder)
    planned = hour_plan(plan)
    asked = replace(hour, plan=planned.hash(), prompts=planned.prompts)
    save_state(folder / STATE, asked.reopened("rest").reopened("free").reopened("touches"))
    earlier = (folder / "free.mcap").read_bytes()
    arguments = ["first-hour", "--backend", "mock", "--out", str(folder), "--plan", str(plan)]
    assert run([*arguments, "--label", "head", "--yes"]) == 0
    shown = capsys.readouterr().out
    assert "Begin step 'doctor'" not in shown
    assert shown.index("Begin step 'rest'") < shown.index("Begin step 'free'")
    assert "1. My head." in shown
    assert "0 of 2 touches were labelled" in shown
    assert (folder / "free.mcap.early-1").read_bytes() == earlier
    with open_bundle(folder / ARCHIVE) as bundle:
        assert bundle.state.next_step is None
        assert bundle.state.step("rest").figures["false_contacts"] == 0
        rest = read_log(bundle.rest)
        assert np.ptp(rest["time"]) == pytest.approx(2.0 + 3.0, abs=1.5)
        assert rest.metadata["identity"] == bundle.state.identity != hour.identity
        assert rest.metadata["observer_models_sha256"] == ModelSet.load(bundle.models).sha256()
        counted = bundle.state.step("free").figures["false_contacts"]
        free = read_log(bundle.free)
        moved = np.ptp(free["position"], axis=0) > 0.1
        legs = [ROBOT.joint_index(joint) for joint in ROBOT.chains["legs"]]
        assert moved.sum() > 10
        assert not moved[legs].any()
        assert not read_log(bundle.touches).labels
    # All is done: the same command does nothing more.
    capsys.readouterr()
    before = (folder / ARCHIVE).read_bytes()
    assert run([*arguments, "--label", "head", "--yes"]) == 0
    assert "Begin step" not in capsys.readouterr().out
    assert (folder / ARCHIVE).read_bytes() == before
    # But where it is asked for again.
    early = (folder / "free.mcap").read_bytes()
    assert run([*arguments, "--label", "head", "--yes", "--again", "free"]) == 0
    assert capsys.readouterr().out.count("Begin step") == 1
    assert (folder / "free.mcap.early-2").read_bytes() == early
    with open_bundle(folder / ARCHIVE) as bundle:
        before_it = bundle.state.step("free").earlier
        assert [figures.get("false_contacts") for figures in before_it] == [None, counted]


@pytest.mark.parametrize("identity", [SERIAL, f"{SERIAL}/angles"])
def test_nothing_in_the_archive_says_whose_robot_it_is(
    identity: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("platform.node", lambda: "annas-laptop.lab.example")
    monkeypatch.setattr("getpass.getuser", lambda: "anna.smith")
    folder = tmp_path / "hour"
    make_hour(folder)
    owned = replace(INFO, identity=identity, name="pepper-7.lab.example")
    rename(folder, owned)
    with open_bundle(folder) as bundle:
        assert SERIAL in texts_of(bundle.free)
        assert "pepper-9" in texts_of(bundle.free)
    pack_bundle(folder, tmp_path / "sent.zip", URI, owned)
    with open_bundle(tmp_path / "sent.zip") as bundle:
        assert bundle.state.identity == ModelSet.load(bundle.models).identity
        assert read_log(bundle.free).events[-1].text == "<robot> refuses <user>"
        texts = {log.name: texts_of(log) for log in (bundle.rest, bundle.free, bundle.touches)}
    with zipfile.ZipFile(tmp_path / "sent.zip") as archive:
        texts |= {name: archive.read(name).decode("latin-1") for name in archive.namelist()}
    for name, text in texts.items():
        for secret in (SERIAL, "pepper-7", "pepper-9", "lab.example", "anna", f"{Path.home()}/"):
            assert secret.lower() not in text.lower(), (name, secret)


def texts_of(path: Path) -> str:
    """Return all texts of a log: its chunks are compressed."""
    log = read_log(path)
    return repr((log.metadata, log.events))


def rename(folder: Path, info: BackendInfo) -> None:
    """Have all parts be of another robot, and name its addresses where those of a real one would."""
    for part in ("rest", "free", "touches"):
        # It had another address then.
        about = {"identity": info.identity, "cycle": str(info.cycle)}
        about["backend"] = "naoqis://anna@pepper-9.lab.example"
        with LogWriter(folder / f"{part}.mcap", ROBOT, about) as log:
            log.note(LogEvent(time=1.0, kind="fault", text="pepper-9.lab.example refuses anna"))
    save_state(folder / STATE, replace(finished_hour(), identity=info.identity))
    models = ModelSet.load(folder / "models.json")
    replace(models, identity=info.identity, created_by=f"pepper identify --backend {URI}").save(
        folder / "models.json"
    )
    path = folder / "identification" / "manifest.json"
    write_json(path, json.loads(path.read_text()) | {"identity": info.identity, "backend": URI})


def test_two_archives_of_one_hour_are_equal(tmp_path: Path) -> None:
    make_hour(tmp_path / "hour")
    for name in ("a.zip", "b.zip"):
        pack_bundle(tmp_path / "hour", tmp_path / name, "mock", INFO)
    one, other = (zipfile.ZipFile(tmp_path / name) for name in ("a.zip", "b.zip"))
    with one, other:
        for name in one.namelist():
            if name != STATE:  # it has the time of packing
                assert one.read(name) == other.read(name), name


def test_a_robot_without_models_is_moved_and_its_motion_is_judged() -> None:
    seen = examine("mock", unidentified=True)
    assert seen.models is None
    assert seen.passed
    moved = try_motion(make_pepper("mock", None, ROBOT), None)
    assert moved.passed
    assert {fit.verdict for fit in moved.fits} == {Verdict.NO_MODEL}
    assert [result.name for result in moved.results] == [
        "motion",
        "delay",
        "sensors",
        "joints follow",
    ]


def test_a_touch_while_no_one_may_touch_is_shown_with_the_way_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Touched(Pepper):
        def start_log(self, path: Path | str, label: Labelling | None = None) -> LogWriter:
            self.push("LForeArm", [0.0, 25.0, 0.0], duration=0.6, delay=3.5)
            return super().start_log(path, label)

    monkeypatch.setattr(steps_module, "Pepper", Touched)
    identity = Pepper("mujoco", observer=None).backend.info.identity
    nominal = ModelSet.load(shipped("fusion")["nominal"])
    replace(nominal, identity=identity).save(tmp_path / "models.json")
    steps = steps_on("mujoco", tmp_path, hour_plan(tiny_plan(tmp_path)))
    figures = steps.watch("rest", standing(2.0))
    assert figures["false_contacts"]
    shown = capsys.readouterr().out
    assert "false contact at" in shown
    assert "the same command with '--again rest' makes this step again" in shown


class Willing:
    """An operator who says yes to all that is asked."""

    def __init__(self) -> None:
        self.questions: list[str] = []

    def confirm(self, question: str) -> None:
        self.questions.append(question)

    def offer(self, question: str) -> bool:
        self.questions.append(question)
        return True


def steps_on(
    uri: str, folder: Path, plan: HourPlan, operator: Operator | None = None
) -> RobotSteps:
    return RobotSteps(
        uri=uri,
        info=INFO,
        robot=ROBOT,
        plan=plan,
        folder=folder,
        archive=folder / ARCHIVE,
        operator=operator or Willing(),
        display=ConsoleDisplay(make_console()),
    )


def test_a_touch_in_a_run_is_shown_at_once_and_the_run_is_offered_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, operator = hour_plan(tiny_plan(tmp_path)), Willing()
    sensor = "LHand/Touch/Back"

    def touched(*_: Any, on_touch: OnTouch, repeat: Repeat, **__: Any) -> None:
        run = plan.runs["measure"][0]
        on_touch(run, sensor)
        assert repeat(run, (sensor,))
        raise PepperError("that is enough")

    monkeypatch.setattr(steps_module, "record_joints", touched)
    with pytest.raises(PepperError, match="enough"):
        steps_on("mock", tmp_path, plan, operator).measure()
    assert f"{sensor} is pressed in run measure_response-1" in capsys.readouterr().out
    assert operator.questions == [f"{sensor} pressed in run measure_response-1. Record it again?"]


def test_a_run_that_looks_touched_is_offered_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A second such run after nothing touched the robot is its own doing: an hour must come to its end."""
    looks = [("calibration-4",), ("calibration-3", "calibration-4"), ("calibration-3",)]
    recorded: list[bool] = []

    def fitted(*_: Any, **__: Any) -> SimpleNamespace:
        findings = [
            Finding(kind="contact", joint="LElbowRoll", run=name, text="looks touched")
            for name in looks[len(recorded) - 1]
        ]
        return SimpleNamespace(
            findings=findings,
            fits={"fusion": {"LElbowRoll": SimpleNamespace(test=90.0)}},
            sensitivities={"LElbowRoll": SimpleNamespace(threshold=0.01)},
            blind=(),
            models=ModelSet.load(shipped("fusion")["nominal"]),
        )

    monkeypatch.setattr(steps_module, "record_joints", lambda *_, **__: recorded.append(True))
    monkeypatch.setattr(steps_module, "fit_folder", fitted)
    monkeypatch.setattr(ConsoleDisplay, "identification", lambda *_: None)
    operator = Willing()
    steps = steps_on("mock", tmp_path, hour_plan(tiny_plan(tmp_path)), operator)
    figures = steps.identify()
    assert len(recorded) == len(looks)
    assert operator.questions == ["Record this again?"] * 2
    shown = " ".join(capsys.readouterr().out.split())
    assert "calibration-4: looks touched again, and is kept" in shown
    assert figures["touched"] == ("calibration-3",)


def test_earlier_attempts_keep_their_files(tmp_path: Path) -> None:
    path = tmp_path / "free.mcap"
    set_aside(path)
    for text in ("one", "two", "three"):
        set_aside(path)
        path.write_text(text)
    names = {file.name: file.read_text() for file in tmp_path.iterdir()}
    assert names == {"free.mcap": "three", "free.mcap.early-1": "one", "free.mcap.early-2": "two"}


@pytest.mark.whole
def test_an_hour_with_short_steps_gives_models_logs_and_an_archive(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, plan = tmp_path / "hour", tiny_plan(tmp_path)
    arguments = ["--backend", "mujoco://?plant=recorded", "--out", str(folder), "--plan", str(plan)]
    assert run(["first-hour", *arguments, "--label", "head", "--yes", "--workers", "1"]) == 0
    shown = capsys.readouterr().out
    assert "touch that a joint detects" in shown
    hour = load_state(folder / STATE)
    assert hour.step("measure").figures["delay_ticks"] == 6
    for name in ("rest", "free"):
        assert hour.step(name).figures["false_contacts"] == 0
    with open_bundle(folder / ARCHIVE) as bundle:
        recordings = load_recordings(bundle.identification, ROBOT)
        assert [entry.joint for entry in recordings.sweeps] == ["LShoulderPitch"]
        again = fit_folder(bundle.identification, "fusion", compare=False, workers=1)
        assert again.models.models == ModelSet.load(bundle.models).models
