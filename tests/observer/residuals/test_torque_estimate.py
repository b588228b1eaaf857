"""External torque of one joint from both channels, in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.observer.residuals.torque_estimate import (
    DAHL_DISTANCE,
    RESTING_DOUBT,
    SLIDING_DOUBT,
    TORQUE_DOUBT,
    TorqueEstimate,
    estimate_torque,
)
from support.fusion import PER_AMPERE, STICK_SLIP, fusion_model

K, SPREAD, THRESHOLD = 70.0, 0.001, 0.01
"""Stiffness [N m/rad] of a known weight, spread and threshold [rad]."""

SMOOTH = replace(STICK_SLIP, load_friction=0.0, breakaway=1.0)
FRICTION = SMOOTH.friction * K
"""[N m]"""


class Joint:
    """Steps of a joint whose motor could give a lot."""

    def __init__(self) -> None:
        self.target = TorqueEstimate(
            [fusion_model(SMOOTH)],
            window=5,
            stiffness=np.array([K]),
            spread=np.array([SPREAD]),
        )

    def step(
        self,
        model: float,
        current: float,
        *,
        friction: float = 0.0,
        position: float = 0.0,
        moving: bool = False,
        ampere: float = 10.0,
    ) -> tuple[float, float]:
        """Return torque and standard deviation [N m] for residuals of both channels, and expected friction [rad]."""
        target = self.target
        target.count += 1
        return estimate_torque(
            target.states,
            target.currents,
            target.count,
            0,
            model,
            current,
            friction,
            THRESHOLD,
            position,
            moving,
            0.0,
            ampere,
        )


@pytest.mark.parametrize(
    ("model", "current", "mean"),
    [
        (0.05, 0.03, 0.04),
        (-0.05, -0.03, -0.04),
        (0.01, 0.03, 0.02),
        (0.50, 0.03, 0.045),  # a board at its limit: twice what the current shows
        (-0.04, 0.03, 0.0),  # a board that follows another target
        (0.04, 0.0, 0.0),
    ],
)
def test_the_model_counts_as_far_as_the_current_bears_it_out(
    model: float, current: float, mean: float
) -> None:
    torque, std = Joint().step(model, current, moving=True)
    assert torque == pytest.approx(-K * mean)
    unknown = (SLIDING_DOUBT * FRICTION, TORQUE_DOUBT * torque, K * SPREAD, K * (mean - current))
    assert std == pytest.approx(np.sqrt(np.sum(np.square(unknown))), rel=1e-6)


def test_a_push_on_a_joint_at_rest_reverses_its_friction() -> None:
    """Friction acts upwards with all it has; a hand of 5 N m moves the joint up, and it acts downwards."""
    joint = Joint()
    friction = -SMOOTH.friction
    joint.step(0.0, 0.0, friction=friction)
    hand = 5.0
    # Motor torque is friction after the push minus the hand: r = (F + F - hand) / K in the sign of eps.
    residual = -(hand - 2.0 * FRICTION) / K
    torque, std = joint.step(residual, residual, friction=friction, position=3.0 * DAHL_DISTANCE)
    assert torque == pytest.approx(hand)
    assert std > RESTING_DOUBT * FRICTION


def test_a_push_that_moved_a_joint_at_rest_less_has_reversed_less() -> None:
    joint = Joint()
    joint.step(0.0, 0.0, friction=-SMOOTH.friction)
    torque, _ = joint.step(-0.03, -0.03, friction=-SMOOTH.friction, position=DAHL_DISTANCE)
    assert torque == pytest.approx(K * 0.03 + FRICTION)


def test_motion_before_the_residual_is_large_counts_too() -> None:
    joint = Joint()
    for step in range(21):
        quiet, _ = joint.step(
            -0.004, -0.004, friction=-SMOOTH.friction, position=0.05 * step * 2.0 * DAHL_DISTANCE
        )
    assert quiet == pytest.approx(K * 0.004)
    torque, _ = joint.step(-0.03, -0.03, friction=-SMOOTH.friction, position=2.0 * DAHL_DISTANCE)
    assert torque == pytest.approx(K * 0.03 + 2.0 * FRICTION)


def test_friction_of_a_joint_in_motion_stays_as_it_is_expected() -> None:
    joint = Joint()
    joint.step(0.0, 0.0, friction=-SMOOTH.friction, moving=True)
    torque, std = joint.step(
        -0.03, -0.03, friction=-SMOOTH.friction, position=3.0 * DAHL_DISTANCE, moving=True
    )
    assert torque == pytest.approx(K * 0.03)
    assert std < RESTING_DOUBT * FRICTION


def test_the_current_bounds_the_torque_by_the_same_scale() -> None:
    ampere = 0.5
    torque, _ = Joint().step(-0.4, -0.4, moving=True, ampere=ampere)
    assert torque == pytest.approx(K * PER_AMPERE * ampere + FRICTION)


def test_the_largest_current_of_the_filter_bounds_the_torque() -> None:
    """The residual is a median: a current that has just fallen may belong to it."""
    joint, bound = Joint(), K * PER_AMPERE * 0.5 + FRICTION
    joint.step(-0.4, -0.4, moving=True, ampere=0.5)
    for _ in range(4):
        assert joint.step(-0.4, -0.4, moving=True, ampere=0.0)[0] == pytest.approx(bound)
    assert joint.step(-0.4, -0.4, moving=True, ampere=0.0)[0] == pytest.approx(FRICTION)


@pytest.mark.parametrize(("residual", "doubt"), [(0.49, 1.0), (0.51, 0.5)])
def test_friction_of_a_joint_that_rests_hides_a_torque_as_large_as_itself(
    residual: float, doubt: float
) -> None:
    """Up to twice itself: 1.0 is one standard deviation; half of it where the residual shows that it has moved."""
    joint, r = Joint(), residual * THRESHOLD
    torque, std = joint.step(r, r)
    expected = np.sqrt(np.sum(np.square([doubt * FRICTION, K * SPREAD, TORQUE_DOUBT * torque])))
    assert std == pytest.approx(expected, rel=1e-6)


def test_after_a_reset_friction_is_as_expected_again() -> None:
    joint = Joint()
    joint.step(0.0, 0.0, friction=-SMOOTH.friction)
    joint.target.reset()
    torque, _ = joint.step(-0.03, -0.03, friction=SMOOTH.friction, position=1.0)
    assert torque == pytest.approx(K * 0.03)
