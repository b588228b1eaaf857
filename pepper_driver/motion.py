"""Playing of motions: the tasks of one step after the other, and their removal at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from pepper_driver.callbacks.events import StepEvent
from pepper_driver.config import Motion, MotionStep, RobotConfig, check_motion
from pepper_driver.loop import Loop
from pepper_driver.motion_goals import Goal, Measured, PostureGoal
from pepper_driver.motion_report import GoalReport, MotionReport, StepReport

TOLERANCE = 0.01
"""[m] and [rad] of a step that waits for its targets and gives none."""

AFRESH = 1.0
"""[s] A way goes on for at least this long after a reflex let go."""

OnStep = Callable[[StepReport], None]


class Conductor:
    """Says which step follows which, and goes along with them; this one plays the motion as it is written.

    All of it happens inside ticks and must be quick.
    """

    def order(self, motion: Motion) -> Iterable[int]:
        """Return the numbers of the steps as they are played."""
        return list(range(len(motion.steps))) * motion.repeat

    def begin(self, number: int) -> None:
        """A step begins."""

    def ends_early(self, number: int) -> bool:
        """Return True to end the step under way before its time; asked after every tick in which no reflex holds."""
        return False

    def goes_on(self, number: int) -> bool:
        """Return True where another step may follow one that is over."""
        return True


class Player:
    """One motion on one active robot; everything it needs is made here, and nothing has moved then.

    Between :meth:`begin` and :meth:`end` the posture and its stiffness, the base's velocity and the motion's tasks
    belong to the player; tasks of the user's stay untouched.

    While a reflex holds the posture the motion waits: the controller lets no task act, and the clock stands.

    Args:
        motion: What to play.
        robot: Its description.
        loop: Of the active robot.
        on_step: Told each step's report as it ends; must be quick.
        on_begin: Told that a step begins; must be quick.
        conductor: By default one that plays the motion as it is written.

    Raises:
        ConfigError: The robot cannot play the motion.
    """

    def __init__(
        self,
        motion: Motion,
        robot: RobotConfig,
        loop: Loop,
        *,
        on_step: OnStep | None = None,
        on_begin: Callable[[StepEvent], None] | None = None,
        conductor: Conductor | None = None,
    ) -> None:
        check_motion(motion, robot)
        self._motion, self._robot, self._loop = motion, robot, loop
        self._arbiter, self._controller = loop.arbiter, loop.arbiter.controller
        self._on_step, self._on_begin = on_step, on_begin
        self._conductor = conductor or Conductor()
        self._plan = [[Goal(task, robot) for _, task in step.tasks()] for step in motion.steps]
        self._measured = Measured(robot)
        self._order: Iterator[int] = iter(self._conductor.order(motion))
        self._active: list[Goal] = []
        self._posture: PostureGoal | None = None
        self._reports: list[StepReport] = []
        self._waiting = self._over = False
        self._stiffness = loop.arbiter.posture_stiffness
        self._at_rest = np.zeros(3)

    @property
    def report(self) -> MotionReport:
        """Report of the steps that are over."""
        return MotionReport(name=self._motion.name, steps=tuple(self._reports))

    def begin(self) -> None:
        """Start the first step, from the next tick on."""
        self._start(next(self._order))

    def advance(self) -> bool:
        """Go on after a tick; True once the motion is over."""
        if self._arbiter.holds:
            self._waiting = True
            return False
        if self._waiting:
            self._resume()
            return False
        self._ticks += 1
        if not self._step_is_over():
            return False
        goes_on = self._conductor.goes_on(self._number)
        following = next(self._order, None) if goes_on else None
        self._over = following is None
        self._finish()
        if following is not None:
            self._start(following)
        return self._over

    def end(self) -> None:
        """Leave the controller as it was, the robot where it is: at the end, or wherever the motion was broken off."""
        for goal in self._active:
            self._arbiter.remove(goal.task)
        self._active = []
        if not self._over:
            self._stay(np.ones(len(self._robot.joint_names), dtype=np.bool_))
        self._arbiter.posture_stiffness = self._stiffness
        self._arbiter.drive(self._at_rest)

    # -- steps --------------------------------------------------------------------------------------------------

    @property
    def _step(self) -> MotionStep:
        return self._motion.steps[self._number]

    def _start(self, number: int) -> None:
        self._number, self._ticks, self._began = number, 0, self._loop.time
        self._there: int | None = None
        self._reached: bool | None = None
        step, fresh = self._step, self._plan[number]
        if step.stiffness is not None:
            self._arbiter.posture_stiffness = step.stiffness
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
        twist = step.base_velocity
        self._arbiter.drive(
            self._at_rest if twist is None else np.array([twist.vx, twist.vy, twist.wz])
        )
        if self._on_begin is not None:
            self._on_begin(StepEvent(step=step.name or str(number), time=self._loop.time))
        self._conductor.begin(number)

    def _posture_goal(self, step: MotionStep) -> PostureGoal:
        robot, target = self._robot, self._arbiter.target.copy()
        named = np.zeros(len(target), dtype=np.bool_)
        if step.posture is not None:
            target, named[:] = robot.posture(step.posture), True
        for name, angle in {**step.joints, **step.hands}.items():
            index = robot.joint_index(name)
            target[index], named[index] = angle, True
        return PostureGoal(target=target, named=named)

    def _step_is_over(self) -> bool:
        step, cycle = self._step, self._robot.cycle
        if self._conductor.ends_early(self._number):
            return True
        if self._there is None:
            way = round((step.duration or 0.0) / cycle)
            if self._ticks < way:
                return False
            if step.until is not None:
                self._reached = self._is_reached(step.tolerance or TOLERANCE)
                if not self._reached and self._ticks < round((step.timeout or 0.0) / cycle):
                    return False
            self._there = way if step.until is None else self._ticks
        return self._ticks >= self._there + round(step.hold / cycle)

    def _is_reached(self, tolerance: float) -> bool:
        goals = self._plan[self._number]
        if goals or self._posture is None:
            return all(goal.task.reached(tolerance) for goal in goals)
        return self._posture.reached(self._controller, tolerance)

    def _finish(self) -> None:
        """Report, and let go of the tasks that end here: their joints stay where they are."""
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
        model = self._measured.at(measurement, controller)
        goals = [
            GoalReport(
                name=goal.name,
                commanded=goal.miss(),
                measured=goal.measured_miss(model),
            )
            for goal in self._active
        ]
        if self._posture is not None:
            own = GoalReport(
                name="posture",
                commanded=self._posture.miss(controller.position),
                measured=self._posture.miss(measurement.position),
            )
            goals.insert(0, own)
        return StepReport(
            number=self._number,
            name=self._step.name or "",
            time=measurement.time,
            duration=measurement.time - self._began,
            reached=self._reached,
            goals=tuple(goals),
        )

    # -- waiting for a reflex -----------------------------------------------------------------------------------

    def _resume(self) -> None:
        """Go on with what is left of the step, along new splines from where the reflex left the robot."""
        self._waiting = False
        if self._step.until is not None:
            self._there = None  # the reflex may have led the robot away again
        if self._step.duration is None:
            return  # set-points stand
        cycle = self._robot.cycle
        way = round(self._step.duration / cycle)
        left = max(way - self._ticks, min(way, round(AFRESH / cycle)))
        self._ticks = way - left
        seconds = max(left, 1) * cycle
        if self._posture is not None:
            self._arbiter.move_to(self._posture.target, seconds)
        for goal in self._active:
            goal.go_on(seconds)

    # -- rest ---------------------------------------------------------------------------------------------------

    def _stay(self, joints: NDArray[np.bool_]) -> None:
        """Want those joints, a mask (17,), where they come to rest without turning round."""
        rest = self._controller.rest(self._arbiter.posture_stiffness)
        self._arbiter.move_to(np.where(joints, rest, self._arbiter.target))
