"""Closed, open, active: what may be called when, and what it leaves behind."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from pepper_driver.backends import Backend, BackendError, Capability, Command, NotConnectedError
from pepper_driver.config import PepperError
from pepper_driver.testing.conformance.driving import ROBOT, BackendSuite, hold, run

STILL = np.radians(2.0)


def hold_zero() -> Command:
    return Command(position=np.zeros(17), stiffness=np.zeros(17), wheel_speed=np.zeros(3))


class StateTests(BackendSuite):
    """Closed, open, active: what may be called when, and what it leaves behind."""

    def test_info_is_known_before_open_and_stays(self, backend: Backend) -> None:
        uri, real_time = backend.uri, backend.real_time
        assert uri
        before = backend.info
        assert before.joint_names == ROBOT.joint_names
        assert before.cycle == pytest.approx(ROBOT.cycle)
        assert before.response_delay >= 0
        assert before.capabilities <= set(get_args(Capability))
        backend.open()
        after = backend.info
        assert after.identity
        assert (after.joint_names, after.cycle) == (before.joint_names, before.cycle)
        assert (backend.uri, backend.real_time) == (uri, real_time)
        assert after.capabilities >= before.capabilities

    def test_a_closed_robot_is_not_there(self, backend: Backend) -> None:
        def check() -> None:
            nowhere = hold_zero()
            with pytest.raises(NotConnectedError):
                backend.read()
            with pytest.raises(NotConnectedError):
                backend.write(nowhere)
            with pytest.raises(NotConnectedError):
                backend.activate()
            backend.deactivate()
            backend.close()

        check()
        backend.open()
        backend.close()
        check()

    def test_it_is_opened_once(self, backend: Backend) -> None:
        first = backend.open()
        with pytest.raises(BackendError):
            backend.open()
        assert backend.read().tick >= first.tick, "and is open all the same"

    def test_it_is_activated_once(self, backend: Backend) -> None:
        backend.open()
        measurement = backend.activate()
        with pytest.raises(BackendError):
            backend.activate()
        with pytest.raises(BackendError):
            backend.open()
        if self.follows:
            later = run(backend, hold(measurement), 0.3)[-1]
            assert np.abs(later.position - measurement.position).max() < STILL, (
                "and holds its posture"
            )

    def test_activation_holds_the_measured_posture(self, backend: Backend) -> None:
        before = backend.open()
        after = backend.activate()
        assert np.abs(after.position - before.position).max() < STILL
        assert after.tick >= before.tick

    def test_nothing_moves_before_activation_nor_after_deactivation(self, backend: Backend) -> None:
        if not self.follows:
            pytest.skip("it moves as it did then")
        first = backend.open()
        joints = [ROBOT.joint_index(name) for name in ("HeadYaw", "KneePitch")]
        for after in (False, True):
            if after:
                backend.activate()
                backend.deactivate()
                backend.deactivate()
                first = run(backend, hold(first), 0.1)[-1]
            held = hold(first)
            held.position[joints] += 0.1
            held.wheel_speed[:] = 2.0
            last = run(backend, held, 0.4)[-1]
            assert np.abs(last.position - first.position)[joints].max() < 0.03
            np.testing.assert_allclose(last.wheel_speed, 0.0, atol=0.05)

    def test_deactivation_stops_the_wheels(self, backend: Backend) -> None:
        if not self.drives:
            pytest.skip("its wheels take no commands")
        backend.open()
        rolling = hold(backend.activate())
        rolling.wheel_speed[:] = [1.0, -1.0, 0.0]
        assert np.abs([m.wheel_speed for m in run(backend, rolling, 0.5)]).max() > 0.5
        backend.deactivate()
        rolling.wheel_speed[:] = 0.0
        assert np.abs(run(backend, rolling, 0.2)[-1].wheel_speed).max() < 0.05

    def test_it_closes_from_any_state_and_can_be_opened_again(self, backend: Backend) -> None:
        backend.close()
        for active in (False, True):
            first = backend.open()
            if self.starts_at_zero:
                assert (first.tick, first.time) == (0, 0.0)
            if active:
                backend.activate()
            backend.close()
            backend.close()
        again = backend.open()
        assert again.tick == first.tick
        assert again.time == first.time
        assert backend.exchange(hold(again)).tick >= again.tick

    @pytest.mark.parametrize("active", [False, True])
    def test_leaving_the_block_closes_whatever_happened(
        self, backend: Backend, active: bool
    ) -> None:
        def fail() -> None:
            with backend as entered:
                assert entered is backend
                backend.open()
                if active:
                    backend.activate()
                raise KeyError("a user's mistake")

        with pytest.raises(KeyError, match="a user's mistake"):
            fail()
        with pytest.raises(NotConnectedError):
            backend.read()
        backend.open()

    def test_every_refusal_is_one_line(self, backend: Backend) -> None:
        messages = []
        for call in (backend.activate, backend.read, lambda: backend.write(hold_zero())):
            with pytest.raises(PepperError) as caught:
                call()
            messages.append(str(caught.value))
        backend.open()
        with pytest.raises(PepperError) as caught:
            backend.open()
        messages.append(str(caught.value))
        for text in messages:
            assert text.strip()
            assert "\n" not in text
