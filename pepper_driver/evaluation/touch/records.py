"""Records of the judge: what really touched a robot, and what each observer reported of it. Nothing here is a score."""

from __future__ import annotations

import gzip
from dataclasses import field
from pathlib import Path
from typing import Literal, TypeVar

from pydantic import TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from pepper_driver.config import PepperError
from pepper_driver.config.contact_selector import Kind
from pepper_driver.config.errors import short_reason
from pepper_driver.config.files import write_bytes
from pepper_driver.config.loading import STRICT
from pepper_driver.observer.interface import Phase

T = TypeVar("T")

BoardLaw = Literal["nominal", "integral"]
"""Of the motor boards of a robot, called like the plant that has them."""


LOG = "log"
"""Row and state of touches in logs."""

MIN_RISE = 0.1
"""[s] Minimum time that the rise and the fall of a force are taken to last."""


class RecordError(PepperError, ValueError):
    """A file is no record of the judge."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Touched:
    """One touch, as it really acted on the robot.

    Attributes:
        row: Row of the suites that it belongs to; LOG in a log.
        place: Place of the suites, such as ``hand``.
        limb: Limb of its link.
        link: Link.
        asked: Force that the suite asked for [N]; None where it asks for none, as of a hand that grips.
        force: Largest force that acted [N]; None where it is unknown, as on a real robot.
        rise: Rise time [s]; None where it is unknown.
        onset, release: Begin and end of the force, by the clock of the robot [s].
        torque: By joint of the limb, the largest torque, signed [N m]; empty where it is unknown.
        friction_bound: Minimum over the limb's joints of 2 F / |J^T u|: friction may hide a smaller force from a limb
            at rest [N]. None where it is unknown.
        moving: True if a joint of the limb was commanded to move at the onset.
        standing_start: True if it had begun before the first tick.
    """

    row: str
    place: str
    limb: str
    link: str
    asked: float | None
    force: float | None
    rise: float | None
    onset: float
    release: float
    torque: dict[str, float]
    friction_bound: float | None
    moving: bool
    standing_start: bool = False

    @property
    def fading(self) -> float | None:
        """Time at which a force that rises, stays and fades begins to fade [s]; None of a touch that may change.

        It fades as fast as it rises, within MIN_RISE at least. Of touches in a log no more is known than their largest
        force.
        """
        if self.force is None or (self.rise is None and self.row != LOG):
            return None
        return self.release - max(self.rise or 0.0, MIN_RISE)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ReportedEvent:
    """One event of a contact that a callback would get: its begin, its end, or an update of place, direction or kind.

    Attributes:
        id: Number of the contact.
        phase: As of :class:`pepper_driver.observer.Contact`.
        time: When the callback gets it: clock of the tick that reports it [s].
        kind, limb, limb_known, joint, shown_by, direction: As of :class:`pepper_driver.observer.Contact`.
        true_torque: External torque that acts on its joint then [N m]; None where it is unknown.
    """

    id: int
    phase: Phase
    time: float
    kind: Kind
    limb: str
    limb_known: bool = True
    joint: str | None
    shown_by: str | None = None
    direction: int
    true_torque: float | None = None


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TorqueEstimate:
    """Means over the plateau of one touch: true torque on a joint and its estimate [N m]."""

    touch: int
    joint: str
    true: float
    estimate: float


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ForceEstimate:
    """Size of the force of one touch, and as the observer reported it last before the force faded [N].

    Attributes:
        touch: Number of the touch.
        true: Largest that acted.
        estimate: That was reported.
        low, high: Interval that was reported with it.
        scale_known: True if its scale was measured with a known weight, but for that of the wrist.
    """

    touch: int
    true: float
    estimate: float
    low: float
    high: float
    scale_known: bool


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ObserverRecord:
    """One observer over one take.

    Attributes:
        events: In their order.
        torques: Of joints that a touch really turned, where the observer estimates torques.
        forces: Of pushes that rise and fade, where the observer reports forces; empty in older records.
        threshold_deg: By joint, median threshold while nothing touched the robot [deg].
        failure: Reason why there is no result; empty if there is one.
    """

    events: tuple[ReportedEvent, ...] = ()
    torques: tuple[TorqueEstimate, ...] = ()
    forces: tuple[ForceEstimate, ...] = ()
    threshold_deg: dict[str, float] = field(default_factory=dict)
    failure: str = ""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Take:
    """One run of a robot in one state, from its first tick.

    Attributes:
        suite: ``touch``, or ``free`` where no one touches the robot.
        state: State of the suites.
        number: Among the takes of this suite and state.
        day: Day of the robot; None for the day on which it was identified.
        seed: Of its noise.
        start, end: Clock of the first and the last tick [s].
        redrawn: How often it was drawn again because the robot tipped or was stopped.
        reasons: Why, each time.
        failure: Reason why it could not be performed; empty if it was.
        planned: Touches that were planned, by row, place and force asked for; only of a take that failed.
        touches: In the order of their onset.
        hearings: By name of the observer.
    """

    suite: Literal["touch", "free"]
    state: str
    number: int
    day: int | None
    seed: int
    start: float
    end: float
    redrawn: int = 0
    reasons: tuple[str, ...] = ()
    failure: str = ""
    planned: tuple[tuple[str, str, float | None], ...] = ()
    touches: tuple[Touched, ...] = ()
    hearings: dict[str, ObserverRecord] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Length [s]."""
        return self.end - self.start


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RobotRecord:
    """All takes of one robot.

    Attributes:
        key: Hash of all that the record depends on except the robot; empty for a log.
        robot: Name, such as ``random 7``.
        draw: Its number; None for a robot that is no draw, as in a log.
        law: Of its motor boards; None where it is unknown.
        identity: Hash of the simulated robot.
        failure: Reason why it could not be identified; its owner then has no observer. Empty if it could.
        fit: By joint, fit of the expected error on its test run [%].
        warnings: Of its identification.
        takes: In their order.
    """

    format: Literal[1] = 1
    key: str = ""
    robot: str
    draw: int | None
    law: BoardLaw | None
    identity: str
    failure: str = ""
    fit: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    takes: tuple[Take, ...]


_RECORDS = TypeAdapter(RobotRecord)
_TAKES = TypeAdapter(Take)


def save_robot(record: RobotRecord, path: Path) -> None:
    """Write a record, compressed; the same record gives the same bytes.

    Raises:
        OutputError: It cannot be written.
    """
    write_bytes(path, gzip.compress(_RECORDS.dump_json(record), 9, mtime=0))


def load_robot_record(path: Path) -> RobotRecord:
    """Read what :func:`save_robot` wrote.

    Raises:
        RecordError: It is not there, damaged, or no such file.
    """
    return _read(path, _RECORDS)


def save_take(take: Take, path: Path) -> None:
    """Write a take, as :func:`save_robot` does a robot."""
    write_bytes(path, gzip.compress(_TAKES.dump_json(take), 6, mtime=0))


def load_take(path: Path) -> Take:
    """Read what :func:`save_take` wrote; raises as :func:`load_robot_record` does."""
    return _read(path, _TAKES)


def _read(path: Path, adapter: TypeAdapter[T]) -> T:
    try:
        return adapter.validate_json(gzip.decompress(path.read_bytes()))
    except (OSError, EOFError, ValueError, ValidationError) as error:
        raise RecordError(f"{path}: no record of the judge ({short_reason(error)})") from error
