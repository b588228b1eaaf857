"""Between DCM and simulated Pepper: hardness, wheel stiffness and commands act, sensors are published."""

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.backends import Command
from pepper_driver.backends.mujoco_ import MujocoBackend
from pepper_driver.backends.naoqi_server.robot_faults import RobotFaults
from pepper_driver.backends.naoqi_server.robot_process import DcmHardware
from pepper_driver.backends.naoqi_server.shared_values import table_keys
from pepper_driver.backends.selection import make_backend
from pepper_driver.config import PepperError, load_plant, load_robot
from pepper_driver.config.naoqi_devices import load_naoqi_devices
from support.virtual_time import VirtualTime

ROBOT = load_robot()
DEVICES = load_naoqi_devices(ROBOT)
PREFIX = "Device/SubDeviceList/"


def backend(uri: str = "mujoco://?seed=3") -> MujocoBackend:
    made = make_backend(uri, ROBOT)
    assert isinstance(made, MujocoBackend)
    return made


class Bench:
    """A body without a DCM: values of actuators are set at once."""

    def __init__(self, simulated: MujocoBackend | None = None) -> None:
        self.body = DcmHardware(ROBOT, DEVICES, simulated or backend(), 0)
        self.actuators = self.body.actuator_values
        self.cycles = 0

    def set(self, pattern: str, value: float) -> None:
        matching = [key for key in self.actuators if key.endswith(pattern)]
        assert matching, pattern
        for key in matching:
            self.actuators[key] = value

    def run(self, cycles: int) -> None:
        for _ in range(cycles):
            self.cycles += 1
            self.body.cycle(list(self.actuators.values()), self.cycles * 12)

    def value(self, name: str) -> float:
        return float(self.body.values[self.body.keys[PREFIX + name]])


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_every_key_has_a_place_and_a_value(bench: Bench) -> None:
    keys = table_keys(ROBOT, DEVICES)
    assert bench.body.keys == keys
    assert set(keys) == {*DEVICES.values, "DCM/Time"}
    assert sorted(keys.values()) == list(range(len(keys)))
    assert np.isfinite(bench.body.values).all()
    begun = DcmHardware(ROBOT, DEVICES, backend(), -5)
    assert begun.values[keys["DCM/Time"]] == -5


def test_the_boards_begin_where_the_joints_are(bench: Bench) -> None:
    for number, name in enumerate(ROBOT.joint_names):
        start = bench.body.measurement.position[number]
        assert bench.value(f"{name}/Position/Actuator/Value") == pytest.approx(start, abs=0.01)
        assert bench.value(f"{name}/Position/Sensor/Value") == start
        assert bench.value(f"{name}/Hardness/Actuator/Value") == 0.0


def test_a_joint_moves_only_with_hardness(bench: Bench) -> None:
    bench.set("HeadYaw/Position/Actuator/Value", 0.3)
    bench.run(80)
    assert abs(bench.value("HeadYaw/Position/Sensor/Value")) < 0.02
    bench.set("HeadYaw/Hardness/Actuator/Value", 1.0)
    bench.run(80)
    assert bench.value("HeadYaw/Position/Sensor/Value") == pytest.approx(0.3, abs=0.04)
    assert bench.value("HeadYaw/ElectricCurrent/Sensor/Value") >= 0.0


def test_an_arm_without_hardness_hangs_and_brakes_hold_the_legs(bench: Bench) -> None:
    bench.set("Hardness/Actuator/Value", 1.0)
    bench.set("LShoulderPitch/Position/Actuator/Value", 0.6)
    bench.run(200)
    raised = bench.value("LShoulderPitch/Position/Sensor/Value")
    knee = bench.value("KneePitch/Position/Sensor/Value")
    bench.set("Hardness/Actuator/Value", 0.0)
    bench.run(200)
    assert raised == pytest.approx(0.6, abs=0.05)
    assert bench.value("LShoulderPitch/Position/Sensor/Value") > raised + 0.3
    assert bench.value("KneePitch/Position/Sensor/Value") == pytest.approx(knee, abs=0.02)


def test_each_wheel_turns_only_with_stiffness(bench: Bench) -> None:
    bench.set("Speed/Actuator/Value", 1.0)
    bench.run(40)
    assert all(abs(bench.value(f"{w}/Speed/Sensor/Value")) < 0.05 for w in ROBOT.wheels.names)
    bench.set("Stiffness/Actuator/Value", 1.0)  # all three alike: the base turns on the spot
    bench.run(120)
    for wheel in ROBOT.wheels.names:
        assert bench.value(f"{wheel}/Speed/Sensor/Value") == pytest.approx(1.0, abs=0.15)
    bench.set("Stiffness/Actuator/Value", 0.0)
    bench.run(120)
    for wheel in ROBOT.wheels.names:
        assert abs(bench.value(f"{wheel}/Speed/Sensor/Value")) < 0.3, "it runs out"


def test_one_wheel_alone_has_stiffness(bench: Bench) -> None:
    bench.set("WheelB/Speed/Actuator/Value", 2.0)
    bench.set("WheelFL/Speed/Actuator/Value", 2.0)
    bench.set("WheelB/Stiffness/Actuator/Value", 1.0)
    bench.run(120)
    assert bench.value("WheelB/Speed/Sensor/Value") == pytest.approx(2.0, abs=0.3)
    assert bench.value("WheelFL/Speed/Sensor/Value") < 1.0


def test_beyond_its_limit_a_joint_is_not_driven(bench: Bench) -> None:
    """ "Actuators store the last requested commands while Sensors store the real values", page "DCM"."""
    yaw = ROBOT.joint_index("HeadYaw")
    bench.set("HeadYaw/Hardness/Actuator/Value", 7.0)
    bench.set("HeadYaw/Position/Actuator/Value", 5.0)
    bench.set("Speed/Actuator/Value", 100.0)
    bench.run(1)
    assert bench.value("HeadYaw/Position/Actuator/Value") == 5.0
    assert bench.body.sent.position[yaw] == ROBOT.upper[yaw]
    assert bench.body.sent.stiffness[yaw] == 1.0
    assert (bench.body.sent.wheel_speed == ROBOT.wheels.speed_limit).all()


def test_sensors_are_those_of_the_simulation_bit_by_bit(bench: Bench) -> None:
    """The plant behind the stand-in is the one behind ``mujoco``: same seed, same commands, same samples."""
    other = backend()
    other.open()
    other.switch_on()
    position = bench.body.sent.position.copy()
    bench.set("Hardness/Actuator/Value", 1.0)
    bench.set("Stiffness/Actuator/Value", 1.0)
    for number in range(100):
        target = position + 0.2 * np.sin(number / 15.0)
        for joint, value in zip(ROBOT.joint_names, target, strict=True):
            bench.actuators[f"{PREFIX}{joint}/Position/Actuator/Value"] = float(value)
        bench.run(1)
        clipped = np.clip(target, ROBOT.lower, ROBOT.upper)
        sample = other.exchange(
            Command(position=clipped, stiffness=np.ones(17), wheel_speed=np.zeros(3))
        )
        for joint, position_, current in zip(
            ROBOT.joint_names, sample.position, sample.current, strict=True
        ):
            assert bench.value(f"{joint}/Position/Sensor/Value") == position_
            assert bench.value(f"{joint}/ElectricCurrent/Sensor/Value") == current
    assert (
        bench.value("InertialSensorBase/AccelerometerZ/Sensor/Value") == sample.imu.acceleration[2]
    )
    assert bench.value("Battery/Charge/Sensor/Value") == sample.battery
    assert bench.body.values[bench.body.keys["DCM/Time"]] == 1200.0


@pytest.mark.parametrize(("start", "status"), [(38.0, 0.0), (70.0, 1.0), (80.0, 2.0)])
def test_hot_motors_say_so(start: float, status: float) -> None:
    plant = load_plant("nominal", ROBOT)
    hot = MujocoBackend(ROBOT, replace(plant, heat=replace(plant.heat, start=start)))
    bench = Bench(hot)
    assert bench.value("HeadYaw/Temperature/Sensor/Value") == start
    assert bench.value("HeadYaw/Temperature/Sensor/Status") == status


def test_registers_that_mirror_their_actuator(bench: Bench) -> None:
    bench.set("Front/Reg/OperationMode/Actuator/Value", 4.0)
    bench.run(1)
    assert bench.value("Platform/LaserSensor/Front/Reg/OperationMode/Sensor/Value") == 4.0
    assert bench.value("Platform/LaserSensor/Left/Reg/OperationMode/Sensor/Value") == 0.0


def test_a_push_on_a_bumper_is_detected(bench: Bench) -> None:
    bench.body.backend.push("Tibia", np.array([-30.0, 0, 0]), np.array([0.129, 0.227, -0.264]))
    bench.run(20)
    assert bench.value("Platform/FrontLeft/Bumper/Sensor/Value") == 1.0
    assert bench.value("Platform/Back/Bumper/Sensor/Value") == 0.0


def test_pressed_sensors_are_published_and_let_go() -> None:
    keys = table_keys(ROBOT, DEVICES)
    faults, values = RobotFaults(ROBOT, keys), np.zeros(len(keys))
    faults.set("press", {"sensors": "Head/Touch/Front+FrontLeft+ChestBoard/Button"})
    faults.sensors(values)
    pressed = {key.removeprefix(PREFIX) for key, place in keys.items() if values[place]}
    assert pressed == {
        "Head/Touch/Front/Sensor/Value",
        "Platform/FrontLeft/Bumper/Sensor/Value",
        "ChestBoard/Button/Sensor/Value",
    }
    faults.clear()
    values[:] = 0.0
    faults.sensors(values)
    assert not values.any()


def test_a_fraction_of_the_samples_is_dropped() -> None:
    """In place of each of them the one before is shown, which may be shown for longer."""
    keys = table_keys(ROBOT, DEVICES)
    faults = RobotFaults(ROBOT, keys)
    faults.set("dropped", {"fraction": 0.33})
    shown = []
    for number in range(3000):
        values = np.full(len(keys), float(number))
        faults.sensors(values)
        assert values.min() == values.max(), "whole samples"
        shown.append(values[0])
    dropped = np.array(shown) != np.arange(3000)
    assert dropped.mean() == pytest.approx(0.33, abs=0.035), "four standard deviations"
    assert (np.diff(shown)[dropped[1:]] == 0.0).all()


def test_a_fault_of_the_robot_has_its_times() -> None:
    keys, time = table_keys(ROBOT, DEVICES), VirtualTime()
    faults = RobotFaults(ROBOT, keys, time.clock())
    faults.set("press", {"seconds": 0.5, "after": 0.25})
    pressed = []
    for _ in range(8):
        values = np.zeros(len(keys))
        faults.sensors(values)
        pressed.append(bool(values.any()))
        time.sleep(0.125)
    assert pressed == [False, False, True, True, True, True, False, False]


@pytest.mark.parametrize(
    ("name", "arguments", "word"),
    [
        ("prss", {}, "press"),
        ("press", {"sensors": ["Back"]}, "must be a text"),
        ("press", {"sensors": "Head/Touch/Frnt"}, "Head/Touch/Front"),
        ("press", {"sensor": "Back"}, "sensors"),
    ],
)
def test_faults_that_cannot_be(name: str, arguments: dict[str, object], word: str) -> None:
    faults = RobotFaults(ROBOT, table_keys(ROBOT, DEVICES))
    with pytest.raises(PepperError, match=word):
        faults.set(name, arguments)
