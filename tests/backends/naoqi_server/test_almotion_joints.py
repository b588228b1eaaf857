"""Parts of the stand-in's ALMotion: names, values as NAOqi takes them, places of parts, postures, waking."""

from collections.abc import Callable
from functools import partial
from math import pi
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.naoqi_server.almotion.engine import AlmotionReflexes, MotionEngine
from pepper_driver.backends.naoqi_server.almotion.kinematics import (
    ROBOT,
    TORSO,
    WORLD,
    CallError,
    JointGroups,
    Kinematics,
    lists,
    number,
    numbers,
    position6,
)
from pepper_driver.backends.naoqi_server.almotion.postures import PREFIX, Life, Postures, Waking
from pepper_driver.backends.naoqi_server.almotion.wheels import DriveLimits
from pepper_driver.backends.naoqi_server.memory import Memory
from pepper_driver.config.transforms import transform
from support.almotion import CONFIG, SETTINGS, Stage, hardness_key, joint, wheel_key
from support.examples import examples
from support.pinocchio_robot import PinocchioRobot

BODY = JointGroups(CONFIG, SETTINGS)
KINEMATICS = Kinematics(CONFIG, SETTINGS)
STAND = CONFIG.posture("Stand").tolist()
ORIGIN = np.zeros(3)
MODEL = PinocchioRobot()


def test_groups_are_those_of_the_documentation() -> None:
    assert BODY.names("Body", "")[:2] == ["HeadYaw", "HeadPitch"]
    assert len(BODY.names("Body", "")) == 17
    assert BODY.names("Actuators", "") == ["LHand", "RHand"]
    assert len(BODY.names("Joints", "")) == 15
    assert BODY.names("Chains", "") == ["Head", "LArm", "Leg", "RArm"]
    assert BODY.names("Leg", "") == ["HipRoll", "HipPitch", "KneePitch"]
    assert BODY.joints(["HeadPitch", "Leg"], "") == [
        joint(name) for name in ("HeadPitch", "HipRoll", "HipPitch", "KneePitch")
    ]


@pytest.mark.parametrize(
    ("names", "word"),
    [
        ("LLeg", "Leg"),
        ("HeadYow", "HeadYaw"),
        ([], "no joint"),
        (["Head", "HeadYaw"], "twice"),
        (3, "3"),
    ],
)
def test_wrong_names_are_refused(names: object, word: str) -> None:
    with pytest.raises(CallError, match=word) as caught:
        BODY.joints(names, "ALMotion::setAngles")
    assert str(caught.value).startswith("ALMotion::setAngles: ")


def test_values_are_taken_as_naoqi_takes_them() -> None:
    assert lists(1, 1, "", "") == [[1.0]]
    assert lists(1.0, 2, "", "") == [[1.0], [1.0]]
    assert lists([1, 2], 1, "", "") == [[1.0, 2.0]]
    assert lists([1, 2], 2, "", "") == [[1.0], [2.0]]
    assert lists([[1, 2], [3]], 2, "", "") == [[1.0, 2.0], [3.0]]
    assert numbers(0.5, 3, "", "") == [0.5] * 3


@pytest.mark.parametrize(
    "call",
    [
        lambda: lists([1, [2]], 2, "", ""),
        lambda: lists([1, 2, 3], 2, "", ""),
        lambda: lists("1", 1, "", ""),
        lambda: numbers([1], 2, "", ""),
        lambda: number(True, "", ""),
        lambda: number(float("nan"), "", ""),
        lambda: number(float("inf"), "", ""),
        lambda: number(None, "", ""),
    ],
)
def test_other_values_are_refused(call: Callable[[], object]) -> None:
    with pytest.raises(CallError):
        call()


@examples(25)
@given(st.lists(st.floats(0.0, 1.0), min_size=17, max_size=17))
def test_parts_are_where_the_controllers_model_has_them(fractions: list[float]) -> None:
    """Against Pinocchio on the same URDF."""
    angles = CONFIG.lower + np.array(fractions) * (CONFIG.upper - CONFIG.lower)
    for name in CONFIG.joint_names:
        if name in CONFIG.hands.joints:
            continue
        child = CONFIG.joints[joint(name)].child
        pose = KINEMATICS.pose(name, ROBOT, angles.tolist(), ORIGIN, "")
        assert pose == pytest.approx(MODEL.link_pose(child, angles), abs=1e-9)


def test_frames() -> None:
    base = np.array([1.0, 2.0, pi / 2])
    hand = KINEMATICS.pose("LArm", ROBOT, STAND, base, "")
    world = KINEMATICS.pose("LArm", WORLD, STAND, base, "")
    assert world[:3, 3] == pytest.approx([1.0 - hand[1, 3], 2.0 + hand[0, 3], hand[2, 3]])
    torso = KINEMATICS.pose("Torso", ROBOT, STAND, base, "")
    assert torso[2, 3] == pytest.approx(
        0.82, abs=0.01
    )  # NAOqi's drawings: the torso's origin 820 mm up
    assert torso @ KINEMATICS.pose("LArm", TORSO, STAND, base, "") == pytest.approx(hand)
    assert KINEMATICS.pose("Torso", TORSO, STAND, base, "") == pytest.approx(np.eye(4))
    left, right = (KINEMATICS.pose(arm, ROBOT, [0.0] * 17, base, "") for arm in ("LArm", "RArm"))
    assert left[:3, 3] == pytest.approx(right[:3, 3] * [1, -1, 1], abs=1e-9)


@given(*[st.floats(-1.5, 1.5)] * 6)
def test_six_numbers_say_where_a_part_is(
    x: float, y: float, z: float, wx: float, wy: float, wz: float
) -> None:
    assert position6(transform((x, y, z), (wx, wy, wz))) == pytest.approx([x, y, z, wx, wy, wz])


@pytest.mark.parametrize(
    ("name", "frame"), [("LHip", ROBOT), ("LArm", 3), ("LArm", "robot"), ("LArm", True)]
)
def test_unknown_parts_and_frames_are_refused(name: object, frame: object) -> None:
    with pytest.raises(CallError):
        KINEMATICS.pose(name, frame, STAND, ORIGIN, "ALMotion::getPosition")


def test_reflexes_need_consent_where_they_are_critical() -> None:
    with pytest.raises(CallError, match="/advanced/#/settings"):
        AlmotionReflexes(BODY, consent=False).check_consent(
            False, "ALMotion::setFallManagerEnabled"
        )
    AlmotionReflexes(BODY, consent=False).check_consent(True, "")
    AlmotionReflexes(BODY, consent=True).check_consent(False, "")


class Parts:
    """Postures, waking and life of a robot in a posture."""

    def __init__(self, posture: str) -> None:
        self.stage = Stage(posture=posture)
        self.memory = Memory(self.stage.robot, CONFIG.naoqi.time, {})
        motion = self.stage.motion
        self.postures = Postures(motion, CONFIG, SETTINGS)
        self.waking = Waking(motion, self.postures, self.memory, SETTINGS)
        self.life = Life(motion)
        self.events: list[tuple[str, Any]] = []
        for name in (PREFIX + "wakeUpStarted", PREFIX + "wakeUpFinished", "robotIsWakeUp"):
            self.memory.listen(name, partial(self._note, name.removeprefix(PREFIX)))

    def _note(self, name: str, value: Any) -> None:
        self.events.append((name, value))


def test_waking_up_stiffens_then_stands_and_rest_is_the_way_back() -> None:
    parts = Parts("Crouch")
    stage, robot = parts.stage, parts.stage.robot
    assert not stage.motion.awake
    assert parts.postures.now == "Crouch"
    assert parts.waking.wake_up() is True
    assert parts.postures.now == "Stand"
    assert parts.events == [
        ("wakeUpStarted", True),
        ("robotIsWakeUp", True),
        ("wakeUpFinished", True),
    ]
    stage.run(0.1)
    assert all(robot.value(hardness_key(name)) == 1.0 for name in CONFIG.joint_names)
    stiffness = "Device/SubDeviceList/WheelB/Stiffness/Actuator/Value"
    assert robot.value(stiffness) == 1.0
    # It rose in a ramp: no step of the stiffness was larger than its fraction of the time.
    steps = np.diff(robot.sent[hardness_key("HipPitch")])
    assert 0 < steps.max() < 2.1 * 0.02 / SETTINGS.stiffness_ramp

    parts.waking.rest()
    stage.run(0.1)
    assert parts.postures.now == "Crouch"
    assert not stage.motion.awake
    assert all(robot.value(hardness_key(name)) == 0.0 for name in CONFIG.joint_names)
    assert robot.value(stiffness) == 0.0
    before = robot.now
    stage.run(0.5)
    assert robot.written(before) == set()


def test_waking_up_switches_reflexes_on_again_but_two() -> None:
    """As programs of other drivers found it on robots."""
    parts = Parts("Stand")
    reflexes = parts.stage.motion.reflexes
    for _ in range(2):  # asleep, then awake
        parts.stage.quiet()
        parts.waking.wake_up()
        assert reflexes.self_collision == {"LArm": True, "RArm": True}
        assert reflexes.external == {"Move": True, "LArm": True, "RArm": True}
        assert (reflexes.fall_manager, reflexes.push_recovery) == (True, True)
        assert (reflexes.diagnosis, reflexes.smart_stiffness) == (False, False)


def test_a_robot_that_stayed_awake_is_taken_over_awake() -> None:
    stage = Stage()
    for name in CONFIG.joint_names:
        stage.robot.show(hardness_key(name), 1.0)
    motion = MotionEngine(stage.robot, CONFIG, SETTINGS)
    assert motion.awake
    assert motion.joints.stiffness == [1.0] * 17


def test_rest_stops_the_base() -> None:
    parts = Parts("Stand")
    parts.waking.wake_up()
    parts.stage.motion.base.drive(np.array([0.3, 0.0, 0.0]), DriveLimits.of(SETTINGS, {}))
    parts.stage.run(1.0)
    assert abs(parts.stage.robot.value(wheel_key("WheelFL"))) > 1
    parts.waking.rest()
    assert parts.stage.robot.value(wheel_key("WheelFL")) == 0.0


def test_life_moves_the_robot_only_while_it_lasts() -> None:
    parts = Parts("Stand")
    stage = parts.stage
    stage.quiet()
    stage.stiffen()
    parts.life.enter("solitary")
    stage.run(3.0)
    assert np.ptp(stage.sent("LShoulderPitch")[-200:]) > 0.01
    assert parts.life.running("BasicAwareness")
    parts.life.paused = True
    parts.life.apply()
    assert not parts.life.running("BasicAwareness")
    parts.life.enter("disabled")
    stage.run(0.2)
    before = stage.robot.now
    stage.run(0.5)
    assert stage.robot.written(before) == set()
