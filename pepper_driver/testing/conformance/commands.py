"""Commands: refusals, limits, and the joint or wheel that executes them."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends import Backend, Command, CommandError
from pepper_driver.testing.conformance.driving import ROBOT, BackendSuite, command, hold, move, run

SMALL = 0.12
"""[rad] A motion that no joint can miss: beyond backlash and what gravity bends."""

PARTS = ("position", "stiffness", "wheel_speed")
NONSENSE: tuple[Any, ...] = (
    None,
    "forward",
    0.0,
    [],
    {},
    object(),
    np.zeros((17, 1)),
    np.zeros(16),
    np.zeros(18),
    np.full(17, np.nan),
    [[0.0] * 3, [0.0] * 2],
    np.full(17, "a"),
    1j * np.ones(17),
)


class CommandTests(BackendSuite):
    """Commands: refusals, limits, and the joint or wheel that executes them."""

    def test_a_command_that_is_not_finite_is_refused(self, backend: Backend) -> None:
        opened = backend.open()
        for part, value, place in product(PARTS, (np.nan, np.inf, -np.inf), range(3)):
            held = hold(opened)
            getattr(held, part)[place] = value
            with pytest.raises(CommandError, match=part):
                backend.write(held)

    def test_what_is_no_command_is_refused_and_nothing_happens(self, backend: Backend) -> None:
        opened = backend.open()
        before = backend.exchange(hold(opened))
        for part, nonsense in product(PARTS, NONSENSE):
            parts: dict[str, Any] = {name: getattr(hold(opened), name) for name in PARTS}
            with pytest.raises(CommandError, match=part):
                backend.write(Command(**{**parts, part: nonsense}))
        after = backend.exchange(hold(opened))
        assert after.tick >= before.tick
        if not backend.real_time:
            assert after.tick == before.tick + 1, "no cycle passed"

    def test_no_joint_goes_beyond_its_limits(self, backend: Backend) -> None:
        """A joint moves as far as it can; and wheels no faster than they can."""
        if not self.follows:
            pytest.skip("it moves as it did then")
        backend.open()
        start = hold(backend.activate()).position
        names = ("HeadYaw", "LElbowYaw", "RElbowYaw", "LWristYaw", "LHand", "RHand")
        joints = [ROBOT.joint_index(name) for name in names]
        goal = start.copy()
        goal[joints] = ROBOT.upper[joints]
        move(backend, start, goal, 1.8)
        goal[joints] += 0.5
        samples = run(backend, command(goal, stiffness=7.0), 0.5)
        for measurement in samples:
            assert (measurement.position <= ROBOT.upper + 0.02).all()
            assert (measurement.position >= ROBOT.lower - 0.02).all()
        reached = samples[-1].position[joints]
        np.testing.assert_allclose(reached, ROBOT.upper[joints], atol=0.08)
        samples = run(backend, command(goal, wheel_speed=np.array([0.0, 0.0, 1e6])), 0.3)
        fastest = np.abs([m.wheel_speed for m in samples]).max()
        assert fastest < 1.2 * ROBOT.wheels.speed_limit
        assert fastest > 1.0 or not self.drives

    def test_each_joint_follows_its_command(self, backend: Backend) -> None:
        """Joints that move together in five motions, each joint in others than any other: none can be mistaken."""
        if not self.follows:
            pytest.skip("it moves as it did then")
        backend.open()
        start = hold(backend.activate()).position
        inward = np.where(start < 0.5 * (ROBOT.lower + ROBOT.upper), 1.0, -1.0) * SMALL
        numbers = np.arange(1, 18)
        here, code = start, np.zeros(17, dtype=np.int64)
        measured = run(backend, command(start), 0.1)[-1].position
        for bit in range(5):
            moving = (numbers >> bit & 1).astype(bool)
            goal = np.where(moving, start + inward, start)
            after = move(backend, here, goal, 0.5).position
            code |= (np.abs(after - measured) > 0.5 * SMALL).astype(np.int64) << bit
            here = goal
            np.testing.assert_allclose(after, goal, atol=0.08)
        np.testing.assert_array_equal(code, numbers)

    def test_wheels_of_a_fixed_base_stand(self, backend: Backend) -> None:
        """For any command, and so does the base where the truth is known."""
        if self.drives or not self.follows:
            pytest.skip("its wheels turn")
        backend.open()
        start = hold(backend.activate()).position
        for measurement in run(backend, command(start, wheel_speed=np.full(3, 2.0)), 0.5):
            np.testing.assert_allclose(measurement.wheel_speed, 0.0, atol=0.05)
        if "truth" in backend.info.capabilities:
            np.testing.assert_allclose(backend.truth.base, 0.0, atol=1e-3)

    def test_each_wheel_follows_its_command(self, backend: Backend) -> None:
        if not self.drives:
            pytest.skip("its wheels take no commands")
        backend.open()
        start = hold(backend.activate()).position
        for held in ([0.8, 0.0, 0.0], [0.0, -0.8, 0.0], [0.0, 0.0, 0.8]):
            speed = np.array(held)
            samples = run(backend, command(start, wheel_speed=speed), 0.5)
            # The best of them: on a busy machine a robot's own dead-man's stop may cut in.
            errors = [np.abs(m.wheel_speed - speed).max() for m in samples]
            assert min(errors) < 0.2
