"""Plans an experiment to its last goal and contact, before the robot moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from urllib.parse import urlencode

import numpy as np

from pepper_driver.backends import Backend
from pepper_driver.backends.selection import parse_uri
from pepper_driver.config import Experiment, RobotConfig, UnknownNameError
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.contact_specs import GrabSpec, RandomForces, RandomPushes, StatedContact
from pepper_driver.config.experiment import check_experiment
from pepper_driver.config.lines import with_lines
from pepper_driver.config.settings import load_controller_settings
from pepper_driver.config.steps import (
    AnyStep,
    BranchStep,
    RandomStep,
    RepeatStep,
    Step,
    Sweeps,
    Wait,
)
from pepper_driver.experiments.contact_planning import ContactPlanner
from pepper_driver.experiments.feasibility import PostureCheck, too_fast
from pepper_driver.experiments.goals import Goal
from pepper_driver.experiments.segments import (
    PlannedContact,
    Segment,
    goal_step,
    segment_after,
    sweep_steps,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """An experiment that is ready to be played on one robot.

    Attributes:
        experiment: The experiment.
        rounds: By key of a step, its segments each time it is played; the last ones for all times after.
        at_begin: Contacts whose times count from the beginning.
    """

    experiment: Experiment
    rounds: dict[str, list[list[Segment]]]
    at_begin: list[PlannedContact] = field(default_factory=list)

    @property
    def segments(self) -> list[Segment]:
        """All segments, in the order in which they are first played."""
        return [segment for rounds in self.rounds.values() for r in rounds for segment in r]


def experiment_uri(uri: str, experiment: Experiment) -> str:
    """Return the URI of a simulated Pepper with the experiment's plant and world, where it names none."""
    parsed = parse_uri(uri)
    required = {"plant": experiment.plant, "world": experiment.world}
    added = {k: v for k, v in required.items() if v is not None and k not in parsed.query}
    if parsed.scheme != "mujoco" or not added:
        return uri
    return f"{parsed.scheme}://?{urlencode({**parsed.query, **added})}"


@with_lines
def plan_experiment(
    experiment: Experiment,
    robot: RobotConfig,
    backend: Backend,
    *,
    seed: int | Sequence[int] | None = None,
    start: FloatArray | None = None,
) -> Plan:
    """Plan all steps and contacts, and check the postures they lead to. Nothing moves.

    Contacts are planned for a robot at rest where the step leads when it is first played.

    Args:
        experiment: As it was loaded or made.
        robot: Its description.
        backend: The robot; need not be open.
        seed: Of all that is random; None for the experiment's own.
        start: (17,) where the robot stands [rad]; None for unknown.

    Raises:
        ConfigError: Something is wrong with it, a posture or contact that the robot could not take, or contacts on a
            robot that software cannot push; the message names file and key.
    """
    check_experiment(experiment, robot)
    return _Planner(experiment, robot, backend, seed).plan(start)


@dataclass(eq=False)
class _State:
    """State before a step: the segment before it, and the joints (17,) that tasks have moved."""

    last: Segment
    led: BoolArray


class _Planner:
    def __init__(
        self,
        experiment: Experiment,
        robot: RobotConfig,
        backend: Backend,
        seed: int | Sequence[int] | None,
    ) -> None:
        self._experiment, self._robot = experiment, robot
        self._rng = np.random.default_rng(experiment.seed if seed is None else seed)
        self._check = PostureCheck(robot)
        self._plan = Plan(experiment=experiment, rounds={})
        self._numbers: dict[str, int] = {}
        self._contacts: ContactPlanner | None = None
        if experiment.contacts:
            needed = {"grab" if isinstance(c, GrabSpec) else "push" for c in experiment.contacts}
            if not needed <= backend.info.capabilities:
                raise experiment.error(
                    "contacts",
                    f"only simulated robots can be pushed, and '{backend.uri}' cannot; leave them out"
                    " with 'pepper run --no-contacts'",
                )
            self._contacts = ContactPlanner(experiment, robot, backend)

    def plan(self, start: FloatArray | None) -> Plan:
        experiment, n = self._experiment, len(self._robot.joint_names)
        stiffness = experiment.stiffness or load_controller_settings(self._robot).posture.stiffness
        nowhere = np.full(n, np.nan)
        before = Segment.before(nowhere if start is None else start, stiffness)
        self._block(experiment.steps, "steps", _State(before, np.zeros(n, dtype=np.bool_)))
        for number, reaction in enumerate(experiment.reactions):
            if reaction.play is not None:  # its start is unknown
                state = _State(Segment.before(nowhere, stiffness), np.ones(n, dtype=np.bool_))
                self._block(reaction.steps, f"reactions.{number}.play", state)
        for number, contact in enumerate(experiment.contacts):
            if not isinstance(contact, RandomPushes | RandomForces):
                self._add_stated(f"contacts.{number}", contact)
        return self._plan

    def _block(self, steps: Sequence[AnyStep], key: str, state: _State) -> None:
        for number, step in enumerate(steps):
            here = f"{key}.{number}"
            if isinstance(step, RandomStep):
                self._add(here, self._random(step, here, state))
                state.led[:] = False
            elif isinstance(step, Step):
                self._segment(step, here, state)
            elif isinstance(step, BranchStep):
                self._branch(step, here, state)
            else:
                self._repeat(step, here, state)

    def _repeat(self, step: AnyStep, key: str, state: _State) -> None:
        """Plan a block that is played: twice if more often, as all later rounds begin as the second one does.

        Random goals are drawn again in each round.
        """
        times = step.repeat.times if isinstance(step, RepeatStep) else 1
        ((inner, block),) = step.blocks()
        random = any(isinstance(s, RandomStep) for _, s in self._experiment.walk(block))
        begin = state.last.end(self._robot)
        for played in range(times if random else min(times, 2)):
            self._block(block, f"{key}.{inner}", state)
            if played == 0:
                end = state.last.end(self._robot)
        until = isinstance(step, RepeatStep) and step.repeat.until is not None
        over = begin + times * (end - begin)
        state.last = state.last.shifted(over, self._robot, is_timed=not until)

    def _branch(self, step: BranchStep, key: str, state: _State) -> None:
        # Any touch of a case ends it: the trigger of this wait is never asked.
        wait = Step(name=step.name or "branch", wait=Wait(timeout=step.branch.timeout))
        self._segment(wait, f"{key}.branch", state)
        ends = []
        for inner, block in step.blocks():
            ends.append(replace(state, led=state.led.copy()))
            self._block(block, f"{key}.{inner}", ends[-1])
        postures = np.array([end.last.posture for end in ends])
        same = (postures == postures[0]).all(axis=0)
        state.last = replace(
            max((end.last for end in ends), key=lambda last: last.end(self._robot)),
            posture=np.where(same, postures[0], np.nan),
            arrival=np.max([end.last.arrival for end in ends], axis=0),
        )
        state.led = np.any([end.led for end in ends], axis=0) | ~same

    def _segment(self, step: Step, key: str, state: _State) -> None:
        segment = self._after(step, key, state.last)
        if problem := too_fast(segment, state.last, state.led, self._robot):
            raise self._experiment.error(f"{key}.duration", problem)
        if step.posture is not None:
            state.led[:] = False
        state.led[[self._robot.joint_index(name) for name in (*step.joints, *step.hands)]] = False
        for _, task in step.tasks():
            state.led |= Goal(task, self._robot).joints
        if step.moves_joints:
            problem = self._check.problem(np.where(state.led, np.nan, segment.posture))
            if problem:
                said = next(k for k in ("posture", "joints", "hands") if getattr(step, k))
                raise self._experiment.error(f"{key}.{said}", problem)
        if key not in self._plan.rounds:
            self._add(key, [segment])
        state.last = segment

    def _add(self, key: str, segments: list[Segment]) -> None:
        self._plan.rounds.setdefault(key, []).append(segments)

    def _after(
        self, step: Step, key: str, last: Segment, *, drawn: bool = False, settling: bool = False
    ) -> Segment:
        number = self._numbers.setdefault(key, len(self._numbers))
        return segment_after(
            last, step, self._robot, key=key, number=number, is_random=drawn, is_settling=settling
        )

    def _random(self, step: RandomStep, key: str, state: _State) -> list[Segment]:
        """Draw the goals of a step and their contacts from one generator."""
        robot, rng, goals, last = self._robot, self._rng, step.goals, state.last
        segments: list[Segment] = []

        def follow(drawn: Step, settling: bool = False) -> Segment:
            named = replace(drawn, name=step.name) if step.name else drawn
            return self._after(named, key, state.last, drawn=True, settling=settling)

        if isinstance(goals, Sweeps):
            for drawn, settling in sweep_steps(goals, robot, rng):
                state.last = last = follow(drawn, settling)
                segments.append(last)
            return segments
        state.last = first = follow(Step(posture=goals.posture, hold=goals.settle), settling=True)
        contacts = [
            (f"contacts.{number}", contact)
            for number, contact in enumerate(self._experiment.contacts)
            if isinstance(contact, RandomPushes | RandomForces)
            and contact.step in (None, step.name)
            and key.startswith("steps")
        ]
        draw: Callable[[], Segment] = lambda: follow(goal_step(goals, robot, rng))  # noqa: E731
        segments.append(first)
        for _ in range(goals.count):
            planner = self._contacts
            state.last = (
                planner.with_random(draw, contacts, first.end(robot), rng) if planner else draw()
            )
            if problem := too_fast(state.last, segments[-1], state.led, robot):
                raise self._experiment.error(f"{key}.holds.move", problem)
            segments.append(state.last)
        return segments

    def _add_stated(self, key: str, contact: StatedContact) -> None:
        """Plan a contact of stated time, into its step or at the beginning."""
        assert self._contacts is not None
        segments, begins = (
            [s for s in self._plan.segments if s.key.startswith("steps")],
            [self._plan.at_begin],
        )
        error, end, time = self._experiment.error, contact.start + contact.duration, contact.start
        if contact.step is not None:
            keys = {segment.key for segment in segments if segment.step.name == contact.step}
            if len(keys) != 1:
                names = sorted({s.step.name for s in segments if s.step.name})
                raise error(
                    f"{key}.step",
                    f"several steps are called '{contact.step}'; give them different names"
                    if keys
                    else str(UnknownNameError("step", contact.step, names)),
                )
            rounds = self._plan.rounds[keys.pop()]
            segments, begins = rounds[0], [played[0].contacts for played in rounds]
            length = segments[-1].end(self._robot) - segments[0].start
            if end > length + self._robot.cycle:
                raise error(
                    key,
                    f"ends at {end:g} s, after step '{contact.step}', which is over at {length:g} s",
                )
            time += segments[0].start
        elif end > self._experiment.max_length:
            over = self._experiment.max_length
            raise error(key, f"ends after the experiment, which is over at {over:g} s")
        now = [segment for segment in segments if segment.start <= time < segment.end(self._robot)]
        if not now or (contact.step is None and not now[-1].is_timed):
            raise error(
                key,
                f"the motion at {contact.start:g} s is unknown, as steps before that repeat or last as long"
                " as it takes; give 'step', with whose beginning 'start' counts",
            )
        unknown = np.flatnonzero(np.isnan(now[-1].posture))
        if len(unknown):
            raise error(
                key,
                f"contacts are planned for a known posture, and no step up to '{now[-1].name}' says where"
                f" {self._robot.joint_names[unknown[0]]} is; begin with a 'posture'",
            )
        for concurrent in begins:  # each round of random goals has its own
            self._contacts.add_stated(key, contact, now[-1], time - now[-1].start, concurrent)
