"""Meaning of the robot's values, and answers that are no sample."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.naoqi.memory_keys import Alias, SensorKeys, Values, actuator_keys
from pepper_driver.config import load_robot

ROBOT = load_robot()
KEYS = SensorKeys(ROBOT)
PREFIX = "Device/SubDeviceList/"


def answer(**changed: Any) -> list[Any]:
    """Answer of a robot, each value its own; keys are places in the list."""
    values: list[Any] = [0.001 * place for place in range(len(KEYS.names))]
    values[KEYS.names.index("DCM/Time")] = -7
    for key, value in changed.items():
        values[int(key.removeprefix("at_"))] = value
    return values


def test_what_the_dcm_commands_comes_after_all_else() -> None:
    joints, wheels = ROBOT.joint_names, ROBOT.wheels.names
    assert KEYS.with_commands[: len(KEYS.names)] == KEYS.names
    assert KEYS.with_commands[len(KEYS.names) :] == [
        *(f"{PREFIX}{name}/Position/Actuator/Value" for name in joints),
        *(f"{PREFIX}{name}/Speed/Actuator/Value" for name in wheels),
    ]
    plain = KEYS.values(answer())
    sample = KEYS.values([*answer(), *(10.0 + n for n in range(19)), None])
    assert isinstance(plain, Values)
    assert isinstance(sample, Values)
    assert plain.commanded is None
    assert sample.commanded is not None
    assert sample.commanded[:19].tolist() == [10.0 + n for n in range(19)]
    assert np.isnan(sample.commanded[19]), "which makes it no worse a sample"
    assert sample.shown == plain.shown
    np.testing.assert_array_equal(sample.position, plain.position)
    assert isinstance(KEYS.values([*answer(), 1.0]), str)


def test_every_value_is_found_at_its_place() -> None:
    values = KEYS.values(answer())
    assert isinstance(values, Values)
    assert values.shown == -7

    def value(key: str) -> float:
        return 0.001 * KEYS.names.index(PREFIX + key)

    joints, wheels = ROBOT.joint_names, ROBOT.wheels.names
    for name, position, current, temperature, stiffness in zip(
        joints,
        values.position,
        values.current,
        values.temperature,
        values.stiffness,
        strict=True,
    ):
        assert stiffness == value(f"{name}/Hardness/Actuator/Value")
        assert position == value(f"{name}/Position/Sensor/Value")
        assert current == value(f"{name}/ElectricCurrent/Sensor/Value")
        assert temperature == value(f"{name}/Temperature/Sensor/Value")
    for name, speed in zip(wheels, values.wheel_speed, strict=True):
        assert speed == value(f"{name}/Speed/Sensor/Value")
    for place, axis in enumerate("XYZ"):
        unit = "InertialSensorBase/{}" + axis + "/Sensor/Value"
        assert values.imu.acceleration[place] == value(unit.format("Accelerometer"))
        assert values.imu.angular_velocity[place] == value(unit.format("Gyroscope"))
        assert values.imu.attitude[place] == value(unit.format("Angle"))
    assert values.touch[0] == value("Head/Touch/Front/Sensor/Value")
    assert values.touch[4] == value("RHand/Touch/Back/Sensor/Value")
    assert values.bumpers[2] == value("Platform/Back/Bumper/Sensor/Value")
    assert values.buttons.tolist() == [value("ChestBoard/Button/Sensor/Value")]
    assert values.battery == value("Battery/Charge/Sensor/Value")
    assert values.charging_flap == value("Platform/ILS/Sensor/Value")


def test_actuators() -> None:
    keys = actuator_keys(ROBOT)
    assert keys[Alias.POSITION][0] == PREFIX + "KneePitch/Position/Actuator/Value"
    assert keys[Alias.STIFFNESS][16] == PREFIX + "RHand/Hardness/Actuator/Value"
    assert keys[Alias.WHEEL_SPEED][2] == PREFIX + "WheelB/Speed/Actuator/Value"
    assert keys[Alias.WHEEL_STIFFNESS][1] == PREFIX + "WheelFR/Stiffness/Actuator/Value"


@pytest.mark.parametrize("bad", [None, float("nan"), float("inf"), "warm", [1.0], {}])
def test_a_needed_value_that_is_no_number_spoils_the_sample(bad: Any) -> None:
    for key in KEYS.needed:
        found = KEYS.values(answer(**{f"at_{KEYS.names.index(key)}": bad}))
        assert isinstance(found, str)
        assert key in found
        assert "\n" not in found


def test_joints_without_values_are_named_as_far_as_one_board_explains_it() -> None:
    def lacking(*keys: str) -> str:
        places = {f"at_{KEYS.names.index(PREFIX + key + '/Sensor/Value')}": None for key in keys}
        found = KEYS.values(answer(**places))
        assert isinstance(found, str)
        return found

    elbow = ("RElbowYaw/Position", "RElbowYaw/ElectricCurrent", "RElbowYaw/Temperature")
    assert lacking(*elbow).startswith("no answer from RElbowYaw, whose board is off or unplugged")
    both = lacking("RElbowYaw/Position", "RElbowRoll/Position")
    assert both.startswith("no answer from RElbowYaw and RElbowRoll, whose")
    for more in ("HeadYaw/Position", "WheelB/Speed"):
        assert lacking(*elbow, "RElbowRoll/Position", more).startswith("no number for")


@pytest.mark.parametrize("bad", [None, float("nan"), "warm"])
def test_temperatures_battery_and_flap_may_be_missing(bad: Any) -> None:
    for key in set(KEYS.names) - set(KEYS.needed):
        found = KEYS.values(answer(**{f"at_{KEYS.names.index(key)}": bad}))
        assert isinstance(found, Values)
    assert len(KEYS.names) - len(KEYS.needed) == 19


@given(
    answer_=st.one_of(
        st.none(),
        st.text(max_size=5),
        st.integers(),
        st.lists(st.one_of(st.none(), st.floats(), st.text(max_size=3)), max_size=80),
        st.lists(st.lists(st.floats(), max_size=2), max_size=3),
    )
)
def test_whatever_else_comes_is_no_sample(answer_: Any) -> None:
    assert isinstance(KEYS.values(answer_), str)


def test_a_sample_cannot_be_changed() -> None:
    values = KEYS.values(answer())
    assert isinstance(values, Values)
    with pytest.raises(ValueError, match="read-only"):
        values.position[0] = 1.0
    assert np.isfinite(values.position).all()
