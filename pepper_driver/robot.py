"""``Pepper``: the robot as users meet it, with its life, motion, contacts and services."""

from __future__ import annotations

import logging
import math
import sys
import threading
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Literal, ParamSpec, Self, Unpack

from numpy.typing import ArrayLike

from pepper_driver.backends import Backend, BackendError, Grab, Measurement, make_backend
from pepper_driver.backends.simulated import HAND_TIMEOUT
from pepper_driver.callbacks.callback_registry import CallbackRegistry
from pepper_driver.callbacks.dispatcher import CallbackStatistics
from pepper_driver.callbacks.events import ProgramEvent
from pepper_driver.callbacks.filters import ContactArguments, contact_filter
from pepper_driver.callbacks.waiting import stream_contacts, wait_for_contact
from pepper_driver.config import (
    ConfigError,
    ControllerSettings,
    Experiment,
    JointArray,
    PepperError,
    Posture,
    RobotConfig,
    SafetySettings,
    load_controller_settings,
    load_experiment,
    load_robot,
    load_safety_settings,
)
from pepper_driver.config.arguments import as_path, checked_arguments, is_number
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import ArgumentError, shown
from pepper_driver.config.signals import Terminated, describe_interrupt
from pepper_driver.config.steps import MAX_STEP_TIME, MIN_DURATION
from pepper_driver.controller import GainError, TargetError, Tick, WholeBodyController
from pepper_driver.controller.changes import Changes
from pepper_driver.controller.constraints import Constraint
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.solvers import make_solver
from pepper_driver.controller.tasks import Task, checked_stiffness
from pepper_driver.controller.tasks.targets import finite_vector
from pepper_driver.controller.whole_body import check_part
from pepper_driver.experiments.plan import Plan, plan_experiment
from pepper_driver.experiments.player import OnStep, Player
from pepper_driver.experiments.reports import ExperimentReport
from pepper_driver.log import LogError, LogWriter, run_metadata
from pepper_driver.loop import Labelling, Loop
from pepper_driver.observer import Contact, ContactObserver, ModelSet, Observation, Observer
from pepper_driver.observers import (
    check_observer,
    friction_errors,
    make_observer,
    measured_robot,
    uri_with_measured_delay,
    warn_of_assumed_delay,
)
from pepper_driver.realtime import Pacer, RealTimePacer, Statistics
from pepper_driver.reflexes import Arbiter, Reflex, prepare_reflexes
from pepper_driver.reflexes.declared import declare
from pepper_driver.safety import FaultReason, RobotState
from pepper_driver.safety.plugins import dry_run_observer, dry_run_part, dry_run_reflexes
from pepper_driver.services import UserServices
from pepper_driver.session import OnTick, Session
from pepper_driver.steady_hand import SteadyHand
from pepper_driver.telemetry import TelemetryServer

if TYPE_CHECKING:
    from pepper_driver.viewer.view import View

logger = logging.getLogger("pepper_driver")

P = ParamSpec("P")

MAX_RUN = 1e9
"""[s] Longest run: thirty years."""

MAX_DRIVE = 10.0
"""[m/s], [rad/s] Of a drive: far beyond what the wheels do, so it is a mistake."""


@checked_arguments
class Pepper(CallbackRegistry):
    """A Pepper, real or simulated, that detects where it is touched.

    >>> with Pepper("mujoco") as pepper:
    ...     pepper.set_posture({"LShoulderRoll": 0.6})
    ...     pepper.run(3.0)

    Making one checks and loads; nothing connects or moves. Entering the block connects, raises the stiffness and starts
    to hold the posture; leaving it, for any reason, stops the wheels, lowers the stiffness, closes the log and
    disconnects. :meth:`start` and :meth:`stop` do the same without a block.

    In between the robot ticks every 12 ms. Where time passes by itself, a thread ticks all the time, independent of
    what the program does; in a simulation that is not paced, time passes only inside :meth:`run` and :meth:`step`. What
    other threads change takes effect between two ticks.

    Callbacks are registered with the decorators of
    :class:`~pepper_driver.callbacks.callback_registry.CallbackRegistry`: ``on_contact``, ``on_tick``, ``on_touch``,
    ``on_bumper``, ``on_button``, ``on_fault``, ``on_reflex``, ``on_step``, ``on_cue`` and ``on_push``.

    Args:
        uri: Which robot: ``mujoco``, ``mujoco://?plant=nominal&seed=3``, ``naoqi://pepper.local``, ...
        observer: Name of an observer, an observer, or None to detect nothing.
        models: Model file of the observer, by default the one shipped for this robot, or for a plant that it extends.
            A robot over NAOqi also gets the response delay that was measured for it, unless the URI has one, and
            speeds that were measured replace the controller's default limits. The friction of the joints sizes the
            oscillation of an attentive robot, unless ``controller`` has its own.
        log: Where to write the MCAP log; None for no log.
        reflexes: Reactions inside the tick, asked in the order of their priority.
        real_time: Pace a simulation to the wall clock.
        loop: ``thread`` or ``caller`` makes the ticks. The default is a thread wherever time passes by itself. With
            ``caller``, the thread that calls :meth:`run` or :meth:`step` does; when it does not for 60 ms, the robot
            comes to rest.
        robot: Description of the robot, by default the shipped Pepper.
        controller: Gains, limits, feedback and solver, by default those of ``controller.yaml``.
        safety: Limits of the safety gate, by default those of ``safety.yaml``.
        about: More that the log shall say of its runs.

    Attributes:
        config: Description of the robot.
        backend: The robot or simulation behind it.
        services: Speech, lights, tablet, postures, wake-up and rest, where the robot has them.
        paced: True where ticks wait for the wall clock: on a real robot, or with ``real_time``.
        observer: The observer in use; of a real robot, by name, once it is connected.
        reflexes: In the order in which they are asked.
        push, grab: Push or grab a link of a simulated robot; see :meth:`pepper_driver.backends.Backend.push`.

    Raises:
        PepperError: An argument is wrong.
    """

    def __init__(
        self,
        uri: str = "mujoco",
        *,
        observer: str | Observer | None = "fusion",
        models: Path | str | None = None,
        log: Path | str | None = None,
        reflexes: Sequence[Reflex] = (),
        real_time: bool = False,
        loop: Literal["thread", "caller"] | None = None,
        robot: RobotConfig | None = None,
        controller: ControllerSettings | None = None,
        safety: SafetySettings | None = None,
        about: Mapping[str, str] | None = None,
    ) -> None:
        config = load_robot() if robot is None else robot
        self.reflexes = prepare_reflexes(reflexes, config)
        dry_run_reflexes(self.reflexes, config)
        super().__init__(config, self.reflexes)
        self._models = None if models is None else as_path("models", models)
        self._observer_name = observer if isinstance(observer, str) else None
        if self._models is not None and self._observer_name is None:
            raise ConfigError("models are for an observer that is given by its name")
        measured = measured_robot(self._models)
        self.backend: Backend = make_backend(uri_with_measured_delay(uri, measured), self.config)
        if self._models is not None:
            warn_of_assumed_delay(uri, self._models, measured)
        self.services = UserServices(self.backend, self._is_active)
        self.paced = real_time or self.backend.real_time
        if loop not in (None, "thread", "caller") or (loop == "thread" and not self.paced):
            raise BackendError(
                f"loop is 'thread' or 'caller', got {loop!r}; a simulation that is not paced, without real_time=True, "
                "always ticks in the caller"
            )
        self._loop_thread = self.paced and loop != "caller"
        self.observer = observer if isinstance(observer, Observer) else None
        if self.observer is not None:
            dry_run_observer(self.observer, self.config)
        if self._observer_name is not None:
            check_observer(self._observer_name, self._models)
            if not self.backend.real_time:  # a real robot is not asked before it is connected
                self._make_observer()
        self._log_path = None if log is None else as_path("log", log)
        if self._log_path is not None and self._log_path.is_dir():
            raise LogError(f"{self._log_path}: cannot be written (it is a folder)")
        self._about = _texts(about or {})
        self._controller_settings = controller or load_controller_settings(self.config)
        if controller is None and measured is not None:
            self._controller_settings = self._controller_settings.with_measured_speeds(
                measured.speeds
            )
        if not self._controller_settings.attentive.friction_deg:
            known: Path | ModelSet | None = self._models
            if known is None and isinstance(self.observer, ContactObserver):
                known = self.observer.models
            self._controller_settings = self._controller_settings.with_friction(
                friction_errors(known)
            )
        make_solver(self._controller_settings.solver)  # now, and not once the robot is connected
        self._safety_settings = safety or load_safety_settings()
        self._changes = Changes()
        self._attentive = False
        self._telemetry: TelemetryServer | None = None
        self._view: View | None = None
        self._parts: tuple[Task | Constraint, ...] = ()  # of the user, added before the start
        self._model: RobotModel | None = None
        self._model_lock, self._starting = threading.Lock(), threading.Lock()
        self._session: Session | None = None  # the one that starts or runs, or the last one
        self._stopped_early: str | None = None  # why, if it was stopped before the first start
        self.push = self._when_active(self.backend.push)
        self.grab = self._when_active(self.backend.grab)

    # -- life -----------------------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        before = self._session
        try:
            self.start()
        except BaseException:
            if self._session is not before:  # Ctrl-C as it ended
                self.stop()
            raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        session = self._session
        try:
            self._end(error)
        except PepperError as problem:
            problem.while_active = True
            if error is None:
                raise
            error.add_note(f"and in the end: {problem}")
        if isinstance(error, PepperError):
            error.while_active = True
        if error is None and session is not None:
            session.check_failure(again=False)

    def start(self) -> None:
        """Connect, open the log, raise the stiffness, hold the measured posture; tick from now on.

        Raises:
            PepperError: The robot or the log cannot be opened, the robot is not ready to move (``NotReadyError``), or
                an emergency stop came meanwhile.
        """
        if not self._starting.acquire(blocking=False):
            raise BackendError(f"'{self.backend.uri}' is being started already")
        try:
            if self._is_active():
                raise BackendError(f"'{self.backend.uri}' is already active")
            self._start()
        finally:
            self._starting.release()

    def _start(self) -> None:
        first = self._session is None
        session = self._session = Session(
            self.backend,
            self.config,
            self._controller_settings,
            self._safety_settings,
            dispatcher=self._make_dispatcher(),
            pacer=RealTimePacer(self.config.cycle, self.backend, clock=self.backend.clock)
            if self.paced
            else Pacer(),
            changes=self._changes,
            metadata=self.run_metadata,
            loop_thread=self._loop_thread,
        )
        if first and self._stopped_early is not None:
            session.gate.stop(FaultReason.EMERGENCY_STOP, self._stopped_early)
        try:
            session.start(
                observer=self._make_observer,
                reflexes=self.reflexes,
                parts=self._parts,
                log=self._log_path,
                telemetry=self._telemetry,
                attentive=self._attentive,
            )
        except BaseException as error:
            self._end(error)
            raise

    def stop(self) -> None:
        """Stop, lower the stiffness, close the log, disconnect. Does nothing when stopped.

        Raises:
            PepperError: The error that ended the ticks, unless a call has raised it already or another error is
                propagating; or the robot or the log cannot be closed.
        """
        session = self._session
        self._end(None)
        if session is not None and sys.exc_info()[0] is None:
            session.check_failure(again=False)

    def _end(self, error: BaseException | None) -> None:
        """Close the session, and note on the interrupt that ended it where the log is, and the contacts so far."""
        session = self._session
        if session is None:
            return
        try:
            session.close()
        except KeyboardInterrupt as late:
            error = late
            session.close()  # in case it came before it could be deferred
            raise
        finally:
            if isinstance(error, KeyboardInterrupt):
                if session.log is not None:
                    error.add_note(f"log: {session.log.path}")
                if count := len({contact.id for contact in session.contact_history}):
                    error.add_note("1 contact so far" if count == 1 else f"{count} contacts so far")
                # No traceback shows it.
                if isinstance(error, Terminated) and session.raises_signals:
                    logger.warning("%s", describe_interrupt(error))

    @checked_arguments
    def start_log(self, path: Path | str, label: Labelling | None = None) -> LogWriter:
        """Log from the next tick on, where ``log`` would also log how the robot got ready; it ends with the run.

        Args:
            path: An existing file is replaced.
            label: Makes the labels of each tick, inside it: must be quick.

        Raises:
            PepperError: The robot is not active, the file cannot be opened, or there is a log already.
        """
        return self._active().start_log(as_path("path", path), label)

    @checked_arguments
    def take_hand(
        self,
        link: str,
        point: ArrayLike | None = None,
        *,
        stiffness: float = Grab.stiffness,
        max_force: float = Grab.max_force,
        timeout: float = HAND_TIMEOUT,
    ) -> SteadyHand:
        """Take a link of a simulated robot in a springy hand that is moved later, bounded by what would tip the robot.

        >>> hand = pepper.take_hand("LForeArm")
        >>> hand.move(hand.point + [0.0, 0.1, 0.0])

        Args:
            link: Name of the link.
            point: (3,) where it holds, in the link's frame [m]; by default the link's centre of mass.
            stiffness: Of the hand, 300 to 3000 [N/m].
            max_force: What the hand can do [N].
            timeout: [s] of the robot's time without :meth:`~pepper_driver.steady_hand.SteadyHand.move` after which it
                lets go.

        Returns:
            The hand.

        Raises:
            CapabilityError: A real robot must be taken by hand.
            PepperError: The robot is not active, there is no such link, or it cannot be taken there.
        """
        self._active()
        hand = self.backend.take_hand(
            link, point, stiffness=stiffness, max_force=max_force, timeout=timeout
        )
        stance = self.backend.truth if self.backend.plant.rolling else None
        return SteadyHand(hand, stance, self.config, max_force=max_force)

    def stream_to(self, telemetry: TelemetryServer) -> None:
        """Stream every tick from now on, and every further run, to those who listen to ``telemetry``."""
        self._telemetry = telemetry
        if self._session is not None and self._session.active:
            self._session.start_telemetry(telemetry)

    def show(
        self, *, port: int | None = None, open_browser: bool = False, allow_control: bool = False
    ) -> View:
        """Show the robot on a page in the browser; a notebook shows the page itself.

        Args:
            port: Of the page; None for the first free one from 8080.
            open_browser: Open it in the browser of this computer.
            allow_control: On a real robot, let the page move it; without, it looks and stops.

        Returns:
            The page, with its address; that of an earlier call while it is open.

        Raises:
            MissingExtraError: The extra ``viewer`` is not installed.
            ViewError: The page cannot be served.
        """
        from pepper_driver.viewer.view import View

        if self._view is None or not self._view.is_open:
            view = View(port=port, allow_control=allow_control)
            try:
                if view.address and open_browser:
                    view.open()
            except PepperError:
                view.close()
                raise
            view.show(self)
            self._view = view
        return self._view

    def run_metadata(self) -> dict[str, str]:
        """Return what a log says of a run that begins now: robot, observer, reflexes, settings, versions."""
        about = self._about | {"attentive": str(self._attentive).lower()}
        return about | run_metadata(
            self.backend,
            self.observer,
            self.config,
            self._controller_settings,
            self._safety_settings,
            observer_name=self._observer_name,
            reflexes=[declare(reflex) for reflex in self.reflexes],
        )

    # -- read it --------------------------------------------------------------------------------------------------

    @property
    def state(self) -> RobotState:
        """INACTIVE, ACTIVE, or FAULT, which only a new start leaves."""
        return RobotState.INACTIVE if self._session is None else self._session.gate.state

    @property
    def time(self) -> float:
        """Clock of the robot at the newest measurement [s]."""
        return self.measurement.time

    @property
    def measurement(self) -> Measurement:
        """The newest measurement."""
        return self._loop.latest.tick.measurement

    @property
    def observation(self) -> Observation | None:
        """The newest observation; None without an observer, and before the first tick."""
        return self._loop.latest.observation

    @property
    def position(self) -> JointArray:
        """(17,) newest measured joint positions [rad], a copy; also by name: ``pepper.position["HeadYaw"]``."""
        return JointArray(self.measurement.position, self.config)

    @property
    def target(self) -> JointArray:
        """(17,) joint positions that user or motion request [rad], a copy; also by name."""
        return JointArray(self._loop.arbiter.target, self.config)

    @property
    def touches(self) -> tuple[Contact, ...]:
        """Contacts that last now, the newest event of each, the oldest contact first."""
        return () if self._session is None else self._session.touches.now

    @property
    def contact_history(self) -> tuple[Contact, ...]:
        """All contact events since the start, oldest first."""
        return () if self._session is None else tuple(self._session.contact_history)

    @property
    def base_pose(self) -> FloatArray:
        """(3,) x [m], y [m], heading [rad] of the base by its wheels, since the start."""
        return self.controller.odometry.pose.copy()

    @checked_arguments
    def link_pose(self, link: str, of: Literal["measured", "commanded"] = "measured") -> FloatArray:
        """Return the (4, 4) transform of a link in base_link.

        Args:
            link: Name of the link.
            of: At the newest measured joint positions, or at those commanded last.

        Raises:
            UnknownNameError: No such link.
            TargetError: ``of`` is neither.
            BackendError: The robot was never started.
        """
        if not isinstance(of, str) or of not in ("measured", "commanded"):
            raise TargetError(f"of is 'measured' or 'commanded', got {shown(of)}")
        joints = self.measurement.position if of == "measured" else self._loop.commanded
        with self._model_lock:
            if self._model is None:
                self._model = RobotModel(self.config)
            return self._model.link_pose(link, joints)

    @property
    def controller(self) -> WholeBodyController:
        """The controller in use, to be read: its state, model, status and report."""
        return self._loop.arbiter.controller

    @property
    def statistics(self) -> Statistics:
        """Times of the stages of the ticks, and how many ticks were late or missed, since the start."""
        return self._loop.times.statistics

    def clear_statistics(self) -> None:
        """Reset the statistics at the next tick."""
        self._changes.make(self._active().loop.times.clear)

    @property
    def callback_statistics(self) -> tuple[CallbackStatistics, ...]:
        """Calls and lost events of each callback in the current run, or in the last one."""
        return () if self._session is None else self._session.dispatcher.statistics()

    # -- move it --------------------------------------------------------------------------------------------------

    @checked_arguments
    def set_posture(
        self,
        posture: Posture,
        *,
        stiffness: float | None = None,
        duration: float | None = None,
    ) -> None:
        """Set the target of the joints from the next tick on; return at once.

        Args:
            posture: Name, joints with angles [rad], or all 17 angles [rad].
            stiffness: Of the posture task [1/s2], above 0; None leaves it.
            duration: Get there along a spline within this time [s], from a millisecond up; None for a set-point, which
                the joints approach as springs do. After a reflex has held the robot, the whole time begins again.

        Raises:
            PepperError: Unknown name, an angle that is not finite or outside the joint's limits, a stiffness or
                invalid duration. Nothing changes.
        """
        arbiter = self._active().loop.arbiter
        self._resolve_posture(posture, arbiter)
        if stiffness is not None and checked_stiffness(stiffness) == 0:
            raise GainError("stiffness", stiffness, "above 0 for a posture")  # to stop the joints
        if duration is not None:
            duration = _checked_time("duration", duration, MIN_DURATION, MAX_STEP_TIME)

        def change() -> None:  # the target may have changed meanwhile, in the same group too
            arbiter.move_to(self._resolve_posture(posture, arbiter), duration)
            if stiffness is not None:
                arbiter.posture_stiffness = stiffness

        self._changes.make(change)

    @property
    def attentive(self) -> bool:
        """True to detect lighter touches: arms and head oscillate a little on top of any motion; may be set.

        The oscillation of ``controller.yaml`` fades in, and out again, from the next tick on; before the start, from
        the first one. Each joint oscillates by as much as its friction asks for, where the models of the robot have
        it. Joints that a reflex has, or that are hot or soft, do not oscillate; a warning and the log say what limits
        it. :attr:`target` does not contain the oscillation.

        Raises:
            TargetError: Not True or False; nothing changes.
        """
        return self._attentive

    @attentive.setter
    def attentive(self, value: bool) -> None:
        if not isinstance(value, bool):
            raise TargetError(f"attentive is True or False, got {value!r}")
        loop = self._active().loop if self._is_active() else None

        def change() -> None:
            if loop is not None:
                loop.set_attentive(value)
            self._attentive = value

        self._changes.make(change)

    @checked_arguments
    def drive(self, vx: float, vy: float, wz: float, *, hold: bool = False) -> None:
        """Drive the base from the next tick on; returns at once.

        Args:
            vx: Forwards [m/s].
            vy: To the left [m/s].
            wz: Turn to the left [rad/s].
            hold: Keep driving until the next call. By default the base stops ``drive_time`` of ``safety.yaml``, half
                a second, after the last call.

        Raises:
            TargetError: Not finite numbers, or beyond 10; nothing changes.
        """
        arbiter = self._active().loop.arbiter
        names = ("vx", "vy", "wz")
        twist = finite_vector("drive", [vx, vy, wz], 3, names=names)
        for name, value in zip(names, twist.tolist(), strict=True):
            if abs(value) > MAX_DRIVE:
                raise TargetError(f"drive: {name} is {MAX_DRIVE:g} at most, got {value:g}")
        time = self._safety_settings.drive_time
        self._changes.make(lambda: arbiter.drive(twist, None if hold else time))

    def add(self, part: Task | Constraint) -> None:
        """Have the robot follow a task, or keep a constraint, from the next tick on; before the start too.

        A task or constraint of a class that is not of this package is evaluated once before, on a copy.

        Raises:
            PepperError: The task is for another robot, or there are too many; it is neither a task nor a constraint; or
                it raises, or gives arrays of a wrong shape (``PluginInterfaceError``).
        """
        check_part(part, self.config)
        dry_run_part(part, self.config)
        arbiter = self._active().loop.arbiter if self._is_active() else None

        def change() -> None:
            if arbiter is not None:
                arbiter.add(part)
            self._parts = (*(p for p in self._parts if p is not part), part)

        self._changes.make(change)

    @checked_arguments
    def remove(self, part: Task | Constraint) -> None:
        """Take a task or constraint back; one that is not there is no error."""
        arbiter = self._active().loop.arbiter if self._is_active() else None

        def change() -> None:
            self._parts = tuple(p for p in self._parts if p is not part)
            if arbiter is not None:
                arbiter.remove(part)

        self._changes.make(change)

    def changes(self) -> AbstractContextManager[None]:
        """Return a block whose changes of tasks, postures and the like take effect between the same two ticks."""
        return self._changes.together()

    def step(self) -> tuple[Measurement, Observation | None]:
        """Wait for the next tick, or make it where no thread does; return its measurement and observation.

        Raises:
            FaultError: The safety gate stopped the robot.
            BackendError: Another thread runs it, or this is inside a tick or a callback.
        """
        record = self._active().run(1).record
        assert record is not None
        return record.tick.measurement, record.observation

    @checked_arguments
    def run(
        self,
        seconds: float,
        *,
        on_tick: OnTick | None = None,
        until: Callable[[], bool] | None = None,
    ) -> bool:
        """Wait for a time, or let it pass where no thread ticks.

        In a simulation that is not paced, callbacks then get up to 2 s to catch up before the robot's time goes on.

        Args:
            seconds: How long [s]; as fast as possible in a simulation that is not paced. Each missed tick adds a cycle.
            on_tick: Called inside every tick: must be quick.
            until: Asked after every tick, such as ``lambda: task.reached(0.005)``; True ends the run early.

        Returns:
            True where ``until`` ended it.

        Raises:
            TargetError: That is no time; nothing runs.
            FaultError: The safety gate stopped the robot.
            BackendError: Another thread runs it, or this is inside a tick or a callback.
        """
        ticks = round(_checked_time("seconds", seconds, 0.0, MAX_RUN) / self.config.cycle)
        return self._active().run(ticks, on_tick, until).stopped

    @checked_arguments
    def play(
        self,
        experiment: Plan | Experiment | str | Path,
        *,
        on_step: OnStep | None = None,
        on_tick: OnTick | None = None,
        on_progress: Callable[[float], None] | None = None,
        skip_settling: bool = False,
    ) -> ExperimentReport:
        """Play a motion or an experiment to its end; callbacks then catch up as after :meth:`run`.

        At its end, also after an error, its tasks are removed, the base is at rest, and the posture stays.
        While a reflex holds the posture, it waits.

        Args:
            experiment: A plan, an experiment, the name of a shipped one, or a path that ends in ``.yaml``.
            on_step: Called with each step's report as it ends, inside the tick: must be quick.
            on_tick: Called inside every tick: must be quick.
            on_progress: Called inside a tick every second with the fraction of the longest time that has passed, 0..1.
            skip_settling: Do not call ``on_tick`` during the motion to the first posture of random goals.

        Returns:
            Result of each step, and the contacts.

        Raises:
            PepperError: The experiment is wrong, has reflexes, which only :class:`ExperimentRun` gives to a robot, or
                another thread runs the robot; nothing moves.
            FaultError: The safety gate stopped the robot.
        """
        session = self._active()
        if not isinstance(experiment, Plan):
            if not isinstance(experiment, Experiment):
                experiment = load_experiment(experiment, self.config)
            for number, reaction in enumerate(experiment.reactions):
                if reaction.reflex:
                    raise experiment.error(
                        f"reactions.{number}.do",
                        "a Pepper has its reflexes from the start; perform it with ExperimentRun or 'pepper run'",
                    )
            experiment = plan_experiment(experiment, self.config, self.backend)
        player = Player(
            experiment, self.config, session.loop, self.backend, session.publish, on_step=on_step
        )
        report_every = round(1.0 / self.config.cycle)

        def listener(tick: Tick, observation: Observation | None) -> None:
            if on_tick is not None and not (skip_settling and player.is_settling):
                on_tick(tick, observation)
            if on_progress is not None and tick.measurement.tick % report_every == 0:
                on_progress(player.progress)

        session.run(math.inf, listener, player.advance, begin=player.begin, end=player.end)
        if on_progress is not None:
            on_progress(1.0)
        return player.report

    def emergency_stop(self, text: str = "emergency stop") -> None:
        """Hold the joints and stop the wheels from the next tick on; only a new start leaves this state.

        May come from any thread. Before the first start, and while the robot starts, it makes the start fail with a
        FaultError. After a run it does nothing.

        Args:
            text: Human-readable reason: part of the FaultError.
        """
        if self._session is None:
            self._stopped_early = text
        if self._session is not None:  # asked again: it may start just now
            self._session.gate.stop(FaultReason.EMERGENCY_STOP, text)
            self._session.publish_fault()

    # -- receive events -----------------------------------------------------------------------------------------------

    @checked_arguments
    def wait_for_contact(
        self, *, timeout: float | None = None, **selector: Unpack[ContactArguments]
    ) -> Contact | None:
        """Wait for the next contact. Where no thread ticks, the thread that calls this does meanwhile.

        Args:
            timeout: Longest wait [s] on the robot's clock, or on the wall's while no thread ticks; None waits for ever.
            **selector: Which contacts, as in :meth:`on_contact`.

        Returns:
            The contact; None after the timeout, or when the robot was stopped meanwhile by :meth:`stop`.

        Raises:
            UnknownNameError: No such limb, link, joint, kind or phase.
            SubscriptionError: Another wrong argument, or a robot without an observer.
            FaultError: The robot was stopped.
            BackendError: The robot is not active, or this is inside a tick.
        """
        return wait_for_contact(self._active(), contact_filter(self.config, **selector), timeout)

    @checked_arguments
    def contacts(self, **selector: Unpack[ContactArguments]) -> AsyncGenerator[Contact, None]:
        """Return contacts for ``async for``, until the robot is stopped.

        Args:
            **selector: Which contacts, as in :meth:`on_contact`.

        Raises:
            UnknownNameError: No such limb, link, joint, kind or phase.
            SubscriptionError: Another wrong argument, or a choice that no contact can meet.
            BackendError: The robot is not active.
        """
        predicate = contact_filter(self.config, **selector)
        return stream_contacts(self._active().dispatcher, predicate)

    @checked_arguments
    def publish(self, event: ProgramEvent) -> None:
        """Send something that a program does with the robot to the log and to the callbacks that subscribed to it."""
        self._active().publish(event)

    # -- inside ---------------------------------------------------------------------------------------------------

    def _make_observer(self) -> Observer | None:
        if self.observer is None and self._observer_name is not None:
            robots = self.backend.info.identities
            self.observer = make_observer(self._observer_name, self.config, robots, self._models)
        return self.observer

    def _active(self) -> Session:
        """Return the current session; raise the error that ended its ticks."""
        if self._session is None or not self._session.active:
            raise BackendError(
                f"'{self.backend.uri}' is not active; use it inside 'with Pepper(...) as pepper:'"
            )
        self._session.check_failure()
        return self._session

    def _when_active(self, call: Callable[P, None]) -> Callable[P, None]:
        """Return a function of the backend, refused while the robot is not active."""

        @wraps(call)
        def checked(*args: P.args, **kwargs: P.kwargs) -> None:
            self._active()
            call(*args, **kwargs)

        return checked_arguments(checked)

    def _is_active(self) -> bool:
        return self._session is not None and self._session.active

    def _resolve_posture(self, posture: Posture, arbiter: Arbiter) -> FloatArray:
        target = self.config.resolve_posture(posture, arbiter.target)
        return arbiter.controller.posture.checked(target)

    @property
    def _loop(self) -> Loop:
        """The loop of the current run, or of the last one."""
        loop: Loop | None = getattr(self._session, "loop", None)
        if loop is None:
            raise BackendError(f"'{self.backend.uri}' was never started")
        return loop


def _checked_time(name: str, value: float, least: float, most: float) -> float:
    """Return a time [s] within bounds, else raise a TargetError."""
    if is_number(value) and least <= value <= most:
        return float(value)
    raise TargetError(f"{name} must be a time from {least:g} to {most:g} s, got {shown(value)}")


def _texts(about: Mapping[str, str]) -> dict[str, str]:
    for name, text in about.items():
        if not (isinstance(name, str) and isinstance(text, str)):
            raise ArgumentError(f"about holds texts by name, got {shown(text)} for {shown(name)}")
    return dict(about)
