"""Choice of contacts, the same for callbacks, reflexes, waits and files."""

from __future__ import annotations

from dataclasses import fields
from numbers import Real
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BeforeValidator, Field, ValidationError
from pydantic.dataclasses import dataclass

from pepper_driver.config.errors import PepperError, UnknownNameError, suggestion
from pepper_driver.config.loading import STRICT
from pepper_driver.config.mistakes import in_words
from pepper_driver.config.robot import RobotConfig

Kind = Literal["contact", "collision", "push", "hold", "grip", "tap", "double tap", "rebound"]
"""A contact begins as ``contact``, or as ``collision`` where it is hard. It becomes a ``push`` when it lasts longer
than a tap, a ``hold`` when it lasts for seconds, a ``grip`` when it pulls both ways. A ``tap``, and a second one as
``double tap``, is known at its end. ``rebound`` is the swing of a joint back after a contact, and no touch."""

KNOWN_AT_END: tuple[Kind, ...] = ("tap", "double tap")
"""Kinds of a contact that its end reports first."""

MAX_INTENSITY_DEG = 180.0
"""Largest ``min_intensity_deg`` [deg]."""

MAX_TORQUE = 100.0
"""Largest ``min_torque`` [N m]; more than any joint of a Pepper holds."""

MAX_FORCE = 300.0
"""Largest ``min_force`` [N]; more than a Pepper weighs."""


class SelectorError(PepperError, ValueError):
    """A choice of contacts that makes no sense, or that no contact can meet.

    Attributes:
        field: Of the selector that is wrong; empty for several together.
    """

    def __init__(self, message: str, field: str = "") -> None:
        self.field = field
        super().__init__(message)


def _to_names(value: object) -> object:
    """Return a single name as a tuple of one, None as none, a list as a tuple."""
    if value is None:
        return ()
    names = (value,) if isinstance(value, str) else value
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        raise ValueError("a name or a list of names is needed")
    if not names:
        raise ValueError("a list needs at least one name; leave it out to choose all")
    return tuple(names)


def _to_float(value: object) -> object:
    """Return any kind of real number as a float."""
    return float(value) if isinstance(value, Real) and not isinstance(value, bool) else value


Names = Annotated[tuple[str, ...], BeforeValidator(_to_names)]
_Number = BeforeValidator(_to_float)


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ContactSelector:
    """Choice of contacts: those that meet all of its conditions. Without any, all contacts.

    Attributes:
        limb: Only contacts on one of these limbs; a name or a list of names, empty for any. Limbs are those of
            :attr:`RobotConfig.limbs`: ``left_arm``, ``right_arm``, ``head`` and ``trunk``, which includes the base.
        link: Only contacts on one of these links.
        joint: Only contacts that turn one of these joints most. To choose a place, take ``link``.
        kind: Only this kind, once it is known. None takes all but rebounds, which are no touch.
        min_intensity_deg: Only contacts of at least this intensity [deg].
        min_torque: Only contacts whose estimated torque on their joint is at least this, in either direction [N m].
            Contacts on the trunk, and those of an observer that estimates no torques, have none.
        min_force: Only contacts whose estimated force on their limb is at least this [N]. Contacts on the trunk, and
            those of another observer than ``fusion``, have none.
    """

    limb: Names = ()
    link: Names = ()
    joint: Names = ()
    kind: Kind | None = None
    min_intensity_deg: Annotated[float, Field(ge=0, le=MAX_INTENSITY_DEG), _Number] = 0.0
    min_torque: Annotated[float, Field(ge=0, le=MAX_TORQUE), _Number] = 0.0
    min_force: Annotated[float, Field(ge=0, le=MAX_FORCE), _Number] = 0.0

    @classmethod
    def from_arguments(cls, **arguments: Any) -> Self:  # noqa: ANN401 checked here
        """Make a selector from the arguments of a call.

        Raises:
            UnknownNameError: No such kind.
            SelectorError: An unknown argument, or a value of the wrong type or size.
        """
        try:
            return cls(**arguments)
        except ValidationError as error:
            raise _explained(error) from error

    def check(self, robot: RobotConfig) -> None:
        """Refuse names that a robot does not have, and limbs, links and joints that exclude each other.

        Raises:
            UnknownNameError: No such limb, link or joint; its ``kind`` is the field.
            SelectorError: No contact can meet all conditions.
        """
        known = {"limb": robot.limbs, "link": robot.links, "joint": robot.joint_names}
        for field, choices in known.items():
            for name in getattr(self, field):
                if name not in choices:
                    raise UnknownNameError(field, name, choices)
        if not self.limbs_in(robot):
            given = (
                f"{field} {' or '.join(names)}"
                for field in known
                if (names := getattr(self, field))
            )
            raise SelectorError(
                f"no contact is on {' and '.join(given)}: they belong to different limbs"
            )

    def limbs_in(self, robot: RobotConfig) -> frozenset[str]:
        """Limbs of a robot on which a contact can meet the conditions; its names are checked."""
        limbs = frozenset(self.limb or robot.limbs)
        if self.link:
            limbs &= {robot.limb_of_link(link) for link in self.link}
        if self.joint:
            limbs &= {robot.limb_of(joint) for joint in self.joint}
        return limbs

    def __str__(self) -> str:
        """Human-readable: ``collision on left_arm turning LElbowRoll, 2 deg and more``."""
        text: str = self.kind or "contact"
        for word, names in (("on", self.limb), ("on", self.link), ("turning", self.joint)):
            if names:
                text += f" {word} {' or '.join(names)}"
        if self.min_intensity_deg:
            text += f", {self.min_intensity_deg:g} deg and more"
        if self.min_torque:
            text += f", {self.min_torque:g} N m and more"
        if self.min_force:
            text += f", {self.min_force:g} N and more"
        return text


def _explained(error: ValidationError) -> PepperError:
    """Return the first problem with an argument as an error of one line."""
    # pydantic reports all problems; a call gets one line about the first.
    first = error.errors()[0]
    name, value = str(first["loc"][0]), first["input"]
    if first["type"] == "unexpected_keyword_argument":
        known = ContactSelector.__dataclass_fields__
        return SelectorError(f"no contact is chosen by '{name}'{suggestion(name, known)}", name)
    if name == "kind" and isinstance(value, str):
        return UnknownNameError("kind", value, get_args(Kind))
    return SelectorError(" ".join(f"{name}: {in_words(first)}".split()), name)


SELECTOR_FIELDS = tuple(field.name for field in fields(ContactSelector))
"""Conditions of a selector: ``on`` in files."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TouchTrigger(ContactSelector):
    """Choice of touches by what they become.

    Attributes:
        lasting: The contact has lasted this long, as chosen [s].
        touches: It is the last of so many, each chosen so.
        within: They begin within this time [s]; needed for more than one.
    """

    lasting: Annotated[float, Field(ge=0, le=3600)] = 0.0
    touches: Annotated[int, Field(ge=1, le=100)] = 1
    within: Annotated[float, Field(gt=0, le=3600)] | None = None

    def __post_init__(self) -> None:
        if self.kind == "rebound":
            raise ValueError("'kind': a rebound is no touch: choose contact or collision")
        if (self.touches > 1) != (self.within is not None):
            raise ValueError(
                "'touches' above 1 and 'within' [s] belong together: give both or none"
            )

    def includes(self, other: TouchTrigger, robot: RobotConfig) -> bool:
        """Return True if every contact that fires ``other`` fires this one too, at the latest then."""
        limbs = not self.limb or other.limbs_in(robot) <= set(self.limb)
        return (
            limbs
            and all(
                not chosen or (narrower and set(narrower) <= set(chosen))
                for chosen, narrower in ((self.link, other.link), (self.joint, other.joint))
            )
            and self.kind in (None, other.kind)
            and self.min_intensity_deg <= other.min_intensity_deg
            and self.min_torque <= other.min_torque
            and self.min_force <= other.min_force
            and self.lasting <= other.lasting
            and self.touches <= other.touches
            and (self.within is None or (other.within or self.within) <= self.within)
        )

    def __str__(self) -> str:
        """Human-readable."""
        text = super().__str__()
        if self.lasting:
            text += f", lasting {self.lasting:g} s"
        if self.touches > 1:
            text += f", {self.touches} times within {self.within:g} s"
        return text
