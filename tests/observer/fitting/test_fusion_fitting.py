"""Identification of mode ``fusion`` from recordings of a joint that another integrator simulates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.constants import MIN_SPREAD, SETTLING_TICKS
from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.detection.threshold import REST, SLIDING
from pepper_driver.observer.fitting.bounds import fit_spreads, free_residual
from pepper_driver.observer.fitting.fusion import FittedFusion, fit_fusion, fit_joint_fusion
from pepper_driver.observer.fitting.stick_slip import START_UP_TIME
from pepper_driver.observer.fitting.tree import FittingError
from pepper_driver.observer.interface import JointState
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.model_file import predict_recording
from pepper_driver.observer.recording import Recording
from support.fusion import (
    ELBOW,
    PER_AMPERE,
    STICK_SLIP,
    VOLTAGE,
    drive,
    fusion_model,
    push_profile,
    recording_of,
    standing,
    swing,
    ticks_of,
)
from support.observer import CYCLE, MEDIAN_STD, NORMAL_QUANTILE, ROBOT, SETTINGS, models, recording

JOINT, OTHER = "LElbowRoll", "RElbowRoll"
WINDOW = SETTINGS.fusion_window
TRUE = replace(STICK_SLIP, friction=0.01, load_friction=0.0, lag=0.03, offset=0.002, breakaway=1.1)


def runs(*, noise: float = 0.0, seed: int = 0) -> list[Recording]:
    rng = np.random.default_rng(seed)
    made = []
    for size, rate, gravity in ((0.5, 1.2, 3.0), (0.4, 2.2, -3.0)):
        motion = swing(6.0, size, rate, gravity=gravity, rest=1.0)
        run = recording_of(motion, drive(motion, TRUE))
        made.append(
            replace(
                run, current=np.abs(run.current + noise * rng.standard_normal(run.current.shape))
            )
        )
    return made


@pytest.fixture(scope="module")
def found() -> FusionModel:
    return fit_joint_fusion(JOINT, runs(noise=0.01), ROBOT)


def test_a_clean_current_is_the_source_of_the_motors_torque(found: FusionModel) -> None:
    momentum = found.momentum
    assert momentum.source == "current"
    assert momentum.torque_per_ampere == pytest.approx(PER_AMPERE, rel=0.05)
    # Back-EMF takes no current, and the constant load is found again.
    assert momentum.lag < 0.3 * TRUE.lag
    assert momentum.offset == pytest.approx(TRUE.offset, abs=0.001)


def test_a_current_without_information_is_not_used(found: FusionModel) -> None:
    """The stick-slip model is then used alone."""
    blind = fit_joint_fusion(JOINT, runs(noise=5.0), ROBOT)
    assert blind.momentum.source == "voltage"
    assert blind.twin.lag == pytest.approx(found.twin.lag, rel=0.2)


def test_it_predicts_a_motion_that_it_has_not_seen(found: FusionModel) -> None:
    motion = swing(6.0, 0.45, 1.7, gravity=2.0, rest=0.5)
    driven = drive(motion, TRUE)
    error = motion.position - driven.position
    predicted = predict_recording(found, JOINT, recording_of(motion, driven))
    settled = slice(round(START_UP_TIME / CYCLE), None)
    assert np.sqrt(np.mean((predicted - error)[settled] ** 2)) < 0.12 * error.std()


# -- spreads ----------------------------------------------------------------------------------------------------------

BY_POSITION = fusion_model(momentum=VOLTAGE)
MEDIAN_QUANTILE = MEDIAN_STD * NORMAL_QUANTILE
"""Quantile 0.99 of the size of a median of five standard normal numbers."""


def noisy(
    rest: float,
    motion: float,
    seconds: float = 30.0,
    fraction: float = 0.5,
    reversal: float | None = None,
) -> Recording:
    """A run that rests, then goes to and fro; the joint is where it belongs, but for the noise of its encoder.

    ``reversal`` is the noise in the first third of a second after the joint has turned.
    """
    nothing = standing(seconds)
    moves = np.arange(len(nothing)) >= fraction * len(nothing)
    to_and_fro = 0.5 * np.sign(np.sin(np.pi * np.arange(len(nothing)) * CYCLE))
    velocity = np.where(moves, to_and_fro, 0.0)
    made = replace(nothing, position=np.cumsum(velocity) * CYCLE, velocity=velocity)
    run = recording_of(made, drive(made, steps=20))
    position = run.position.copy()
    noise = np.random.default_rng(8).standard_normal(len(run))
    size = np.where(moves, motion, rest)
    if reversal is not None:
        turned = np.flatnonzero(np.diff(velocity))
        after = turned[:, None] + np.arange(3, 3 + SETTLING_TICKS)
        size[after[after < len(run)]] = reversal
    position[:, ELBOW] += size * noise
    return replace(run, position=position)


def spreads(*calibration: Recording, model: FusionModel = BY_POSITION) -> FloatArray:
    fitted = fit_spreads({JOINT: model}, calibration, window=WINDOW)
    assert fitted.keys() == {JOINT}
    assert replace(fitted[JOINT], spread=model.spread, momentum_bound=model.momentum_bound) == model
    return np.array(fitted[JOINT].spread)


def test_spreads_are_the_quantiles_of_the_residual_by_phase() -> None:
    found = spreads(noisy(0.004, 0.01, seconds=200.0))
    np.testing.assert_allclose(found, MEDIAN_QUANTILE * np.array([0.004, 0.01, 0.01]), rtol=0.1)


def test_a_joint_that_breaks_away_roughly_has_a_spread_for_that_alone() -> None:
    found = spreads(noisy(0.004, 0.005, seconds=200.0, reversal=0.02))
    np.testing.assert_allclose(found, MEDIAN_QUANTILE * np.array([0.004, 0.02, 0.005]), rtol=0.15)


def test_a_phase_that_was_hardly_seen_has_the_largest_spread_of_the_others() -> None:
    found = spreads(noisy(0.004, 0.005, fraction=0.9, seconds=60.0, reversal=0.02))
    np.testing.assert_allclose(found[0], MEDIAN_QUANTILE * 0.004, rtol=0.15)
    assert (found[1:] == found[0]).all()


@pytest.mark.parametrize(
    ("fraction", "size"), [(1.0, 0.004), (0.0, 0.01), (0.1, 0.01), (0.9, 0.004)]
)
def test_a_phase_with_few_samples_has_the_spread_of_the_other(fraction: float, size: float) -> None:
    found = spreads(noisy(0.004, 0.01, fraction=fraction))
    np.testing.assert_allclose(found, MEDIAN_QUANTILE * size, rtol=0.15)


def behind(run: Recording, joint: str) -> Recording:
    """A joint that is half a radian behind all the time."""
    position = run.position.copy()
    position[:, ROBOT.joint_index(joint)] -= 0.5
    return replace(run, position=position)


def test_one_joint_that_falls_behind_does_not_cost_the_others() -> None:
    """The head in all of its runs, the other elbow in the free motion for thresholds."""
    sweeps = {JOINT: runs(), OTHER: [run.mirrored(ROBOT) for run in runs()]}
    head = [behind(run, "HeadYaw") for run in runs()]
    free = [behind(run, OTHER) for run in runs(seed=1)]

    def fit(sweeps: dict[str, list[Recording]], mirrors: dict[str, str]) -> FittedFusion:
        return fit_fusion(
            ROBOT,
            sweeps,
            mirrors,
            {"HeadPitch": "HeadYaw"},
            free,
            window=WINDOW,
            target_speeds={},
            workers=1,
        )

    models, left_out, _ = fit({**sweeps, "HeadYaw": head}, {OTHER: JOINT})
    assert set(models) == {JOINT}
    assert set(left_out) == {OTHER, "HeadYaw", "HeadPitch"}
    assert "hardly any of its samples in the free motion" in left_out[OTHER]
    assert "HeadYaw: none of its samples counts" in left_out["HeadPitch"]
    with pytest.raises(FittingError, match="HeadYaw: none of its samples counts"):
        fit({"HeadYaw": head}, {})


def test_a_quiet_joint_has_the_smallest_spread() -> None:
    np.testing.assert_array_equal(spreads(noisy(0.0, 0.0, fraction=1.0)), MIN_SPREAD)


def test_the_residual_is_that_of_the_observer() -> None:
    """Both channels of it: noise of the encoder alone is no residual where the current shows the torque."""
    run = noisy(0.004, 0.01)
    assert (spreads(run, model=fusion_model()) < 0.8 * spreads(run)).all()
    seen = free_residual(JOINT, run, BY_POSITION, WINDOW)
    for phase, spread in zip((0, 1), spreads(run)[[REST, SLIDING]], strict=True):
        moving = (np.arange(len(run)) >= 0.5 * len(run)) == bool(phase)
        sizes = np.abs(seen[moving])[round(START_UP_TIME / CYCLE) :]
        assert np.nanmean(sizes <= spread) == pytest.approx(0.99, abs=0.004)


def test_samples_that_are_no_answer_and_those_of_the_start_do_not_count() -> None:
    run = noisy(0.004, 0.01)
    position, age = run.position.copy(), run.age.copy()
    position[: round(0.5 * START_UP_TIME / CYCLE), ELBOW] += 0.1
    position[500:540, ELBOW], age[500:540] = 0.15, 1.0
    # There it falls behind.
    position[1700:1760, ELBOW] = 0.4
    found = spreads(replace(run, position=position, age=age))
    np.testing.assert_allclose(found, MEDIAN_QUANTILE * np.array([0.004, 0.01, 0.01]), rtol=0.15)


@pytest.mark.parametrize("seconds", [5.0, 20.0])
def test_a_joint_without_enough_samples_is_left_out(seconds: float) -> None:
    run = noisy(0.004, 0.01, seconds)
    if seconds > 10.0:  # it falls behind in all of it
        run = replace(run, position=run.position - 0.5)
    assert not fit_spreads({JOINT: BY_POSITION}, [run], window=WINDOW)


def test_the_bound_of_the_baseline_is_a_margin_over_its_largest_residual() -> None:
    """A joint without friction or lag at rest: the residual is its error, less the constant load."""
    begin, n = round(START_UP_TIME / CYCLE), 1500
    error = np.full(n, 0.01)
    error[: begin - 20] = 0.15  # while the robot starts up
    error[700:720] = 0.042  # longer than half of the window of the baseline
    error[900:904] = 0.1  # shorter: it does not pass the median
    error[1100:1160] = 0.5  # here it falls behind
    twin = replace(STICK_SLIP, inertia=1e-9, lag=0.0, friction=0.0, load_friction=0.0, offset=0.002)
    run = recording(np.zeros((n, 3)), error)
    fitted = fit_spreads({JOINT: fusion_model(twin)}, [run], window=WINDOW)[JOINT]
    assert fitted.momentum_bound == pytest.approx(1.5 * 0.04, rel=1e-3)


# -- all of it --------------------------------------------------------------------------------------------------------


def test_all_of_it_together_detects_a_push_and_nothing_else() -> None:
    free = runs(seed=1)
    sweeps = {JOINT: runs(), OTHER: [run.mirrored(ROBOT) for run in runs()]}
    fitted, _, base = fit_fusion(
        ROBOT,
        sweeps,
        {OTHER: JOINT},
        {"HeadYaw": JOINT},
        free,
        window=WINDOW,
        target_speeds={},
        workers=1,
    )
    assert fitted.keys() == {JOINT, OTHER, "HeadYaw"}
    assert base is None
    assert fitted["HeadYaw"].twin == fitted[JOINT].twin
    # The other elbow turns in the other direction, and so does its constant load.
    assert ROBOT.mirror[ELBOW] == (ROBOT.joint_index(OTHER), -1.0)
    offset = fitted[JOINT].twin.offset
    assert offset == pytest.approx(TRUE.offset, abs=5e-4)
    assert fitted[OTHER].twin == replace(fitted[JOINT].twin, offset=-offset)
    assert max(max(model.spread) for model in fitted.values()) < 0.01
    target = ContactObserver(ROBOT, models(fitted, kind="fusion"), SETTINGS)
    assert [e for run in free for tick in run.ticks() for e in target.step(tick).contacts] == []
    target.reset()
    motion = swing(8.0, 0.45, 1.8, gravity=2.0)
    push = push_profile(len(motion), 5.0, 0.7, -8.0)
    observations = [
        target.step(tick) for tick in ticks_of(motion, drive(motion, TRUE, torque=push))
    ]
    events = [event for one in observations for event in one.contacts]
    begins = [event for event in events if event.phase == "begin" and event.kind != "rebound"]
    assert [(event.joint, event.direction) for event in begins] == [(JOINT, -1)]
    assert 5.0 < begins[0].time < 5.2
    assert observations[0].state[0] == JointState.BLIND
