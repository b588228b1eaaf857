"""Any sequence of calls: the states are those of the interface, and time increases."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from pepper_driver.backends import (
    Backend,
    BackendError,
    Command,
    CommandError,
    Measurement,
    NotConnectedError,
)
from pepper_driver.testing.conformance.driving import ROBOT, BackendSuite, hold

LENGTH = 12
"""Calls in a sequence."""

NOTHING = Command(position=np.zeros(17), stiffness=np.zeros(17), wheel_speed=np.zeros(3))


class SequenceTests(BackendSuite):
    """Any sequence of calls."""

    def test_any_sequence_of_calls(self) -> None:
        for seed in range(self.sequences):
            random, calls = np.random.default_rng(seed), list[str]()
            caller = _Caller(self.make_backend(), self.starts_at_zero, random)
            try:
                for _ in range(LENGTH):
                    calls.append(str(random.choice(CALLS)))
                    getattr(caller, calls[-1])()
                    assert caller.backend.info.joint_names == ROBOT.joint_names
            except Exception as error:
                error.add_note(f"sequence {seed}: {', '.join(calls)}")
                raise
            finally:
                caller.backend.close()


class _Caller:
    """A backend and the model of its states."""

    def __init__(self, backend: Backend, starts_at_zero: bool, random: np.random.Generator) -> None:
        self.backend, self._starts_at_zero, self._random = backend, starts_at_zero, random
        self._state: Literal["closed", "open", "active"] = "closed"
        self._last: Measurement | None = None

    def open(self) -> None:
        if self._state != "closed":
            with pytest.raises(BackendError):
                self.backend.open()
            return
        self._last = self.backend.open()
        self._state = "open"
        assert self._last.tick == 0 or not self._starts_at_zero

    def activate(self) -> None:
        if self._state == "closed":
            with pytest.raises(NotConnectedError):
                self.backend.activate()
        elif self._state == "active":
            with pytest.raises(BackendError):
                self.backend.activate()
        else:
            self._see(self.backend.activate())
            self._state = "active"

    def read(self) -> None:
        for _ in range(int(self._random.integers(1, 7))):
            if self._last is None:
                with pytest.raises(NotConnectedError):
                    self.backend.read()
                return
            before = self._last.tick
            self._see(self.backend.read())
            assert self._last.tick == before + 1 or self.backend.real_time

    def write(self) -> None:
        if self._last is None:
            with pytest.raises(NotConnectedError):
                self.backend.write(NOTHING)
            return
        held = hold(self._last)
        held.wheel_speed[:] = self._random.uniform(-1.0, 1.0)
        self.backend.write(held)

    def request(self) -> None:
        self.backend.request()
        assert 0.0 <= self.backend.request_lead < self.backend.info.cycle

    def write_wrongly(self) -> None:
        if self._last is None:
            return
        held = hold(self._last)
        part = self._random.choice(["position", "stiffness", "wheel_speed"])
        getattr(held, str(part))[1] = np.nan
        with pytest.raises(CommandError):
            self.backend.write(held)

    def deactivate(self) -> None:
        self.backend.deactivate()
        if self._state == "active":
            self._state = "open"
            if self._last is not None and not self.backend.real_time:
                # Cycles of the ramp pass without a sample.
                self._see(self.backend.read())

    def close(self) -> None:
        self.backend.close()
        self._state, self._last = "closed", None

    def leave_the_block(self) -> None:
        with pytest.raises(KeyError), self.backend:
            raise KeyError("a user's mistake")
        self._state, self._last = "closed", None

    def _see(self, measurement: Measurement) -> None:
        assert self._last is not None
        assert measurement.tick >= self._last.tick
        assert measurement.time >= self._last.time
        assert np.isfinite(measurement.position).all()
        self._last = measurement


CALLS = tuple(name for name in vars(_Caller) if not name.startswith("_"))
