"""One tick after the other: read, pair sample and command, observe, arbitrate, control, gate, write, log, publish."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from pepper_driver.backends import Backend, Measurement
from pepper_driver.backends.interface import MAX_RESPONSE_DELAY
from pepper_driver.backends.simulated import TruthSample
from pepper_driver.callbacks.events import ReflexEvent, SensorEdges, SensorEvent
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Reference, SentCommand, Tick, WholeBodyController
from pepper_driver.log import Label, LogEvent, LogWriter
from pepper_driver.log.topics import EventPhase
from pepper_driver.observer import Observation, Observer
from pepper_driver.realtime import StageTimes
from pepper_driver.reflexes import Arbiter
from pepper_driver.reflexes.attentive import AttentiveNote
from pepper_driver.safety import FaultError, FaultReason, SafetyGate
from pepper_driver.safety.plugins import describe_failure
from pepper_driver.telemetry import TelemetryServer

Labelling = Callable[[Measurement], Sequence[Label]]
"""Makes the labels of a tick, inside it: must be quick."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TickRecord:
    """One tick, as log and listeners get it; nothing in it is ever changed.

    Attributes:
        tick: Measurement, and the reference and command it answers.
        observation: Result of the observer; None without one.
        base_pose: (3,) x [m], y [m], heading [rad] of the base by its wheels, since the start.
        events: Sensors that were pressed or released, reflexes that began or ended.
        unmatched: Commands that no tick answers, older than the one that this tick answers: how many ticks before this
            one, and which.
        truth: Ground truth of a simulation that is logged; for the log only.
        labels: Ends of touches that a person has marked.
        tick_end: From the time the tick was to begin to its log entry [s]; NaN where ticks do not wait.
        missed: Ticks missed since the log began.
    """

    tick: Tick
    observation: Observation | None = None
    base_pose: FloatArray = field(default_factory=lambda: np.zeros(3))
    events: Sequence[ReflexEvent | SensorEvent] = ()
    unmatched: Sequence[tuple[int, SentCommand]] = ()
    truth: TruthSample | None = None
    labels: Sequence[Label] = ()
    tick_end: float = np.nan
    missed: int = 0


class Loop:
    """Runs the ticks of one active robot.

    Args:
        backend: Active already.
        robot: Its description.
        arbiter: Decides what its controller follows; the controller is reset to the posture the robot holds.
        gate: Active, holding the same posture.
        first: Newest measurement.
        observer: Reset; or None to detect nothing.
        publish: Takes every tick; must not block.

    Attributes:
        arbiter: The same.
        observer: The same.
        times: Times of the stages.
        latest: Newest tick, or the robot at the start, as it stands.
    """

    def __init__(
        self,
        backend: Backend,
        robot: RobotConfig,
        arbiter: Arbiter,
        gate: SafetyGate,
        *,
        first: Measurement,
        observer: Observer | None,
        publish: Callable[[TickRecord], None],
    ) -> None:
        self._backend, self._wheels, self._gate = backend, robot.wheels, gate
        self.arbiter = arbiter
        self._controller: WholeBodyController = arbiter.controller
        self.observer, self._publish = observer, publish
        if observer is not None:
            observer.reset()
        self._log: LogWriter | None = None
        self._telemetry: TelemetryServer | None = None
        self._label: Labelling = lambda _: ()
        self._logs_truth = "truth" in backend.info.capabilities
        self._missed = 0
        self.times = StageTimes(robot.cycle)
        self._sensors = SensorEdges(robot, first)
        self._halted = False
        n, controller = len(robot.joint_names), self._controller
        standing = Reference(
            position=controller.position,
            velocity=np.zeros(n),
            acceleration=np.zeros(n),
            load_torque=controller.model.gravity_torque(controller.position),
            base_twist=np.zeros(3),
        )
        sent = SentCommand(reference=standing, sent=gate.sent, limited=np.zeros(n, dtype=np.bool_))
        self._response_delay = backend.info.response_delay
        # The last one is in force.
        self._in_flight = deque([sent], maxlen=max(MAX_RESPONSE_DELAY, self._response_delay) + 1)
        # Numbers of the last command, and of the last one answered.
        self._written = self._matched = 0
        self.latest = TickRecord(tick=_tick(first, sent))
        backend.write(sent.sent)

    @property
    def time(self) -> float:
        """Clock of the robot at the newest measurement [s]."""
        return self.latest.tick.measurement.time

    @property
    def commanded(self) -> FloatArray:
        """(17,) joint positions commanded last [rad]."""
        return self._in_flight[-1].sent.position

    def start_log(self, log: LogWriter, label: Labelling | None = None) -> None:
        """Log every tick from the next one on, with the labels made of its measurement."""
        self._log, self._label, self._missed = log, label or self._label, 0

    def start_telemetry(self, telemetry: TelemetryServer) -> None:
        """Stream every tick from the next one on."""
        self._telemetry = telemetry

    def set_attentive(self, value: bool) -> None:
        """Begin or end to oscillate by a little on top of any motion, from the next tick on."""
        if value != self.arbiter.attentive:
            self.arbiter.attentive = value
            phase: EventPhase = "begin" if value else "end"
            self.log_event(LogEvent(time=self.time, kind="attentive", phase=phase))

    def _log_note(self, note: AttentiveNote, time: float) -> None:
        """Log what limits an attentive robot."""
        event = LogEvent(
            time=time, kind="attentive", phase="update", joints=(note.joint,), text=note.text
        )
        self.log_event(event)

    def log_event(self, event: LogEvent) -> None:
        """Log what happened outside the stages of a tick."""
        if self._log is not None:
            self._log.note(event)
        if self._telemetry is not None:
            self._telemetry.log_event(event)

    def tick(self, due: int | None = None, missed: int = 0) -> TickRecord:
        """Run one cycle.

        An exception of observer, reflexes or controller puts the gate into FAULT; one of the backend, such as a
        lost connection, comes out as it is. In FAULT the robot is stopped before the error is raised, and
        the cycle is logged all the same.

        Args:
            due: When it was to begin, by the clock of the backend [ns]; None where ticks do not wait.
            missed: Ticks before it that never began.

        Raises:
            FaultError: The safety gate stopped the robot, in this cycle or before.
        """
        gate, cause, now = self._gate, None, self._backend.clock.now
        if gate.fault is not None:
            self.halt()
            raise FaultError(gate.fault)
        self._missed += missed
        marks = [now()]
        measurement = self._backend.read()
        truth = self._backend.truth.sample() if self._log is not None and self._logs_truth else None
        marks.append(now())
        answered, unmatched = self._match_command(measurement)
        tick = _tick(measurement, answered)
        observation: Observation | None = None
        events: list[ReflexEvent | SensorEvent] = []
        labels: Sequence[Label] = ()
        try:
            labels = self._label(measurement)
            events += self._sensors.step(measurement)
            if self.observer is not None:
                observation = self.observer.step(tick)
            marks.append(now())
            events += self.arbiter.step(observation, measurement)
            for note in self.arbiter.notes:
                self._log_note(note, measurement.time)
            marks.append(now())
            reference = self._controller.step(measurement, tick.sent.position)
            marks.append(now())
            sent = self._pass_gate(reference, measurement, tick)
            marks.append(now())
        except Exception as error:
            # An observer's or a reflex's mistake must not leave the robot moving.
            gate.stop(FaultReason.EXCEPTION, describe_failure(error))
            cause = error
        else:
            self._backend.write(sent.sent)
            self._in_flight.append(sent)
            self._written += 1
            marks.append(now())
        try:
            record = TickRecord(
                tick=tick,
                observation=observation,
                base_pose=self._controller.odometry.pose,
                events=events,
                unmatched=unmatched,
                truth=truth,
                labels=labels,
                tick_end=np.nan if due is None else (now() - due) * 1e-9,
                missed=self._missed,
            )
            if self._log is not None:
                self._log.append(record)
            if self._telemetry is not None:
                self._telemetry.append(record)
            marks.append(now())
            self.latest = record
            self._publish(record)
        finally:  # also if a listener raises: a fault must reach the robot
            if gate.fault is not None:
                self.halt()
        if gate.fault is not None:
            raise FaultError(gate.fault) from cause
        marks.append(now())
        self.times.add(marks, age=measurement.age, due=due, missed=missed)
        return record

    def _match_command(
        self, measurement: Measurement
    ) -> tuple[SentCommand, list[tuple[int, SentCommand]]]:
        """Return the command whose effect a measurement shows, the oldest known where it is older.

        And those before it that none has shown, with the ticks since they were sent: samples are lost, and of two that
        come at once the newer one counts.
        """
        ago, sent = measurement.response_delay, self._in_flight
        if ago is None:
            ago = self._response_delay
        ago = min(ago, len(sent) - 1)
        since = self._written - ago - self._matched
        unmatched = [(before, sent[-1 - before]) for before in range(ago + since - 1, ago, -1)]
        self._matched += max(since, 0)
        return sent[-1 - ago], unmatched

    def _pass_gate(self, reference: Reference, measurement: Measurement, tick: Tick) -> SentCommand:
        """Return the command that leaves the gate; the controller continues from the limited command."""
        gate = self._gate
        gate.watch(measurement, tick.sent)
        wheel_speed = self._wheels.matrix.dot(reference.base_twist)
        sent, limited, joints_limited, wheels_limited = gate.gate(
            reference, self.arbiter.stiffness, wheel_speed, measurement.age
        )
        if wheels_limited:
            twist = self._wheels.inverse @ sent.wheel_speed
            self._controller.override_state(sent.position, twist)
        elif joints_limited:
            self._controller.override_state(sent.position)
        return SentCommand(reference=reference, sent=sent, limited=limited)

    def halt(self) -> None:
        """Write one command, after a fault, that holds the joints and stops the wheels."""
        fault = self._gate.fault
        if self._halted or fault is None:
            return
        self._halted = True
        with suppress(Exception):  # of the backend: the fault is what is raised
            self._backend.write(self._gate.hold())
        self.log_event(
            LogEvent(time=self.time, kind="fault", name=fault.reason.value, text=fault.text)
        )


def _tick(measurement: Measurement, sent: SentCommand) -> Tick:
    return Tick(
        measurement=measurement,
        reference=sent.reference,
        sent=sent.sent,
        limited=sent.limited,
    )
