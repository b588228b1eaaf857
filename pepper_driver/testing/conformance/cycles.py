"""One cycle: a command acts in the next one, holds without a new one, and wheels stop without commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from pepper_driver.backends import Backend, Command, CommandError, Measurement
from pepper_driver.backends.interface import DEAD_MAN_CYCLES
from pepper_driver.testing.conformance.driving import (
    ROBOT,
    BackendSuite,
    bits,
    command,
    cycles,
    hold,
    move,
    run,
    watch,
)

MAX_STOPPING_TIME = 0.5
"""[s of the robot] From the last command to wheels that stand: over a network they get theirs ahead of time."""

STILL = 0.05
"""[rad/s] Of a wheel that stands."""

HEAD = ROBOT.joint_index("HeadYaw")

Drive = Callable[[Backend, Command], Iterator[Measurement]]
"""Drives an active robot, from a command that holds it; yields what is measured."""


def trail(suite: BackendSuite, drive: Drive) -> list[list[object]]:
    """All that a new robot measures while it is driven, bit by bit."""
    with suite.make_backend() as backend:
        if backend.real_time:
            pytest.skip("nothing repeats to the last bit")
        samples = [backend.open()]
        samples.append(backend.activate())
        samples += drive(backend, hold(samples[-1]))
        backend.deactivate()
        samples.append(backend.read())
    return [bits(sample) for sample in samples]


def turned(held: Command, tick: int) -> Command:
    """Another command in each tick: the head turns, and so does the base."""
    position = held.position.copy()
    position[HEAD] += 0.01 * tick
    return command(position, stiffness=0.9, wheel_speed=np.full(3, 0.5 - 0.03 * tick))


def exchanging(backend: Backend, held: Command) -> Iterator[Measurement]:
    for tick in range(25):
        yield backend.exchange(turned(held, tick))


def writing_and_reading(backend: Backend, held: Command) -> Iterator[Measurement]:
    for tick in range(25):
        backend.write(turned(held, tick))
        yield backend.read()


class CycleTests(BackendSuite):
    """One cycle: a command acts in the next one, holds without a new one, and wheels stop without commands."""

    def test_the_same_commands_give_the_same_bits(self) -> None:
        assert trail(self, exchanging) == trail(self, exchanging)

    def test_to_exchange_is_to_write_and_to_read(self) -> None:
        assert trail(self, exchanging) == trail(self, writing_and_reading)

    def test_the_last_command_before_a_read_counts(self) -> None:
        def overwriting(backend: Backend, held: Command) -> Iterator[Measurement]:
            for tick in range(25):
                for other in (tick + 5, tick - 5, tick):
                    backend.write(turned(held, other))
                yield backend.read()

        assert trail(self, overwriting) == trail(self, writing_and_reading)

    def test_a_wrong_command_leaves_the_old_one_in_force(self) -> None:
        def going_on(backend: Backend, held: Command) -> Iterator[Measurement]:
            backend.write(turned(held, 9))
            for _ in range(18):
                yield backend.read()

        def with_mistakes(backend: Backend, held: Command) -> Iterator[Measurement]:
            backend.write(turned(held, 9))
            for part in 6 * ("position", "stiffness", "wheel_speed"):
                wrong = turned(held, 3)
                getattr(wrong, part)[1] = np.nan
                with pytest.raises(CommandError, match=part):
                    backend.write(wrong)
                yield backend.read()

        assert trail(self, with_mistakes) == trail(self, going_on)

    def test_a_command_that_is_changed_afterwards_is_as_it_was_written(self) -> None:
        def filling_again(backend: Backend, held: Command) -> Iterator[Measurement]:
            filled = hold(backend.read())
            for tick in range(25):
                new = turned(held, tick)
                for part in ("position", "stiffness", "wheel_speed"):
                    getattr(filled, part)[:] = getattr(new, part)
                backend.write(filled)
                for part in ("position", "stiffness", "wheel_speed"):
                    getattr(filled, part)[:] = np.nan
                yield backend.read()

        def plainly(backend: Backend, held: Command) -> Iterator[Measurement]:
            backend.read()
            yield from writing_and_reading(backend, held)

        assert trail(self, filling_again) == trail(self, plainly)

    def test_requests_change_nothing_in_a_simulation(self) -> None:
        def requesting(backend: Backend, held: Command) -> Iterator[Measurement]:
            assert backend.request_lead == 0.0
            for tick in range(25):
                for _ in range(tick % 3):
                    backend.request()
                backend.write(turned(held, tick))
                yield backend.read()

        assert trail(self, requesting) == trail(self, writing_and_reading)

    def test_joints_stay_at_the_last_command(self, backend: Backend) -> None:
        """After any time without commands, and as soon as the command is there."""
        if not self.follows:
            pytest.skip("it moves as it did then")
        backend.open()
        start = hold(backend.activate()).position
        goal = start.copy()
        goal[HEAD] += 0.3
        move(backend, start, goal, 0.6)
        for sample in watch(backend, 0.8):
            assert sample.position[HEAD] == pytest.approx(goal[HEAD], abs=0.06)
        goal[HEAD] -= 0.1
        backend.write(command(goal))
        last = watch(backend, 0.5)[-1]
        assert last.position[HEAD] == pytest.approx(goal[HEAD], abs=0.06), "written once, read on"
        assert np.abs(last.position - goal).max() < 0.08

    def test_wheels_stand_without_commands_and_go_on_with_them(self, backend: Backend) -> None:
        if not self.drives:
            pytest.skip("its wheels take no commands")
        backend.open()
        start = hold(backend.activate()).position
        rolling = command(start, wheel_speed=np.array([1.0, -1.0, 0.0]))
        for _ in range(2):
            rolled = run(backend, rolling, 0.6)[-5:]
            assert max(np.abs(sample.wheel_speed).max() for sample in rolled) > 0.5
            begin = backend.read().time
            samples = watch(backend, MAX_STOPPING_TIME + 0.3)
            if not backend.real_time:  # a thread that is late has its robot's wheels stopped before
                for sample in samples[: DEAD_MAN_CYCLES - 2]:
                    assert np.abs(sample.wheel_speed).max() > 0.5
            late = [m for m in samples if m.time - begin > MAX_STOPPING_TIME]
            assert late
            for sample in late:
                np.testing.assert_allclose(sample.wheel_speed, 0.0, atol=STILL)
                assert np.abs(sample.position - start).max() < 0.08, "joints are held all the same"

    def test_what_was_written_before_activation_moves_nothing_then_or_later(
        self, backend: Backend
    ) -> None:
        if not self.follows:
            pytest.skip("it moves as it did then")
        first = backend.open()
        displaced = hold(first)
        displaced.position[HEAD] += 0.5
        displaced.wheel_speed[:] = 2.0
        for active in (False, True, False):
            if active:
                backend.write(displaced)
                first = backend.activate()
            else:
                backend.deactivate()
                backend.write(displaced)
            for sample in watch(backend, 0.4):
                assert abs(sample.position[HEAD] - first.position[HEAD]) < 0.03
                np.testing.assert_allclose(sample.wheel_speed, 0.0, atol=STILL)

    def test_what_the_pacer_asks_may_be_asked_in_any_state(self, backend: Backend) -> None:
        def ask() -> None:
            for _ in range(3):
                backend.request()
            cycle = backend.info.cycle
            assert 0.0 <= backend.request_lead < cycle
            assert abs(backend.phase_error(backend.clock.now())) <= 0.5 * cycle + 1e-9

        ask()
        first = backend.open()
        ask()
        (later,) = cycles(backend, None, 1)
        assert later.tick >= first.tick
        backend.activate()
        ask()
        backend.deactivate()
        ask()
        backend.close()
        ask()
        assert backend.open().tick == first.tick

    def test_samples_that_are_requested_come(self, backend: Backend) -> None:
        """As the pacer does it: requested before each tick, or left out now and then."""
        before = backend.open()
        cycle, lead = backend.info.cycle, backend.request_lead
        for tick in range(60):
            if backend.real_time:
                backend.clock.sleep(cycle - lead)
            if tick % 7:
                backend.request()
            if backend.real_time:
                backend.clock.sleep(lead)
            sample = backend.read()
            assert sample.tick >= before.tick
            before = sample
        assert sample.tick >= 40 + (0 if backend.real_time else 20)
