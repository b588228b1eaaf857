"""Experiments: steps, reactions to touch, and contacts for a simulated robot; checked to the last name.

One form for all: a motion is an experiment of steps alone; identification, calibration, evaluation and
demonstration are experiments with random goals and contacts.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, WrapValidator
from pydantic.dataclasses import dataclass

from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.contact_selector import SELECTOR_FIELDS, SelectorError, TouchTrigger
from pepper_driver.config.contact_specs import AnyContact, RandomForces, RandomTouch
from pepper_driver.config.errors import ConfigError, UnknownNameError, suggestion
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import (
    STRICT,
    by_kind,
    named_file,
    package_file,
    parse,
    parse_part,
    read_yaml,
    shipped_names,
)
from pepper_driver.config.mistakes import HIDDEN, explain, keys_of, unknown_keys
from pepper_driver.config.parts import TaskStiffness
from pepper_driver.config.robot import RobotConfig
from pepper_driver.config.steps import (
    AnyStep,
    Branch,
    BranchStep,
    Cues,
    OptionalSteps,
    PlayStep,
    RandomStep,
    RepeatStep,
    Setpoints,
    Step,
    Steps,
    Sweeps,
    changed_steps,
)
from pepper_driver.config.task_specs import Label, Named

SCHEMA = 2

FOLDERS = ("motions", "experiments")
"""Folders of shipped experiments: those of steps alone, and all others."""

DAY = 24 * 3600.0
"""[s] No experiment takes longer."""

ROUNDING = 1e-9
"""[s] Sums of times in files are off by less."""

MAX_STEPS = 20_000
"""Played in one experiment, with all repetitions."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ObserverChoice:
    """Name of an observer, and its model file relative to the experiment's; None for the one shipped for the robot."""

    mode: Label = "fusion"
    models: str | None = None


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Reaction(Cues):
    """Reaction to a touch during any step.

    Attributes:
        on: Which touches; without it any.
        play: Steps of another file, before the current step continues.
        at_most: Number of times; None for no end. A reflex acts each time.
        reflex: Entry of a reflex: ``do``, and the arguments of this kind; ``pepper_driver`` registers the kinds.
        steps: Those of the file that it plays.
    """

    on: TouchTrigger = TouchTrigger()
    play: Label | None = None
    at_most: Annotated[int, Field(ge=1, le=10_000)] | None = None
    reflex: dict[str, Any] = field(default_factory=dict, metadata=HIDDEN)
    steps: OptionalSteps = field(default=(), metadata=HIDDEN)

    def __post_init__(self) -> None:
        if not (self.has_cues or self.play or self.reflex):
            raise ValueError("a reaction gives 'do', 'say', 'leds', 'cue' or 'play'")
        if self.reflex and (self.on.lasting or self.on.touches > 1):
            raise ValueError(
                "a reflex answers at once: 'lasting' and 'touches' are for words and motions"
            )

    @property
    def reflex_entry(self) -> dict[str, Any]:
        """Entry of the reflex, with ``on``; empty for none."""
        on = {key: value for key in SELECTOR_FIELDS if (value := getattr(self.on, key))}
        return {**self.reflex, "on": on} if self.reflex else {}


def _reaction(value: object, _: object) -> object:
    """Pass keys other than ``do`` and those of a reaction to the reflex."""
    # `replace` makes pydantic validate again what is a reaction already.
    if isinstance(value, Reaction):
        return value
    if not isinstance(value, dict):
        raise ValueError("a reaction is a mapping of keys to values")
    known = keys_of(Reaction)
    own = {key: value[key] for key in value if key in known}
    rest = {key: value[key] for key in value if key not in known}
    if rest and "do" not in rest:
        raise unknown_keys(rest, (*known, "do"))
    return parse_part(Reaction, own, hidden={"reflex": rest})


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Experiment:
    """Steps one after the other, with reactions and contacts.

    Attributes:
        schema: Of this form of file.
        name: As it is called.
        description: Its purpose, human-readable.
        seed: Of random goals and contacts, where none other is given.
        plant, world: Of a simulated robot; None for the backend's own.
        observer: Detects the touches; None without an observer, the default of a file of steps alone.
        attentive: True: arms and head oscillate by a little, so that the robot detects more; None leaves it.
        stiffness: Of the posture task from the beginning on [1/s2]; None for the usual one.
        reactions: To touch.
        contacts: Given to a simulated robot. Others skip them.
        steps: One after the other.
        max_duration: It is refused if it may take longer [s].
        max_load: Largest ratio of contact and gravity together to the torque that each motor board can hold.
        max_tipping: Largest ratio to the moment over an edge between the wheels that would lift the robot; on wheels
            only.
        source: The file it came from, for messages.
    """

    schema: Literal[2]
    name: Label
    description: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    plant: str | None = None
    world: str | None = None
    observer: ObserverChoice | None = ObserverChoice()
    attentive: bool | None = None
    stiffness: TaskStiffness | None = None
    reactions: Annotated[
        tuple[Annotated[Reaction, WrapValidator(_reaction)], ...], Field(max_length=100)
    ] = ()
    contacts: Annotated[
        tuple[Annotated[AnyContact, by_kind(AnyContact)], ...], Field(max_length=1000)
    ] = ()
    steps: Steps
    max_duration: Annotated[float, Field(gt=0, le=DAY)] = 3600.0
    max_load: Annotated[float, Field(gt=0, le=1)] = 0.85
    max_tipping: Annotated[float, Field(gt=0, le=1)] = 0.8
    source: str = field(default="", metadata=HIDDEN)

    @property
    def max_length(self) -> float:
        """Longest time it takes [s], unless a reflex holds the robot."""
        return self._measure(self.steps)[0]

    @property
    def is_open(self) -> bool:
        """True where it may end before its longest time."""
        return any(
            step.is_open if isinstance(step, Step) else any(True for _ in step.triggers())
            for _, step in self.walk()
        )

    @property
    def random_step(self) -> RandomStep | None:
        """The first step with random goals; None without one."""
        return next((step for _, step in self.walk() if isinstance(step, RandomStep)), None)

    @property
    def touched_joints(self) -> tuple[str, ...]:
        """The joints that contacts are meant for, each once, in the order of the file."""
        named = (name for contact in self.contacts for name in contact.names())
        return tuple(dict.fromkeys(name for key, _, name in named if key in ("joint", "joints")))

    def error(self, key: str, problem: str) -> ConfigError:
        """Make the error that a value is wrong."""
        return ConfigError(f"{self.source or self.name}: key '{key}': {problem}")

    def walk(
        self, steps: tuple[AnyStep, ...] | None = None, key: str = "steps"
    ) -> Iterator[tuple[str, AnyStep]]:
        """Yield all steps with their keys, blocks before the steps they hold, those of played files too."""
        for number, step in enumerate(self.steps if steps is None else steps):
            yield f"{key}.{number}", step
            for inner, block in step.blocks():
                yield from self.walk(block, f"{key}.{number}.{inner}")

    def triggers(self) -> Iterator[tuple[str, TouchTrigger]]:
        """Yield all choices of touches, with their keys."""
        yield from ((f"reactions.{n}.on", reaction.on) for n, reaction in enumerate(self.reactions))
        for key, step in self.walk():
            yield from ((f"{key}.{inner}", trigger) for inner, trigger in step.triggers())

    def playing(self) -> Iterator[tuple[str, PlayStep | Reaction]]:
        """Yield the steps and reactions that play another file, with their keys."""
        for key, step in self.walk():
            if isinstance(step, PlayStep):
                yield f"{key}.play", step
        for number, reaction in enumerate(self.reactions):
            if reaction.play is not None:
                yield f"reactions.{number}.play", reaction

    def with_goals(self, **changes: Any) -> Experiment:  # noqa: ANN401 fields of the goals
        """Return it with other values of the goals of its first random step, such as ``count=3``.

        Raises:
            ConfigError: It does not exist, or its values are invalid.
        """
        chosen = self.random_step
        if chosen is None:
            raise self.error("steps", "no step has random goals")
        try:
            goals: Any = replace(chosen.goals, **changes)
        except ValidationError as error:
            problem = explain(error, type(chosen.goals))
            raise ConfigError(f"{self.source or self.name}: {problem}") from error
        new = replace(chosen, **{chosen.kind: goals})
        steps = changed_steps(self.steps, lambda _, step: new if step is chosen else step, "steps")
        return replace(self, steps=steps)

    def _measure(self, steps: tuple[AnyStep, ...]) -> tuple[float, int]:
        """Longest time of steps [s], and their number, with all repetitions."""
        time, count = 0.0, 0
        for step in steps:
            inner = [self._measure(block) for _, block in step.blocks()] or [(0.0, 1)]
            times = step.repeat.times if isinstance(step, RepeatStep) else 1
            # Of several blocks, the cases of a branch, one alone is played.
            time += times * max(seconds for seconds, _ in inner)
            count += times * max(number for _, number in inner)
            if isinstance(step, Step):
                time += step.max_duration
            elif isinstance(step, RandomStep):
                time, count = time + step.goals.max_duration, count + step.goals.number
            elif isinstance(step, BranchStep):
                time, count = time + step.branch.timeout, count + 1
        return time, count


def find_experiment(name: str | Path, including_file: str = "") -> Path:
    """Return the file of a shipped experiment, or the path given, which ends in ``.yaml``.

    Args:
        name: Name or path.
        including_file: File in whose folder a relative path begins; empty for the working directory.

    Raises:
        UnknownNameError: No shipped experiment has this name.
    """
    if str(name).endswith((".yaml", ".yml")):
        return Path(including_file).parent / name
    for folder in FOLDERS:
        if str(name) in shipped_names(folder):
            return package_file(folder, f"{name}.yaml")
    names = [name for folder in FOLDERS for name in shipped_names(folder)]
    own = f"{name}.yaml"
    with suppress(OSError):  # of a name that no file can have
        if (Path(including_file).parent / own).is_file():
            names.append(own)
    if own not in names:
        names.append("FILE.yaml")
    raise UnknownNameError("experiment", str(name), names)


@checked_arguments
@with_lines
def load_experiment(name: str | Path, robot: RobotConfig) -> Experiment:
    """Load an experiment by name, or from a path that ends in ``.yaml``.

    Raises:
        UnknownNameError: No shipped experiment has this name.
        ConfigError: The file is wrong; the message names file, line, key and remedy.
    """
    return _load(find_experiment(name), robot, ())


def _load(path: Path, robot: RobotConfig, outer: tuple[Path, ...]) -> Experiment:
    """Load a file that is played in ``outer`` ones."""
    source, data = str(path), read_yaml(path)
    old = next((key for key in ("version", "schema") if data.get(key) == 1), None)
    if old is not None:
        raise ConfigError(
            f"{source}: key '{old}': a file of an old form, '{old}: 1'; the form is 'schema: {SCHEMA}' now, see"
            " docs/experiments.md"
        )
    experiment = parse(Experiment, data, source, hidden={"source": source})
    experiment = _with_played(experiment, robot, (*outer, path.resolve()))
    if "observer" not in data and not (
        experiment.contacts or any(True for _ in experiment.triggers())
    ):
        experiment = replace(experiment, observer=None)
    check_experiment(experiment, robot)
    return experiment


def _with_played(experiment: Experiment, robot: RobotConfig, outer: tuple[Path, ...]) -> Experiment:
    """Return an experiment with the steps of the files that it plays; ``outer`` are those that play it, and its own."""
    known: dict[str, OptionalSteps] = {}

    def load(key: str, name: str) -> OptionalSteps:
        if name in known:
            return known[name]
        try:
            where = find_experiment(name, experiment.source)
        except UnknownNameError as error:
            raise experiment.error(key, str(error)) from error
        if not where.is_file():
            raise experiment.error(key, f"there is no file {where}")
        if where.resolve() in outer:
            raise experiment.error(key, f"'{name}' would be played in itself without end")
        part = _load(where, robot, outer)
        if part.reactions or part.contacts:
            problem = f"'{name}' has reactions or contacts; steps alone are played"
            raise experiment.error(key, problem)
        # A file that is played in several places is read and checked once.
        known[name] = part.steps
        return part.steps

    def change(key: str, step: AnyStep) -> AnyStep:
        if not isinstance(step, PlayStep):
            return step
        return replace(step, steps=load(f"{key}.play", step.play))

    reactions = tuple(
        replace(r, steps=load(f"reactions.{number}.play", r.play)) if r.play else r
        for number, r in enumerate(experiment.reactions)
    )
    steps = changed_steps(experiment.steps, change, "steps")
    return replace(experiment, steps=steps, reactions=reactions)


def check_experiment(experiment: Experiment, robot: RobotConfig) -> None:
    """Refuse what is wrong with steps, triggers and contacts, as far as the description of the robot allows.

    Loading does it; of use for an experiment that was made in Python.

    Raises:
        ConfigError: The message names the key.
    """
    length, count = experiment._measure(experiment.steps)
    if length > experiment.max_duration:
        raise experiment.error(
            "max_duration" if experiment.max_duration != Experiment.max_duration else "steps",
            f"may take {length:.0f} s, with all repetitions and timeouts, which is more than"
            f" {experiment.max_duration:g} s; set 'max_duration' to allow more, up to {DAY:g} s",
        )
    if count > MAX_STEPS:
        raise experiment.error("steps", f"{count} with all repetitions; at most {MAX_STEPS}")
    for kind, name in (("plant", experiment.plant), ("world", experiment.world)):
        try:
            if name is not None:
                named_file(kind, name, f"{kind}s")
        except UnknownNameError as error:
            raise experiment.error(kind, str(error)) from error
    for key, part in experiment.playing():
        if not part.steps:
            raise experiment.error(key, f"the steps of '{part.play}' were not loaded")
    for key, step in experiment.walk():
        if ".play." in key:  # checked where it stands
            continue
        _check_names(experiment, key, step.names(), robot)
        for inner, value, lower, upper, unit in _ranges(step, robot):
            if not lower <= value <= upper:
                problem = f"{value:g}{unit} lies outside {lower:g} to {upper:g}{unit}"
                raise experiment.error(f"{key}.{inner}", problem)
        if isinstance(step, BranchStep):
            _check_branch(experiment, f"{key}.branch.cases", step.branch, robot)
    for key, trigger in experiment.triggers():
        if experiment.observer is None:
            raise experiment.error(key, "no touch can be detected: the experiment has no observer")
        try:
            trigger.check(robot)
        except UnknownNameError as error:
            raise experiment.error(f"{key}.{error.kind}", str(error)) from error
        except SelectorError as error:
            raise experiment.error(key, str(error)) from error
    random = [step for _, step in experiment.walk() if isinstance(step, RandomStep)]
    for number, contact in enumerate(experiment.contacts):
        _check_names(experiment, f"contacts.{number}", contact.names(), robot)
        if isinstance(contact, RandomTouch):
            _check_random(experiment, f"contacts.{number}", contact, random, robot)


def _check_names(
    experiment: Experiment, key: str, names: Iterator[Named], robot: RobotConfig
) -> None:
    known: dict[str, tuple[str, ...]] = {
        "joint": robot.joint_names,
        "joint or chain": (*robot.chains, *robot.joint_names),
        "link": robot.links,
        "posture": tuple(robot.postures),
        "hand": robot.hands.joints,
    }
    for inner, kind, name in names:
        if name not in known[kind]:
            hint = suggestion(name, known[kind])
            raise experiment.error(f"{key}.{inner}", f"unknown {kind} '{name}'{hint}")


def _ranges(step: AnyStep, robot: RobotConfig) -> Iterator[tuple[str, float, float, float, str]]:
    """Yield key, value, bounds and unit of what the robot limits in a step."""
    base = robot.limits.base
    speed, turn = (base.linear_velocity, " m/s"), (base.angular_velocity, " rad/s")
    if isinstance(step, RandomStep) and isinstance(step.goals, Setpoints) and step.goals.base:
        for key, (limit, unit) in (("linear", speed), ("angular", turn)):
            yield f"setpoints.base.{key}", getattr(step.goals.base, key), 0.0, limit, unit
    if not isinstance(step, Step):
        return
    for name, angle in step.joints.items():
        joint = robot.joints[robot.joint_index(name)]
        unit = "" if name in robot.hands.joints else " rad"
        yield f"joints.{name}", angle, joint.lower, joint.upper, unit
    yield from ((f"hands.{hand}", aperture, 0.0, 1.0, "") for hand, aperture in step.hands.items())
    if step.base_velocity is not None:
        for key, (limit, unit) in (("vx", speed), ("vy", speed), ("wz", turn)):
            value = getattr(step.base_velocity, key)
            yield f"base_velocity.{key}", value, -limit, limit, unit


def _check_branch(experiment: Experiment, key: str, branch: Branch, robot: RobotConfig) -> None:
    """Refuse cases that can never be chosen."""
    for number, case in enumerate(branch.cases):
        on, problem = case.on, ""
        if on.lasting >= branch.timeout:
            problem = f"no touch lasts {on.lasting:g} s within {branch.timeout:g} s"
        for other, rival in enumerate(branch.cases):
            spare = on.lasting - rival.on.lasting
            if other < number and rival.on.includes(on, robot):
                problem = f"'cases.{other}', before it, takes all its touches"
            elif (
                other > number
                and spare > branch.deciding + ROUNDING
                and rival.on.includes(on, robot)
            ):
                problem = (
                    f"'cases.{other}' takes its touches before they have lasted {on.lasting:g} s; give 'deciding' of"
                    f" {spare:g} s or more"
                )
        if problem:
            raise experiment.error(f"{key}.{number}", f"can never be chosen: {problem}")


def _check_random(
    experiment: Experiment,
    key: str,
    contact: RandomTouch,
    random: list[RandomStep],
    robot: RobotConfig,
) -> None:
    """Refuse random contacts without a step of random goals, longer than one, or of the wrong kind."""
    steps = [step for step in random if contact.step in (None, step.name)]
    if len(steps) != 1:
        problem = "random contacts need a step with random goals; give 'step', its name, where there are several"
        raise experiment.error(key, problem)
    goals = steps[0].goals
    if isinstance(goals, Sweeps):
        raise experiment.error(key, "sweeps are free motion; leave contacts out")
    if contact.latest > goals.period + ROUNDING:
        problem = (
            f"may last until {contact.latest:g} s, beyond the next goal after {goals.period:g} s"
        )
        raise experiment.error(f"{key}.times", problem)
    carried = {joint.child: joint.name for joint in robot.joints}
    for place in contact.points if isinstance(contact, RandomForces) else ():
        joint = carried.get(place.link)
        if joint is not None and joint not in robot.chains["legs"]:
            problem = f"{place.link} is carried by {joint}; push it with random_pushes"
            raise experiment.error(f"{key}.points", problem)
