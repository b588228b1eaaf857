"""Pushes that no one planned: from the truth of a log they are the same as from the plan."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends.log_file import LogError
from pepper_driver.config import load_robot, load_safety_settings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_specs import AnyContact, PushPoint, RandomForces, RandomPushes
from pepper_driver.config.evaluation import SuiteRun, load_evaluation
from pepper_driver.evaluation import episodes
from pepper_driver.evaluation.episode_score import watch
from pepper_driver.evaluation.episodes import Episode, episode_uri
from pepper_driver.evaluation.evaluate import episode_of_log
from pepper_driver.evaluation.observers_under_test import contestants
from pepper_driver.evaluation.true_pushes import (
    DISTAL_RATIO,
    LoggedPlant,
    pushed_joint,
    true_pushes,
)
from pepper_driver.log import RunLog, read_log
from pepper_driver.log.topics import TrueForce
from pepper_driver.log.touches import PUSH_PAUSE
from pepper_driver.observer import ContactScore, KnownPush, score
from pepper_driver.recording.labels import LabelError
from pepper_driver.robot import Pepper

ROBOT = load_robot()
CYCLE, N = ROBOT.cycle, len(ROBOT.joint_names)
STIFFNESS, FRICTION = 50.0, 0.4
PLANT = LoggedPlant(stiffness=np.full(N, STIFFNESS), friction=np.full(N, FRICTION))
DEGREE = STIFFNESS * math.pi / 180.0
"""[N m] One equivalent degree."""
FUSION = contestants(["fusion"], [], ROBOT)
EVALUATION = load_evaluation(ROBOT)


def scored(episode: Episode) -> ContactScore:
    """The score of the observer that a robot has by default."""
    observer = FUSION.observer("fusion", episode, ROBOT)
    return score(episode.pushes, watch(observer, episode.recording).contacts, ROBOT)


# -- a run that was planned -----------------------------------------------------------------------------------------


def at(*places: tuple[str, float], y: float = 0.0) -> tuple[PushPoint, ...]:
    """Points along links of the arm, or next to their axis."""
    return tuple(PushPoint(link=link, xyz=(x, y, 0.0)) for link, x in places)


PUSHES = RandomPushes(
    kind="random_pushes",
    times=(0.4, 3.7),
    jitter=0.5,
    joints=("LShoulderRoll", "LElbowRoll"),
    balanced=True,
    degrees=(2.0, 6.0),
    duration=(0.3, 2.0),
    rise=(0.04, 0.2),
    max_force=60.0,
    in_motion=True,
    max_distal_ratio=DISTAL_RATIO,
    points={
        "LShoulderRoll": at(("LBicep", 0.17), ("LForeArm", 0.05), ("LForeArm", 0.14)),
        "LElbowRoll": at(("LForeArm", 0.08), ("LForeArm", 0.14), ("l_wrist", 0.07)),
    },
)
RIGHT = {"RElbowRoll": at(("RForeArm", 0.14), ("r_wrist", 0.07))}
FINGERS = {"LHand": at(("l_gripper", 0.04), y=0.03)}
FORCES = RandomForces(
    kind="random_forces",
    times=PUSHES.times,
    jitter=PUSHES.jitter,
    newtons=(5.0, 60.0),
    duration=PUSHES.duration,
    rise=PUSHES.rise,
    in_motion=True,
    points=(
        PushPoint(link="torso", xyz=(0.08, 0.0, 0.2)),
        PushPoint(link="Tibia", xyz=(0.12, 0.0, -0.2)),
    ),
)
PLANNED: dict[str, tuple[AnyContact, ...]] = {
    "arm": (PUSHES,),
    "pairs": (PUSHES, replace(PUSHES, joints=("RElbowRoll",), points=RIGHT, degrees=(1.0, 4.0))),
    "fingers": (replace(PUSHES, joints=("LHand",), points=FINGERS, degrees=(10.0, 16.0)),),
    "trunk and base": (FORCES,),
}


def run_of(contacts: tuple[AnyContact, ...]) -> SuiteRun:
    """A run of Table I with few set-points and other contacts, from the first one on."""
    run = EVALUATION.runs("paper")[0]
    experiment = replace(run.experiment.with_goals(count=4), contacts=contacts)
    return replace(run, plant="nominal", experiment=experiment)


@pytest.mark.parametrize("name", PLANNED)
def test_a_planned_run_has_the_same_pushes_and_scores_by_its_log(name: str, tmp_path: Path) -> None:
    run, path = run_of(PLANNED[name]), tmp_path / "a.mcap"
    safety = replace(load_safety_settings(), chest_button=False)
    pepper = Pepper(episode_uri(run), observer=None, robot=ROBOT, safety=safety, log=path)
    planned = episodes._performed(run, pepper)
    derived = episode_of_log(path)
    assert len(planned.pushes) == len(derived.pushes) >= 8
    # The log also has the ticks before the first one of the plan.
    shift = len(derived.recording) - len(planned.recording)
    assert np.array_equal(derived.recording.time[shift:], planned.recording.time)
    assert np.array_equal(derived.contact_torque[shift:], planned.contact_torque)
    for plan, truth in zip(planned.pushes, derived.pushes, strict=True):
        assert (truth.joint, truth.link) == (plan.joint, plan.link)
        assert (truth.direction, truth.saturated) == (plan.direction, plan.saturated)
        assert truth.onset == pytest.approx(plan.onset, abs=CYCLE)
        assert truth.release == pytest.approx(plan.release, abs=1.01 * CYCLE)
        assert truth.force == pytest.approx(plan.force, rel=1e-6)
        # On trunk and base the plan has the size in the posture at rest.
        close = 0.02 if plan.joint is None else 1e-9
        assert truth.degrees == pytest.approx(plan.degrees, rel=close, abs=1e-3 * (close > 0.01))
    # One recording for both: the pushes alone differ.
    one = scored(replace(derived, pushes=planned.pushes))
    other = scored(derived)
    for contacts in ("false", "rebounds", "repeated", "on_trunk"):
        assert getattr(one, contacts) == getattr(other, contacts)
    by_plan, by_truth = (
        [(derived_pushes.index(f.push), f.contact) for f in result.detected]
        for derived_pushes, result in ((planned.pushes, one), (derived.pushes, other))
    )
    assert by_plan == by_truth
    assert by_plan


# -- a run that was not ---------------------------------------------------------------------------------------------


def test_an_arm_that_is_pulled_by_hand_is_scored(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Pepper("mujoco://?seed=3", observer=None, robot=ROBOT, log=path) as pepper:
        pepper.run(1.0)
        closed = pepper.time
        hand = pepper.take_hand("LForeArm", [0.1, 0.0, 0.0])
        pepper.step()
        goal = hand.point + np.array([0.0, 0.08, 0.0])
        for _ in range(80):
            hand.move(goal)
            pepper.step()
        hand.release()
        while hand.holds:
            pepper.step()
        opened = pepper.time
        pepper.run(2.0)
    episode = episode_of_log(path)
    (push,) = episode.pushes
    assert (push.link, ROBOT.limb_of(push.joint)) == ("LForeArm", "left_arm")
    assert push.onset == pytest.approx(closed, abs=CYCLE)
    assert push.release == pytest.approx(opened, abs=2.0 * CYCLE)
    assert push.force > 10.0
    result = scored(episode)
    assert not result.false
    (detected,) = result.detected
    assert 0.0 < detected.delay < 0.5


def test_a_force_from_before_the_log_counts_from_its_begin(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Pepper("mujoco://?seed=3", observer=None, robot=ROBOT) as pepper:
        pepper.push("LForeArm", [0.0, 30.0, 0.0], duration=1.0)
        pepper.push("base_link", [25.0, 0.0, 0.0], duration=3.0, delay=1.8)
        pepper.run(0.5)
        begin = pepper.time
        pepper.start_log(path)
        pepper.run(2.0)
        end = pepper.time
    arm, base = episode_of_log(path).pushes
    assert (arm.link, base.link, base.joint) == ("LForeArm", "base_link", None)
    assert arm.onset == pytest.approx(begin, abs=1.01 * CYCLE)
    assert arm.release - arm.onset == pytest.approx(0.5, abs=3.0 * CYCLE)
    assert base.release == pytest.approx(end, abs=CYCLE)
    assert base.force == pytest.approx(25.0)


def test_a_ball_pushes_the_chest_and_as_it_falls_the_base(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Pepper("mujoco://?seed=1&world=ball", observer=None, robot=ROBOT, log=path) as pepper:
        pepper.run(3.0)
    log = read_log(path)
    assert log.forces is not None
    assert {(force.kind, force.object) for force in log.forces} == {("object", "ball")}
    hits = episode_of_log(path).pushes
    assert [(push.link, push.joint) for push in hits] == [("torso", None), ("Tibia", None)]
    assert all(push.release - push.onset < 0.1 for push in hits)


def test_a_run_without_a_touch_is_free_motion(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Pepper("mujoco", observer=None, robot=ROBOT, log=path) as pepper:
        pepper.run(0.5)
    episode = episode_of_log(path)
    assert episode.pushes == ()
    assert not episode.contact_torque.any()
    assert scored(episode) == score((), (), ROBOT)


def test_a_log_that_is_cut_short_is_scored_as_far_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Pepper("mujoco://?seed=3", observer=None, robot=ROBOT, log=path) as pepper:
        pepper.push("LForeArm", [0.0, 30.0, 0.0], duration=3.0, delay=0.5)
        pepper.run(4.0)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    episode = episode_of_log(path)
    (push,) = episode.pushes
    assert push.degrees > 2.0
    assert push.release == pytest.approx(episode.recording.time[-1], abs=CYCLE)


# -- closed forms ---------------------------------------------------------------------------------------------------


def force(row: int, link: str, size: float = 10.0, thing: str | None = None) -> TrueForce:
    """A force in one cycle."""
    return TrueForce(
        time=row * CYCLE,
        kind="push" if thing is None else "object",
        link=link,
        object=thing,
        x=0.0,
        y=0.0,
        z=1.0,
        force_x=size,
        force_y=0.0,
        force_z=0.0,
        peak=size,
    )


def handmade(forces: Sequence[TrueForce] | None, **torque: tuple[slice, float]) -> RunLog:
    """A log in which joints have the torques of these rows [equivalent degrees]."""
    rows = 100
    time = CYCLE * np.arange(float(rows))
    contact_torque: FloatArray = np.zeros((rows, N))
    for joint, (during, degrees) in torque.items():
        contact_torque[during, ROBOT.joint_index(joint)] = degrees * DEGREE
    plant = {"stiffness": [STIFFNESS] * N, "friction": [FRICTION] * N}
    truth: dict[str, Any] = {
        "time": time,
        "contact_torque": contact_torque,
        "saturated": np.zeros((rows, N), dtype=np.bool_),
    }
    return RunLog(
        metadata={"plant": json.dumps(plant)},
        complete=True,
        joint_names=ROBOT.joint_names,
        chains=ROBOT.chains,
        hand_joints=ROBOT.hands.joints,
        robot=ROBOT.name,
        fields={"time": time, "reference_velocity": np.zeros((rows, N))},
        contacts=[],
        truth=truth,
        forces=None if forces is None else list(forces),
    )


def pushes(forces: Sequence[TrueForce], **torque: tuple[slice, float]) -> tuple[KnownPush, ...]:
    return true_pushes(handmade(forces, **torque), ROBOT)


def test_the_numbers_of_a_push() -> None:
    forces = [force(row, "LBicep", size=5.0 + row) for row in range(10, 20)]
    (push,) = pushes(forces, LShoulderRoll=(slice(10, 20), -3.0), LShoulderPitch=(slice(0, 9), 9.0))
    assert (push.joint, push.link, push.direction) == ("LShoulderRoll", "LBicep", -1)
    assert (push.moving, push.saturated, push.saturating) == (False, False, False)
    numbers = (push.force, push.torque, push.degrees, push.onset, push.release)
    assert numbers == pytest.approx((24.0, 3.0 * DEGREE, 3.0, 9 * CYCLE, 19 * CYCLE))


@pytest.mark.parametrize(
    ("link", "joint", "row", "saturated"),
    [
        ("LForeArm", "LElbowRoll", 15, True),
        ("LForeArm", "LElbowRoll", 25, False),  # after the push
        ("LForeArm", "LShoulderRoll", 15, False),  # not the joint of the push
        ("torso", "KneePitch", 15, True),
        ("torso", "LElbowRoll", 15, False),
    ],
)
def test_a_push_is_saturated_where_the_board_of_its_joint_was(
    link: str, joint: str, row: int, saturated: bool
) -> None:
    forces = [force(n, link) for n in range(10, 20)]
    log = handmade(forces, LElbowRoll=(slice(10, 20), 3.0))
    assert log.truth is not None
    log.truth["saturated"][row, ROBOT.joint_index(joint)] = True
    (push,) = true_pushes(log, ROBOT)
    assert push.saturated is saturated


@pytest.mark.parametrize(("speed", "moving"), [(0.5, True), (-0.5, True), (0.001, False)])
def test_a_push_is_in_motion_where_its_joint_was_to_move(speed: float, moving: bool) -> None:
    log = handmade([force(10, "LForeArm")], LElbowRoll=(slice(10, 11), 3.0))
    log["reference_velocity"][9, ROBOT.joint_index("LElbowRoll")] = speed
    log["reference_velocity"][9, ROBOT.joint_index("HeadYaw")] = 1.0
    (push,) = true_pushes(log, ROBOT)
    assert push.moving is moving


def test_a_short_pause_is_none_and_a_long_one_parts_two_pushes() -> None:
    pause = round(PUSH_PAUSE / CYCLE)
    for gap, count in ((pause - 1, 1), (pause + 1, 2)):
        rows = [*range(10, 20), *range(20 + gap, 40 + gap)]
        assert len(pushes([force(row, "LBicep") for row in rows])) == count


def test_two_hands_are_two_pushes_and_an_object_is_one_for_each_limb() -> None:
    rows = range(10, 30)
    two = [force(row, link) for row in rows for link in ("LBicep", "LForeArm")]
    assert {push.link for push in pushes(two)} == {"LBicep", "LForeArm"}
    sizes = {"LBicep": 3.0, "LForeArm": 8.0, "Head": 1.0}
    table = [force(row, link, size, "table") for row in rows for link, size in sizes.items()]
    assert sorted(push.link for push in pushes(table)) == ["Head", "LForeArm"]


def test_a_force_of_rounding_touches_nothing() -> None:
    assert pushes([force(10, "LBicep", size=1e-7)]) == ()


def test_a_force_on_the_trunk_is_as_large_as_on_the_leg_joint_it_turns_most() -> None:
    (push,) = pushes(
        [force(row, "torso") for row in range(10, 20)],
        HipRoll=(slice(10, 20), 0.5),
        KneePitch=(slice(12, 14), -2.0),
    )
    assert (push.joint, push.direction) == (None, -1)
    assert push.degrees == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("link", "degrees", "joint"),
    [
        ("LForeArm", {"LElbowRoll": 4.0, "LShoulderRoll": 6.0}, "LElbowRoll"),
        ("LForeArm", {"LElbowRoll": 0.9 * DISTAL_RATIO * 6.0, "LShoulderRoll": 6.0}, None),
        ("LForeArm", {"LElbowRoll": 0.2, "LShoulderRoll": 0.7}, None),  # friction holds it
        ("LForeArm", {"LElbowRoll": 0.1, "LShoulderRoll": 0.12}, None),  # and the other one too
        ("LBicep", {"LElbowRoll": 9.0, "LShoulderRoll": 1.0}, "LShoulderRoll"),  # of another hand
        ("l_gripper", {"LHand": 5.0, "LShoulderRoll": 1.0}, "LHand"),
        ("Head", {}, "HeadPitch"),
    ],
)
def test_the_joint_of_a_push_is_the_last_that_it_turns(
    link: str, degrees: dict[str, float], joint: str | None
) -> None:
    torque = np.zeros(N)
    for name, size in degrees.items():
        torque[ROBOT.joint_index(name)] = size * DEGREE
    assert pushed_joint(ROBOT, link, torque, PLANT) == (joint or "LShoulderRoll")


@pytest.mark.parametrize("link", ["base_link", "Tibia", "torso", "WheelB_link"])
def test_trunk_and_base_have_no_joint(link: str) -> None:
    assert pushed_joint(ROBOT, link, np.full(N, DEGREE), PLANT) is None


def test_without_its_metadata_the_size_of_a_push_is_unknown() -> None:
    log = replace(handmade([force(10, "LForeArm")], LElbowRoll=(slice(10, 11), 3.0)), metadata={})
    (push,) = true_pushes(log, ROBOT)
    assert push.joint == "LElbowRoll"
    assert push.torque == pytest.approx(3.0 * DEGREE)
    assert math.isnan(push.degrees)


@pytest.mark.parametrize(
    ("plant", "words"),
    [
        ("{", "is damaged"),
        ('{"friction": []}', "is damaged"),
        ("3", "is damaged"),
        ('{"stiffness": [1.0], "friction": [1.0]}', "not that of its joints"),
    ],
)
def test_a_plant_that_is_none_is_refused(plant: str, words: str) -> None:
    log = replace(handmade([force(10, "Head")]), metadata={"plant": plant})
    with pytest.raises(LabelError, match=words):
        true_pushes(log, ROBOT)


def test_a_log_without_true_forces_is_refused() -> None:
    with pytest.raises(LabelError, match="record the run again"):
        true_pushes(handmade(None), ROBOT)


def test_no_log_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot be read"):
        episode_of_log(tmp_path / "none.mcap")
