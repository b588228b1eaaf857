"""One tick after the other: measure, observe, react, control, gate, log."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import perf_counter_ns

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends import (
    Backend,
    BackendError,
    Command,
    Measurement,
    NotConnectedError,
    Truth,
)
from pepper_driver.config import RobotConfig
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import Reference, Tick, WholeBodyController
from pepper_driver.log import LogWriter
from pepper_driver.observer import Observation, Observer
from pepper_driver.reflexes import Control, Reflex
from pepper_driver.safety import FaultError, FaultReason, SafetyGate

STAGES = ("backend", "observer", "reflexes", "controller", "gate", "log")
"""What a tick consists of, in order; the backend's part is the robot, or the physics."""


class StageTimes:
    """How long each stage of the last ticks took; the newest ``capacity`` ticks are kept."""

    def __init__(self, capacity: int = 10_000) -> None:
        self._microseconds = np.zeros((capacity, len(STAGES)))
        self._count = 0

    def add(self, marks_ns: Sequence[int]) -> None:
        """Take in one tick: the clock before the first and after each stage [ns]."""
        row = self._microseconds[self._count % len(self._microseconds)]
        for stage in range(len(STAGES)):
            row[stage] = (marks_ns[stage + 1] - marks_ns[stage]) * 1e-3
        self._count += 1

    def clear(self) -> None:
        """Forget all ticks."""
        self._count = 0

    @property
    def microseconds(self) -> FloatArray:
        """(n, stages) the ticks kept, not in order of time [us]."""
        return self._microseconds[: min(self._count, len(self._microseconds))]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Sent:
    """A command on its way, with the reference it was made from."""

    reference: Reference
    command: Command
    changed: NDArray[np.bool_]


class Loop:
    """Runs the ticks of one active robot.

    Args:
        backend: Active already.
        robot: Its description.
        controller: Reset to the posture the robot holds.
        gate: Active, holding the same posture.
        time: Clock of the robot now [s].
        observer: Or None to feel nothing.
        reflexes: Called in this order in every tick.
        log: Or None.
        deliver: Takes every tick and its observation; must not block.

    Attributes:
        control: What reflexes act on.
        times: How long the stages took.
        target: (17,) posture the user wants [rad].
        posture_stiffness: Stiffness of the posture task the user wants [1/s2].
        time: Clock of the robot at the last measurement [s].
    """

    def __init__(
        self,
        backend: Backend,
        robot: RobotConfig,
        controller: WholeBodyController,
        gate: SafetyGate,
        *,
        time: float,
        observer: Observer | None,
        reflexes: Sequence[Reflex],
        log: LogWriter | None,
        deliver: Callable[[Tick, Observation | None], None],
    ) -> None:
        self._backend = backend
        self._robot = robot
        self._controller = controller
        self._gate = gate
        self._observer = observer
        self._reflexes = reflexes
        self._log = log
        self._deliver = deliver
        self._truth: Truth | None = backend.truth if "truth" in backend.info.capabilities else None
        self.control = Control(controller)
        self.times = StageTimes()
        self.target = controller.position
        self.time = time
        self.posture_stiffness = controller.posture.stiffness
        self._wanted: FloatArray | None = self.target.copy()
        self._duration: float | None = None
        self._halted = False
        n = len(robot.joint_names)
        standing = Reference(
            position=controller.position,
            velocity=np.zeros(n),
            acceleration=np.zeros(n),
            load_torque=controller.model.gravity_torque(controller.position),
            base_twist=np.zeros(3),
        )
        first = _Sent(reference=standing, command=gate.sent, changed=np.zeros(n, dtype=np.bool_))
        # The command that a measurement answers is the oldest here.
        self._on_the_way = deque([first], maxlen=backend.info.response_delay + 1)

    def move_to(self, target: FloatArray, duration: float | None = None) -> None:
        """Want a posture (17,) [rad] from the next tick on, reached within ``duration`` [s] along a spline.

        Without a duration it is a set-point. A way under way ends here, even one to the same posture.
        """
        self.target, self._duration = target, duration
        self._wanted = None

    def tick(self) -> Tick:
        """One cycle.

        Whatever fails inside a cycle puts the gate into FAULT. The robot is then told to stand still before the error
        is raised, and the cycle is logged all the same.

        Raises:
            FaultError: The safety gate stopped the robot, in this cycle or before.
        """
        if self._gate.fault is not None:
            self._halt()
            raise FaultError(self._gate.fault)
        marks = [perf_counter_ns()]
        measurement = self._backend.step(self._on_the_way[-1].command)
        self.time = measurement.time
        marks.append(perf_counter_ns())

        answered = self._on_the_way[0]
        tick = Tick(
            measurement=measurement,
            reference=answered.reference,
            sent=answered.command,
            changed=answered.changed,
        )
        observation: Observation | None = None
        cause: Exception | None = None
        try:
            if self._observer is not None:
                observation = self._observer.step(tick)
            marks.append(perf_counter_ns())
            if observation is not None:
                for reflex in self._reflexes:
                    reflex.step(observation, measurement, self.control)
            marks.append(perf_counter_ns())
            reference = self._reference(measurement, answered.command)
            marks.append(perf_counter_ns())
            self._send(reference, measurement, answered.command)
            marks.append(perf_counter_ns())
        except Exception as error:
            # An observer's or a reflex's mistake must not leave the robot moving.
            text = f"{type(error).__name__} inside a tick: {error}"
            self._gate.stop(FaultReason.EXCEPTION, text)
            cause = error

        try:
            if self._log is not None:
                self._log.append(tick, observation, self._truth)
            self._deliver(tick, observation)
        finally:  # whatever a listener does: a fault reaches the robot
            if self._gate.fault is not None:
                self._halt()
        if self._gate.fault is not None:
            raise FaultError(self._gate.fault) from cause
        marks.append(perf_counter_ns())
        self.times.add(marks)
        return tick

    def _reference(self, measurement: Measurement, answered: Command) -> Reference:
        """What the controller wants, for the user's posture or the one a reflex has put in its place."""
        control, task = self.control, self._controller.posture
        held = control.posture
        # A posture outweighs no other task: what a reflex holds, nothing else may move.
        self._controller.hold = held is not None
        wanted = self.target if held is None else held
        # By value: a reflex may change its array in place.
        if self._wanted is None or not np.array_equal(wanted, self._wanted):
            if held is None and self._duration is not None:
                task.move_to(wanted, self._duration)
            else:
                task.target = wanted
            self._wanted = wanted.copy()
        stiffness = control.posture_stiffness
        task.stiffness = self.posture_stiffness if stiffness is None else stiffness
        return self._controller.step(measurement, answered.position)

    def _send(self, reference: Reference, measurement: Measurement, answered: Command) -> None:
        """Pass a reference through the gate; the result is the command of the next cycle."""
        wheel_speed = self._robot.wheels.matrix.dot(reference.base_twist)
        self._gate.watch(measurement, answered)
        gated = self._gate.gate(reference, self.control.stiffness, wheel_speed, measurement.age)
        sent = gated.command
        if gated.wheels_changed:
            self._controller.accept(sent.position, self._robot.wheels.inverse @ sent.wheel_speed)
        elif gated.joints_changed:
            self._controller.accept(sent.position)
        self._on_the_way.append(
            _Sent(reference=reference, command=gated.command, changed=gated.changed)
        )

    def _halt(self) -> None:
        """Tell the robot once, after a fault, to hold its joints and stop its wheels."""
        if not self._halted:
            self._halted = True
            with suppress(BackendError, NotConnectedError):  # nobody there to be told
                self._backend.step(self._gate.hold())
