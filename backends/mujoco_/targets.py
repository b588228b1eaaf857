"""Targets of the motor boards: what becomes of a command before a board follows it."""

from __future__ import annotations

import math

import numpy as np

from pepper_driver.backends.simulated import Resumable
from pepper_driver.config import PlantConfig, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Out, Records, kernel, make_records

REST_TIME, REST_SPEED = 0.1, 0.005
"""[s] and [rad/s]: a target that has been slower for so long rests. A drift may then begin, until the next motion."""

TARGET_STREAM = 2
"""Of the random sequences of a seed: the sensors have the ones before."""


class Target:
    """Target of one board: what it is, and its state.

    ``brake`` and ``fast`` are 1.0 where it has a brake, and takes part in fast chases. ``wander`` [rad] is the plant's,
    ``drift_probability`` its ``strays``. ``position`` runs after the command [rad]; ``braked_at`` is where a brake
    holds [rad], ``braked`` 1.0 while it does. What a board is off from it [rad] is ``wandered`` and ``drift``, which
    heads for ``drawn`` while it rests. ``still`` counts the cycles since it moved.
    """

    brake: float
    fast: float
    wander: float
    drift_probability: float
    position: float
    braked_at: float
    braked: float
    wandered: float
    drift: float
    drawn: float
    still: float


@kernel
def plan_cycle(
    targets: Out[Records[Target]],
    position: FloatArray,
    stiffness: FloatArray,
    reach: float,
    reach_fast: float,
    resting: float,
    steps: int,
    now: Out[FloatArray],
    held: Out[FloatArray],
    increment: Out[FloatArray],
) -> bool:
    """Plan how the boards' targets run over the steps of a cycle; return True if one falls behind its command.

    Args:
        targets: Of the boards.
        position: (n,) command [rad].
        stiffness: (n,) 0..1.
        reach: Furthest way of a target in a cycle [rad].
        reach_fast: The same of one that takes part in fast chases [rad].
        resting: Way in a cycle below which a target rests [rad].
        steps: Of physics in a cycle.
        now: (n,) what the boards follow at the beginning [rad].
        held: (n,) stiffness of the boards: a closed brake holds like a board at full stiffness.
        increment: (n,) change of what they follow in each step [rad].
    """
    behind = False
    for j in range(len(position)):
        target = targets[j]
        goal, held[j] = position[j], stiffness[j]
        # A brake holds where it closed; it stays until the stiffness returns.
        target.braked = 1.0 if target.brake != 0.0 and stiffness[j] <= 0.0 else 0.0
        if target.braked != 0.0:
            goal, held[j] = target.braked_at, 1.0
        target.braked_at = goal
        limit = reach_fast if target.fast != 0.0 else reach
        way = min(max(goal - target.position, -limit), limit)
        # By the usual limit, fast or not: so a chase lasts as long as the command outruns it.
        behind = behind or abs(goal - target.position) > reach
        now[j] = target.position + (target.wandered + target.drift)
        increment[j] = way / steps
        target.position += way
        target.still = target.still + 1.0 if abs(way) < resting else 0.0
    return behind


@kernel
def let_drift(
    targets: Out[Records[Target]],
    rest_cycles: float,
    memory: float,
    lowest: float,
    highest: float,
    normal: FloatArray,
    chance: FloatArray,
    place: FloatArray,
    steps: int,
    increment: Out[FloatArray],
) -> None:
    """Move what the boards follow off their targets; called after :func:`plan_cycle`.

    Args:
        targets: Of the boards.
        rest_cycles: Cycles after which a target rests.
        memory: Fraction of what has wandered that is left after a cycle.
        lowest: Size of a drift at least [rad].
        highest: And at most.
        normal: (n,) normal noise.
        chance: (n,) even noise, 0..1.
        place: (n,) the same.
        steps: Of physics in a cycle.
        increment: (n,) change in each step [rad], to be added to.
    """
    for j in range(len(targets)):
        target = targets[j]
        if target.braked != 0.0:
            continue
        before = target.wandered + target.drift
        spread = math.sqrt(1.0 - memory * memory) * target.wander
        target.wandered = memory * target.wandered + spread * normal[j]
        if target.still == rest_cycles:
            target.drawn = 0.0
            if chance[j] < target.drift_probability:
                # Small ones are seen more often: even in the reciprocal of the size. Either side is as likely.
                side = 2.0 * place[j] - 1.0
                reciprocal = 1.0 / lowest + abs(side) * (1.0 / highest - 1.0 / lowest)
                target.drawn = math.copysign(1.0 / reciprocal, side)
        elif target.still == 0.0:
            target.drawn = 0.0
        step = highest / rest_cycles
        target.drift += min(max(target.drawn - target.drift, -step), step)
        increment[j] += (target.wandered + target.drift - before) / steps


class BoardTargets(Resumable):
    """Brakes, limiter, wander and drift of the 17 boards; arrays are (17,), in joint order.

    Recordings of a real Pepper show joints that run at 2 rad/s while their commands are faster, twice as fast in some
    chases; currents that creep while the joint stands; and rests degrees off the goal that no current works against.
    All three fit a board that follows something else than its command. See :class:`~..config.plant_parts.Targets`.

    Attributes:
        now: What the boards follow at the beginning of the cycle [rad].
        increment: Its change in each step of the cycle [rad].
        held: Stiffness of the boards in the cycle.
    """

    STATE = ("_targets", "_chasing", "_fast", "_rng")

    def __init__(self, robot: RobotConfig, plant: PlantConfig, steps: int) -> None:
        names, settings = robot.joint_names, plant.targets
        n = len(names)
        self._steps = steps
        limit = settings.speed_limit
        self._reach = math.inf if limit is None else limit * robot.cycle
        self._fast_chases = settings.fast_chases
        self._resting = REST_SPEED * robot.cycle
        self._rest_cycles = float(round(REST_TIME / robot.cycle))
        self._memory = math.exp(-robot.cycle / settings.wander_time)
        self._drift_sizes = settings.stray
        self._targets = make_records(
            Target,
            n,
            brake=np.array([float(name in plant.board.brakes) for name in names]),
            fast=np.array([float(name in settings.fast_joints) for name in names]),
            wander=plant.per_joint("wander", robot),
            drift_probability=plant.per_joint("strays", robot),
        )
        self._drifts = bool(
            self._targets["wander"].any() or self._targets["drift_probability"].any()
        )
        self.now, self.increment, self.held = np.zeros(n), np.zeros(n), np.zeros(n)
        self._plan, self._let_drift = plan_cycle.load(), let_drift.load()
        self.reset(np.zeros(n), 0)

    def reset(self, posture: FloatArray, seed: int) -> None:
        """Be at rest at ``posture`` [rad], with the random sequence of a seed to come."""
        sequence = np.random.SeedSequence(seed, spawn_key=(TARGET_STREAM,))
        self._rng = np.random.Generator(np.random.PCG64(sequence))
        for name in ("wandered", "drift", "drawn"):
            self._targets[name] = 0.0
        self._targets["position"] = self._targets["braked_at"] = posture
        # As if it had rested for long: no drift is drawn before it has moved.
        self._targets["still"] = self._rest_cycles + 1.0
        self._chasing = self._fast = False

    def plan(self, position: FloatArray, stiffness: FloatArray) -> None:
        """Plan the next cycle towards a command: ``position`` [rad], ``stiffness`` 0..1."""
        reach_fast = 2.0 * self._reach if self._fast else self._reach
        behind = self._plan(
            self._targets,
            position,
            stiffness,
            self._reach,
            reach_fast,
            self._resting,
            self._steps,
            self.now,
            self.held,
            self.increment,
        )
        if behind and not self._chasing:
            # One draw for the robot: in recordings joints are fast together.
            self._fast = bool(self._fast_chases) and self._rng.random() < self._fast_chases
        self._chasing = behind
        self._fast = self._fast and behind
        if self._drifts:
            n = len(position)
            normal, even = self._rng.standard_normal(n), self._rng.random((2, n))
            self._let_drift(
                self._targets,
                self._rest_cycles,
                self._memory,
                *self._drift_sizes,
                normal,
                even[0],
                even[1],
                self._steps,
                self.increment,
            )
