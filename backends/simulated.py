"""Parameters of a simulated robot, the truth of what happens to it, and commands that are replayed on it."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.fields import Command, Measurement
from pepper_driver.backends.motion_profile import minimum_jerk
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.contact_specs import Axes, GrabSpec

if TYPE_CHECKING:
    from pepper_driver.backends.interface import Backend

HAND_TIMEOUT = 0.5
"""[s] of the robot's time after which a hand lets go that no one moves, where nothing else is asked for. A simulation
that is paced has the wall's time; in one that is not, the hand waits while the program does something else."""

APPROACH, REST = 2.0, 1.0
"""[s] to reach the posture in which commands begin, and to come to rest there."""

ContactKind = Literal["push", "hand", "object"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Push:
    """Push that a simulated robot is asked for; attributes as in :meth:`pepper_driver.backends.Backend.push`."""

    link: str
    force: ArrayLike
    point: ArrayLike | None = None
    duration: float = 0.5
    frame: Axes = "world"
    delay: float = 0.0
    rise: float = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class Grab:
    """Springy hand that a simulated robot is asked for; attributes as in :meth:`pepper_driver.backends.Backend.grab`.

    Its defaults are those of a hand in an experiment.
    """

    link: str
    pull: ArrayLike
    point: ArrayLike | None = None
    stiffness: float = GrabSpec.stiffness
    rise: float = GrabSpec.rise
    hold: float = GrabSpec.hold
    release: float = GrabSpec.release
    max_force: float = GrabSpec.max_force
    frame: Axes = GrabSpec.frame
    delay: float = 0.0


class Hand(ABC):
    """Springy hand of a person on a link of a simulated robot, moved as one likes. Any thread may call."""

    @abstractmethod
    def move(self, position: ArrayLike, *, max_force: float | None = None) -> None:
        """Set where the hand is to go; it follows at 1 m/s and 10 m/s2 at most.

        Call it again within the timeout, even to stay there: a hand that no one moves lets go.

        Args:
            position: (3,) in the world [m].
            max_force: What the hand can do from now on [N], beyond that it slips along; None leaves it.

        Raises:
            CommandError: Not finite numbers, or a force that is not above 0.
        """

    @abstractmethod
    def release(self) -> None:
        """Let go: the force fades within a tenth of a second."""

    @property
    @abstractmethod
    def holds(self) -> bool:
        """True until it has let go."""

    @property
    @abstractmethod
    def force(self) -> FloatArray:
        """(3,) force on the robot in the last step of physics, in the world [N]."""

    @property
    @abstractmethod
    def point(self) -> FloatArray:
        """(3,) where it holds the link, in the world [m]."""

    @property
    @abstractmethod
    def position(self) -> FloatArray:
        """(3,) of the hand itself, in the world [m]."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SimulatedPlant:
    """The robot that a simulation simulates: what pushes are planned with, and nothing of what happens to it.

    Attributes:
        stiffness: (17,) proportional stiffness of each joint [N m/rad]; of a motor board K = kp N Kt / R.
        torque_limit: (17,) largest torque each board can hold at stiffness 1 [N m], gear friction left out.
        friction: (17,) largest torque that friction holds at rest [N m].
        rolling: True where the robot stands on wheels, and a push can tip it over.
        config: Parameters of the motors, boards and gears, where they are those of ``config/plants``; None for a
            simulation with a model of its own. With them, identification compares its models with the closed form.
    """

    stiffness: FloatArray
    torque_limit: FloatArray
    friction: FloatArray
    rolling: bool
    config: PlantConfig | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class TrueContact:
    """Effect of one object on one link in the last cycle of a simulation. Vectors are in the world.

    Attributes:
        kind: A scheduled ``push``, a ``hand`` that holds on, or an ``object`` of the world.
        link: Name of the link it acted on.
        object: Name of the object, None for a push or a hand.
        point: (3,) where it acted [m]; the centre of the forces where that was more than one point.
        force: (3,) on the robot, mean over the cycle [N].
        peak: Size of the largest force in a step of physics [N].
        torque: (17,) J^T f, mean over the cycle [N m].
    """

    kind: ContactKind
    link: str
    object: str | None
    point: FloatArray
    force: FloatArray
    peak: float
    torque: FloatArray


@dataclass(frozen=True, kw_only=True, slots=True)
class TruthSample:
    """Ground truth at the end of one cycle; each value as in :class:`Truth`, copied."""

    contact_torque: FloatArray
    peak_torque: FloatArray
    position: FloatArray
    base: FloatArray
    tilt: FloatArray
    wheel_load: FloatArray
    in_gap: BoolArray
    saturated: BoolArray
    contacts: tuple[TrueContact, ...]


_SAMPLED = tuple(part.name for part in fields(TruthSample))


class Truth(ABC):
    """Ground truth of a simulation, now. For the log and for evaluation; no estimator may hold a reference to it.

    Arrays are copies. What is not abstract is that of a robot on a fixed base, with gears without backlash.
    """

    @property
    @abstractmethod
    def contact_torque(self) -> FloatArray:
        """(17,) external torque on each joint, J^T f, mean over the last cycle [N m]: the sum of ``contacts``."""

    @property
    @abstractmethod
    def peak_torque(self) -> FloatArray:
        """(17,) largest size of the external torque on each joint in a step of the last cycle [N m]."""

    @property
    @abstractmethod
    def contacts(self) -> tuple[TrueContact, ...]:
        """Contacts of the robot in the last cycle. The floor under the wheels does not count."""

    @property
    @abstractmethod
    def base(self) -> FloatArray:
        """(3,) pose of base_link in the world: x, y [m], yaw [rad], counted on over full turns."""

    @property
    def tilt(self) -> FloatArray:
        """(2,) pitch and roll of the base [rad], applied after the yaw in this order."""
        return np.zeros(2)

    @property
    def fallen(self) -> bool:
        """True once the robot has fallen over."""
        return False

    @property
    def wheel_load(self) -> FloatArray:
        """(3,) force with which the floor carries each wheel [N]; zero on a fixed base."""
        return np.zeros(3)

    @property
    @abstractmethod
    def kinetic_energy(self) -> float:
        """Kinetic energy of all links, rotors and wheels, with the objects of the world [J]."""

    @property
    def in_gap(self) -> BoolArray:
        """(17,) True where the joint was inside its backlash at the end of the last cycle."""
        return np.zeros(len(self.position), dtype=np.bool_)

    @property
    @abstractmethod
    def saturated(self) -> BoolArray:
        """(17,) True where the board was at its current or voltage limit at any time of the last cycle.

        At stiffness 0 the limit is no current: a motor that is off is at it.
        """

    @property
    @abstractmethod
    def position(self) -> FloatArray:
        """(17,) link-side joint positions now, without encoder or transport [rad]."""

    @abstractmethod
    def link_pose(self, link: str) -> FloatArray:
        """(4, 4) transform of a link in the world now, with flexible joints and the tilt of the base.

        Raises:
            UnknownNameError: No such link.
        """

    def sample(self) -> TruthSample:
        """Return the present values for a log."""
        return TruthSample(**{name: getattr(self, name) for name in _SAMPLED})


class Resumable:
    """An object whose state is the attributes named in ``STATE``; everything else follows from its construction."""

    STATE: ClassVar[tuple[str, ...]] = ()

    def save(self) -> dict[str, Any]:
        """Return a copy of the state."""
        return {name: copy.deepcopy(getattr(self, name)) for name in self.STATE}

    def restore(self, saved: dict[str, Any]) -> None:
        """Take on a state that :meth:`save` gave."""
        for name in self.STATE:
            # A copy here too: one saved state may be restored several times.
            setattr(self, name, copy.deepcopy(saved[name]))


def drive_along(
    backend: Backend,
    position: FloatArray,
    stiffness: FloatArray,
    wheel_speed: FloatArray,
    robot: RobotConfig,
) -> Iterator[Measurement]:
    """Open a simulated robot, have it come slowly to where commands begin, and yield what it measures after each.

    Args:
        backend: Of the simulated robot, not yet opened.
        position: (n, N) commands [rad].
        stiffness: (n, N) 0..1.
        wheel_speed: (n, 3) [rad/s].
        robot: Its description.
    """
    backend.open()
    start = np.clip(backend.activate().position, robot.lower, robot.upper)
    path = minimum_jerk(np.linspace(0.0, 1.0, round(APPROACH / robot.cycle)))
    for fraction in (*path, *[1.0] * round(REST / robot.cycle)):
        backend.exchange(
            Command(
                position=start + fraction * (position[0] - start),
                stiffness=stiffness[0],
                wheel_speed=np.zeros(3),
            )
        )
    for row in range(len(position)):
        yield backend.exchange(
            Command(position=position[row], stiffness=stiffness[row], wheel_speed=wheel_speed[row])
        )
