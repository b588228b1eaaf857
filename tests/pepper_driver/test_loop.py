"""The tick: what is paired with what, in which order, and what happens when something fails."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pepper_driver.backends import Truth
from pepper_driver.backends.interface import MAX_RESPONSE_DELAY
from pepper_driver.backends.mock import Fault, MockBackend
from pepper_driver.config import (
    ControllerSettings,
    RobotConfig,
    load_controller_settings,
    load_robot,
    load_safety_settings,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Reference, Tick, WholeBodyController
from pepper_driver.loop import Loop, TickRecord
from pepper_driver.observer import Contact, Observation, Observer
from pepper_driver.realtime import STAGES
from pepper_driver.reflexes import Arbiter, Reflex, ReflexRequests, prepare_reflexes
from pepper_driver.robot import Pepper
from pepper_driver.safety import FaultError, FaultReason, RobotState, SafetyGate
from pepper_driver.testing import aged, displaced
from support.examples import examples
from support.fakes import slowed

ROBOT = load_robot()


def make_loop(
    backend: MockBackend,
    observer: Observer | None = None,
    reflexes: tuple[Reflex, ...] = (),
    publish: Callable[[TickRecord], None] = lambda _: None,
    feedback: Literal["none", "joints"] = "none",
    gated: tuple[RobotConfig, ControllerSettings] | None = None,
) -> tuple[Loop, SafetyGate, WholeBodyController]:
    gains = replace(load_controller_settings(ROBOT), feedback=feedback)
    controller = WholeBodyController(ROBOT, gains)
    robot, limits = gated or (ROBOT, gains)
    gate = SafetyGate(robot, load_safety_settings(), limits)
    backend.open()
    first = backend.activate()
    start = first.position
    controller.reset(start)
    gate.activate(start)
    loop = Loop(
        backend,
        ROBOT,
        Arbiter(controller, ROBOT, prepare_reflexes(reflexes, ROBOT)),
        gate,
        first=first,
        observer=observer,
        publish=publish,
    )
    return loop, gate, controller


def turn(loop: Loop, angle: float) -> None:
    """Request that the left shoulder goes by an angle [rad]."""
    target = loop.arbiter.target.copy()
    target[6] += angle
    loop.arbiter.move_to(target)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_measurement_is_paired_with_the_command_it_answers(delay: int) -> None:
    """The fake joint shows the command of ``delay`` ticks ago, so the tracking error must vanish."""
    loop, _, _ = make_loop(MockBackend(delay=delay))
    turn(loop, 0.5)
    for _ in range(60):
        tick = loop.tick().tick
        np.testing.assert_array_equal(tick.sent.position, tick.measurement.position)
    assert abs(tick.sent.position[6] - ROBOT.posture("Stand")[6]) > 0.1


def answering(ago: int) -> Fault:
    return lambda measurement: replace(measurement, response_delay=ago)


@examples(25)
@given(
    st.lists(
        st.integers(0, 6) | st.integers(0, MAX_RESPONSE_DELAY + 30),
        min_size=1,
        max_size=MAX_RESPONSE_DELAY + 40,
    )
)
@example([0, 3] + 70 * [80] + [2, 0])
def test_each_command_is_answered_or_known_not_to_be(answers: list[int]) -> None:
    """Whatever a backend says of its samples: late, twice, lost, older than all that is known."""
    backend = MockBackend()
    loop, _, _ = make_loop(backend)
    turn(loop, 0.5)
    answered: list[int] = []
    for step, ago in enumerate(answers):
        backend.faults[step + 1] = answering(ago)
        record = loop.tick()
        place = max(0, step - ago, step - MAX_RESPONSE_DELAY)
        # The arm moves in every tick: each command has a position of its own.
        written = [command.position.tobytes() for command in backend.commands]
        assert len(set(written)) == len(written)
        assert record.tick.sent.position.tobytes() == written[place]
        first = max(answered, default=0) + 1
        late = [(ago, entry.sent.position.tobytes()) for ago, entry in record.unmatched]
        expected = range(max(first, step - MAX_RESPONSE_DELAY), place)
        assert late == [(step - k, written[k]) for k in expected]
        answered.append(place)


def test_the_reference_in_a_tick_is_the_one_its_command_was_made_from() -> None:
    loop, _, _ = make_loop(MockBackend(delay=2))
    turn(loop, 0.3)
    for _ in range(40):
        tick = loop.tick().tick
        np.testing.assert_array_equal(tick.reference.position, tick.sent.position)


def test_transport_is_no_error_of_a_closed_loop() -> None:
    """The fake follows exactly, three ticks late: with the number of the answered command, feedback changes nothing."""
    trails: list[FloatArray] = []
    feedback: Literal["none", "joints"]
    for feedback in ("none", "joints"):
        backend = MockBackend(delay=3)
        loop, _, _ = make_loop(backend, feedback=feedback)
        turn(loop, 0.5)
        for _ in range(100):
            loop.tick()
        trails.append(np.array([command.position[6] for command in backend.commands]))
    assert np.ptp(trails[0]) > 0.3
    np.testing.assert_allclose(trails[1], trails[0], atol=1e-9)


class Spy(Observer):
    """Notes what it sees; reports the contacts that a test gives it."""

    def __init__(self) -> None:
        self.ticks: list[Tick] = []
        self.report: dict[int, tuple[Contact, ...]] = {}

    def step(self, tick: Tick) -> Observation:
        self.ticks.append(tick)
        nan = np.full(17, np.nan)
        return Observation(
            contacts=self.report.get(len(self.ticks), ()),
            expected=nan,
            residual=nan,
            threshold=nan,
            torque=nan,
            torque_std=nan,
            state=np.zeros(17, dtype=np.int8),
        )

    def reset(self) -> None:
        self.ticks.clear()

    def describe(self) -> str:
        return "spy"


class Reach(Reflex):
    """Requests another posture from its third tick on."""

    def __init__(self) -> None:
        self.calls = 0

    def step(self, observation: Observation, measurement: Any, requests: ReflexRequests) -> None:
        self.calls += 1
        if self.calls == 3:
            self.requested = requests.controller.position
            self.requested[6] += 0.2
        if self.calls >= 3:
            requests.hold_posture(self.requested, 100.0)

    def reset(self) -> None:
        self.calls = 0


def test_a_reflex_acts_in_the_tick_it_is_called_in() -> None:
    backend = MockBackend()
    loop, _, _ = make_loop(backend, observer=Spy(), reflexes=(Reach(),))
    for _ in range(2):
        loop.tick()
    resting = backend.commands[-1].position[6]
    loop.tick()
    assert backend.commands[-1].position[6] > resting


class Creep(Reflex):
    """Moves its own posture on, in place."""

    requested: FloatArray | None = None

    def step(self, observation: Observation, measurement: Any, requests: ReflexRequests) -> None:
        if self.requested is None:
            self.requested = requests.controller.position
        self.requested[6] += 0.002
        requests.hold_posture(self.requested, 5.0)

    def reset(self) -> None:
        self.requested = None


def test_a_posture_that_a_reflex_changes_in_place_is_followed() -> None:
    backend = MockBackend()
    loop, _, controller = make_loop(backend, observer=Spy(), reflexes=(Creep(),))
    start = controller.position[6]
    for _ in range(300):
        loop.tick()
    assert controller.position[6] - start == pytest.approx(0.6, abs=0.2)


def test_a_listener_that_fails_does_not_keep_a_fault_from_the_robot() -> None:
    backend = MockBackend()

    def fail(record: TickRecord) -> None:
        if record.tick.measurement.tick == 61:
            raise KeyError("a user's mistake")

    loop, gate = driving(backend, observer=Spy(), reflexes=(Broken("raises"),), publish=fail)
    with pytest.raises(KeyError):
        loop.tick()
    assert gate.state is RobotState.FAULT
    stands_still(backend, loop, 61)


def test_what_the_gate_changed_is_flagged_and_fed_back() -> None:
    """A clamped command must not look like a touch, nor may the controller run ahead of the robot."""
    backend = MockBackend()
    spy = Spy()
    loop, _, controller = make_loop(backend, observer=spy)

    honest = controller.step

    def jump(measurement: Any = None, answered: Any = None) -> Reference:
        reference = honest(measurement, answered)
        if len(backend.commands) == 5:
            reference.position[6] += 0.4
        return reference

    controller.step = jump  # type: ignore[method-assign]
    for _ in range(8):
        loop.tick()
    flagged = [i for i, tick in enumerate(spy.ticks) if tick.limited.any()]
    assert flagged == [5]
    assert spy.ticks[5].limited.tolist() == [i == 6 for i in range(17)]
    np.testing.assert_array_equal(spy.ticks[5].sent.position, spy.ticks[5].measurement.position)
    # it goes on from where the robot was really sent
    step = np.abs(backend.commands[6].position - backend.commands[5].position).max()
    assert step < 0.04


def test_the_controller_does_not_run_ahead_of_a_robot_that_the_gate_slows() -> None:
    backend = MockBackend()
    slow = slowed(load_controller_settings(ROBOT), 0.001 / ROBOT.cycle / 1.5)
    loop, gate, controller = make_loop(backend, gated=(ROBOT, slow))
    turn(loop, 0.5)
    for _ in range(60):
        loop.tick()
        assert abs(controller.position[6] - gate.sent.position[6]) < 1e-12
    assert 0.03 < gate.sent.position[6] - ROBOT.posture("Stand")[6] <= 0.0601


@pytest.mark.parametrize(
    ("fault", "word"), [(aged(0.15), "old"), (displaced("HeadPitch", np.nan), "not a number")]
)
def test_a_fault_stops_the_robot_and_is_reported(fault: Any, word: str) -> None:
    backend = MockBackend()
    loop, gate, _ = make_loop(backend)
    turn(loop, 0.5)
    backend.faults[20] = fault
    for _ in range(19):
        loop.tick()
    with pytest.raises(FaultError, match=word):
        loop.tick()
    assert gate.state is RobotState.FAULT
    stands_still(backend, loop, 20)


def stands_still(backend: MockBackend, loop: Loop, commands: int) -> None:
    """After so many commands one made the robot hold its joints and stop its wheels; no other came."""
    before, after = backend.commands[commands - 1], backend.commands[commands:]
    assert after
    for command in after:
        # It holds what had left the gate: at most the step of one cycle further on.
        assert np.abs(command.position - before.position).max() < 0.01
        np.testing.assert_array_equal(command.stiffness, before.stiffness)
        np.testing.assert_array_equal(command.wheel_speed, 0.0)
    for _ in range(2):
        with pytest.raises(FaultError):
            loop.tick()
    assert len(backend.commands) == commands + len(after)


def driving(backend: MockBackend, **parts: Any) -> tuple[Loop, SafetyGate]:
    """A loop whose arm and wheels move."""
    loop, gate, _ = make_loop(backend, **parts)
    turn(loop, 0.5)
    loop.arbiter.drive(np.array([0.2, 0.0, 0.0]))
    for _ in range(60):
        loop.tick()
    assert np.abs(backend.commands[-1].wheel_speed).max() > 0.3
    return loop, gate


def test_an_emergency_stop_reaches_the_robot() -> None:
    backend = MockBackend()
    loop, gate = driving(backend)
    gate.stop(FaultReason.EMERGENCY_STOP, "emergency stop")
    with pytest.raises(FaultError, match="emergency stop"):
        loop.tick()
    stands_still(backend, loop, 61)


class Broken(Reflex):
    """Works for a while."""

    def __init__(self, harm: str) -> None:
        self.harm, self.calls = harm, 0

    def step(self, observation: Observation, measurement: Any, requests: ReflexRequests) -> None:
        self.calls += 1
        if self.calls <= 60:
            return
        if self.harm == "raises":
            raise ZeroDivisionError("a user's mistake")
        if self.harm == "posture":
            requests.posture = np.full(17, np.nan)
        if self.harm == "stiffness":
            requests.stiffness = np.zeros(16)
        if self.harm == "gain":
            requests.hold_posture(requests.controller.position, -1.0)

    def reset(self) -> None:
        self.calls = 0


@pytest.mark.parametrize("harm", ["raises", "posture", "stiffness", "gain"])
def test_a_broken_reflex_stops_the_robot_and_the_tick_is_published(harm: str) -> None:
    backend, published = MockBackend(), list[TickRecord]()
    loop, gate = driving(
        backend, observer=Spy(), reflexes=(Broken(harm),), publish=published.append
    )
    with pytest.raises(FaultError) as caught:
        loop.tick()
    assert gate.state is RobotState.FAULT
    if harm == "raises":
        assert "ZeroDivisionError" in str(caught.value)
        assert isinstance(caught.value.__cause__, ZeroDivisionError)
    assert len(published) == 61
    stands_still(backend, loop, 61)


class BrokenObserver(Spy):
    def step(self, tick: Tick) -> Observation:
        if len(self.ticks) == 60:
            raise RuntimeError("a user's mistake")
        return super().step(tick)


def test_a_broken_observer_stops_the_robot() -> None:
    backend = MockBackend()
    loop, _ = driving(backend, observer=BrokenObserver())
    with pytest.raises(FaultError, match="RuntimeError"):
        loop.tick()
    stands_still(backend, loop, 61)


def reachable(root: object) -> list[object]:
    """Everything that can be reached from an object through attributes, items and closures."""
    seen: dict[int, object] = {}
    todo = [root]
    while todo:
        thing = todo.pop()
        if id(thing) in seen or isinstance(thing, str | bytes | int | float | np.generic | type):
            continue
        if type(thing).__module__.startswith(("numba", "llvmlite")):  # compiled code holds nothing
            continue
        seen[id(thing)] = thing
        if is_dataclass(thing):
            todo += [getattr(thing, field.name) for field in fields(thing)]
        if isinstance(thing, dict):
            todo += [*thing.keys(), *thing.values()]
        if isinstance(thing, list | tuple | set | frozenset):
            todo += list(thing)
        if isinstance(thing, np.ndarray):
            todo.append(thing.base)
        todo += list(vars(thing).values()) if hasattr(thing, "__dict__") else []
        todo += [cell.cell_contents for cell in getattr(thing, "__closure__", None) or ()]
    return list(seen.values())


def test_nothing_reachable_from_a_tick_leads_to_the_truth() -> None:
    spy = Spy()
    with Pepper("mujoco", observer=spy) as pepper:
        pepper.push("LForeArm", [0.0, 8.0, 0.0], duration=0.5)
        pepper.run(0.3)
        torque = pepper.backend.truth.contact_torque
        position = pepper.backend.truth.position
        assert np.abs(torque).max() > 0.5
        for tick in spy.ticks:
            for thing in reachable(tick):
                assert not isinstance(thing, Truth)
                assert "mujoco" not in type(thing).__module__
                if isinstance(thing, np.ndarray) and thing.shape == (17,):
                    assert not np.array_equal(thing, torque)
                    assert not np.array_equal(thing, position)
        assert any(isinstance(thing, Truth) for thing in reachable({"t": pepper.backend.truth}))


def test_every_stage_is_timed() -> None:
    loop, _, _ = make_loop(MockBackend())
    for _ in range(10):
        loop.tick()
    statistics = loop.times.statistics
    assert statistics.ticks == 10
    assert tuple(statistics.stages) == STAGES
    assert statistics.stages["controller"].median > 0
    assert statistics.end is None


def test_wheels_that_the_gate_slows_keep_the_direction_and_the_controller_gets_them() -> None:
    """The gate's limit is below the controller's: what that integrates is what the wheels were sent."""
    backend = MockBackend(delay=0)
    slow = replace(ROBOT, wheels=replace(ROBOT.wheels, speed_limit=0.5))
    loop, _, controller = make_loop(backend, gated=(slow, load_controller_settings(ROBOT)))
    twist = np.array([0.15, 0.05, 0.2])
    loop.arbiter.drive(twist)
    for _ in range(200):
        tick = loop.tick().tick
    sent = np.linalg.solve(ROBOT.wheels.matrix, tick.sent.wheel_speed)
    assert np.abs(tick.sent.wheel_speed).max() == pytest.approx(0.5)
    requested = tick.reference.base_twist
    assert np.abs(ROBOT.wheels.matrix @ requested).max() > 0.5
    fraction = np.linalg.norm(sent) / np.linalg.norm(requested)
    np.testing.assert_allclose(sent, fraction * requested, atol=1e-9)
    before = controller.base_pose
    loop.tick()
    moved = controller.base_pose - before
    assert np.linalg.norm(moved[:2]) == pytest.approx(
        np.linalg.norm(sent[:2]) * ROBOT.cycle, rel=0.1
    )
