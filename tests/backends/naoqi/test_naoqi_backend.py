"""The backend against the stand-in and its black box, in virtual time and at the shipped bounds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.backends import (
    BackendError,
    CapabilityError,
    Command,
    Measurement,
    NotConnectedError,
    make_backend,
)
from pepper_driver.backends.naoqi.robot import NaoqiRobot
from pepper_driver.backends.naoqi_server.shared_values import BlackBox
from pepper_driver.config import (
    ConfigError,
    UnknownNameError,
    load_naoqi_settings,
    load_robot,
)
from pepper_driver.config.arrays import FloatArray
from support.virtual_naoqi import VirtualNaoqi, pacer_of

pytestmark = pytest.mark.usefixtures("qi")

ROBOT = load_robot()
SETTINGS = load_naoqi_settings()
ONES, STILL = np.ones(17), np.zeros(3)
SMART = 0.69
"""What ALMotion's smart stiffness leaves to joints that stand is above it."""
LEGS = np.array([name in ROBOT.chains["legs"] for name in ROBOT.joint_names])


@pytest.fixture
def robot() -> Iterator[VirtualNaoqi]:
    """Awake, and its owner allows all: as a robot is that a person works with."""
    with VirtualNaoqi() as robot:
        robot.wake_up()
        yield robot


@pytest.fixture
def backend(robot: VirtualNaoqi) -> Iterator[NaoqiRobot]:
    backend = robot.backend()
    yield backend
    backend.close()


def run(
    backend: NaoqiRobot,
    ticks: int,
    position: Callable[[int], FloatArray],
    wheels: FloatArray = STILL,
    stiffness: FloatArray = ONES,
    until: Callable[[Measurement], bool] = lambda _: False,
) -> list[Measurement]:
    """Ticks, paced as those of a robot."""
    pacer, measured = pacer_of(backend), []
    for tick in range(ticks):
        pacer.wait()
        measured.append(backend.read())
        command = Command(position=position(tick), stiffness=stiffness, wheel_speed=wheels)
        backend.write(command)
        if until(measured[-1]):
            break
    return measured


def held(measurement: Measurement) -> FloatArray:
    return np.clip(measurement.position, ROBOT.lower, ROBOT.upper)


def assert_let_go(box: BlackBox) -> None:
    """Arms, head and wheels went soft, and gently; the legs did not.

    What ALMotion then does is its own: it gives them stiffness in the next cycle, or in the very one in which they lost
    the last of it.
    """
    assert box.stiffness[:, LEGS].min() >= SMART
    stiffest = box.stiffness[:, ~LEGS].max(axis=1)
    soft = int(np.argmin(stiffest))
    assert stiffest[soft] < 0.2, stiffest.round(2).tolist()
    steps = (
        np.diff(box.stiffness[: soft + 1, ~LEGS], axis=0) / np.diff(box.cycle[: soft + 1])[:, None]
    )
    assert steps.min() > -0.15
    assert not box.wheel_stiffness[soft].any()


def test_a_variant_behind_the_stand_in_is_known_as_one() -> None:
    with VirtualNaoqi("mujoco://?plant=drift&draw=5") as robot:
        for mode, suffix in (("dcm", ""), ("angles", "/angles")):
            info = robot.backend(mode).info
            parents = make_backend("mujoco://?plant=drift&draw=5").info.parents
            assert len(parents) == 2
            assert info.parents == tuple(
                replace(parent, identity=parent.identity + suffix) for parent in parents
            )


def recent(robot: VirtualNaoqi, seconds: float) -> BlackBox:
    robot.time.sleep(0.1)  # what was said last is done
    return robot.black_box(round(seconds / ROBOT.cycle))


# -- who it is ----------------------------------------------------------------------------------------------------


def test_the_stand_in_is_known_as_the_robot_it_simulates(
    robot: VirtualNaoqi, backend: NaoqiRobot
) -> None:
    info = backend.info
    assert info.identity == make_backend("mujoco").info.identity, "so its models apply"
    assert info.capabilities >= {"push", "grab"}
    assert info.simulated, "so its recordings are not taken for those of a real robot"
    assert "truth" not in info.capabilities
    assert backend.real_time
    assert info.response_delay == make_backend("mujoco").info.response_delay == 3
    slower = replace(SETTINGS, timing=replace(SETTINGS.timing, response_delay=5))
    assert robot.backend(settings=slower).info.response_delay == 5


@pytest.mark.parametrize(
    ("query", "word"),
    [
        ("delay=-1", "whole number"),
        ("delay=x", "whole number"),
        ("wake=2", "wake"),
        ("force=yes", "force"),
        ("dela=3", "delay"),
    ],
)
def test_a_wrong_key_is_reported_before_anything_is_looked_for(query: str, word: str) -> None:
    with pytest.raises(ConfigError, match=word) as caught:
        make_backend(f"naoqi://127.0.0.1:1?{query}")
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("qi")
def test_no_robot_there_is_one_line() -> None:
    backend = make_backend("naoqi://127.0.0.1:1")
    with pytest.raises(NotConnectedError, match=r"127\.0\.0\.1") as caught:
        backend.open()
    assert "\n" not in str(caught.value)
    backend.close()


# -- one after the other ------------------------------------------------------------------------------------------


def test_before_activation_all_sensors_are_read_and_nothing_is_sent(
    robot: VirtualNaoqi, backend: NaoqiRobot
) -> None:
    before = robot.black_box(1)
    begun = robot.time.seconds()
    first = backend.open()
    assert first.tick == 0
    requested = held(first) + 0.2
    measured = run(backend, 60, lambda _: np.clip(requested, ROBOT.lower, ROBOT.upper), np.ones(3))
    last = measured[-1]
    for name, size in (("position", 17), ("current", 17), ("temperature", 17), ("wheel_speed", 3)):
        values = getattr(last, name)
        assert values.shape == (size,)
        assert np.isfinite(values).all()
    assert np.linalg.norm(last.imu.acceleration) == pytest.approx(9.81, abs=0.3)
    assert last.touch.shape == (5,)
    assert last.buttons.tolist() == [0.0]
    assert 0.0 < last.battery <= 1.0
    assert last.charging_flap == 0.0
    assert last.response_delay is None
    assert 20.0 < last.temperature[0] < 60.0
    ticks = [measurement.tick for measurement in measured]
    assert np.diff(ticks).min() >= 0
    assert 30 < ticks[-1] <= (robot.time.seconds() - begun) / ROBOT.cycle
    box = robot.black_box(60)
    assert not box.wheel_command.any()
    np.testing.assert_allclose(box.position_command[-1], before.position_command[-1], atol=1e-3)


def test_activation_holds_and_deactivation_lets_all_go_but_the_legs(
    robot: VirtualNaoqi, backend: NaoqiRobot
) -> None:
    begun = robot.time.seconds()
    before = backend.open()
    after = backend.activate()
    assert np.abs(after.position - before.position).max() < np.radians(2.0)
    box = robot.since(begun)
    np.testing.assert_allclose(box.stiffness[-1], 1.0)
    np.testing.assert_allclose(box.wheel_stiffness[-1], 1.0)
    assert box.stiffness[:, LEGS].min() >= SMART, "they had it before, and keep it"
    np.testing.assert_allclose(box.position_command[-1], held(before), atol=0.02)
    begun = robot.time.seconds()
    backend.deactivate()
    assert_let_go(recent(robot, robot.time.seconds() - begun))
    with pytest.raises(BackendError, match="open"):
        backend.open()
    backend.activate()
    backend.close()
    with pytest.raises(NotConnectedError, match="not open"):
        backend.write(Command(position=held(before), stiffness=ONES, wheel_speed=STILL))


def test_the_dcm_is_at_each_command_at_a_cycle_and_samples_answer_it(
    robot: VirtualNaoqi, backend: NaoqiRobot
) -> None:
    backend.open()
    start = held(backend.activate())
    given = []

    def position(tick: int) -> FloatArray:
        requested = start.copy()
        requested[[6, 12]] += np.array([0.2, -0.2]) * (1.0 - np.cos(0.03 * tick))
        given.append(requested)
        return requested

    begun = robot.time.seconds()
    measured = run(backend, 250, position)
    commanded = recent(robot, robot.time.seconds() - begun + 0.5).position_command
    reached = {row.tobytes() for row in commanded}
    hits = [requested.tobytes() in reached for requested in given[20:]]
    assert np.mean(hits) > 0.5, "all, but on a busy machine; off its cycles it would be at none"
    errors = []
    for tick in range(30, 250):
        measurement = measured[tick]
        assert measurement.response_delay is not None
        if measurement.age == 0.0:
            errors.append(given[tick - 1 - measurement.response_delay] - measurement.position)
    # The simulated robot lags by less than a degree; two ticks of a wrong pairing would be more.
    assert np.abs(np.array(errors)[:, [6, 12]]).max() < np.radians(2.5)


def test_legs_go_back_to_where_almotion_left_them(robot: VirtualNaoqi, backend: NaoqiRobot) -> None:
    settings = SETTINGS.timing
    backend.open()
    start = held(backend.activate())
    bowed = start.copy()
    hip = ROBOT.joint_index("HipPitch")
    bowed[hip] -= 0.1
    run(backend, 120, lambda tick: start + (bowed - start) * min(1.0, tick / 100))
    assert recent(robot, 0.1).position_command[-1, hip] == pytest.approx(bowed[hip], abs=1e-6)
    begun = robot.time.seconds()
    backend.deactivate()
    box = recent(robot, robot.time.seconds() - begun + 0.2)
    assert box.position_command[-1, hip] == pytest.approx(start[hip], abs=0.01)
    steps = np.diff(box.position_command[:, hip]) / np.diff(box.cycle)
    assert np.abs(steps).max() <= settings.max_step
    on_way = np.ptp(box.cycle[np.abs(steps).nonzero()[0]]) * ROBOT.cycle
    assert on_way > 0.1 / (1.5 * settings.leg_return_speed)
    assert_let_go(box)


def test_wheels_turn_and_stand_again(robot: VirtualNaoqi, backend: NaoqiRobot) -> None:
    backend.open()
    start = held(backend.activate())
    begun = robot.time.seconds()
    run(backend, 60, lambda _: start, wheels=np.array([0.5, -0.5, 0.0]))
    box = robot.since(begun)
    assert np.abs(box.wheel_command).max() == pytest.approx(0.5)
    assert box.wheel_speed[:, 0].max() == pytest.approx(0.5, abs=0.1)
    assert robot.time.clock().wait_for(lambda: not robot.black_box(1).wheel_command.any(), 0.2), (
        "no command makes them go on"
    )


def test_a_stand_in_can_be_pushed(robot: VirtualNaoqi, backend: NaoqiRobot) -> None:
    with pytest.raises(NotConnectedError):
        backend.push("LForeArm", np.array([5.0, 0.0, 0.0]))
    backend.open()
    start = held(backend.activate())
    begun = robot.time.seconds()
    backend.push("LBicep", np.array([0.0, 20.0, 0.0]), np.array([0.16, 0.0, 0.0]), duration=0.6)
    run(backend, 60, lambda _: start)
    assert np.abs(robot.since(begun).position[:, 6] - start[6]).max() > np.radians(0.5)
    with pytest.raises(UnknownNameError, match="LForeArm"):
        backend.push("LForearm", np.array([0.0, 8.0, 0.0]))
    with pytest.raises(ValueError, match="duration"):
        backend.push("LForeArm", np.array([0.0, 8.0, 0.0]), duration=-1.0)
    with pytest.raises(ValueError, match="stiffness"):
        backend.grab("LForeArm", np.array([0.0, 0.01, 0.0]), stiffness=1.0)
    with pytest.raises(CapabilityError):
        _ = backend.truth


# -- what goes wrong ----------------------------------------------------------------------------------------------


def test_a_lost_connection_is_reported_and_nothing_goes_on_by_itself(
    robot: VirtualNaoqi, backend: NaoqiRobot
) -> None:
    backend.open()
    start = held(backend.activate())
    run(backend, 20, lambda _: start)
    robot.kill_naoqi()
    killed = robot.time.seconds()
    with pytest.raises(NotConnectedError, match=r"lost.*start again"):
        run(backend, 500, lambda _: start)
    assert robot.time.seconds() - killed <= 2 * ROBOT.cycle, (
        "the library notices at once that a program ended"
    )
    with pytest.raises(NotConnectedError):
        backend.diagnosis()
    begun = robot.time.seconds()
    backend.close()
    assert robot.time.seconds() == begun, "it waits for no answer"
    assert robot.black_box(1).stiffness[-1].all(), "the joints stay as they are"

    robot.start_naoqi()
    backend.open()
    measured = run(backend, 20, lambda _: start)
    assert measured[-1].response_delay is None, "open, and not active"
    backend.activate()
    assert run(backend, 500, lambda _: start, until=lambda m: m.age < 0.03)[-1].age < 0.03
    backend.close()


def test_a_robot_that_hangs_is_left_as_it_is(
    robot: VirtualNaoqi, backend: NaoqiRobot, caplog: pytest.LogCaptureFixture
) -> None:
    backend.open()
    start = held(backend.activate())
    run(backend, 30, lambda _: start, wheels=np.array([1.0, -1.0, 0.0]))
    robot.suspend_naoqi()
    hung = robot.time.seconds()
    turn = np.array([1.0, -1.0, 0.0])
    last = run(backend, 500, lambda _: start, turn, until=lambda m: m.age > 0.3)[-1]
    assert 0.3 < last.age < robot.time.seconds() - hung + 2 * ROBOT.cycle, "as old as it is"
    begun = robot.time.seconds()
    backend.close()
    assert robot.time.seconds() - begun < SETTINGS.end_silence + SETTINGS.call_time, (
        "it waits for no answer any more"
    )
    assert "left as it is" in caplog.text
    box = recent(robot, 0.2)
    assert not box.wheel_command.any()
    assert (box.stiffness[-1] == 1.0).all()
    robot.resume_naoqi()
    box = recent(robot, 0.08)
    assert not box.wheel_command[-1].any()
    assert np.abs(np.diff(box.position_command, axis=0)).max() <= 0.02


def test_leaving_the_block_lets_go_whatever_happened(robot: VirtualNaoqi) -> None:
    backend = robot.backend()
    with pytest.raises(KeyError), backend:  # noqa: PT012
        backend.open()
        backend.activate()
        begun = robot.time.seconds()
        raise KeyError("a user's mistake")
    assert_let_go(recent(robot, robot.time.seconds() - begun))


def test_a_robot_that_is_woken_up_goes_on_from_where_it_then_stands(
    robot: VirtualNaoqi,
) -> None:
    """Asleep its arms hang elsewhere: to go back there would be a jump."""
    robot.call("ALMotion", "rest")
    asleep = robot.black_box(1).position[-1]
    with robot.pepper(wake=True) as pepper:
        pepper.run(0.5)
        # Not `recent`: time that passes without a tick wakes the thread that ticks for a silent caller.
        box = robot.black_box(round(1.5 / ROBOT.cycle))
        moved = np.abs(pepper.target - asleep)
    assert moved.max() > 0.2, "it did move while it woke up"
    steps = np.diff(box.position_command, axis=0) / np.diff(box.cycle)[:, None]
    assert np.abs(steps).max() < 0.01
