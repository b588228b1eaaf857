"""The device list: exactly the documented keys, each with a value."""

from dataclasses import replace
from pathlib import Path

import pytest

from pepper_driver.config import ConfigError, load_robot
from pepper_driver.config.loading import package_file
from pepper_driver.config.naoqi_devices import load_naoqi_devices
from support import ROOT

ROBOT = load_robot()
DEVICES = load_naoqi_devices(ROBOT)
SHIPPED = package_file("naoqi_devices.yaml").read_text()


def changed(tmp_path: Path, old: str, new: str) -> Path:
    path = tmp_path / "devices.yaml"
    assert old in SHIPPED
    path.write_text(SHIPPED.replace(old, new))
    return path


def test_the_keys_are_those_of_the_documentation() -> None:
    lines = (ROOT / "tests" / "facts" / "naoqi_keys.txt").read_text().splitlines()
    documented = {line for line in lines if line and not line.startswith("#")}
    assert set(DEVICES.values) == documented
    assert len(documented) == 552


def test_actuators_and_those_that_step() -> None:
    assert all(key.endswith("/Actuator/Value") for key in DEVICES.actuators)
    assert len(DEVICES.actuators) == 2 * 17 + 2 * 3 + 4 + 20 + 48 + 3
    assert DEVICES.steps <= set(DEVICES.actuators)
    assert not any("Position" in key or "Speed" in key for key in DEVICES.steps)


def test_a_list_has_a_value_for_each_number() -> None:
    laser = "Device/SubDeviceList/Platform/LaserSensor/Front/Horizontal/Seg{:02}/{}/Sensor/Value"
    across = [DEVICES.values[laser.format(number, "Y")] for number in range(1, 16)]
    assert across == sorted(across, reverse=True)
    assert across[7] == 0.0


def test_events_name_sensors_that_are_there() -> None:
    assert DEVICES.events["RightBumperPressed"] == (
        "Device/SubDeviceList/Platform/FrontRight/Bumper/Sensor/Value",
        "Bumper/FrontRight",
    )


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("[2.89, ", "[", "14 values"),
        ("steps: [", "steps: [Head/Led/Actuator/Value, ", "Head/Led"),
        ("[Head/Touch/Front/Sensor/Value", "[Head/Touch/Frnt/Sensor/Value", "Frnt"),
        ("body_id:", "bodyid:", "bodyid"),
    ],
)
def test_mistakes_are_one_line(tmp_path: Path, old: str, new: str, word: str) -> None:
    with pytest.raises(ConfigError, match=word) as error:
        load_naoqi_devices(ROBOT, changed(tmp_path, old, new))
    assert "\n" not in str(error.value)


def test_another_robot_has_keys_of_its_own_joints() -> None:
    fewer = replace(ROBOT, joints=ROBOT.joints[:3])
    keys = load_naoqi_devices(fewer).values
    assert not any("HeadYaw/" in key for key in keys)
