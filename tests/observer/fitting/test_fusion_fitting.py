"""Identification of mode ``fusion`` from recordings of a joint that another integrator simulates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.fitting.bounds import (
    BOUND_FACTOR,
    LEARNING_TIME,
    MIN_BOUND,
    MIN_LEAF_RATIO,
    fit_bounds,
)
from pepper_driver.observer.fitting.fusion import FittedFusion, fit_fusion, fit_joint_fusion
from pepper_driver.observer.fitting.stick_slip import START_UP_TIME
from pepper_driver.observer.fitting.tree import FittingError
from pepper_driver.observer.interface import JointState
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.model_file import predict_recording
from pepper_driver.observer.recording import Recording
from pepper_driver.observer.residuals.fusion import FusionGenerator
from support.fusion import (
    ELBOW,
    PER_AMPERE,
    STICK_SLIP,
    drive,
    fusion_model,
    push_profile,
    recording_of,
    swing,
    ticks_of,
)
from support.observer import CYCLE, JOINTS, ROBOT, SETTINGS, models

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
    """The stick-slip model is then used alone, and is not worse by it."""
    blind = fit_joint_fusion(JOINT, runs(noise=5.0), ROBOT)
    assert blind.momentum.source == "voltage"
    assert blind.spread[1] < 2.0 * found.spread[1]


def test_the_spread_is_that_of_free_motion_and_small(found: FusionModel) -> None:
    assert max(found.spread) < 0.0015
    assert all(0.0 <= weight <= 1.0 for weight in found.weight)


def test_it_predicts_a_motion_that_it_has_not_seen(found: FusionModel) -> None:
    motion = swing(6.0, 0.45, 1.7, gravity=2.0, rest=0.5)
    driven = drive(motion, TRUE)
    error = motion.position - driven.position
    predicted = predict_recording(found, JOINT, recording_of(motion, driven))
    settled = slice(round(START_UP_TIME / CYCLE), None)
    assert np.sqrt(np.mean((predicted - error)[settled] ** 2)) < 0.12 * error.std()


def calibration() -> list[Recording]:
    made = []
    for seconds, size, rate in ((8.0, 0.5, 2.5), (30.0, 0.6, 1.5)):
        motion = swing(seconds, size, rate, rest=1.0)
        # More friction than in the model, and more than it can adapt to: residuals of some size.
        made.append(
            recording_of(motion, drive(motion, replace(STICK_SLIP, friction=0.03, lag=0.06)))
        )
    return made


@pytest.fixture(scope="module")
def bounded() -> FusionModel:
    return fit_bounds({JOINT: fusion_model()}, calibration(), CYCLE, window=WINDOW)[JOINT]


def residuals(model: FusionModel, run: Recording) -> list[float]:
    """In use, when the observer has got used to the robot; of short runs the second half."""
    ordered = [model if name == JOINT else None for name in ROBOT.joint_names]
    signal = FusionGenerator(ordered, CYCLE, window=WINDOW, adapt=True)
    everything, nothing = np.ones(JOINTS, dtype=np.bool_), np.zeros(JOINTS, dtype=np.bool_)
    sizes = []
    for tick in run.ticks():
        made = signal.step(tick)
        sizes.append(abs(float(made.residual[ELBOW])))
        signal.learn(made, everything, nothing, True)
    return sizes[min(round(LEARNING_TIME / CYCLE), len(sizes) // 2) :]


def test_thresholds_keep_their_margin_on_the_calibration(bounded: FusionModel) -> None:
    largest = max(max(residuals(fusion_model(), run)) for run in calibration())
    assert largest > MIN_BOUND
    assert bounded.max_bound == pytest.approx(BOUND_FACTOR * largest, rel=1e-9)
    leaves = [v for v, f in zip(bounded.bound.value, bounded.bound.feature, strict=True) if f < 0]
    assert min(leaves) >= min(MIN_BOUND, MIN_LEAF_RATIO * bounded.max_bound)
    for run in calibration():
        speed, size = np.abs(run.velocity[:, ELBOW]), np.abs(run.acceleration[:, ELBOW])
        memory = round(0.5 / CYCLE)
        held = np.array([speed[max(0, k + 1 - memory) : k + 1].max() for k in range(len(run))])
        bound = bounded.bound.predict(np.column_stack((speed, size, held)))
        sizes = np.array(residuals(fusion_model(), run))
        assert (bound[-len(sizes) :] >= BOUND_FACTOR * sizes - 1e-12).all()


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
    assert "none of its samples in the free motion" in left_out[OTHER]
    assert "HeadYaw: none of its samples counts" in left_out["HeadPitch"]
    with pytest.raises(FittingError, match="HeadYaw: none of its samples counts"):
        fit({"HeadYaw": head}, {})


def test_a_quiet_joint_gets_the_least_threshold() -> None:
    motion = swing(6.0, 0.2, 0.8)
    quiet = recording_of(motion, drive(motion))
    model = fit_bounds({JOINT: fusion_model()}, [quiet], CYCLE, window=WINDOW)[JOINT]
    assert set(model.bound.value) <= {0.0, MIN_BOUND}


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
