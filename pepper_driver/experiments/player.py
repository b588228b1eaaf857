"""The one player: steps one after the other, with their tasks, words, contacts, and reactions to touch."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.backends import Backend
from pepper_driver.callbacks.events import CueEvent, ProgramEvent, ReflexEvent, StepEvent
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.experiment import Reaction
from pepper_driver.config.steps import AnyStep, BranchStep, Cues, RandomStep, RepeatStep, Step
from pepper_driver.experiments.contact_schedule import ContactSchedule
from pepper_driver.experiments.goals import Goal, MeasuredModel, PostureGoal
from pepper_driver.experiments.plan import Plan
from pepper_driver.experiments.reports import ExperimentReport, GoalReport, StepReport, WaitReport
from pepper_driver.experiments.segments import PlannedContact, Segment, goal_posture
from pepper_driver.experiments.touch_watch import TouchWatch
from pepper_driver.loop import Loop
from pepper_driver.observer import Contact
from pepper_driver.reflexes.arbiter import return_time

GOAL_TOLERANCE = 0.01
"""[m] and [rad] of a step that waits for its targets and gives none."""

MIN_RESUME_TIME = 1.0
"""[s] Minimum time that remains for a motion after a reflex has released it."""

OnStep = Callable[[StepReport], None]


@dataclass
class _Watched:
    """A reaction of words or steps, and how often it has come."""

    key: str
    reaction: Reaction
    watch: TouchWatch
    count: int = 0

    def may_react(self) -> bool:
        return self.reaction.at_most is None or self.count < self.reaction.at_most


@dataclass
class _Listening:
    """Touches that a step waits for: watches, ticks in which to decide, and those since the first touch."""

    watches: Sequence[TouchWatch] = ()
    deciding: int = 0
    fired_ticks: int = 0

    @property
    def fired(self) -> bool:
        return any(watch.fired for watch in self.watches)

    def is_over(self, timed_out: bool) -> bool:
        """Count a tick; return True where no better case can come any more, or none came in time."""
        if not self.fired:
            return timed_out
        self.fired_ticks += 1
        return self.watches[0].fired or self.fired_ticks > self.deciding


@dataclass(frozen=True)
class _Interrupted:
    """A step that a reaction has interrupted: where it was, and what it had requested."""

    segment: Segment
    ticks: int
    there: int | None
    began: float
    posture: PostureGoal | None
    target: FloatArray
    stiffness: float
    attentive: bool
    active: list[Goal]
    listening: _Listening


class Player:
    """One plan on one active robot; everything it needs is made here, and nothing has moved then.

    Between :meth:`begin` and :meth:`end` the posture and its stiffness, the base's velocity and the tasks of the steps
    belong to the player; tasks of the user's stay untouched.

    While a reflex holds the posture the steps wait: the controller lets no task act, and the clock stands. A reaction
    that plays steps interrupts the current step, which continues afterwards; meanwhile no other one that plays steps
    answers a touch.

    Args:
        plan: Made for this robot.
        robot: Its description.
        loop: Of the active robot.
        backend: The same robot, to be given its contacts.
        publish: Called with events; must be quick.
        on_step: Called with each step's report as it ends; must be quick.
    """

    def __init__(
        self,
        plan: Plan,
        robot: RobotConfig,
        loop: Loop,
        backend: Backend,
        publish: Callable[[ProgramEvent], None],
        *,
        on_step: OnStep | None = None,
    ) -> None:
        self._plan, self._robot, self._loop = plan, robot, loop
        self._arbiter, self._controller = loop.arbiter, loop.arbiter.controller
        self._publish, self._on_step = publish, on_step
        self._schedule = ContactSchedule(backend, robot)
        self._goals = {
            segment.number: [Goal(task, robot) for _, task in segment.step.tasks()]
            for segment in plan.segments
        }
        self._played: Counter[str] = Counter()
        self._reactions = [
            _Watched(f"reactions.{number}.play", reaction, TouchWatch(reaction.on, robot))
            for number, reaction in enumerate(plan.experiment.reactions)
            if reaction.has_cues or reaction.play
        ]
        self._watches: list[TouchWatch] = []  # of the current blocks
        self._listening = _Listening()  # of the current step
        self._flows: list[Iterator[Segment]] = [self._flow(plan.experiment.steps, "steps")]
        self._interrupted: _Interrupted | None = None
        self._pending: _Watched | None = None
        self._measured = MeasuredModel(robot)
        self._active: list[Goal] = []
        self._posture: PostureGoal | None = None
        self._reports: list[StepReport] = []
        self._waits: list[WaitReport] = []
        self._contacts: list[Contact] = []
        self._reflexes: list[ReflexEvent] = []
        self._stopped_by = ""
        self._waiting = self._over = False
        self._stiffness = loop.arbiter.posture_stiffness
        self._attentive = loop.arbiter.attentive
        self._at_rest = np.zeros(3)
        self._start_time = loop.time
        self._there: int | None = None  # ticks until the targets of the step were reached
        self._reached: bool | None = None

    @property
    def report(self) -> ExperimentReport:
        """Report of what is over."""
        return ExperimentReport(
            name=self._plan.experiment.name,
            seconds=self._loop.time - self._start_time,
            stopped_by=self._stopped_by,
            steps=tuple(self._reports),
            waits=tuple(self._waits),
            contacts=tuple(self._contacts),
            reflexes=tuple(self._reflexes),
            pushes=tuple(self._schedule.pushes),
        )

    @property
    def is_settling(self) -> bool:
        """True during the motion to the first posture of random goals."""
        return self._segment.is_settling

    @property
    def progress(self) -> float:
        """Fraction of the longest time that has passed, 0..1."""
        length = self._plan.experiment.max_length
        return min(1.0, (self._loop.time - self._start_time) / length) if length else 1.0

    def begin(self) -> None:
        """Start the first step, from the next tick on."""
        self._start_time = self._loop.time
        if (stiffness := self._plan.experiment.stiffness) is not None:
            self._arbiter.posture_stiffness = stiffness
        self._set_attentive(self._plan.experiment.attentive)
        self._order_contacts(self._plan.at_begin)
        self._start(next(self._flows[-1]))

    def advance(self) -> bool:
        """Advance after a tick; return True at the end."""
        self._take_in()
        self._schedule.watch(self._loop.time)
        if self._arbiter.holds:
            self._waiting = True
            return False
        if self._waiting:
            self._resume()
            return False
        self._ticks += 1
        if self._pending is not None:
            self._interrupt(self._pending)
            return False
        if not self._step_is_over():
            return False
        following = None if self._gives_up() else self._next()
        self._over = following is None
        self._finish()
        if following is not None:
            self._start(following)
        elif self._interrupted is not None and not self._stopped_by:
            self._over = False
            self._go_back()
        return self._over

    def end(self) -> None:
        """Leave the controller as it was, the robot where it is: at the end, or when the steps are aborted."""
        for goal in self._active:
            self._arbiter.remove(goal.task)
        self._active = []
        if not self._over:
            self._stay(np.ones(len(self._robot.joint_names), dtype=np.bool_))
        self._arbiter.posture_stiffness = self._stiffness
        self._set_attentive(self._attentive)
        self._arbiter.drive(self._at_rest)

    # -- which step follows which -----------------------------------------------------------------------------------

    def _next(self) -> Segment | None:
        return next(self._flows[-1], None)

    def _flow(self, steps: Sequence[AnyStep], key: str) -> Iterator[Segment]:
        """Yield segments as they are played; what decides is asked when the one before is over."""
        for number, step in enumerate(steps):
            here = f"{key}.{number}"
            if isinstance(step, BranchStep):
                yield from self._branch(step, here)
            elif isinstance(step, Step | RandomStep):
                wait = step.wait if isinstance(step, Step) else None
                watches = [] if wait is None else [TouchWatch(wait, self._robot)]
                self._listening = _Listening(watches)
                rounds = self._plan.rounds[here]
                yield from rounds[min(self._played[here], len(rounds) - 1)]
                self._played[here] += 1
            else:
                ((inner, block),) = step.blocks()
                repeat = step.repeat if isinstance(step, RepeatStep) else None
                watches = [TouchWatch(t, self._robot) for _, t in step.triggers()]
                self._watches += watches
                for _ in range(repeat.times if repeat else 1):
                    yield from self._flow(block, f"{here}.{inner}")
                    if any(watch.fired for watch in watches):
                        break
                self._watches = [watch for watch in self._watches if watch not in watches]

    def _branch(self, step: BranchStep, key: str) -> Iterator[Segment]:
        watches = [TouchWatch(case.on, self._robot) for case in step.branch.cases]
        self._listening = _Listening(watches, round(step.branch.deciding / self._robot.cycle))
        yield from self._plan.rounds[f"{key}.branch"][0]
        chosen = next((n for n, watch in enumerate(watches) if watch.fired), len(watches))
        inner, block = list(step.blocks())[chosen]
        yield from self._flow(block, f"{key}.{inner}")

    def _gives_up(self) -> bool:
        """Return True where no touch came and the experiment stops then."""
        wait, listening = self._segment.step.wait, self._listening
        if wait is None:
            return False
        detected, name = listening.fired, self._segment.name
        self._waits.append(WaitReport(step=name, detected=detected))
        if not detected and wait.on_timeout == "stop":
            self._stopped_by = name
        return bool(self._stopped_by)

    # -- touch --------------------------------------------------------------------------------------------------------

    def _take_in(self) -> None:
        """Take in the contacts and reflexes of a tick."""
        record, time = self._loop.latest, self._loop.time
        self._reflexes += [
            e for e in record.events if isinstance(e, ReflexEvent) and e.phase == "begin"
        ]
        contacts = () if record.observation is None else record.observation.contacts
        self._contacts += contacts
        interrupted = self._interrupted.listening.watches if self._interrupted else ()
        for watch in (*self._watches, *self._listening.watches, *interrupted):
            watch.step(contacts, time)
        for watched in self._reactions:
            plays = watched.reaction.play is not None
            # Words too are left out where the steps that belong to them are.
            busy = plays and (self._pending or self._interrupted) is not None
            if watched.watch.step(contacts, time) and not busy and watched.may_react():
                watched.count += 1
                self._publish_cues(watched.reaction)
                if plays:
                    self._pending = watched

    def _interrupt(self, watched: _Watched) -> None:
        """Interrupt the current step, and play the steps of a reaction."""
        self._pending = None
        arbiter = self._arbiter
        self._interrupted = _Interrupted(
            segment=self._segment,
            ticks=self._ticks,
            there=self._there,
            began=self._began,
            posture=self._posture,
            target=arbiter.target.copy(),
            stiffness=arbiter.posture_stiffness,
            attentive=arbiter.attentive,
            active=self._active,
            listening=self._listening,
        )
        for goal in self._active:
            arbiter.remove(goal.task)
        self._active = []
        self._stay(np.ones(len(arbiter.target), dtype=np.bool_))
        self._flows.append(self._flow(watched.reaction.steps, watched.key))
        following = self._next()
        assert following is not None
        self._start(following)

    def _go_back(self) -> None:
        """Continue the step that a reaction has interrupted, smoothly from the present state.

        It reaches its targets in the remaining time, or later. Its clock stands until the robot is back.
        """
        before, self._interrupted = self._interrupted, None
        assert before is not None
        self._flows.pop()
        self._segment, self._began, self._posture = before.segment, before.began, before.posture
        self._ticks, self._there, self._reached = before.ticks, before.there, None
        self._listening = before.listening
        arbiter, step, cycle = self._arbiter, before.segment.step, self._robot.cycle
        arbiter.posture_stiffness = before.stiffness
        self._set_attentive(before.attentive)
        self._reach_again()
        left = max(round((step.duration or 0.0) / cycle) - self._ticks, 0)
        here = self._controller.position - self._controller.dither.position
        seconds = max(return_time(before.target - here, self._controller), left * cycle)
        self._ticks -= round(seconds / cycle) - left
        arbiter.move_to(before.target, seconds)
        for goal in before.active:
            goal.go_on(seconds)
            arbiter.add(goal.task)
            self._active.append(goal)
        self._drive(step)

    # -- steps --------------------------------------------------------------------------------------------------------

    def _start(self, segment: Segment) -> None:
        self._segment, self._ticks, self._began = segment, 0, self._loop.time
        self._there = self._reached = None
        step, fresh = segment.step, self._goals[segment.number]
        if step.stiffness is not None:
            self._arbiter.posture_stiffness = step.stiffness
        self._set_attentive(step.attentive)
        replaced = {goal.name for goal in fresh}
        if step.base_velocity is not None:
            replaced.add("base")
        for goal in self._active:
            if goal.name in replaced:
                self._arbiter.remove(goal.task)
        self._active = [goal for goal in self._active if goal.name not in replaced]
        self._posture = self._posture_goal(step) if step.moves_joints else None
        if self._posture is not None:
            self._arbiter.move_to(self._posture.target, step.duration)
        for goal in fresh:
            goal.begin(self._arbiter, step.duration)
            self._active.append(goal)  # each at once: a later one may be refused
        self._drive(step)
        self._publish(StepEvent(step=segment.name, time=self._loop.time))
        self._publish_cues(step)
        self._order_contacts(segment.contacts)

    def _set_attentive(self, value: bool | None) -> None:
        if value is not None:
            self._loop.set_attentive(value)

    def _drive(self, step: Step) -> None:
        twist = step.base_velocity
        self._arbiter.drive(
            self._at_rest if twist is None else np.array([twist.vx, twist.vy, twist.wz])
        )

    def _order_contacts(self, contacts: Sequence[PlannedContact]) -> None:
        for event in self._schedule.order(contacts, self._loop.time):
            self._publish(event)

    def _publish_cues(self, cues: Cues) -> None:
        for event in CueEvent.of(cues, self._loop.time):
            self._publish(event)

    def _posture_goal(self, step: Step) -> PostureGoal:
        robot = self._robot
        named = np.full(len(robot.joint_names), step.posture is not None)
        named[[robot.joint_index(name) for name in (*step.joints, *step.hands)]] = True
        return PostureGoal(target=goal_posture(step, self._arbiter.target, robot), named=named)

    def _step_is_over(self) -> bool:
        step, cycle = self._segment.step, self._robot.cycle
        if step.wait is not None:
            return self._listening.is_over(self._ticks >= round(step.wait.timeout / cycle))
        if self._there is None:
            length = round((step.duration or 0.0) / cycle)
            if self._ticks < length:
                return False
            if step.until is not None:
                self._reached = self._is_reached(step.tolerance or GOAL_TOLERANCE)
                if not self._reached and self._ticks < round((step.timeout or 0.0) / cycle):
                    return False
            self._there = length if step.until is None else self._ticks
        return self._ticks >= self._there + round(step.hold / cycle)

    def _is_reached(self, tolerance: float) -> bool:
        goals = self._goals[self._segment.number]
        if goals or self._posture is None:
            return all(goal.task.reached(tolerance) for goal in goals)
        return self._posture.reached(self._controller, tolerance)

    def _finish(self) -> None:
        """Report the step, and release the tasks that end here: their joints stay in place."""
        report = self._report_step()
        self._reports.append(report)
        over = [goal for goal in self._active if self._over or not goal.keep]
        for goal in over:
            self._arbiter.remove(goal.task)
        self._active = [goal for goal in self._active if goal not in over]
        if over:
            self._stay(np.any([goal.joints for goal in over], axis=0))
        if self._on_step is not None:
            self._on_step(report)

    def _report_step(self) -> StepReport:
        controller, measurement = self._controller, self._loop.latest.tick.measurement
        goals = []
        if self._posture is not None:
            goals.append(
                GoalReport(
                    name="posture",
                    commanded=self._posture.miss(controller.position - controller.dither.position),
                    measured=self._posture.miss(measurement.position),
                )
            )
        if self._active:
            model = self._measured.at(measurement, controller)
            goals += [
                GoalReport(name=g.name, commanded=g.miss(), measured=g.measured_miss(model))
                for g in self._active
            ]
        return StepReport(
            number=self._segment.number,
            name=self._segment.step.name or "",
            time=measurement.time,
            duration=measurement.time - self._began,
            reached=self._reached,
            goals=tuple(goals),
        )

    # -- waiting for a reflex -----------------------------------------------------------------------------------------

    def _resume(self) -> None:
        """Continue the rest of the step along new splines, from where the reflex left the robot."""
        self._waiting = False
        step, cycle = self._segment.step, self._robot.cycle
        self._reach_again()
        if step.duration is None:
            return  # set-points stand
        length = round(step.duration / cycle)
        left = max(length - self._ticks, 0)
        fresh = max(left, min(length, round(MIN_RESUME_TIME / cycle)))
        self._ticks -= fresh - left
        seconds = max(fresh, 1) * cycle
        if self._posture is not None:
            self._arbiter.move_to(self._posture.target, seconds)
        for goal in self._active:
            goal.go_on(seconds)

    def _reach_again(self) -> None:
        """Restart the wait for the targets: a reflex may have moved the robot away from them."""
        if self._segment.step.until is not None and self._there is not None:
            self._ticks, self._there = self._there, None

    # -- rest ---------------------------------------------------------------------------------------------------------

    def _stay(self, joints: BoolArray) -> None:
        """Request those joints, a mask (17,), where they come to rest without turning round."""
        rest = self._controller.stopping_position(self._arbiter.posture_stiffness, dither=False)
        self._arbiter.move_to(np.where(joints, rest, self._arbiter.target))
