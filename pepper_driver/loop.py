"""One tick after the other: measure, observe, react, control, gate, log."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from time import perf_counter_ns

import numpy as np

from pepper_driver.backends import (
    Backend,
    Command,
    Measurement,
    Truth,
)
from pepper_driver.backends.interface import LONGEST_WAY
from pepper_driver.callbacks.events import ReflexEvent, SensorEdges, SensorEvent
from pepper_driver.config import RobotConfig
from pepper_driver.config.parts import FloatArray
from pepper_driver.controller import Reference, Sent, Tick, WholeBodyController
from pepper_driver.log import Label, LogEvent, LogWriter
from pepper_driver.observer import Observation, Observer
from pepper_driver.reflexes import Control, Reflexes
from pepper_driver.safety import FaultError, FaultReason, SafetyGate
from pepper_driver.timing import StageTimes

RETURN_SPEED = 0.6
"""[rad/s] At most, of joints that a reflex has led away and that go back to the user's posture."""

SHORTEST_RETURN = 0.8
"""[s] For small ways, so that nothing jerks."""

PEAK = 1.875
"""Largest speed of a motion of least jerk over its mean."""

Labelling = Callable[[Measurement], Sequence[Label]]
"""Makes the labels of a tick, inside it: must be quick."""


class Loop:
    """Runs the ticks of one active robot.

    Args:
        backend: Active already.
        robot: Its description.
        controller: Reset to the posture the robot holds.
        gate: Active, holding the same posture.
        first: What the robot measures now.
        observer: Or None to feel nothing.
        reflexes: Asked in every tick in which there is an observation.
        log: Or None.
        deliver: Takes every tick, its observation and what sensors and reflexes did; must not block.

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
        first: Measurement,
        observer: Observer | None,
        reflexes: Reflexes,
        log: LogWriter | None,
        deliver: Callable[[Tick, Observation | None, Sequence[ReflexEvent | SensorEvent]], None],
    ) -> None:
        self._backend = backend
        self._robot = robot
        self._controller = controller
        self._gate = gate
        self._observer = observer
        self._reflexes = reflexes
        self._log = log
        self._label: Labelling | None = None
        self._missed = 0
        self._deliver = deliver
        self._truth: Truth | None = backend.truth if "truth" in backend.info.capabilities else None
        self.control = Control(controller, robot)
        self.times = StageTimes(robot.cycle)
        self.target = controller.position
        self.time = first.time
        self._sensors = SensorEdges(robot, first)
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
        sent = Sent(reference=standing, command=gate.sent, changed=np.zeros(n, dtype=np.bool_))
        # The last is the one of the next step.
        self._on_the_way = deque([sent], maxlen=max(LONGEST_WAY, backend.info.response_delay) + 1)
        self._step = self._answered_step = 0

    def move_to(self, target: FloatArray, duration: float | None = None) -> None:
        """Want a posture (17,) [rad] from the next tick on, reached within ``duration`` [s] along a spline.

        Without a duration it is a set-point. A way under way ends here, even one to the same posture.
        """
        self.target, self._duration = target, duration
        self._wanted = None

    def start_log(self, log: LogWriter, label: Labelling | None = None) -> None:
        """Log every tick from the next one on, with the labels made of its measurement."""
        self._log, self._label, self._missed = log, label, 0

    def note(self, event: LogEvent) -> None:
        """Log what happened outside the stages of a tick."""
        if self._log is not None:
            self._log.note(event)

    def tick(self, due: int | None = None, missed: int = 0) -> Tick:
        """One cycle.

        Whatever observer, reflexes or controller raise puts the gate into FAULT; what the backend raises, such as a
        lost connection, comes out as it is. In FAULT the robot is told to stand still before the error is raised, and
        the cycle is logged all the same.

        Args:
            due: When it was to begin, by ``perf_counter_ns``; None where ticks do not wait.
            missed: Ticks before it that never began.

        Raises:
            FaultError: The safety gate stopped the robot, in this cycle or before.
        """
        if self._gate.fault is not None:
            self._halt()
            raise FaultError(self._gate.fault)
        self._missed += missed
        marks = [perf_counter_ns()]
        measurement = self._backend.step(self._on_the_way[-1].command)
        self.time = measurement.time
        truth = None
        if self._truth is not None and self._log is not None:
            truth = self._truth.sample()
        marks.append(perf_counter_ns())

        answered, unanswered = self._answered(measurement)
        tick = Tick(
            measurement=measurement,
            reference=answered.reference,
            sent=answered.command,
            changed=answered.changed,
        )
        observation: Observation | None = None
        events: list[ReflexEvent | SensorEvent] = []
        cause: Exception | None = None
        try:
            events += self._sensors.step(measurement)
            if self._observer is not None:
                observation = self._observer.step(tick)
            marks.append(perf_counter_ns())
            if observation is not None and self._reflexes:
                events += self._reflexes.step(observation, measurement, self.control)
                self._leave()
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
                self._log.append(
                    tick,
                    observation,
                    truth,
                    () if self._label is None else self._label(measurement),
                    events=[LogEvent.of(event) for event in events],
                    unanswered=unanswered,
                    tick_end=np.nan if due is None else (perf_counter_ns() - due) * 1e-9,
                    missed=self._missed,
                )
            marks.append(perf_counter_ns())
            self._deliver(tick, observation, events)
        finally:  # whatever a listener does: a fault reaches the robot
            if self._gate.fault is not None:
                self._halt()
        if self._gate.fault is not None:
            raise FaultError(self._gate.fault) from cause
        marks.append(perf_counter_ns())
        self.times.add(marks, age=measurement.age, due=due, missed=missed)
        return tick

    def _answered(self, measurement: Measurement) -> tuple[Sent, list[tuple[int, Sent]]]:
        """The command whose effect a measurement shows, the oldest known where it is older.

        And those before it that none has shown, with the ticks since they were given: samples are lost, and of two that
        come at once the newer one counts.
        """
        ago, sent = measurement.answers, self._on_the_way
        if ago is None:
            ago = self._backend.info.response_delay
        ago = min(ago, len(sent) - 1)
        since = self._step - ago - self._answered_step
        unanswered = [(before, sent[-1 - before]) for before in range(ago + since - 1, ago, -1)]
        self._answered_step += max(since, 0)
        self._step += 1
        return sent[-1 - ago], unanswered

    def _leave(self) -> None:
        """Have the user's posture find the joints, which a reflex has led, where they come to rest."""
        left = self.control.left
        if np.count_nonzero(left):
            self.target = np.where(left, self._controller.rest(self.posture_stiffness), self.target)

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
        elif held is None and np.count_nonzero(control.returned) and not task.driven:
            # A spring would jerk at first, and creep at the end, where worn gears stick and slip.
            way = float(np.abs(wanted - self._controller.position)[control.returned].max())
            task.move_to(wanted, max(PEAK * way / RETURN_SPEED, SHORTEST_RETURN))
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
            Sent(reference=reference, command=gated.command, changed=gated.changed)
        )

    def _halt(self) -> None:
        """Tell the robot once, after a fault, to hold its joints and stop its wheels."""
        if not self._halted:
            self._halted = True
            fault = self._gate.fault
            if self._log is not None and fault is not None:
                event = LogEvent(
                    time=self.time, kind="fault", name=fault.reason.value, text=fault.text
                )
                self._log.note(event)
            with suppress(Exception):  # of the backend: the fault is what is raised
                self._backend.step(self._gate.hold())
