"""Steps of an experiment: of motion, with words and lights; waits, loops, branches; random goals. [rad], [s]."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import field, replace
from typing import Annotated, Any, Literal, Self

from pydantic import Field, WrapValidator
from pydantic.dataclasses import dataclass

from pepper_driver.config.contact_selector import TouchTrigger
from pepper_driver.config.loading import STRICT, one_or_more, parse_part
from pepper_driver.config.mistakes import HIDDEN, keys_of, unknown_keys
from pepper_driver.config.parts import NonNegative, Positive, TaskStiffness, check_bounds
from pepper_driver.config.task_specs import (
    AnyTask,
    BaseSpec,
    BaseVelocitySpec,
    ComSpec,
    Label,
    LookAtSpec,
    Named,
    OrientationSpec,
    PoseSpec,
    PositionSpec,
)

MIN_DURATION = 1e-3
"""[s] The least that tasks take."""

MAX_STEP_TIME = 3600.0
"""[s] Of one step."""

MAX_REPEATS = 1000
"""Of a block."""

Duration = Annotated[float, Field(ge=MIN_DURATION, le=MAX_STEP_TIME)]
Pause = Annotated[float, Field(ge=0, le=MAX_STEP_TIME)]
UnitInterval = Annotated[float, Field(ge=0, le=1)]
PartOfRange = Annotated[float, Field(gt=0, le=1)]
Count = Annotated[int, Field(ge=1, le=10_000)]
Joints = Annotated[tuple[str, ...], Field(min_length=1)]
# \P{Cc}, no control character, is known to the regular expressions of pydantic, but not to Python's `re`.
Speech = Annotated[str, Field(min_length=1, max_length=500, pattern=r"^\P{Cc}+$")]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class AnyStep:
    """A step of any kind; ``name`` is for reports, and for contacts that come in it."""

    name: Label | None = None

    def names(self) -> Iterator[Named]:
        """Names the robot must know."""
        return iter(())

    def triggers(self) -> Iterator[tuple[str, TouchTrigger]]:
        """Choices of touches, with their keys."""
        return iter(())

    def blocks(self) -> Iterator[tuple[str, tuple[AnyStep, ...]]]:
        """Yield the steps that it holds, with their keys."""
        return iter(())

    def with_blocks(self, *blocks: tuple[AnyStep, ...]) -> Self:
        """Return it with other steps in its blocks."""
        return self


def changed_steps(
    steps: tuple[AnyStep, ...], change: Callable[[str, AnyStep], AnyStep], key: str
) -> tuple[AnyStep, ...]:
    """Return steps, each as ``change`` makes it of its key and itself; what a block holds comes before the block."""

    def changed(here: str, step: AnyStep) -> AnyStep:
        blocks = [changed_steps(block, change, f"{here}.{inner}") for inner, block in step.blocks()]
        return change(here, step.with_blocks(*blocks) if blocks else step)

    return tuple(changed(f"{key}.{number}", step) for number, step in enumerate(steps))


def _by_key(value: object, _: object) -> object:
    """Convert a mapping to the kind of step that one of its keys names, or else to a step of motion."""
    # `replace` makes pydantic validate again what is a step already.
    if isinstance(value, AnyStep):
        return value
    if not isinstance(value, dict):
        raise ValueError("a step is a mapping of keys to values")
    kind = next((cls for key, cls in _KINDS.items() if key in value), Step)
    known = keys_of(Step)
    if kind is Step and (unknown := {key: value[key] for key in value if key not in known}):
        raise unknown_keys(unknown, (*known, *_KINDS))
    return parse_part(kind, value)


OptionalSteps = tuple[Annotated[AnyStep, WrapValidator(_by_key)], ...]
Steps = Annotated[OptionalSteps, Field(min_length=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Leds:
    """A ``group`` of lights, by NAOqi's name for it, fades to a ``colour`` (r, g, b), each 0..1, in ``duration``."""

    group: Label = "FaceLeds"
    colour: tuple[UnitInterval, UnitInterval, UnitInterval]
    duration: Annotated[float, Field(ge=0, le=60)] = 0.2


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Cues:
    """Output by speech, lights, or a ``cue``, a word of the author's for subscribers. It takes no time."""

    say: Speech | None = None
    leds: Leds | None = None
    cue: Label | None = None

    @property
    def has_cues(self) -> bool:
        """True where anything is said, shown or cued."""
        return self.say is not None or self.leds is not None or self.cue is not None


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Wait(TouchTrigger):
    """For a touch that begins after the step did.

    Attributes:
        timeout: Longest wait.
        on_timeout: ``continue``, or ``stop`` the experiment, where none came.
    """

    timeout: Duration
    on_timeout: Literal["continue", "stop"] = "continue"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lasting >= self.timeout:
            raise ValueError("'lasting' must be shorter than 'timeout': no touch lasts that long")


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Step(AnyStep, Cues):
    """Part of a sequence; all parts of a step begin together.

    Attributes:
        duration: Everything gets to its target along a spline within this time [s]; without one, as fast as stiffness
            and limits allow.
        until: ``reached``: continue only when every task is within ``tolerance`` and at rest, or, in a step without
            tasks, every joint that it names.
        tolerance: [m] and [rad].
        timeout: Since the step began [s]; then the experiment continues without having reached.
        hold: Stay this long afterwards [s].
        wait: Stay until touched; in a step without motion.
        posture, joints, hands: Posture by name; joints with angles [rad]; hands with apertures, 0 closed to 1 open.
            The latter win over the former; what is not named stays.
        stiffness: Of the posture task [1/s2], from here on.
        attentive: Arms and head oscillate by a little, or no longer, from here on.
        position, orientation, pose, look_at, com, base: Tasks, one or a list of each.
        base_velocity: Of the base while the step lasts.
    """

    duration: Duration | None = None
    until: Literal["reached"] | None = None
    tolerance: Positive | None = None
    timeout: Duration | None = None
    hold: Pause = 0.0
    wait: Wait | None = None
    posture: str | None = None
    joints: dict[str, float] = field(default_factory=dict)
    hands: dict[str, float] = field(default_factory=dict)
    stiffness: TaskStiffness | None = None
    attentive: bool | None = None
    position: Annotated[tuple[PositionSpec, ...], one_or_more(PositionSpec)] = ()
    orientation: Annotated[tuple[OrientationSpec, ...], one_or_more(OrientationSpec)] = ()
    pose: Annotated[tuple[PoseSpec, ...], one_or_more(PoseSpec)] = ()
    look_at: LookAtSpec | None = None
    com: ComSpec | None = None
    base: BaseSpec | None = None
    base_velocity: BaseVelocitySpec | None = None

    def __post_init__(self) -> None:
        moves = (
            self.moves_joints or self.base_velocity is not None or any(True for _ in self.tasks())
        )
        takes_time = self.duration is not None or self.until is not None or self.hold > 0
        if self.wait is not None and (moves or takes_time):
            raise ValueError(
                "a step that waits for a touch does not move: give it a step of its own"
            )
        if not takes_time and self.wait is None and (moves or not self.has_cues):
            raise ValueError("a step takes time: give 'duration', 'until: reached' or 'hold'")
        if self.until is None and (self.tolerance is not None or self.timeout is not None):
            raise ValueError("'tolerance' and 'timeout' belong to 'until: reached'")
        if self.until is not None:
            if self.timeout is None:
                raise ValueError("'until: reached' needs a 'timeout' [s]")
            if self.duration is not None and self.timeout < self.duration:
                raise ValueError(
                    f"'timeout' {self.timeout:g} s ends before 'duration', {self.duration:g} s"
                )
            if not self.moves_joints and not any(True for _ in self.tasks()):
                raise ValueError("'until: reached' needs a task or a posture to reach")
        if self.base is not None and self.base_velocity is not None:
            raise ValueError("a step gives 'base' or 'base_velocity', not both")
        labels = [task.label for _, task in self.tasks()]
        for number, label in enumerate(labels):
            if label == "posture":
                raise ValueError("a task cannot be called 'posture', which is that of all joints")
            if label in labels[:number]:
                raise ValueError(f"two tasks are called '{label}'; give one another 'name'")

    @property
    def moves_joints(self) -> bool:
        """True where it moves joints, by a posture or by hands."""
        return self.posture is not None or bool(self.joints or self.hands)

    @property
    def max_duration(self) -> float:
        """Longest time it takes [s], unless a reflex holds the robot."""
        wait = 0.0 if self.wait is None else self.wait.timeout
        return (self.timeout or self.duration or 0.0) + self.hold + wait

    @property
    def is_open(self) -> bool:
        """True where it may end before its longest time."""
        return self.until is not None or self.wait is not None

    def triggers(self) -> Iterator[tuple[str, TouchTrigger]]:
        """Choices of touches, with their keys."""
        if self.wait is not None:
            yield "wait", self.wait

    def tasks(self) -> Iterator[tuple[str, AnyTask]]:
        """All its tasks, each with its key."""
        for key in ("position", "orientation", "pose"):
            many = getattr(self, key)
            for number, task in enumerate(many):
                yield key if len(many) == 1 else f"{key}.{number}", task
        for key in ("look_at", "com", "base"):
            if (task := getattr(self, key)) is not None:
                yield key, task

    def names(self) -> Iterator[Named]:
        """Names the robot must know."""
        if self.posture is not None:
            yield "posture", "posture", self.posture
        yield from ((f"joints.{joint}", "joint", joint) for joint in self.joints)
        yield from ((f"hands.{hand}", "hand", hand) for hand in self.hands)
        for key, task in self.tasks():
            if not isinstance(task, BaseSpec):
                yield from ((f"{key}.{inner}", kind, name) for inner, kind, name in task.names())


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BaseMotion:
    """With each new goal the base gets a random twist: up to ``linear`` [m/s] in any direction, ``angular`` [rad/s].

    That happens with probability ``share``; else the base stops.
    """

    linear: NonNegative
    angular: NonNegative
    share: UnitInterval


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RandomGoals:
    """Joints move to goals that are drawn from the seed of the experiment.

    Attributes:
        joints: These move.
        posture: First posture of the robot, by name.
        settle: Time for that [s]; not part of what is recorded.
    """

    joints: Joints
    posture: str = "Stand"
    settle: Duration = 2.0

    @property
    def number(self) -> int:
        """Number of goals."""
        raise NotImplementedError

    @property
    def max_duration(self) -> float:
        """Longest time it takes [s]."""
        raise NotImplementedError

    def names(self) -> Iterator[Named]:
        """Names the robot must know."""
        yield "posture", "posture", self.posture
        for key in ("joints", "secondary_joints", "ranges"):
            yield from ((key, "joint", joint) for joint in getattr(self, key, ()))


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Sweeps(RandomGoals):
    """Free motion of one joint after the other, as in Sec. IV of the contact observer paper.

    The joint plays a random sequence, its neighbours move to new set-points, it plays the sequence again.

    Attributes:
        estimation_stiffness: Of the posture task [1/s2] in the runs a model is estimated from; the experiment's own
            is that of the test run.
        sweeps: Moves from near one limit to near the other.
        max_offset: Fraction of the joint's range: largest distance from the limit at the end of a sweep.
        setpoints: Random set-points anywhere in the range, after the sweeps.
        dwell: Shortest and longest stay of the command at one target [s].
        neighbour_range: Fraction of their range, around its middle, for the joints before and after.
        ranges: For joints with a smaller range: fraction of the distance from the first posture to either limit that
            stands for their range.
    """

    estimation_stiffness: Annotated[tuple[Positive, ...], Field(min_length=1)]
    sweeps: Count
    max_offset: Annotated[float, Field(ge=0, lt=0.5)]
    setpoints: Count
    dwell: tuple[Positive, Positive]
    neighbour_range: UnitInterval
    ranges: dict[str, PartOfRange] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_bounds("dwell", self.dwell)

    @property
    def number(self) -> int:
        """Number of goals."""
        # Twice, because each joint plays its sequence again after its neighbours have moved (Sec. IV of the paper).
        return 2 * len(self.joints) * (2 * self.sweeps + self.setpoints)

    @property
    def max_duration(self) -> float:
        """Longest time it takes [s]."""
        return len(self.joints) * self.settle + self.number * self.dwell[1]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PeriodicGoals(RandomGoals):
    """``count`` goals, in the middle fraction ``range`` of the range of ``joints``."""

    range: UnitInterval
    count: Count

    @property
    def number(self) -> int:
        """Number of goals."""
        return self.count


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Setpoints(PeriodicGoals):
    """Random set-points, at once, one every ``period`` [s].

    Attributes:
        secondary_joints, secondary_range: Others that move too, each goal in this fraction of their range.
        ranges: Of single joints: another fraction.
        base: The base moves too.
    """

    secondary_joints: tuple[str, ...] = ()
    secondary_range: UnitInterval = 0.0
    ranges: dict[str, UnitInterval] = field(default_factory=dict)
    base: BaseMotion | None = None
    period: Positive

    def __post_init__(self) -> None:
        for joint in self.ranges:
            if joint not in (*self.joints, *self.secondary_joints):
                raise ValueError(f"'ranges': {joint} is not among the joints that move")

    @property
    def max_duration(self) -> float:
        """Longest time it takes [s]."""
        return self.settle + self.count * self.period


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Holds(PeriodicGoals):
    """Each goal is reached along a spline in ``move`` [s] and held for ``hold`` [s]."""

    move: Duration
    hold: NonNegative

    @property
    def period(self) -> float:
        """Time from one goal to the next [s]."""
        return self.move + self.hold

    @property
    def max_duration(self) -> float:
        """Longest time it takes [s]."""
        return self.settle + self.count * self.period


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RandomStep(AnyStep):
    """Random goals of one kind."""

    setpoints: Setpoints | None = None
    holds: Holds | None = None
    sweeps: Sweeps | None = None

    def __post_init__(self) -> None:
        if sum(goals is not None for goals in (self.setpoints, self.holds, self.sweeps)) != 1:
            raise ValueError("a step gives one of 'setpoints', 'holds' and 'sweeps'")

    @property
    def kind(self) -> str:
        """``setpoints``, ``holds`` or ``sweeps``."""
        return next(key for key in ("setpoints", "holds", "sweeps") if getattr(self, key))

    @property
    def goals(self) -> Setpoints | Holds | Sweeps:
        """The goals, of any kind."""
        goals: Setpoints | Holds | Sweeps = getattr(self, self.kind)
        return goals

    def names(self) -> Iterator[Named]:
        """Names the robot must know."""
        yield from ((f"{self.kind}.{key}", kind, name) for key, kind, name in self.goals.names())


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PlayStep(AnyStep):
    """The ``steps`` of another file: ``play`` names a shipped motion, or a file next to this one."""

    play: Label
    steps: OptionalSteps = field(default=(), metadata=HIDDEN)

    def blocks(self) -> Iterator[tuple[str, tuple[AnyStep, ...]]]:
        """Yield the steps that it holds, with their keys."""
        yield "play", self.steps

    def with_blocks(self, *blocks: tuple[AnyStep, ...]) -> Self:
        """Return it with other steps in its blocks."""
        return replace(self, steps=blocks[0])


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Repeat:
    """A block of steps, ``times`` times, or fewer where a touch came meanwhile that is as ``until`` says."""

    times: Annotated[int, Field(ge=1, le=MAX_REPEATS)]
    steps: Steps
    until: TouchTrigger | None = None


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RepeatStep(AnyStep):
    """A block of steps, several times."""

    repeat: Repeat

    def triggers(self) -> Iterator[tuple[str, TouchTrigger]]:
        """Choices of touches, with their keys."""
        if self.repeat.until is not None:
            yield "repeat.until", self.repeat.until

    def blocks(self) -> Iterator[tuple[str, tuple[AnyStep, ...]]]:
        """Yield the steps that it holds, with their keys."""
        yield "repeat.steps", self.repeat.steps

    def with_blocks(self, *blocks: tuple[AnyStep, ...]) -> Self:
        """Return it with other steps in its blocks."""
        return replace(self, repeat=replace(self.repeat, steps=blocks[0]))


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Case:
    """Steps that follow a touch: ``on`` says which."""

    on: TouchTrigger
    steps: OptionalSteps


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Branch:
    """The robot stays in place until a touch comes, then continues with the first case that fits.

    Attributes:
        timeout: Longest wait [s].
        deciding: After a touch that fits a case, one before it may still fit [s]: how hard a touch is takes its time.
        cases: In the order in which they are asked.
        otherwise: Where no touch came.
    """

    timeout: Duration
    deciding: Pause = 0.3
    cases: Annotated[tuple[Case, ...], Field(min_length=1, max_length=20)]
    otherwise: OptionalSteps = ()


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BranchStep(AnyStep):
    """One of several blocks of steps, by touch."""

    branch: Branch

    def triggers(self) -> Iterator[tuple[str, TouchTrigger]]:
        """Choices of touches, with their keys."""
        yield from ((f"branch.cases.{n}.on", case.on) for n, case in enumerate(self.branch.cases))

    def blocks(self) -> Iterator[tuple[str, tuple[AnyStep, ...]]]:
        """Yield the steps that it holds, with their keys."""
        yield from ((f"branch.cases.{n}.steps", c.steps) for n, c in enumerate(self.branch.cases))
        yield "branch.otherwise", self.branch.otherwise

    def with_blocks(self, *blocks: tuple[AnyStep, ...]) -> Self:
        """Return it with other steps in its blocks."""
        *bodies, otherwise = blocks
        pairs = zip(self.branch.cases, bodies, strict=True)
        cases = tuple(replace(case, steps=body) for case, body in pairs)
        return replace(self, branch=replace(self.branch, cases=cases, otherwise=otherwise))


_KINDS: dict[str, Any] = dict.fromkeys(("setpoints", "holds", "sweeps"), RandomStep)
_KINDS |= {"play": PlayStep, "repeat": RepeatStep, "branch": BranchStep}
