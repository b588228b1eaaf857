"""Quality of recordings for fitting: excitation, touches, currents at their limit, gaps, constants at their bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pepper_driver.config import load_observer_settings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.identification.dataset import IdentificationDataset, JointDataset
from pepper_driver.identification.runs import run_name
from pepper_driver.observer import FusionModel, JointModel, Recording, predict_recording
from pepper_driver.observer.fitting.bounds import free_residual
from pepper_driver.observer.fitting.samples import (
    WORKING_ERROR,
    clipped_current,
    fit_samples,
)
from pepper_driver.observer.fitting.stick_slip import START_UP_TIME, bounded_constants
from pepper_driver.observer.recording import STALE_AGE

Kind = Literal[
    "excitation",
    "contact",
    "current",
    "gaps",
    "stale",
    "limited",
    "bound",
    "behind",
    "blind",
    "weight",
    "wander",
]

MIN_RANGE = 0.1
"""[rad] Smallest range of a joint's motion: less is close to the errors that must be detected."""

MIN_SPEED = 0.1
"""[rad/s] Largest desired speed of a joint."""

MIN_REVERSALS = 20
"""In all estimation runs together: friction shows where the motion turns round."""

AT_REST = 0.02
"""[rad/s] A joint that is commanded slower rests."""

MAX_ALTERED_FRACTION = 0.01
"""Of the samples of a run: more that are missing, stale or altered are worth a word."""

LONG_GAP = 0.1
"""[s] So is a single gap as long as this."""

BURST = 3.5
"""Robust standard deviations by which the logarithm of a run's largest residual may lie above that of other runs."""

MIN_SPREAD = 0.2
"""Of that logarithm: few runs may be similar by chance."""

MIN_BURST = np.radians(0.5)
"""[rad] Residual beyond that of other runs that raises no warning."""

SLOWER = 0.8
"""Fraction of the fastest command below which the fastest motion of such a joint is limited."""

SPEED_TIME = 0.06
"""[s] over which measured and commanded speeds are compared."""

WANDER_TIME = 1.0
"""[s] over which the mean of an error is taken: slower is what a target that wanders does."""

MIN_WANDER_RATIO = 0.5
"""Fraction of the variance of what a model leaves over that is slow, where a target wanders. Recorded joints with lags,
friction or loads that are not known have 0.1: their motion explains the rest."""

_DELAY, _LOAD = (
    "is the delay right?",
    "a load that the robot's description does not have, or an encoder that is off",
)
_STIFFNESS = "neither load nor current shows how stiff its board is"

BOUND_CAUSES = {
    "transport": (
        f"the joint answers earlier than the backend reports; {_DELAY}",
        f"the joint answers later than the backend reports; {_DELAY}",
    ),
    "lag": (
        "the joint does not lag at all, its board leads",
        "the joint falls far behind, as where its speed is limited; use a slower motion",
    ),
    "offset": (_LOAD, _LOAD),
    "load_gain": (_STIFFNESS, _STIFFNESS),
}
"""Likely causes of a constant at its lower and at its upper bound, by its name."""

BOUND_CAUSE = "the model does not describe this joint, or the motion is too uniform"
"""For the other ones."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Something wrong with recordings.

    Attributes:
        kind: What it is.
        joint: Whose data; None for all joints.
        run: Name of the run; None for all of the joint's.
        text: For people.
    """

    kind: Kind
    joint: str | None
    run: str | None
    text: str


def inspect_recordings(
    recordings: IdentificationDataset, models: Mapping[str, JointModel]
) -> tuple[Finding, ...]:
    """All that is wrong with recordings; empty when they are good.

    Args:
        recordings: As they were recorded.
        models: By joint, fitted to them; joints without one are not searched for touches.
    """
    found: list[Finding] = []
    for entry in recordings.sweeps:
        if entry.estimation:
            found.extend(_excitation(entry))
        for name, run in zip(entry.names, entry.runs, strict=True):
            found.extend(_holes(name, run, entry.joint))
            found.extend(_clipped(name, run, entry.joint))
            found.extend(_behind(name, run, entry.joint))
        if entry.estimation and entry.joint in models:
            found.extend(_constants(entry.joint, models[entry.joint]))
        if entry.joint in models:
            found.extend(_bursts(entry.joint, entry.names, entry.runs, models[entry.joint]))
    runs = recordings.calibration
    names = [run_name("calibration", number) for number in range(1, len(runs) + 1)]
    for name, run in zip(names, runs, strict=True):
        found.extend(_holes(name, run, None))
    for joint, model in models.items():
        found.extend(_bursts(joint, names, runs, model))
    return tuple(found)


def wandering_targets(
    recordings: IdentificationDataset, models: Mapping[str, JointModel]
) -> tuple[Finding, ...]:
    """Joints whose error changes slowly, in motion and at rest, without a reason in their motion.

    The target of such a board wanders. That is no fault of the recordings, and a cause of poor models.

    Args:
        recordings: As they were recorded.
        models: By joint, fitted to them; only those of kind ``fusion`` count.
    """
    found = []
    for entry in recordings.sweeps:
        model = models.get(entry.joint)
        size = _wander(entry, model) if isinstance(model, FusionModel) else None
        if size is not None:
            text = (
                f"its error changes slowly by {np.degrees(size):.1f} deg to either side without a reason in its "
                "motion: the target of its board wanders, which no model knows"
            )
            found.append(Finding(kind="wander", joint=entry.joint, run=None, text=text))
    return tuple(found)


def _wander(entry: JointDataset, model: FusionModel) -> float | None:
    """Return by how much the error of a joint changes slowly, nine tenths of the time [rad]; None where it does not.

    What its motion explains is no wander, whatever a model says of it: friction, lag, and a load that it does not know.
    """
    residuals, columns = [], []
    for run in entry.runs:
        residual = run.tracking_error(entry.index) - predict_recording(model, entry.joint, run)
        residual[~fit_samples(run, entry.index)] = np.nan
        residual[: round(START_UP_TIME / run.cycle)] = np.nan
        velocity = run.velocity[:, entry.index]
        direction = np.where(np.abs(velocity) > AT_REST, np.sign(velocity), 0.0)
        position, load = run.reference_position[:, entry.index], run.load_torque[:, entry.index]
        residuals.append(residual)
        columns.append(np.stack((position, velocity, direction, load, np.ones_like(load)), axis=1))
    residual, motion = np.concatenate(residuals), np.concatenate(columns)
    seen = np.isfinite(residual)
    explained = np.linalg.lstsq(motion[seen], residual[seen], rcond=None)[0]
    slow = np.concatenate(
        [
            _running_mean(left - of_run @ explained, max(1, round(WANDER_TIME / run.cycle)))
            for left, of_run, run in zip(residuals, columns, entry.runs, strict=True)
        ]
    )
    slow = slow[np.isfinite(slow)]
    if not len(slow) or not slow.var() > MIN_WANDER_RATIO * residual[seen].var():
        return None
    low, high = np.percentile(slow, [5, 95])
    return float(high - low) / 2.0


def _running_mean(values: FloatArray, ticks: int) -> FloatArray:
    """Return the (n,) mean of that many samples around each; NaN where more than half of them are not known."""
    known = np.isfinite(values)
    padded = np.pad(np.stack((known, np.where(known, values, 0.0))), ((0, 0), (ticks // 2, ticks)))
    sums = np.lib.stride_tricks.sliding_window_view(padded, ticks, axis=1).sum(axis=2)
    count, total = sums[:, : len(values)]
    return np.where(count > ticks / 2, total / np.maximum(count, 1.0), np.nan)


def _excitation(entry: JointDataset) -> list[Finding]:
    position = np.concatenate([run.position[:, entry.index] for run in entry.estimation])
    speed = max(float(np.abs(run.velocity[:, entry.index]).max()) for run in entry.estimation)
    turns = sum(_reversals(run.velocity[:, entry.index]) for run in entry.estimation)
    span = float(np.ptp(position))
    problems = []
    if span < MIN_RANGE:
        problems.append(f"it moves over {span:.3f} rad only")
    if speed < MIN_SPEED:
        problems.append(f"at {speed:.3f} rad/s at most")
    if turns < MIN_REVERSALS:
        problems.append(f"it turns round {turns} times in all, not {MIN_REVERSALS}")
    if not problems:
        return []
    text = f"too little excitation: {', '.join(problems)}; use a motion that asks for more"
    return [Finding(kind="excitation", joint=entry.joint, run=None, text=text)]


def _reversals(velocity: FloatArray) -> int:
    """Count the reversals of a motion."""
    moving = np.sign(velocity[np.abs(velocity) > AT_REST])
    return int(np.count_nonzero(np.diff(moving)))


def _holes(name: str, run: Recording, joint: str | None) -> list[Finding]:
    """Find samples that are missing, stale, or answer a command that the safety gate altered."""
    found = []
    steps = np.diff(run.time)
    cycle = float(np.median(steps))
    # Rounded: the robot's clock jitters by less than half a cycle.
    missing = float(np.maximum(np.round(steps / cycle) - 1, 0).sum()) / len(steps)
    longest = float(steps.max())
    if missing > MAX_ALTERED_FRACTION or longest > LONG_GAP:
        text = (
            f"{100 * missing:.1f} % of the samples are missing, the longest gap is {longest:.2f} s"
        )
        found.append(Finding(kind="gaps", joint=joint, run=name, text=text))
    stale = float(np.mean(run.age > STALE_AGE))
    if stale > MAX_ALTERED_FRACTION:
        text = f"{100 * stale:.1f} % of the samples are older than {1e3 * STALE_AGE:.0f} ms"
        found.append(Finding(kind="stale", joint=joint, run=name, text=text))
    altered = run.limited if joint is None else run.limited[:, [run.joint_names.index(joint)]]
    fraction = altered.mean(axis=0)
    if fraction.max() > MAX_ALTERED_FRACTION:
        worst = joint or run.joint_names[int(fraction.argmax())]
        text = f"the safety gate altered {100 * fraction.max():.1f} % of the commands of {worst}"
        found.append(Finding(kind="limited", joint=worst, run=name, text=text))
    return found


def _clipped(name: str, run: Recording, joint: str) -> list[Finding]:
    """Return a current that stays at its maximum while the joint shall move: the board gives no more."""
    clipped = clipped_current(run, run.joint_names.index(joint))
    if clipped is None:
        return []
    text = f"its current stays at {clipped.limit:.2f} A for {clipped.seconds:.1f} s: clipped, the joint cannot follow"
    return [Finding(kind="current", joint=joint, run=name, text=text)]


def _behind(name: str, run: Recording, joint: str) -> list[Finding]:
    """Return a joint that runs slower than its command: a limiter, or a motor at its limit, that no model knows."""
    index = run.joint_names.index(joint)
    late = float(np.abs(run.tracking_error(index)).max())
    ticks = max(1, round(SPEED_TIME / run.cycle))
    if late < WORKING_ERROR or len(run) <= ticks:
        return []
    commanded, ran = (
        float(np.abs(values[ticks:, index] - values[:-ticks, index]).max()) / (ticks * run.cycle)
        for values in (run.sent_position, run.position)
    )
    if ran > SLOWER * commanded:
        return []
    text = (
        f"falls {late:.2f} rad behind: it runs at {ran:.2f} rad/s at most, commanded {commanded:.2f}. A limiter, or a "
        "motor at its limit, is in no model; use a slower motion"
    )
    return [Finding(kind="behind", joint=joint, run=name, text=text)]


def _constants(joint: str, model: JointModel) -> list[Finding]:
    """Find constants of a stick-slip model that are at a bound of the fit."""
    if not isinstance(model, FusionModel):
        return []
    found = []
    for at in bounded_constants(model.twin):
        causes = BOUND_CAUSES.get(at.name, (BOUND_CAUSE, BOUND_CAUSE))
        cause = causes[at.side == "upper"]
        text = f"constant '{at.name}' of its model is at its bound of {at.bound:g}: {cause}"
        found.append(Finding(kind="bound", joint=joint, run=None, text=text))
    return found


def _bursts(
    joint: str, names: Sequence[str], runs: Sequence[Recording], model: JointModel
) -> list[Finding]:
    """Find runs with a much larger residual than the others: a person touched the robot."""
    settings = load_observer_settings()
    fused = isinstance(model, FusionModel)
    window = settings.fusion_window if fused else settings.median_window
    residuals = [np.abs(free_residual(joint, run, model, window)) for run in runs]
    largest = np.array([np.fmax.reduce(residual, initial=0.0) for residual in residuals])
    if len(runs) < 4 or not (largest > 0).all():
        return []  # too few to say what is usual
    found = []
    for number, name in enumerate(names):
        others = np.delete(largest, number)
        usual = float(np.median(others))
        # Logarithms, since residuals vary by factors; 1.4826 makes the median deviation a standard deviation.
        spread = 1.4826 * float(np.median(np.abs(np.log(others / usual))))
        score = float(np.log(largest[number] / usual)) / max(spread, MIN_SPREAD)
        if score > BURST and largest[number] - usual > MIN_BURST:
            run, sample = runs[number], int(np.nanargmax(residuals[number]))
            when = run.time[sample] - run.time[0]
            size = (
                f"{when:.0f} s after its start: the residual of {joint} reaches "
                f"{np.degrees(largest[number]):.1f} deg, {np.degrees(usual):.1f} deg is usual"
            )
            text = f"looks as if it was touched {size}"
            found.append(Finding(kind="contact", joint=joint, run=name, text=text))
    return found
