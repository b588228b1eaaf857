"""Reading the robot: the newest of each thing, by name, from any thread, before, while and after it ticks."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pepper_driver import Pepper
from pepper_driver.backends import BackendError, Measurement
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import UnknownNameError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.loading import package_file
from pepper_driver.controller import TargetError
from pepper_driver.observer import Contact
from pepper_driver.safety import RobotState
from support.reflexes import touch
from support.robots import make_pepper
from support.sessions import ROBOT, Scripted, backend_of, in_thread, stepped_time


class Reporting(MockBackend):
    """Each measurement says in all its fields which one it is."""

    def read(self) -> Measurement:
        measurement = super().read()
        return replace(
            measurement,
            current=np.full(17, float(measurement.tick)),
            wheel_speed=np.full(3, measurement.tick * 1e-6),
        )


class Counting(Scripted):
    """Each observation says which measurement it is of."""

    def step(self, tick: Any) -> Any:
        return replace(super().step(tick), torque=np.full(17, float(tick.measurement.tick)))


def test_several_threads_read_what_belongs_together_and_never_go_back() -> None:
    stop, reads = threading.Event(), [0, 0, 0]

    def read(reader: int) -> None:
        newest = 0
        while not stop.is_set():
            measurement, observation = pepper.measurement, pepper.observation
            number = measurement.tick
            assert measurement.time == pytest.approx(number * ROBOT.cycle)
            assert (measurement.current == number).all()
            assert measurement.wheel_speed[0] == number * 1e-6
            assert number >= newest
            if observation is not None:
                assert (observation.torque == observation.torque[0]).all()
                assert observation.torque[0] >= number, "it was read later"
            assert pepper.time >= measurement.time
            assert pepper.position.shape == (17,)
            assert pepper.base_pose.shape == (3,)
            pepper.link_pose("LForeArm")
            newest = number
            reads[reader] += 1

    with stepped_time() as time, pytest.MonkeyPatch.context() as patch:
        patch.setattr("pepper_driver.robot.make_backend", lambda *_: Reporting())
        pepper = Pepper("any", observer=Counting(), real_time=True)
        with pepper, time.flowing():
            readers = [in_thread(partial(read, number)) for number in range(len(reads))]
            pepper.set_posture({"HeadYaw": 0.5})
            read_enough = pepper.run(60.0, until=lambda: min(reads) > 10)
            stop.set()
            for reader in readers:
                reader.result()
            assert read_enough


def test_joints_by_name_and_as_an_array() -> None:
    with make_pepper() as pepper:
        pepper.set_posture({"HeadYaw": 0.4}, duration=1.0)
        pepper.run(1.5)
        assert pepper.position["HeadYaw"] == pytest.approx(0.4, abs=1e-3)
        assert isinstance(pepper.position["HeadYaw"], float)
        np.testing.assert_array_equal(pepper.position, pepper.measurement.position)
        assert pepper.target["HeadYaw"] == 0.4
        assert pepper.target["HeadPitch"] == ROBOT.posture("Stand")[ROBOT.joint_index("HeadPitch")]
        with pytest.raises(UnknownNameError, match="HeadYaw"):
            pepper.position["HeadYam"]
        with pytest.raises(UnknownNameError):
            pepper.target["head"]
        mine = pepper.position
        mine += 1.0
        assert pepper.position["HeadYaw"] == pytest.approx(0.4, abs=1e-3), "it was a copy"
        mine = pepper.target
        mine[:] = 0.0
        assert pepper.target["HeadYaw"] == 0.4


def by_pinocchio(link: str, position: FloatArray) -> FloatArray:
    """(4, 4) of a link in base_link, from the URDF."""
    model = pin.buildModelFromUrdf(str(package_file("pepper.urdf")))
    data, q = model.createData(), pin.neutral(model)
    for name, angle in zip(ROBOT.joint_names, position, strict=True):
        if model.existJointName(name):
            q[model.joints[model.getJointId(name)].idx_q] = angle
    pin.framesForwardKinematics(model, data, q)
    base = data.oMf[model.getFrameId("base_link")]
    pose: FloatArray = (base.inverse() * data.oMf[model.getFrameId(link)]).homogeneous
    return pose


@pytest.mark.parametrize("link", ["l_wrist", "RForeArm", "Head", "torso", "base_link"])
def test_poses_of_links_as_measured_and_as_commanded(link: str) -> None:
    pepper = make_pepper()
    pepper.backend = MockBackend(delay=4)
    with pepper:
        pepper.set_posture(
            {"LShoulderPitch": 0.5, "RElbowRoll": 1.0, "HeadYaw": 0.6, "HipRoll": 0.1}
        )
        pepper.run(0.3)
        measured, commanded = pepper.link_pose(link), pepper.link_pose(link, of="commanded")
        sent = backend_of(pepper).commands[-1].position
        assert np.abs(sent - pepper.position).max() > 0.02, "it lags behind"
        np.testing.assert_allclose(measured, by_pinocchio(link, pepper.position), atol=1e-9)
        np.testing.assert_allclose(commanded, by_pinocchio(link, sent), atol=1e-9)
        if link != "base_link":
            assert np.abs(measured - commanded).max() > 1e-3
        measured[:] = 0.0
        assert pepper.link_pose(link)[3, 3] == 1.0, "it was a copy"
        np.testing.assert_allclose(
            pepper.link_pose(link, of="commanded"),
            pepper.controller.model.link_pose(link, sent),
        )


def test_wrong_links_and_kinds_of_poses_are_refused() -> None:
    with make_pepper() as pepper:
        with pytest.raises(UnknownNameError, match="LForeArm"):
            pepper.link_pose("LForearm")
        with pytest.raises(TargetError, match="measured"):
            pepper.link_pose("LForeArm", of="wanted")  # type: ignore[arg-type]


def test_touches_are_the_contacts_that_last() -> None:
    first, grown, second = touch(1), touch(1, "update", intensity_deg=9.0), touch(2, link="Head")
    script: dict[int, tuple[Contact, ...]] = {
        2: (first,),
        3: (second,),
        4: (grown,),
        5: (touch(1, "end"), touch(3, kind="rebound")),
        6: (touch(2, "update", kind="rebound"),),
    }
    lasting: list[tuple[Contact, ...]] = []
    with make_pepper(observer=Scripted(script)) as pepper:
        assert pepper.touches == ()
        for _ in range(6):
            pepper.step()
            lasting.append(pepper.touches)
    assert lasting == [(), (first,), (first, second), (grown, second), (second,), ()]
    with pepper:
        assert pepper.touches == ()
        assert not pepper.contact_history


def test_the_base_is_where_its_wheels_have_rolled_to() -> None:
    with make_pepper() as pepper:
        np.testing.assert_array_equal(pepper.base_pose, 0.0)
        pepper.drive(0.2, 0.0, 0.0, hold=True)
        rolled = 0.0
        for _ in range(200):
            measurement, _ = pepper.step()
            rolled += (ROBOT.wheels.inverse @ measurement.wheel_speed)[0] * ROBOT.cycle
        x, y, heading = pepper.base_pose
        assert x == pytest.approx(rolled, abs=1e-6)
        assert 0.2 < x < 0.5
        assert abs(y) + abs(heading) < 1e-6
        pepper.base_pose[:] = 7.0
        assert pepper.base_pose[0] == x


READS = [
    "measurement",
    "observation",
    "position",
    "target",
    "base_pose",
    "time",
    "controller",
    "statistics",
]


def test_before_the_start_there_is_nothing_to_read() -> None:
    pepper = make_pepper()
    for name in READS:
        with pytest.raises(BackendError, match="was never started"):
            getattr(pepper, name)
    with pytest.raises(BackendError, match="was never started"):
        pepper.link_pose("Head")
    assert pepper.state is RobotState.INACTIVE
    for nothing in (pepper.touches, pepper.contact_history, pepper.callback_statistics):
        assert not nothing


def test_a_start_that_failed_leaves_nothing_to_read() -> None:
    pepper = make_pepper()
    pepper.backend.open()
    with pytest.raises(BackendError, match="already open"):
        pepper.start()
    with pytest.raises(BackendError, match="was never started"):
        _ = pepper.measurement
    assert pepper.state is RobotState.INACTIVE


def test_before_the_first_tick_the_robot_is_where_it_was_found() -> None:
    with make_pepper(observer=Scripted()) as pepper:
        assert pepper.measurement.tick == 0
        assert pepper.observation is None
        assert pepper.touches == ()
        np.testing.assert_array_equal(pepper.position, ROBOT.posture("Stand"))
        np.testing.assert_array_equal(
            pepper.link_pose("l_wrist"), pepper.link_pose("l_wrist", of="commanded")
        )
        np.testing.assert_array_equal(pepper.base_pose, 0.0)
        assert pepper.state is RobotState.ACTIVE


@pytest.mark.parametrize("real_time", [False, True])
def test_after_the_end_it_is_where_it_was_seen_last(real_time: bool) -> None:
    with stepped_time() as time, time.flowing():
        with make_pepper(observer=Scripted({3: (touch(),)}), real_time=real_time) as pepper:
            pepper.set_posture({"HeadYaw": 0.4})
            pepper.run(0.6)
        tick = pepper.measurement.tick
        assert tick >= 50
        assert pepper.time == pytest.approx(tick * ROBOT.cycle)
        assert pepper.position["HeadYaw"] > 0.01
        assert pepper.touches == (touch(),)
        assert pepper.link_pose("Head").shape == (4, 4)
        assert pepper.statistics.ticks == tick
        assert pepper.state is RobotState.INACTIVE


def test_a_step_returns_what_can_be_read() -> None:
    with make_pepper(observer=Scripted({2: (touch(),)})) as pepper:
        for number in (1, 2, 3):
            measurement, observation = pepper.step()
            assert measurement.tick == number
            assert measurement is pepper.measurement
            assert observation is pepper.observation
            assert observation is not None
            assert bool(observation.contacts) == (number == 2)
    with make_pepper() as pepper:
        assert pepper.step()[1] is None


@pytest.fixture(autouse=True)
def no_threads_are_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= before
