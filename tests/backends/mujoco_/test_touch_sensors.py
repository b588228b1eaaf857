"""Touch sensors, bumpers and the chest button answer to contact in the right place, hard enough, from any source."""

from typing import Any

import numpy as np
import pytest

from pepper_driver.backends import Command
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.parts import TouchSensor
from support.contacts import FIXED, ROBOT, ROLLING, Robot, world
from support.pinocchio_robot import PinocchioRobot

SENSORS = ROBOT.sensors
ALL = {**SENSORS.touch, **SENSORS.bumpers, **SENSORS.buttons}


def answers(robot: Robot, seconds: float) -> dict[str, float]:
    """The answers after this time, by name."""
    m = robot.run(seconds)[-1]
    values = np.concatenate([m.touch, m.bumpers, m.buttons])
    assert m.touch.shape == (5,)
    assert m.bumpers.shape == (3,)
    assert m.buttons.shape == (1,)
    return dict(zip(ALL, values.tolist(), strict=True))


def pressed(robot: Robot, seconds: float = 0.3) -> set[str]:
    return {name for name, value in answers(robot, seconds).items() if value}


def press(robot: Robot, sensor: TouchSensor, force: float, offset: FloatArray) -> None:
    """A push on the sensor's link, ``offset`` (3,) [m] from its frame."""
    direction = np.array([1.0, 0.0, 0.0])
    robot.push(sensor.parent, force * direction, np.array(sensor.xyz) + offset, 1.0)


@pytest.mark.parametrize("name", ALL)
def test_a_sensor_answers_to_its_own_place_and_force(name: str) -> None:
    sensor = ALL[name]
    outward = np.array(sensor.xyz) * [1.0, 1.0, 0.0] if name in SENSORS.bumpers else [0.0, 0.0, 1.0]
    outward = np.array(outward) / np.linalg.norm(outward)

    robot = Robot(FIXED)
    press(robot, sensor, 1.2 * sensor.threshold, 0.9 * sensor.radius * outward)
    assert name in pressed(robot)
    robot = Robot(FIXED)
    press(robot, sensor, 0.8 * sensor.threshold, np.zeros(3))
    assert not pressed(robot), "too soft"
    robot = Robot(FIXED)
    press(robot, sensor, 1.2 * sensor.threshold, 1.1 * sensor.radius * outward)
    assert name not in pressed(robot), "too far"


def test_only_the_touched_sensor_answers_and_only_while_touched() -> None:
    robot = Robot(FIXED)
    sensor = SENSORS.touch["Head/Touch/Rear"]
    robot.push("Head", np.array([0.0, 0.0, -3.0]), np.array(sensor.xyz), 0.5)
    assert pressed(robot) == {"Head/Touch/Rear"}
    assert not pressed(robot)


def test_the_same_point_on_another_link_is_not_detected() -> None:
    robot = Robot(FIXED)
    robot.push("torso", np.array([0.0, 0.0, -3.0]), np.array([0.028, 0.0, 0.52]), 0.5)
    assert not pressed(robot)


def test_a_hand_is_detected() -> None:
    robot = Robot(FIXED)
    sensor = SENSORS.touch["LHand/Touch/Back"]
    robot.grab("l_wrist", np.array([0.02, 0.0, 0.0]), np.array(sensor.xyz), rise=0.2)
    assert pressed(robot) == {"LHand/Touch/Back"}


def test_forces_of_several_contacts_add_up() -> None:
    robot = Robot(FIXED)
    sensor = SENSORS.buttons["ChestBoard/Button"]
    for _ in range(2):
        press(robot, sensor, 0.6 * sensor.threshold, np.zeros(3))
    assert pressed(robot) == {"ChestBoard/Button"}


def test_an_object_on_the_head_is_detected() -> None:
    pose = PinocchioRobot().link_pose("Head", ROBOT.posture("Stand"))
    sensor = (pose @ [*SENSORS.touch["Head/Touch/Middle"].xyz, 1.0])[:3]
    outward = sensor - (pose @ [0.005, 0.0, 0.118, 1.0])[:3]  # from the centre of the head's sphere
    thing = {"shape": "sphere", "size": [0.05], "mass": 0.3, "start": 1.0}
    above = sensor + 0.056 * outward / np.linalg.norm(outward)
    robot = Robot(FIXED, world(ball={**thing, "position": above.tolist()}))
    detected = set()
    for _ in range(8):
        detected |= pressed(robot, 0.012)
    assert detected == {"Head/Touch/Middle"}


def wall(x: float, y: float = 0.0, yaw: float = 0.0) -> Any:
    thing = {
        "shape": "box",
        "size": [0.1, 1.5, 0.3],
        "mass": None,
        "position": [x, y, 0.16],
        "orientation": [0.0, 0.0, yaw],
    }
    return world(wall=thing)


@pytest.mark.parametrize(
    ("where", "twist", "expected"),
    [
        (wall(0.3), [0.3, 0.0, 0.0], {"FrontLeft", "FrontRight"}),
        (wall(-0.34), [-0.3, 0.0, 0.0], {"Back"}),
        (wall(0.23, 0.23, np.pi / 4), [0.2, 0.2, 0.0], {"FrontLeft"}),
        (wall(0.23, -0.23, -np.pi / 4), [0.2, -0.2, 0.0], {"FrontRight"}),
    ],
    ids=["front", "back", "left", "right"],
)
def test_the_base_meets_a_wall(where: Any, twist: list[float], expected: set[str]) -> None:
    robot = Robot(ROLLING, where)
    assert not pressed(robot, 0.1)
    wheels = ROBOT.wheels.matrix @ np.array(twist)
    detected: set[str] = set()
    for _ in range(60):
        m = robot.exchange(Command(position=robot.hold, stiffness=np.ones(17), wheel_speed=wheels))
        detected |= {n for n, v in zip(SENSORS.bumpers, m.bumpers, strict=True) if v}
    assert {c.link for c in robot.truth.contacts} <= {
        "Tibia",
        *(f"{w}_link" for w in ROBOT.wheels.names),
    }
    assert detected == expected
