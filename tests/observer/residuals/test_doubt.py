"""Joints that rest off their places without the torque that this takes: no touch, and less sure of the next one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pepper_driver.config.kernels import make_records
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.constants import SETTLING_TICKS, UNSURE_FACTOR
from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.interface import Contact, JointState
from pepper_driver.observer.residuals.doubt import DoubtState, raise_threshold, step_doubt
from pepper_driver.observer.residuals.fusion import FusionParts
from support.fusion import (
    BOUND,
    ELBOW,
    VOLTAGE,
    Motion,
    drive,
    fusion_model,
    fusion_observer,
    guided,
    push_profile,
    standing,
    swing,
    ticks_of,
    with_target_drift,
)
from support.observer import CYCLE, SETTINGS, run

THRESHOLD = 0.02


class Joint:
    """Ticks of one joint, with residuals in units of its threshold."""

    def __init__(self) -> None:
        self.doubts = make_records(DoubtState, 1)

    def play(
        self,
        ticks: int,
        model: float,
        residual: float = 0.0,
        *,
        moving: bool = False,
        blind: bool = False,
        jumps: bool = False,
    ) -> bool:
        """True if it is doubtful in the last of some ticks, with these residuals by the model and of both channels."""
        for _ in range(ticks):
            doubtful = step_doubt(
                self.doubts,
                0,
                model * THRESHOLD,
                residual * THRESHOLD,
                THRESHOLD,
                moving,
                blind,
                jumps,
            )
        return doubtful

    @property
    def factor(self) -> float:
        return raise_threshold(self.doubts, 0, THRESHOLD) / THRESHOLD


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("model", "factor", "doubtful"),
    [(0.49, 1.0, False), (0.51, 2.0, False), (0.99, 2.0, False), (1.01, 2.0, True)],
)
def test_half_a_threshold_raises_it_and_a_whole_one_is_doubt(
    side: float, model: float, factor: float, doubtful: bool
) -> None:
    joint = Joint()
    assert not joint.play(SETTLING_TICKS - 1, side * model)
    assert joint.factor == 1.0
    assert joint.play(1, side * model) == doubtful
    assert joint.factor == factor


@pytest.mark.parametrize(("residual", "doubtful"), [(0.49, True), (-0.49, True), (0.51, False)])
def test_an_error_that_the_current_bears_out_is_no_doubt(residual: float, doubtful: bool) -> None:
    joint = Joint()
    assert joint.play(2 * SETTLING_TICKS, 1.5, residual) == doubtful
    assert joint.doubts["loud_ticks"][0] == (0 if doubtful else 2 * SETTLING_TICKS)


@pytest.mark.parametrize("why", ["moving", "blind"])
def test_the_wait_begins_when_a_joint_comes_to_rest_and_can_be_judged(why: str) -> None:
    joint = Joint()
    joint.play(SETTLING_TICKS - 1, 1.5)
    joint.play(1, 1.5, **{why: True})
    assert not joint.play(SETTLING_TICKS - 1, 1.5)
    assert joint.play(1, 1.5)


def test_a_threshold_stays_raised_until_less_than_half_of_the_error_is_left() -> None:
    joint = Joint()
    joint.play(SETTLING_TICKS, 1.5)
    assert not joint.play(100, 0.51, moving=True)
    assert joint.factor == 2.0
    joint.play(1, 0.49, moving=True)
    assert joint.factor == 1.0


def test_a_joint_that_was_blind_has_a_raised_threshold_while_it_settles() -> None:
    joint = Joint()
    joint.play(1, 0.0, blind=True)
    factors = []
    for _ in range(SETTLING_TICKS + 2):
        factors.append(joint.factor)
        joint.play(1, 0.0)
    assert factors == [2.0] * SETTLING_TICKS + [1.0] * 2


# -- in the observer --------------------------------------------------------------------------------------------------


def states(target: ContactObserver, ticks: list[Tick]) -> tuple[list[JointState], list[Contact]]:
    """State of the elbow in each tick, and the events."""
    observations, events = run(target, ticks)
    return [JointState(int(one.state[ELBOW])) for one in observations], events


@pytest.mark.parametrize("offset", [0.053, -0.035, 0.03])
def test_a_joint_that_rests_off_its_command_without_current_is_in_doubt(
    offset: float, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    motion = standing(6.0)
    made = ticks_of(motion, drive(motion))
    for one in made[100:]:
        one.measurement.position[ELBOW] -= offset
    seen, events = states(fusion_observer(), made)
    begin = 100 + SETTINGS.fusion_window // 2 + SETTLING_TICKS - 1
    assert set(seen[:begin]) == {JointState.FREE}
    assert set(seen[begin:]) == {JointState.DOUBTFUL}
    assert events == []
    assert caplog.text.count("LElbowRoll is doubtful") == 1


def test_a_joint_in_doubt_is_free_again_when_its_error_has_ended() -> None:
    motion = standing(3.0)
    made = ticks_of(motion, drive(motion))
    for one in made[100:150]:
        one.measurement.position[ELBOW] -= 0.04
    seen, events = states(fusion_observer(), made)
    assert set(seen[130:150]) == {JointState.DOUBTFUL}
    assert set(seen[155:]) == {JointState.FREE}
    assert events == []


def test_a_joint_in_doubt_needs_more_until_its_error_has_ended() -> None:
    """Its friction may have any sign, also when it moves on."""
    first, second = swing(3.0, rest=2.0), swing(4.0, rest=1.0)
    motion = Motion(
        **{
            name: np.concatenate([getattr(first, name), getattr(second, name)])
            for name in ("position", "velocity", "acceleration", "load")
        }
    )
    made, plain = ticks_of(motion, drive(motion)), ticks_of(motion, drive(motion))
    rests, moves = round(3.0 / CYCLE) + 50, len(first) + 50
    for one in made[rests : moves + 100]:
        one.measurement.position[ELBOW] -= 0.04
    parts = FusionParts(limbs=False, law=False)
    target = fusion_observer(parts=parts)
    seen = [target.step(one) for one in made]
    assert all(one.contacts == () for one in seen)
    other = fusion_observer(parts=parts)
    ordinary = np.array([other.step(one).threshold[ELBOW] for one in plain])
    factor = np.array([one.threshold[ELBOW] for one in seen]) / ordinary
    begin = rests + SETTINGS.fusion_window // 2 + SETTLING_TICKS
    np.testing.assert_allclose(factor[:begin], 1.0)
    assert np.abs(motion.velocity[moves : moves + 100]).max() > 0.3
    np.testing.assert_allclose(factor[begin : moves + 100], UNSURE_FACTOR)
    np.testing.assert_allclose(factor[moves + 110 :], 1.0)


def test_nothing_is_learned_from_a_joint_in_doubt() -> None:
    """Its model stays where the joint belongs."""
    motion = standing(8.0)
    made = ticks_of(motion, drive(motion))
    for one in made[100:-50]:
        one.measurement.position[ELBOW] -= 0.04
    target = fusion_observer(adapt=True)
    seen = [target.step(one) for one in made]
    assert {int(one.state[ELBOW]) for one in seen[130:-50]} == {JointState.DOUBTFUL}
    assert abs(seen[-1].expected[ELBOW]) < 0.002


@pytest.mark.parametrize("torque", [5.0, -5.0, 25.0])
@pytest.mark.parametrize("seconds", [0.2, 2.0])
def test_a_joint_that_a_hand_pushes_is_not_in_doubt(torque: float, seconds: float) -> None:
    """Neither at the begin, while the current does not show it yet, nor when the hand lets go."""
    motion = standing(5.0, load=1.0)
    driven = drive(motion, torque=push_profile(len(motion), 1.0, seconds, torque))
    seen, events = states(fusion_observer(), ticks_of(motion, driven))
    assert JointState.DOUBTFUL not in seen
    assert [event.direction for event in events][:1] == [math.copysign(1.0, torque)]


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(("speed", "far"), [(0.3, 0.2), (1.0, 0.6), (3.0, 0.2), (3.0, 0.6)])
def test_a_hand_that_is_stronger_than_the_board_is_found_until_it_has_left(
    side: float, speed: float, far: float
) -> None:
    """With and against the load: the board gives its 6 N m, far less than its law asks for."""
    motion = standing(6.0, load=1.0)
    driven = guided(motion, side=side, speed=speed, far=far, begin=1.0, seconds=2.0, limit=0.06)
    seen, events = states(fusion_observer(), ticks_of(motion, driven))
    assert JointState.DOUBTFUL not in seen
    lives = [event for event in events if event.phase != "update"]
    assert [event.phase for event in lives] == ["begin", "end"]
    assert lives[0].direction == side
    assert 1.0 < lives[0].time < 1.0 + BOUND / speed + 0.1
    assert lives[1].time == pytest.approx(3.0 + far / speed, abs=0.1)


def test_a_joint_that_moves_is_not_in_doubt() -> None:
    motion = swing(4.0)
    time = np.arange(len(motion)) * CYCLE
    made = with_target_drift(motion, np.where((time > 1.0) & (time < 2.0), 0.05, 0.0))
    assert JointState.DOUBTFUL not in states(fusion_observer(), made)[0][:200]


def test_where_currents_show_nothing_no_joint_is_in_doubt() -> None:
    motion = standing(3.0)
    made = ticks_of(motion, drive(motion))
    for one in made[100:]:
        one.measurement.position[ELBOW] -= 0.053
    seen, events = states(fusion_observer(fusion_model(momentum=VOLTAGE)), made)
    assert JointState.DOUBTFUL not in seen
    assert events
