"""A simulated robot fitted to recordings of another one, whose values are known."""

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends.fields import RECORDED_FIELDS
from pepper_driver.calibration import recorded_robot
from pepper_driver.calibration.drive import changed_drive, values_with_lead
from pepper_driver.calibration.recorded_robot import RobotCalibrationError, with_facts
from pepper_driver.calibration.replayed import RecordedRun, replay
from pepper_driver.cli.app import run
from pepper_driver.config import load_plant, load_robot
from pepper_driver.config.files import make_folder, write_json
from pepper_driver.config.plant_parts import MAX_TICKS
from pepper_driver.identification.dataset import Manifest, RunEntry, recording_path
from pepper_driver.observer import Recording, RecordingBuilder
from pepper_driver.observer.models.measured_robot import MeasuredJoint, MeasuredRobot
from pepper_driver.robot import Pepper
from support.evaluation import recording as still
from support.first_hour import make_hour, manifest

ROBOT = load_robot()
NOMINAL = load_plant("nominal", ROBOT)
ELBOW, SHOULDER = ROBOT.joint_index("LElbowRoll"), ROBOT.joint_index("LShoulderPitch")
SOFTER = 1.5
OTHER = f"""
name: other
description: a softer elbow, two ticks later
extends: nominal
transport: {{command_delay: 4}}
factors: {{kp: {{LElbowRoll: {1 / SOFTER}}}, kd: {{LElbowRoll: {1 / SOFTER}}}}}
"""
FACTS = MeasuredRobot(
    reported_delay=5,
    delay_error=0,
    delay_spread=(0.0, 0.0),
    late=0.01,
    lost=0.002,
    weight=None,
    joints={
        name: MeasuredJoint(encoder_noise=0.001, current_noise=0.01, speed=2.2, speed_limited=True)
        for name in ("LElbowRoll", "LShoulderPitch")
    },
)


def recorded(plant: Path, goals: Sequence[dict[str, float]]) -> Recording:
    """Some moves of a simulated robot, as a user records them."""
    builder = RecordingBuilder(ROBOT)
    with Pepper(f"mujoco://?plant={plant}", observer=None) as pepper:
        for goal in goals:
            pepper.set_posture(goal, stiffness=40.0)
            pepper.run(0.9, on_tick=lambda tick, _: builder.append(tick))
    return builder.finish()


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Plant file of the robot that is to be found again."""
    path = tmp_path_factory.mktemp("plant") / "other.yaml"
    path.write_text(OTHER)
    return path


@pytest.fixture(scope="module")
def moves(other: Path) -> Recording:
    goals: list[dict[str, float]] = [
        {"LElbowRoll": -1.2, "LShoulderPitch": 1.1},
        {"LElbowRoll": -0.4, "LShoulderPitch": 1.4},
        {"LElbowRoll": -0.9},
    ]
    return recorded(other, goals)


@pytest.fixture(scope="module")
def folder(other: Path, moves: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of that robot: a measurement, and a test run with other moves."""
    path = tmp_path_factory.mktemp("hour") / "identification"
    test = recorded(other, [{"LElbowRoll": -1.0}, {"LElbowRoll": -0.3}])
    entries = []
    for name, role, recording in (("measure-1", "measurement", moves), ("x-test", "test", test)):
        joint = None if role == "measurement" else "LElbowRoll"
        entries.append(
            RunEntry(name=name, joint=joint, role=role, stiffness=9.0, seed=(0,), seconds=2.0)  # type: ignore[arg-type]
        )
        make_folder(path)
        recording.save(recording_path(path, name))
    write(path, replace(manifest("other"), response_delay=5, runs=tuple(entries)))
    return path


def write(path: Path, content: Manifest) -> None:
    write_json(path / "manifest.json", asdict(replace(content, real_time=False)))


def rms(replayed: Any, run: RecordedRun) -> float:
    difference = replayed.position[:, ELBOW] - run.recording.position[:, ELBOW]
    return float(np.degrees(np.sqrt(np.mean(difference**2))))


def test_a_robot_replays_its_own_commands_and_another_does_not(
    other: Path, moves: Recording
) -> None:
    true = load_plant(str(other), ROBOT)
    run_ = RecordedRun(name="x", held_out=False, recording=moves, pairing=5)
    # Noise of the encoder and its steps: 0.06 deg.
    assert rms(replay(ROBOT, true, run_), run_) < 0.1
    assert rms(replay(ROBOT, NOMINAL, run_), run_) > 0.5
    # Rows that were not recorded are commands that were sent all the same.
    kept = np.arange(len(moves)) % 5 != 3
    columns: dict[str, Any] = {
        field.column: getattr(moves, field.column)[kept] for field in RECORDED_FIELDS
    }
    fewer = replace(run_, recording=Recording(joint_names=moves.joint_names, **columns))
    assert rms(replay(ROBOT, true, fewer), fewer) < 0.1


def test_a_robot_is_found_again(
    folder: Path,
    other: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(recorded_robot, "STEPS", (SOFTER,))
    monkeypatch.setattr(recorded_robot, "MIN_ROWS", 100)
    monkeypatch.setattr(recorded_robot, "MEASUREMENTS", ("measure",))
    monkeypatch.setattr(recorded_robot, "measure_robot", lambda *_: FACTS)
    out = tmp_path / "mine.yaml"
    arguments = ["calibrate", "--recordings", str(folder), "--out", str(out), "--workers", "1"]
    assert run([*arguments, "--json", str(tmp_path / "f.json")]) == 0
    found, true = load_plant(str(out), ROBOT), load_plant(str(other), ROBOT)
    assert found.response_delay == true.response_delay == 5
    assert found.targets.speed_limit == 2.2
    assert (found.transport.late, found.transport.lost) == (0.01, 0.002)
    assert found.base == NOMINAL.base
    joint = values_with_lead(ROBOT, found, "LElbowRoll")
    assert joint.stiffness == pytest.approx(
        values_with_lead(ROBOT, true, "LElbowRoll").stiffness, rel=0.01
    )
    shoulder = values_with_lead(ROBOT, found, "LShoulderPitch")
    assert shoulder.stiffness == pytest.approx(
        values_with_lead(ROBOT, true, "LShoulderPitch").stiffness, rel=0.01
    )
    # The right arm did not move: it stays as it was.
    for name in ("RElbowRoll", "HeadYaw"):
        assert values_with_lead(ROBOT, found, name) == values_with_lead(ROBOT, NOMINAL, name)
    shown = capsys.readouterr().out
    assert "5 as measured" in shown
    assert "hardly moved, so their values are those of 'nominal'" in shown
    content = json.loads((tmp_path / "f.json").read_text())
    elbow = content["joints"]["LElbowRoll"]
    assert elbow["held_out"]
    assert not content["joints"]["LShoulderPitch"]["held_out"]
    assert elbow["after"]["rms_deg"] < 0.3 * elbow["before"]["rms_deg"]
    assert elbow["after"]["fit"] > 80.0 > elbow["before"]["fit"]
    assert content["delay_ticks"] == {"before": 3, "after": 5}


def test_a_known_weight_separates_masses_from_motors() -> None:
    """Arms of 1.5 times the mass, and gears that pass on less than all of the torque; the left hand was weighed."""
    true = {"LElbowRoll": 0.8, "LShoulderRoll": 0.7, "RElbowRoll": 0.6, "HeadPitch": 0.5}
    joints = {
        name: MeasuredJoint(
            load_scale=(1.0 if name == "HeadPitch" else 1.5) / efficiency,
            # The weight loads the other joints too little, or not at all.
            torque_scale=1.0 / efficiency if name == "LElbowRoll" else None,
            encoder_noise=0.0,
            current_noise=0.0,
        )
        for name, efficiency in true.items()
    }
    runs = [RecordedRun(name="x", held_out=False, recording=still(0.5), pairing=0)]
    plant = with_facts(NOMINAL, replace(FACTS, joints=joints), runs, ROBOT)
    for name, efficiency in true.items():
        assert plant.actuator(name).efficiency == pytest.approx(efficiency, rel=1e-3), name
    # Both arms are built alike: what the left one weighs more, the right one does too.
    for side in "LR":
        assert plant.body.masses[f"{side}ForeArm"] == pytest.approx(1.5)
    assert "Head" not in plant.body.masses
    assert "efficiency" in plant.actuator("LElbowRoll").origin["calibrated"]
    assert "efficiency" in plant.actuator("RElbowYaw").origin["assumed"]
    # Without the weight, all of it is the motor's.
    unweighed = {name: replace(joint, torque_scale=None) for name, joint in joints.items()}
    plant = with_facts(NOMINAL, replace(FACTS, joints=unweighed), runs, ROBOT)
    assert plant.actuator("LElbowRoll").efficiency == pytest.approx(0.8 / 1.5, rel=1e-3)
    assert plant.actuator("RElbowRoll").efficiency == pytest.approx(0.6 / 1.5, rel=1e-3)
    assert not plant.body.masses


def test_facts_that_no_plant_has_are_limited_or_refused() -> None:
    run = still(0.5)
    late = np.zeros(len(run))
    late[3] = 0.4
    runs = [
        RecordedRun(name="x", held_out=False, recording=replace(run, age=late), pairing=0),
    ]
    assert with_facts(NOMINAL, FACTS, runs, ROBOT).transport.longest_late == MAX_TICKS
    assert with_facts(NOMINAL, replace(FACTS, delay_error=16), runs, ROBOT).response_delay == 21
    with pytest.raises(RobotCalibrationError, match="answers 22 ticks after a command"):
        with_facts(NOMINAL, replace(FACTS, delay_error=17), runs, ROBOT)
    with pytest.raises(RobotCalibrationError, match="100% of the samples of this robot came late"):
        with_facts(NOMINAL, replace(FACTS, late=1.0), runs, ROBOT)
    with pytest.raises(RobotCalibrationError, match="100% were lost"):
        with_facts(NOMINAL, replace(FACTS, lost=1.0), runs, ROBOT)


def test_a_noise_that_was_not_measured_is_that_of_the_plant() -> None:
    runs = [RecordedRun(name="x", held_out=False, recording=still(0.5), pairing=0)]
    facts = replace(FACTS, joints={"LElbowRoll": MeasuredJoint()})
    transport = with_facts(NOMINAL, facts, runs, ROBOT).transport
    assert transport.encoder_noise == NOMINAL.transport.encoder_noise
    # Joints that never rested do not count among the others.
    facts = replace(FACTS, joints={**FACTS.joints, **dict.fromkeys("abc", MeasuredJoint())})
    noisy = with_facts(NOMINAL, facts, runs, ROBOT).transport
    assert noisy == with_facts(NOMINAL, FACTS, runs, ROBOT).transport
    assert noisy.encoder_noise > 0.0


def test_a_limit_of_targets_that_the_robot_does_not_have_is_taken_away() -> None:
    runs = [RecordedRun(name="x", held_out=False, recording=still(0.5), pairing=0)]
    limited = replace(NOMINAL, targets=replace(NOMINAL.targets, speed_limit=2.0))
    for speed, expected in ((1.9, 2.0), (2.5, None)):
        joint = MeasuredJoint(encoder_noise=0.0, current_noise=0.0, speed=speed)
        facts = replace(FACTS, joints={"LElbowRoll": joint})
        assert with_facts(limited, facts, runs, ROBOT).targets.speed_limit == expected


def test_rows_of_a_joint_that_hardly_moves_do_not_count() -> None:
    sent = np.zeros((60, len(ROBOT.joint_names)))
    sent[30:, ELBOW] = 0.1
    sent[30:, SHOULDER] = 0.01
    run = replace(still(60 * ROBOT.cycle), sent_position=sent, position=sent)
    counts = RecordedRun(name="x", held_out=False, recording=run, pairing=0).counts
    assert counts[:, ELBOW].all()
    assert np.count_nonzero(counts) == 60


def test_a_lead_is_changed_and_otherwise_kept() -> None:
    drive = NOMINAL.actuator("LElbowRoll")
    values = values_with_lead(ROBOT, NOMINAL, "LElbowRoll")
    later = changed_drive(ROBOT, drive, "LElbowRoll", replace(values, lead=0.01), "calibrated")
    assert later.kd / later.kp == pytest.approx(0.01, rel=1e-3)
    kept = changed_drive(ROBOT, drive, "LElbowRoll", replace(values, lead=None), "calibrated")
    assert kept.kd / kept.kp == pytest.approx(drive.kd / drive.kp, rel=1e-3)
    assert ("kd" in later.origin["calibrated"], "kd" in kept.origin["assumed"]) == (True, True)


def test_wrong_recordings_are_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_hour(tmp_path / "hour")
    (tmp_path / "empty").mkdir()
    cases: dict[tuple[str, ...], str] = {
        (str(tmp_path / "hour"),): "this robot was not measured",
        (str(tmp_path / "empty"),): "no first_hour.json",
        (str(tmp_path / "none.zip"),): "there is no such file or folder",
        (str(folder), "--check"): "--check and --recordings exclude each other",
        (str(folder), "--plot", "x.png"): "--plot and --recordings exclude each other",
        (str(folder), "--models", "x.json"): "--models and --recordings exclude each other",
        (str(folder), "--plant", "random"): "each robot of this plant is drawn again",
        (str(folder), "--out", "x.json"): "a plant file ends in .yaml",
        # These recordings have none of the runs by which a robot is measured.
        (str(folder), "--workers", "1"): "not measured (measure_response, measure_friction",
    }
    for arguments, words in cases.items():
        assert run(["calibrate", "--recordings", *arguments]) == 2, arguments
        (line,) = capsys.readouterr().err.splitlines()
        assert words in line
