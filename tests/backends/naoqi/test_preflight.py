"""Questions to a robot before it moves, and each reason to refuse it, in one line with the cause and the remedy."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from pepper_driver.backends import DeviceError
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi.preflight import (
    Preflight,
    check_robot,
    diagnosis,
    preflight,
)
from pepper_driver.backends.readiness import NotReadyError
from pepper_driver.config import load_naoqi_settings, load_safety_settings
from support.naoqi_fakes import NAMES, ROBOT, FakeRobot, key

pytestmark = pytest.mark.usefixtures("qi")

SETTINGS, SAFETY = load_naoqi_settings(), load_safety_settings()
ELBOW = NAMES.position.format(joint="LElbowRoll")
KEYS = [key(NAMES.position.format(joint=joint)) for joint in ROBOT.joint_names]


@pytest.fixture
def fake() -> Iterator[FakeRobot]:
    with FakeRobot() as fake:
        yield fake


def asked(fake: FakeRobot, **more: Any) -> Preflight:
    connection = fake.connect()
    try:
        return preflight(connection, ROBOT, KEYS, **more)
    finally:
        connection.close()


def refused(fake: FakeRobot, **more: Any) -> str:
    with pytest.raises(NotReadyError) as caught:
        asked(fake, **more)
    return one_line(fake, caught.value)


def unfit(fake: FakeRobot, **more: Any) -> str:
    """Return why a robot is not activated; nothing is sent to it meanwhile."""
    connection = fake.connect()
    with pytest.raises(NotReadyError) as caught:
        check_robot(connection, ROBOT, **{"settings": SETTINGS, "safety": SAFETY, **more})
    connection.close()
    assert not fake.log, "nothing may be done to it"
    return one_line(fake, caught.value)


def one_line(fake: FakeRobot, error: Exception) -> str:
    assert "\n" not in str(error)
    assert fake.uri in str(error)
    return str(error)


def test_a_pepper_that_is_well(fake: FakeRobot) -> None:
    found = asked(fake)
    assert (found.kind, found.version, found.body_id) == ("Juliette", "2.5.10.7", "body-7")
    assert not fake.log


@pytest.mark.parametrize("kind", ["Pepper", "juliette", None])
def test_what_a_pepper_calls_itself(fake: FakeRobot, kind: str | None) -> None:
    """NAOqi 2.9 says it elsewhere."""
    fake.memory["RobotConfig/Body/Type"] = kind
    fake.model.kind = "Pepper"
    assert asked(fake).body_id == "body-7"


@pytest.mark.parametrize("kind", ["Nao", "romeo", "pepper2", ""])
def test_another_robot(fake: FakeRobot, kind: str) -> None:
    fake.memory["RobotConfig/Body/Type"] = kind
    fake.model.kind = kind
    message = refused(fake)
    assert "not a Pepper" in message
    assert kind in message


def test_a_robot_that_says_nothing_of_itself() -> None:
    with FakeRobot(without=("ALMemory", "ALRobotModel")) as fake:
        assert "does not say what robot it is" in refused(fake)


def test_no_dcm() -> None:
    with FakeRobot(without=("DCM", "ALSystem")) as fake:
        message = refused(fake)
        assert "(NAOqi ?) has no DCM" in message
        assert "?mode=angles" in message
        assert asked(fake, need_dcm=False).body_id == "body-7"


@pytest.mark.parametrize("value", [None, math.nan, "broken"])
def test_keys_that_are_missing(fake: FakeRobot, value: object) -> None:
    for name in KEYS[:5]:
        fake.memory[name] = value
    message = refused(fake)
    assert all(name in message for name in KEYS[:3])
    assert KEYS[3] not in message
    assert "and 2 more" in message


def test_a_robot_fit_to_move(fake: FakeRobot) -> None:
    connection = fake.connect()
    check_robot(connection, ROBOT, SETTINGS, SAFETY)
    connection.close()
    assert not fake.log


def test_motors_off(fake: FakeRobot) -> None:
    fake.motion.is_awake = False
    message = unfit(fake)
    assert "motors: off" in message
    assert "?wake=1" in message
    connection = fake.connect()
    check_robot(connection, ROBOT, SETTINGS, SAFETY, may_sleep=True)
    connection.close()


@pytest.mark.parametrize("beyond", [0.06, -3.0])
def test_a_joint_outside_its_limits(fake: FakeRobot, beyond: float) -> None:
    joint = ROBOT.joints[ROBOT.joint_index("LElbowRoll")]
    fake.memory[key(ELBOW)] = joint.upper + 0.04
    connection = fake.connect()
    check_robot(connection, ROBOT, SETTINGS, SAFETY)
    connection.close()
    fake.memory[key(ELBOW)] = joint.upper + beyond
    message = unfit(fake)
    assert "LElbowRoll is" in message
    assert "beyond its limit" in message
    assert "by hand" in message


def test_a_joint_without_a_position(fake: FakeRobot) -> None:
    fake.memory[key(ELBOW)] = None
    assert "no position of LElbowRoll" in unfit(fake)


def test_a_low_battery(fake: FakeRobot) -> None:
    fake.memory[key(NAMES.battery_charge)] = 0.09
    message = unfit(fake)
    assert "battery: 9%" in message
    assert "charge it" in message


def test_an_open_charging_flap(fake: FakeRobot) -> None:
    fake.memory[key(NAMES.charging_flap)] = 1.0
    message = unfit(fake)
    assert "charging flap: open" in message
    assert "close the flap" in message
    connection = fake.connect()
    check_robot(connection, ROBOT, replace(SETTINGS, charging_flap="stand"), SAFETY)
    connection.close()


def test_a_motor_too_hot(fake: FakeRobot) -> None:
    name = key(NAMES.temperature_status.format(joint="KneePitch"))
    fake.memory[name] = 1.0
    connection = fake.connect()
    check_robot(connection, ROBOT, SETTINGS, SAFETY)
    connection.close()
    fake.memory[name] = 2.0
    assert "too hot, status 2 of 3: KneePitch" in unfit(fake)


def test_a_broken_device_that_matters(fake: FakeRobot) -> None:
    fake.memory["Diagnosis/Passive/KneePitch/Error"] = 1
    message = unfit(fake)
    assert "KneePitch: its board does not answer" in message


def found_broken(connection: Connection) -> dict[str, DeviceError]:
    errors = diagnosis(connection, ROBOT)
    assert errors is not None
    return {error.device: error for error in errors}


def test_the_diagnosis(fake: FakeRobot) -> None:
    connection = fake.connect()
    assert diagnosis(connection, ROBOT) == ()
    fake.diagnosis.passive = [1, ["LElbowRoll", "Sonar"]]
    fake.diagnosis.active = [2, ["CameraDepth"]]
    fake.memory["Diagnosis/Temperature/LElbowRoll/Error"] = 1
    fake.memory["Diagnosis/Passive/LElbowRoll/Error"] = 1
    fake.memory["Diagnosis/Active/CameraTop/Error"] = 1
    fake.memory["Diagnosis/Active/Knee/Brake/Error"] = 1
    fake.memory["Diagnosis/Active/HeadYaw/Error"] = None
    found = found_broken(connection)
    connection.close()
    assert set(found) == {"LElbowRoll", "Sonar", "CameraDepth", "CameraTop", "Knee/Brake"}
    serious = {name for name, error in found.items() if error.serious}
    assert serious == {"LElbowRoll", "CameraDepth", "Knee/Brake"}
    assert "board" in found["LElbowRoll"].text
    assert "too hot" in found["LElbowRoll"].text
    assert "wakes up" in found["CameraTop"].text


def test_a_negligible_error_of_a_joint_stops_nothing(fake: FakeRobot) -> None:
    fake.diagnosis.passive = [0, ["HeadYaw"]]
    connection = fake.connect()
    assert not found_broken(connection)["HeadYaw"].serious
    connection.close()


def test_no_diagnosis() -> None:
    with FakeRobot(without=("ALDiagnosis", "ALMemory")) as fake:
        connection = fake.connect()
        assert diagnosis(connection, ROBOT) is None
        connection.close()
