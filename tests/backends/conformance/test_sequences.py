"""Any sequence of calls: the states are those of the interface, and time goes on."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from conformance.cases import ROBOT, Case, hold
from pepper_driver.backends import (
    BackendError,
    Command,
    CommandError,
    Measurement,
    NotConnectedError,
)

LENGTH = 12
NOTHING = Command(position=np.zeros(17), stiffness=np.zeros(17), wheel_speed=np.zeros(3))


class Calls(RuleBasedStateMachine):
    """A backend beside what the interface says of it."""

    case: Case

    def __init__(self) -> None:
        super().__init__()
        self.backend = self.case.make()
        self.state: Literal["closed", "open", "active"] = "closed"
        self.last: Measurement | None = None

    @rule()
    def open(self) -> None:
        if self.state != "closed":
            with pytest.raises(BackendError):
                self.backend.open()
            return
        self.last = self.backend.open()
        self.state = "open"
        assert self.last.tick == 0 or not self.case.starts_at_zero

    @rule()
    def activate(self) -> None:
        if self.state == "closed":
            with pytest.raises(NotConnectedError):
                self.backend.activate()
        elif self.state == "active":
            with pytest.raises(BackendError):
                self.backend.activate()
        else:
            self._see(self.backend.activate())
            self.state = "active"

    @rule(count=st.integers(1, 6))
    def read(self, count: int) -> None:
        for _ in range(count):
            if self.last is None:
                with pytest.raises(NotConnectedError):
                    self.backend.read()
                return
            before = self.last.tick
            self._see(self.backend.read())
            assert self.last.tick == before + 1 or self.backend.real_time

    @rule(speed=st.floats(-1, 1))
    def write(self, speed: float) -> None:
        if self.last is None:
            with pytest.raises(NotConnectedError):
                self.backend.write(NOTHING)
            return
        wanted = hold(self.last)
        wanted.wheel_speed[:] = speed
        self.backend.write(wanted)

    @rule()
    def request(self) -> None:
        self.backend.request()
        assert 0.0 <= self.backend.request_lead < self.backend.info.cycle

    @precondition(lambda self: self.last is not None)
    @rule(part=st.sampled_from(["position", "stiffness", "wheel_speed"]))
    def write_wrongly(self, part: str) -> None:
        assert self.last is not None
        wanted = hold(self.last)
        getattr(wanted, part)[1] = np.nan
        with pytest.raises(CommandError):
            self.backend.write(wanted)

    @rule()
    def deactivate(self) -> None:
        self.backend.deactivate()
        if self.state == "active":
            self.state = "open"
            if self.last is not None and not self.backend.real_time:
                # Cycles of the ramp pass without a sample.
                self._see(self.backend.read())

    @rule()
    def close(self) -> None:
        self.backend.close()
        self.state, self.last = "closed", None

    @rule()
    def leave_the_block(self) -> None:
        with pytest.raises(KeyError), self.backend:
            raise KeyError("a user's mistake")
        self.state, self.last = "closed", None

    @invariant()
    def info_is_valid(self) -> None:
        assert self.backend.info.joint_names == ROBOT.joint_names

    def teardown(self) -> None:
        self.backend.close()

    def _see(self, measurement: Measurement) -> None:
        assert self.last is not None
        assert measurement.tick >= self.last.tick
        assert measurement.time >= self.last.time
        assert np.isfinite(measurement.position).all()
        self.last = measurement


def test_any_sequence_of_calls(case: Case) -> None:
    machine = type("Calls", (Calls,), {"case": case})
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=case.examples,
            stateful_step_count=LENGTH,
            suppress_health_check=list(HealthCheck),
        ),
    )
