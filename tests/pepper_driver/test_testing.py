"""Tools for authors of plug-ins: they work, and the conformance suite finds a backend that does not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver import Hold, Observation, Observer, Pepper
from pepper_driver.backends import (
    Backend,
    BackendInfo,
    Command,
    Measurement,
    make_backend,
)
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import load_robot
from pepper_driver.config.plugins import PluginInterfaceError
from pepper_driver.controller import Tick
from pepper_driver.testing import (
    ReflexBench,
    displaced,
    make_contact,
    observe,
    pressed,
    recorded_ticks,
    standing_ticks,
)
from pepper_driver.testing.conformance import BackendConformance

ROBOT = load_robot()


class Counting(Observer):
    """Counts ticks, and shows the tracking error."""

    def __init__(self, size: int = 17) -> None:
        self.size, self.ticks = size, 0

    def step(self, tick: Tick) -> Observation:
        self.ticks += 1
        nan = np.full(self.size, np.nan)
        return Observation(
            contacts=(),
            expected=nan,
            residual=tick.sent.position - tick.measurement.position,
            threshold=nan,
            torque=nan,
            torque_std=nan,
            state=np.zeros(17, dtype=np.int8),
        )

    def reset(self) -> None:
        self.ticks = 0

    def describe(self) -> str:
        return "counting"


# -- ticks ------------------------------------------------------------------------------------------------------------


def test_a_standing_robot_errs_only_where_it_is_displaced() -> None:
    ticks = standing_ticks(20, dict.fromkeys(range(5, 8), displaced("LElbowRoll", 0.1)))
    errors = np.array([o.residual for o in observe(Counting(), ticks)])
    assert [tick.measurement.tick for tick in ticks] == list(range(1, 21))
    expected = np.zeros((20, 17))
    expected[4:7, ROBOT.joint_index("LElbowRoll")] = -0.1  # ticks 5 to 7
    np.testing.assert_allclose(errors, expected, atol=1e-12)


def test_recorded_ticks_are_those_that_the_observer_saw(tmp_path: Path) -> None:
    path, seen = tmp_path / "a.mcap", list[Tick]()
    with Pepper("mock://?delay=2", observer=None, log=path) as pepper:
        pepper.set_posture({"HeadYaw": 0.5})
        pepper.run(0.6, on_tick=lambda tick, _: seen.append(tick))
    ticks = recorded_ticks(path)
    assert len(ticks) == len(seen) == 50
    for one, other in zip(ticks, seen, strict=True):
        np.testing.assert_array_equal(one.measurement.position, other.measurement.position)
        np.testing.assert_array_equal(one.sent.position, other.sent.position)
        np.testing.assert_array_equal(one.reference.velocity, other.reference.velocity)
    observer = Counting()
    observe(observer, ticks)
    observe(observer, ticks)
    assert observer.ticks == 50, "reset in between"


def test_observing_checks_each_observation() -> None:
    with pytest.raises(PluginInterfaceError, match=r"Counting\.step.*expected: .*\(17,\).*\(16,\)"):
        observe(Counting(16), standing_ticks(3))


def test_sensors_are_pressed_by_number() -> None:
    (tick,) = standing_ticks(1, {1: pressed("touch", 0, 2)})
    np.testing.assert_array_equal(tick.measurement.touch, [1, 0, 1, 0, 0])
    (tick,) = standing_ticks(1, {1: pressed("bumpers")})
    np.testing.assert_array_equal(tick.measurement.bumpers, [1, 0, 0])


def test_a_reflex_acts_on_the_bench() -> None:
    bench = ReflexBench(Hold())
    turned = bench.controller.position
    turned[ROBOT.joint_index("HeadYaw")] += 0.4
    bench.arbiter.move_to(turned, duration=2.0)
    bench.run(0.6)
    bench.step(make_contact())
    held = bench.run(1.0)[-1]
    np.testing.assert_allclose(bench.run(0.3)[-1], held, atol=1e-4)
    bench.step(make_contact(phase="end"))
    assert np.abs(bench.run(2.0)[-1] - held).max() > 0.05
    assert [event.phase for event in bench.events] == ["begin", "end"]


# -- the suite finds what is wrong ------------------------------------------------------------------------------------


class Suite(BackendConformance):
    """The suite on a backend that a test names; pytest does not collect it."""

    def __init__(self, make: Callable[[], Backend]) -> None:
        self.make_backend = make  # type: ignore[method-assign]


class Crossed(MockBackend):
    """Left and right shoulder are exchanged."""

    def write(self, command: Command) -> None:
        if np.shape(command.position) == (17,):
            position = np.array(command.position, dtype=float)
            left, right = (ROBOT.joint_index(f"{side}ElbowYaw") for side in "LR")
            position[[left, right]] = position[[right, left]]
            command = replace(command, position=position)
        super().write(command)


class Reusing(MockBackend):
    """Fills the same array for each sample."""

    _array = np.zeros(17)

    def read(self) -> Measurement:
        sample = super().read()
        self._array[:] = sample.position
        return replace(sample, position=self._array)


class Careless(MockBackend):
    """Checks no command."""

    def write(self, command: Command) -> None:
        super().write(replace(command, position=np.nan_to_num(command.position)))


class Hasty(MockBackend):
    """Two cycles pass in each read."""

    def read(self) -> Measurement:
        super().read()
        return super().read()


class Eager(MockBackend):
    """Moves before it is active."""

    def write(self, command: Command) -> None:
        super().write(command)
        self.position = np.clip(command.position, ROBOT.lower, ROBOT.upper)


class Boasting(MockBackend):
    """Says that it can be pushed."""

    @property
    def info(self) -> BackendInfo:
        return replace(super().info, capabilities=frozenset({"push", "truth"}))


class Forgetting(MockBackend):
    """Is open as soon as it is made."""

    def read(self) -> Measurement:
        if self._state == "closed":
            self.open()
        return super().read()


FOUND: list[tuple[type[MockBackend], str]] = [
    (Crossed, "test_each_joint_follows_its_command"),
    (Reusing, "test_a_measurement_is_never_changed_afterwards"),
    (Careless, "test_a_command_that_is_not_finite_is_refused"),
    (Careless, "test_what_is_no_command_is_refused_and_nothing_happens"),
    (Hasty, "test_each_read_is_a_cycle_or_returns_at_once"),
    (Hasty, "test_any_sequence_of_calls"),
    (Eager, "test_what_was_written_before_activation_moves_nothing_then_or_later"),
    (Boasting, "test_what_is_pushed_is_known"),
    (Boasting, "test_the_truth_is_there_where_it_says_so"),
    (Forgetting, "test_a_closed_robot_is_not_there"),
    (Forgetting, "test_any_sequence_of_calls"),
]


def judge(kind: type[MockBackend], name: str) -> None:
    """Run one test of the suite as pytest does."""
    suite = Suite(lambda: kind(ROBOT))
    test = getattr(suite, name)
    code = test.__func__.__code__
    arguments = code.co_varnames[1 : code.co_argcount]
    backend = kind(ROBOT)
    values: dict[str, Any] = {"backend": backend}
    if "course" in arguments:
        values["course"] = Suite.course.__wrapped__(suite)  # type: ignore[attr-defined]
    test(**{argument: values[argument] for argument in arguments})


@pytest.mark.parametrize(("kind", "name"), FOUND, ids=lambda part: getattr(part, "__name__", part))
def test_the_suite_finds_what_is_wrong(kind: type[MockBackend], name: str) -> None:
    judge(MockBackend, name)
    with pytest.raises((Exception, pytest.fail.Exception)):
        judge(kind, name)


def test_the_suite_finds_wheels_that_turn_on_a_fixed_base() -> None:
    suite = Suite(lambda: MockBackend(ROBOT))
    suite.drives = False
    with pytest.raises(AssertionError):
        suite.test_wheels_of_a_fixed_base_stand(MockBackend(ROBOT))


@pytest.mark.usefixtures("example_plugins")
def test_the_suite_finds_a_wrong_truth() -> None:
    from pinocchio_backend import PinocchioBackend  # its package is there by now

    class Twofold(PinocchioBackend):
        def _touch(self, time: float) -> Any:
            torque = super()._touch(time)
            self.contact_torque *= 1.05
            return torque

    suite = Suite(lambda: make_backend("pinocchio"))
    suite.test_the_truth_of_a_push_is_the_torque_of_its_force(make_backend("pinocchio"))
    wrong = Twofold(ROBOT, seed=0, posture="Stand", uri="pinocchio")
    with pytest.raises(AssertionError):
        suite.test_the_truth_of_a_push_is_the_torque_of_its_force(wrong)
