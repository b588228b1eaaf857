"""The interface of a backend, checks of commands, and methods that exclude each other."""

from __future__ import annotations

import functools
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from types import TracebackType
from typing import Concatenate, Literal, ParamSpec, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.fields import Command, Measurement
from pepper_driver.backends.robot_services import RobotServices
from pepper_driver.backends.simulated import HAND_TIMEOUT, Grab, Hand, Push, SimulatedPlant, Truth
from pepper_driver.config import PepperError, RobotIdentity
from pepper_driver.config.arguments import real_array
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.clock import SYSTEM_CLOCK, Clock
from pepper_driver.config.contact_specs import Axes
from pepper_driver.config.errors import shown


class Serial:
    """Base of classes with methods that are marked with :func:`serial`."""

    def __init__(self) -> None:
        self._lock = (
            threading.RLock()
        )  # re-entrant: for signal handlers, and methods that call each other


P = ParamSpec("P")
S = TypeVar("S", bound=Serial)
R = TypeVar("R")


def serial(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """Run a method only while no other thread runs a serial method of the same object."""

    @functools.wraps(method)
    def alone(self: S, /, *args: P.args, **kwargs: P.kwargs) -> R:
        with self._lock:
            return method(self, *args, **kwargs)

    return alone


MAX_RESPONSE_DELAY = 50
"""[commands] From a command to the sample that answers it, at most: by then the safety gate has stopped the robot."""

Capability = Literal[
    "push", "grab", "seed", "truth", "speech", "leds", "tablet", "postures", "wake"
]
"""``push`` and ``grab``: can be touched by software, has :attr:`Backend.plant`. ``truth``: has :attr:`Backend.truth`.
``seed``: its URI takes ``seed=N``, the root of all its noise. The others: parts of :attr:`Backend.services`."""


class BackendError(PepperError, RuntimeError):
    """The robot cannot do what was asked, for the reason given."""


class NotConnectedError(PepperError, ConnectionError):
    """The backend is not open, or was closed."""


class CommandError(PepperError, ValueError):
    """An invalid command: a wrong shape, a number that is not finite or out of range."""


class CapabilityError(PepperError, NotImplementedError):
    """This kind of backend has no such ability, for example ground truth on a real robot."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DeviceError:
    """A device that the robot itself takes for broken.

    Attributes:
        device: Its name, as the robot has it.
        text: Human-readable description of the defect.
        serious: Whether the robot should not move.
    """

    device: str
    text: str
    serious: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class BackendInfo:
    """Facts about the robot behind a backend.

    Attributes:
        joint_names: Order of every joint vector.
        cycle: Period of ``read`` and ``write`` [s].
        response_delay: Whole ticks from a command to the sample that shows the joint at the time the command was to
            be reached. A measurement answers the command sent this many ticks before the last one.
        capabilities: What this backend can do beyond the interface.
        identity: Hash of the simulated robot, or the body id of a real one. Models carry it.
        name: Human-readable: plant of a simulated robot, or address of a real one.
        parents: Plants that a simulated robot is a variant of, nearest first: their models serve it too.
        robot_type: Type that the robot itself says it is, such as ``Juliette``; empty where it says none.
        system_version: Version of its own software, such as ``2.5.10.7`` of NAOqi; empty likewise.
    """

    joint_names: tuple[str, ...]
    cycle: float
    response_delay: int
    capabilities: frozenset[Capability]
    identity: str
    name: str = ""
    parents: tuple[RobotIdentity, ...] = ()
    robot_type: str = ""
    system_version: str = ""

    @property
    def simulated(self) -> bool:
        """True for a simulated robot, also behind the stand-in NAOqi: programs can push it."""
        return "push" in self.capabilities

    @property
    def identities(self) -> tuple[RobotIdentity, ...]:
        """Robots whose models serve this one: itself first, then its parents."""
        own = RobotIdentity(name=self.name or self.identity, identity=self.identity)
        return (own, *self.parents)


DEAD_MAN_CYCLES = 3
"""Cycles for which wheels follow their last command: then they stop."""


class Backend(ABC):
    """A robot. States: closed, open (reads only), active (takes commands).

    One cycle is one ``read`` and then one ``write``: the command that is computed from a sample leaves at once.

    ``open`` and ``close`` bracket everything; ``activate`` and ``deactivate`` bracket motion. Closed, it can be opened
    again, and ticks and time begin again. Use it as a context manager: leaving the block deactivates and closes,
    whatever happened.

    Any thread may call any method: ``open``, ``activate``, ``read``, ``write``, ``deactivate`` and ``close`` wait for
    each other, and each finds the state that the one before left. All errors are a PepperError; no exception of a
    third-party library leaves a backend.

    Attributes:
        real_time: True where time passes by itself: ``read`` does not wait, its caller does, once a cycle. False where
            each ``read`` simulates one cycle.
        clock: Time by which its caller waits, where time passes by itself.
    """

    real_time: bool = False
    clock: Clock = SYSTEM_CLOCK

    @property
    @abstractmethod
    def uri(self) -> str:
        """The URI it was asked for; never connects."""

    @property
    @abstractmethod
    def info(self) -> BackendInfo:
        """Facts about the robot, valid before ``open``; a real robot is asked for them when this is first read."""

    @abstractmethod
    def open(self) -> Measurement:
        """Connect and read. Nothing moves. What fails leaves the backend closed.

        Raises:
            BackendError: Already open, or the robot refuses.
            NotConnectedError: No robot at this address.
        """

    @abstractmethod
    def activate(self) -> Measurement:
        """Ramp the stiffness up while holding the posture last measured, clipped into the joint limits.

        A real robot may have moved before that, for example got up: ``hold_position`` is the position that it holds.

        Raises:
            NotConnectedError: Not open.
            BackendError: Already active, or the robot is not fit to move.
        """

    @property
    def hold_position(self) -> FloatArray | None:
        """(17,) where ``activate`` holds the joints [rad]; None where that is what was measured before it."""
        return None

    @abstractmethod
    def read(self) -> Measurement:
        """Return the newest sample.

        In simulated time exactly one cycle passes, under the command last written. In real time this returns at once,
        whether the sample is new or not: see its ``age``. The loop calls it once every cycle, and now and then misses
        one. Where nothing was written since the last ``read``, the joints stay at the last command, and after
        ``DEAD_MAN_CYCLES`` the wheels stop.

        Raises:
            NotConnectedError: Not open, or another thread has closed it.
            BackendError: The robot is lost, for the reason given.
        """

    @abstractmethod
    def write(self, command: Command) -> None:
        """Send a command for the cycle to come; never waits.

        While the backend is not active the command is checked, but moves nothing. Values beyond the limits of joints
        and wheels, or a stiffness outside 0..1, are clipped to them. The arrays may be changed afterwards.

        Raises:
            CommandError: Wrong shape, or a value that is not finite: nothing is sent.
            NotConnectedError: Not open, or another thread has closed it.
            BackendError: The robot is lost, for the reason given.
        """

    def exchange(self, command: Command) -> Measurement:
        """Write a command and read: for a path known beforehand, where no command depends on the newest sample."""
        self.write(command)
        return self.read()

    @property
    def request_lead(self) -> float:
        """Time before a ``read`` at which :meth:`request` is best called [s]; 0 where that makes no difference."""
        return 0.0

    def request(self) -> None:  # noqa: B027 a robot that is simulated has nothing to do
        """Ask the robot for the sample that the next ``read`` returns; never waits, and raises nothing.

        The pacer calls it ``request_lead`` before each tick. Without it ``read`` asks for the sample of the next one.
        """

    @abstractmethod
    def deactivate(self) -> None:
        """Stop the wheels, ramp the stiffness down. Does nothing when not active."""

    @abstractmethod
    def close(self) -> None:
        """Deactivate and disconnect. Does nothing when closed."""

    def phase_error(self, due: int) -> float:
        """Return how much later than ``due`` a tick best begins, so that it finds a fresh sample; negative if earlier.

        For the pacing of a robot whose cycles pass by themselves. Costs a microsecond, and may be asked in any state.

        Args:
            due: When the tick is to begin [ns], by ``time.perf_counter_ns``.

        Returns:
            From minus half a cycle to half a cycle [s]; 0 where it does not matter.
        """
        return 0.0

    def diagnosis(self) -> tuple[DeviceError, ...] | None:
        """Return the present findings of the robot's own diagnosis; None without a diagnosis. May take seconds.

        Raises:
            NotConnectedError: Not open.
        """
        return None

    def push(
        self,
        link: str,
        force: ArrayLike,
        point: ArrayLike | None = None,
        duration: float = Push.duration,
        *,
        frame: Axes = Push.frame,
        delay: float = Push.delay,
        rise: float = Push.rise,
    ) -> None:
        """Push a link of a simulated robot, from ``delay`` [s] from now on.

        Args:
            link: Name of the link.
            force: (3,) largest force [N] in ``frame``.
            point: (3,) where it acts, in the link's frame [m], up to 1 m; by default the link's centre of mass.
            duration: Length of the push [s], rise and fall included.
            frame: Axes of ``force``: fixed to the ``world``, or turning with the ``link``.
            delay: Time until the push begins [s].
            rise: Time in which it rises, and falls again [s]; a third of the push where that is shorter.

        Raises:
            CapabilityError: A real robot must be pushed by hand.
            UnknownNameError: No such link.
            NotConnectedError: Not open.
            CommandError: A number that is not finite or out of range, or a point over a metre off the link's origin.
        """
        self.schedule_push(
            Push(
                link=link,
                force=force,
                point=point,
                duration=duration,
                frame=frame,
                delay=delay,
                rise=rise,
            )
        )

    def schedule_push(self, push: Push) -> None:
        """Take in a push that was asked for; raises as :meth:`push` says. A backend with pushes has its own."""
        raise CapabilityError(f"'{self.uri}' cannot push itself: only simulated backends do")

    def grab(
        self,
        link: str,
        pull: ArrayLike,
        point: ArrayLike | None = None,
        *,
        stiffness: float = Grab.stiffness,
        rise: float = Grab.rise,
        hold: float = Grab.hold,
        release: float = Grab.release,
        max_force: float = Grab.max_force,
        frame: Axes = Grab.frame,
        delay: float = Grab.delay,
    ) -> None:
        """Take a link of a simulated robot in a springy hand, from ``delay`` [s] from now on, and pull or push it.

        The hand closes where the point is then, moves by ``pull`` along a minimum-jerk path in ``rise`` seconds, stays
        for ``hold`` and releases it over ``release``. Its force is ``stiffness`` times the lag of the point, and
        damped.

        Args:
            link: Name of the link.
            pull: (3,) displacement of the hand [m] in ``frame``.
            point: (3,) where it holds, in the link's frame [m]; by default the link's centre of mass.
            stiffness: Of the hand, 300 to 3000 [N/m].
            rise: Time in which the hand moves [s].
            hold: Time for which it then stays [s].
            release: Time in which its force fades [s].
            max_force: What the hand can do [N]; beyond that it slips along.
            frame: Axes of ``pull``: of the ``world``, or of the ``link`` as it is when the hand closes.
            delay: Time until the hand closes [s].

        Raises:
            CapabilityError: A real robot must be grabbed by hand.
            UnknownNameError: No such link.
            NotConnectedError: Not open.
            CommandError: A number that is not finite or out of range, another hand on this link at that time, or a
                point too light for a hand this stiff.
        """
        self.schedule_grab(
            Grab(
                link=link,
                pull=pull,
                point=point,
                stiffness=stiffness,
                rise=rise,
                hold=hold,
                release=release,
                max_force=max_force,
                frame=frame,
                delay=delay,
            )
        )

    def schedule_grab(self, grab: Grab) -> None:
        """Take in a hand that was asked for, as :meth:`schedule_push` a push."""
        raise CapabilityError(f"'{self.uri}' cannot grab itself: only simulated backends do")

    def take_hand(
        self,
        link: str,
        point: ArrayLike | None = None,
        *,
        stiffness: float = Grab.stiffness,
        max_force: float = Grab.max_force,
        timeout: float = HAND_TIMEOUT,
    ) -> Hand:
        """Take a link of a simulated robot in a springy hand now, to be moved later; see :class:`Hand`.

        Args:
            link: Name of the link.
            point: (3,) where it holds, in the link's frame [m]; by default the link's centre of mass.
            stiffness: Of the hand, 300 to 3000 [N/m].
            max_force: What the hand can do [N]; beyond that it slips along.
            timeout: [s] of the robot's time without :meth:`Hand.move` after which it lets go.

        Raises:
            CapabilityError: A real robot must be taken by hand.
            UnknownNameError: No such link.
            NotConnectedError: Not open.
            CommandError: A number that is not finite or out of range, another hand on this link, or a point too light
                for a hand this stiff.
        """
        raise CapabilityError(f"'{self.uri}' cannot grab itself: only simulated backends do")

    @cached_property
    def services(self) -> RobotServices:
        """Speech, lights and the like. Where the robot has none of it they do nothing and say so."""
        # Kept, because it warns only once of each service that the robot lacks.
        return RobotServices(self.uri)

    @property
    def plant(self) -> SimulatedPlant:
        """The simulated robot, where this backend can push it.

        Raises:
            CapabilityError: A real robot has no such parameters.
        """
        raise CapabilityError(f"'{self.uri}' is no simulation: its parameters are unknown")

    @property
    def truth(self) -> Truth:
        """Ground truth of a simulated robot.

        Raises:
            CapabilityError: A real robot has no simulation state.
        """
        raise CapabilityError(f"'{self.uri}' has no ground truth: only simulated backends do")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        # Also after an error: an active robot must not be left without a program that supervises it.
        self.close()


def checked_command(command: Command, joints: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, stiffness and wheel speed, as given.

    Raises:
        CommandError: They are not what a robot with so many joints could take.
    """
    if not isinstance(command, Command):
        raise CommandError(f"a command is expected, got {shown(command)}")
    return (
        finite_numbers("command.position", command.position, joints),
        finite_numbers("command.stiffness", command.stiffness, joints),
        finite_numbers("command.wheel_speed", command.wheel_speed, 3),
    )


def finite_numbers(name: str, values: object, size: int) -> FloatArray:
    """``values`` as an array (size,): a float64 array itself, others as a new one.

    Raises:
        CommandError: They are no such numbers.
    """
    array = values if isinstance(values, np.ndarray) else real_array(values)
    if array is not None and array.shape == (size,) and array.dtype.kind in "fiu":
        array = array.astype(np.float64, copy=False)
        # The sum of their squares is not finite where one of them is not, and the quickest to ask.
        if isfinite(array.dot(array)) or np.isfinite(array).all():
            return array
    raise CommandError(f"{name}: expected {size} finite numbers, got {shown(values)}")
