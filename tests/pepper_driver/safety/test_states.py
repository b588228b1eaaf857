"""INACTIVE, ACTIVE, FAULT: the table of transitions, kept whatever happens in whatever order."""

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from pepper_driver.backends import Measurement
from pepper_driver.safety import (
    TRANSITIONS,
    Fault,
    FaultError,
    FaultReason,
    RobotState,
    StateError,
)
from pepper_driver.safety.states import StateMachine
from pepper_driver.testing import aged, displaced, drained, heated, pressed, standing_measurement
from support.examples import examples
from support.fakes import reference
from support.safety import STAND, new_gate

FINE = standing_measurement()

HARM = {
    FaultReason.STALE_SAMPLE: aged(0.15),
    FaultReason.SENSOR: displaced("HeadYaw", np.nan),
    FaultReason.CHEST_BUTTON: pressed("buttons"),
    FaultReason.FOLLOWING_ERROR: displaced("HeadYaw", 2.0),
    FaultReason.TEMPERATURE: heated("HeadYaw", 90.0),
    FaultReason.BATTERY: drained(0.01),
}
LONG_ENOUGH = 200
"""Ticks, after which a lasting harm must have been seen."""


def test_the_table() -> None:
    assert set(TRANSITIONS) == set(RobotState)
    assert TRANSITIONS[RobotState.FAULT] == frozenset()
    for before, after in TRANSITIONS.items():
        assert before not in after


@pytest.mark.parametrize("before", RobotState)
@pytest.mark.parametrize("after", RobotState)
def test_a_transition_that_is_not_in_the_table_changes_nothing(
    before: RobotState, after: RobotState
) -> None:
    machine = StateMachine()
    machine.state = before
    if after in TRANSITIONS[before]:
        machine._go(after)
        assert machine.state is after
    else:
        with pytest.raises(StateError, match=f"from {before.value} to {after.value}") as caught:
            machine._go(after)
        assert machine.state is before
        assert (caught.value.before, caught.value.after) == (before, after)
        possible = [state.value for state in TRANSITIONS[before]] or ["none"]
        assert str(caught.value).endswith(f"(possible: {', '.join(sorted(possible))})")


def test_the_error_of_a_fault_says_why() -> None:
    error = FaultError(Fault(reason=FaultReason.BATTERY, text="the battery is at 3%"))
    assert str(error) == "the robot was stopped: the battery is at 3%"


class Noted(StateMachine):
    """Calls ``before`` with each new state, just before it is set."""

    before: Callable[[RobotState], object] | None = None

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "state" and self.before is not None:
            self.before(value)
        super().__setattr__(name, value)


def test_the_reason_of_a_fault_is_there_before_the_state() -> None:
    """So that each thread that sees FAULT finds it."""
    machine, fault = Noted(), Fault(reason=FaultReason.EMERGENCY_STOP, text="stop")
    found: list[tuple[RobotState, Fault | None]] = []
    machine.before = lambda state: found.append((state, machine.fault))
    machine.fail(fault)
    assert found == [(RobotState.FAULT, fault)]


def test_a_fault_is_not_overwritten_by_a_transition_that_began_before_it() -> None:
    """Another thread cannot fail while one is between the check and the new state: it waits for its lock."""
    machine, free = Noted(), list[bool]()

    def try_lock() -> None:
        free.append(machine._lock.acquire(blocking=False))
        if free[-1]:
            machine._lock.release()

    def look_from_another_thread(_: RobotState) -> None:
        thread = threading.Thread(target=try_lock)
        thread.start()
        thread.join()

    machine.before = look_from_another_thread
    machine.activate()
    machine.deactivate()
    machine.fail(Fault(reason=FaultReason.EMERGENCY_STOP, text="stop"))
    assert free == [False, False, False]
    assert machine.state is RobotState.FAULT


class GateLife(RuleBasedStateMachine):
    """Everything that can happen to a gate, in any order, compared with a model of three states."""

    def __init__(self) -> None:
        super().__init__()
        self.gate = new_gate()
        self.state = RobotState.INACTIVE
        self.reason: FaultReason | None = None

    @rule()
    def activate(self) -> None:
        try:
            self.gate.activate(STAND)
        except FaultError as error:
            assert self.state is RobotState.FAULT
            assert error.fault.reason is self.reason
        except StateError:
            assert self.state is RobotState.ACTIVE
        else:
            assert self.state is RobotState.INACTIVE
            self.state = RobotState.ACTIVE

    @rule()
    def deactivate(self) -> None:
        self.gate.deactivate()
        if self.state is RobotState.ACTIVE:
            self.state = RobotState.INACTIVE

    def fail(self, reason: FaultReason) -> None:
        if self.state is not RobotState.FAULT:
            self.state, self.reason = RobotState.FAULT, reason

    @rule(reason=st.sampled_from(FaultReason))
    def stop(self, reason: FaultReason) -> None:
        self.gate.stop(reason, "for a test")
        self.fail(reason)

    @rule()
    def see_a_robot_that_is_fine(self) -> None:
        self.gate.watch(self.here(), self.gate.sent)

    @rule(reason=st.sampled_from(sorted(HARM, key=lambda r: r.value)))
    @precondition(lambda self: self.state is RobotState.ACTIVE)
    def see_lasting_harm(self, reason: FaultReason) -> None:
        for _ in range(LONG_ENOUGH):
            self.gate.watch(HARM[reason](self.here()), self.gate.sent)
        self.fail(reason)

    @rule(move=st.floats(-1, 1), age=st.sampled_from([0.0, 0.09, np.nan]))
    def command(self, move: float, age: float) -> None:
        before = self.gate.sent
        sent = self.gate.gate(reference(STAND + move), np.ones(17), np.ones(3), age).command
        if self.state is not RobotState.ACTIVE:
            np.testing.assert_array_equal(sent.position, before.position)
            np.testing.assert_array_equal(sent.stiffness, before.stiffness)
            np.testing.assert_array_equal(sent.wheel_speed, 0.0)

    @rule(part=st.integers(0, 2))
    def ask_for_what_is_no_number(self, part: int) -> None:
        parts = [STAND.copy(), np.ones(17), np.zeros(3)]
        parts[part][1] = np.nan
        self.gate.gate(reference(parts[0]), parts[1], parts[2], 0.0)
        if self.state is RobotState.ACTIVE:
            self.fail(FaultReason.COMMAND)

    @rule()
    def hold(self) -> None:
        before = self.gate.sent
        assert self.gate.hold().position is before.position

    def here(self) -> Measurement:
        """A measurement of joints that are where they were sent."""
        return replace(FINE, position=self.gate.sent.position)

    @invariant()
    def the_model_agrees(self) -> None:
        assert self.gate.state is self.state
        fault = self.gate.fault
        assert (fault is not None) == (self.state is RobotState.FAULT)
        assert fault is None or fault.reason is self.reason


GateLife.TestCase.settings = examples(60, stateful_step_count=25)
TestGateLife = GateLife.TestCase
