"""Friction of joints, and the currents that carry them, from slow sweeps in both directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.controller import RobotModel
from pepper_driver.observer import Recording

MIN_SPEED = 0.04
"""[rad/s] of the desired motion: slower, a joint may stick."""

MAX_SPEED = 0.4
"""[rad/s]: faster, viscous friction and inertia count."""

SETTLING = 0.25
"""[s] of motion in one direction before its samples count: gap and friction turn round first."""

MIN_SAMPLES = 150
"""In each direction."""

MIN_LOAD_RANGE = 0.3
"""[N m] over which the load of a joint must change before its currents say how strong its motor is."""

SMALL_CURRENT = 2.0
"""Steps of the current sensor, on average in a sweep: of smaller currents noise and steps change the size."""

MIN_EVIDENCE = 5.0
"""By which a friction must raise the log-likelihood of such currents, else noise alone explains them."""

MISREAD = 0.01
"""Fraction of readings that may be anything: single ones must not decide."""

GRAVITY = 9.81
"""[m/s2]"""


@dataclass(frozen=True, kw_only=True)
class HeldWeight:
    """Known weight that hangs from a hand.

    Attributes:
        mass: [kg]
        link: That carries it.
        xyz: Where it hangs, in the frame of the link [m].
    """

    mass: float
    link: str
    xyz: tuple[float, float, float]

    def __str__(self) -> str:
        return f"{self.mass:g} kg at {self.link}"


@dataclass(frozen=True, kw_only=True)
class MeasuredFriction:
    """Torques of one joint that its current shows, by the documented torque constant.

    Attributes:
        friction: Coulomb friction, as the motor's torque [N m].
        load_scale: Torque of the motor per torque that the model of the robot asks for, 1 where both are as documented;
            None where the load changes too little to say.
    """

    friction: float
    load_scale: float | None


def measure_friction(
    recordings: Sequence[Recording], joint: str, robot: RobotConfig
) -> MeasuredFriction | None:
    """Measure the friction of a joint that sweeps slowly to and fro.

    The current has no sign. Its size is fitted by abs(F d + s tau + c): friction F against the direction d of the
    motion, load tau of the model of the robot with its scale s, and a constant c. Where the current is as small as the
    steps of its sensor, as at a wrist, noise makes its size larger on average: it is fitted too.

    Args:
        recordings: With the sweeps of the joint, and perhaps others.
        joint: Its name.
        robot: Its description.

    Returns:
        None where the joint does not move slowly in both directions, or its current shows no friction.
    """
    index = robot.joint_index(joint)
    parts = [_sweep(run, index) for run in recordings]
    current, direction, load = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    if min(np.count_nonzero(direction > 0), np.count_nonzero(direction < 0)) < MIN_SAMPLES:
        return None
    constant = robot.motors.joint_torque_constant(joint)
    torque, step = constant * current, constant * robot.sensors.current.step
    if float(torque.mean()) < SMALL_CURRENT * step:
        small = _fit_small(torque, direction, load, step)
        return None if small is None else MeasuredFriction(friction=small, load_scale=None)
    scaled = float(np.ptp(load)) > MIN_LOAD_RANGE
    friction, scale = _fit(torque, direction, load, scaled=scaled)
    return MeasuredFriction(friction=friction, load_scale=scale if scaled else None)


def measure_dead_band(
    recordings: Sequence[Recording], joint: str, robot: RobotConfig
) -> float | None:
    """Measure the error that a joint needs before it moves, to either side [rad].

    It is the dead band of its board, and its friction over the stiffness of its board; under a load that keeps the
    torque on one side, the friction alone. The tracking error of slow motion is fitted by h d + l v + g tau + c, with
    the direction d, speed v and load tau. No current is needed.

    Args:
        recordings: With slow sweeps of the joint to and fro, and perhaps others.
        joint: Its name.
        robot: Its description.

    Returns:
        h, 0 or more; None where the joint does not move slowly in both directions.
    """
    index, rows, errors = robot.joint_index(joint), [], []
    for run in recordings:
        settled = slow_samples(run, index)
        velocity = run.velocity[settled, index]
        load = run.load_torque[settled, index]
        rows.append(np.stack((np.sign(velocity), velocity, load, np.ones_like(load)), axis=1))
        errors.append(run.tracking_error(index)[settled])
    columns, error = np.concatenate(rows), np.concatenate(errors)
    if min(np.count_nonzero(columns[:, 0] > 0), np.count_nonzero(columns[:, 0] < 0)) < MIN_SAMPLES:
        return None
    return max(float(np.linalg.lstsq(columns, error, rcond=None)[0][0]), 0.0)


def measure_torque_scale(
    without: Sequence[Recording],
    loaded: Sequence[Recording],
    joint: str,
    weight: HeldWeight,
    robot: RobotConfig,
) -> float | None:
    """Measure the motor's torque, by the documented constant, per torque that arrives at the joint.

    The same sweeps with a known weight in the hand: masses of the robot are not needed.

    Args:
        without: Sweeps with empty hands.
        loaded: The same with the weight.
        joint: A joint that carries the hand.
        weight: In the hand.
        robot: Its description.

    Returns:
        1 for gears without losses and motors as documented, more for others; None where the weight loads the joint too
        little, or it does not move.
    """
    index, constant = robot.joint_index(joint), robot.motors.joint_torque_constant(joint)
    empty = [_sweep(run, index) for run in without]
    held = [_sweep(run, index) for run in loaded]
    extra = [_weight_torque(run, index, weight, robot) for run in loaded]
    current, direction, load = (np.concatenate(columns) for columns in zip(*empty, strict=True))
    current_held, direction_held, load_held = (
        np.concatenate(columns) for columns in zip(*held, strict=True)
    )
    added = np.concatenate(extra)
    counts = [np.count_nonzero(d == s) for d in (direction, direction_held) for s in (1.0, -1.0)]
    if min(counts) < MIN_SAMPLES or float(np.abs(added).max()) < MIN_LOAD_RANGE:
        return None
    return _fit_weight(
        constant * np.concatenate((current, current_held)),
        np.concatenate((direction, direction_held)),
        np.concatenate((load, load_held)),
        np.concatenate((np.zeros(len(load)), added)),
    )


def _weight_torque(
    run: Recording, index: int, weight: HeldWeight, robot: RobotConfig
) -> FloatArray:
    """Return the torque that a weight asks of a joint in the samples of slow motion [N m]."""
    model, point = RobotModel(robot), np.array(weight.xyz)
    postures = run.position[slow_samples(run, index)]
    # The weight hangs straight down from a robot that stands upright.
    return np.array(
        [
            weight.mass * GRAVITY * model.point_jacobian(weight.link, point, posture)[2, index]
            for posture in postures
        ]
    )


def _fit_weight(
    torque: FloatArray, direction: FloatArray, load: FloatArray, added: FloatArray
) -> float:
    """Return the scale of the added load that explains the (n,) size of the motor's torque with and without it."""
    from scipy.optimize import least_squares

    def misfit(point: FloatArray) -> FloatArray:
        friction, constant, scale, added_scale = point
        sum_ = friction * direction + scale * load + constant + added_scale * added
        error: FloatArray = np.abs(sum_) - torque
        return error

    spread = max(float(np.percentile(torque, 75)), 1e-3)
    best = None
    for fraction in (0.1, 0.4, 0.8):
        for added_scale in (1.0, 2.0, 3.0):
            end = least_squares(
                misfit,
                (fraction * spread, 0.0, added_scale, added_scale),
                bounds=((0.0, -np.inf, 0.0, 0.2), (np.inf, np.inf, 8.0, 8.0)),
                loss="soft_l1",
                f_scale=0.05 * spread,
            )
            if best is None or end.cost < best.cost:
                best = end
    assert best is not None
    return float(best.x[3])


def _sweep(run: Recording, index: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return current [A], direction, and load torque [N m] of the samples of slow motion."""
    settled = slow_samples(run, index)
    direction = np.sign(run.velocity[settled, index])
    return run.current[settled, index], direction, run.load_torque[settled, index]


def slow_samples(run: Recording, index: int) -> BoolArray:
    """Return (n,) True in slow motion whose friction has turned round."""
    speed = run.velocity[:, index]
    direction = np.sign(speed)
    slow = (np.abs(speed) > MIN_SPEED) & (np.abs(speed) < MAX_SPEED) & run.usable(index)
    settled = np.zeros(len(run), dtype=np.bool_)
    ticks, count = round(SETTLING / run.cycle), 0
    for k in range(1, len(run)):
        count = count + 1 if slow[k] and direction[k] == direction[k - 1] else 0
        settled[k] = count > ticks
    return settled


def _fit(
    torque: FloatArray, direction: FloatArray, load: FloatArray, *, scaled: bool
) -> tuple[float, float]:
    """Return friction [N m] and scale of the load that explain the (n,) size of the motor's torque [N m]."""
    # Imported for identification only: the import is slow.
    from scipy.optimize import least_squares

    def misfit(point: FloatArray) -> FloatArray:
        friction, constant, scale = point
        error: FloatArray = np.abs(friction * direction + scale * load + constant) - torque
        return error

    spread = max(float(np.percentile(torque, 75)), 1e-3)
    best = None
    # The size of a sum has several minima: without friction, without a constant, and between.
    for fraction in (0.1, 0.4, 0.8):
        for constant in (-0.5, 0.0, 0.5):
            end = least_squares(
                misfit,
                (fraction * spread, constant * spread, 1.5),
                bounds=((0.0, -np.inf, 0.2 if scaled else 1.0), (np.inf, np.inf, 8.0)),
                loss="soft_l1",
                f_scale=0.05 * spread,
            )
            if best is None or end.cost < best.cost:
                best = end
    assert best is not None
    return float(best.x[0]), float(best.x[2])


def _fit_small(
    torque: FloatArray, direction: FloatArray, load: FloatArray, step: float
) -> float | None:
    """Return the friction [N m] that makes (n,) readings in whole steps [N m] most likely, at the best noise.

    None where noise alone makes them about as likely.
    """
    from scipy.optimize import minimize
    from scipy.special import ndtr

    # Each reading stands for all sizes that it is the nearest step of.
    lower, upper = np.maximum(torque - 0.5 * step, 0.0), torque + 0.5 * step
    # Also those that noise has turned round.
    bounds = np.stack((upper, -lower, lower, -upper))
    anything = MISREAD * step / (float(torque.max()) + step)

    def unlikelihood(point: FloatArray) -> float:
        friction, scale, constant, log_noise = point
        true = friction * direction + scale * load + constant
        parts = ndtr((bounds - true) / np.exp(log_noise))
        fractions = parts[0] - parts[2] + parts[1] - parts[3]
        return -float(np.log((1.0 - MISREAD) * fractions + anything).sum())

    mean = float(torque.mean())
    quiet, half, loud = (float(np.log(part * step)) for part in (0.1, 0.5, 4.0))

    def best(max_friction: float | None) -> tuple[float, float]:
        """Return the best friction up to a largest one, and how unlikely the readings are then."""
        ends = [
            minimize(
                unlikelihood,
                np.array((0.5 * mean, 1.5, constant * mean, half)),
                method="L-BFGS-B",
                bounds=((0.0, max_friction), (0.2, 8.0), (None, None), (quiet, loud)),
            )
            for constant in (-0.5, 0.0, 0.5)
        ]
        end = min(ends, key=lambda end: end.fun)
        return float(end.x[0]), float(end.fun)

    friction, unlikely = best(None)
    _, without = best(0.0)
    return friction if without - unlikely > MIN_EVIDENCE else None
