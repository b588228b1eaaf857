"""Currents that the law of a board does not explain: a target that jumps, a saturated motor. It explains pushes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.kernels import make_records
from pepper_driver.observer.constants import (
    HELD_FACTOR,
    MAX_TARGET_DRIFT,
    MIN_DRIVE,
    PUSH_TICKS,
    SETTLING_TICKS,
)
from pepper_driver.observer.detection.threshold import ThresholdState
from pepper_driver.observer.fitting.samples import SETTLING_TIME
from pepper_driver.observer.residuals.board_law import CATCHING_UP_TICKS, BoardLaw
from pepper_driver.observer.residuals.fusion import FusionParts
from pepper_driver.observer.residuals.joint_tick import JointCommand, JointTick
from support.fusion import PER_AMPERE, fusion_generator, play
from support.observer import CYCLE, JOINTS, SETTINGS, tick

DEG = np.pi / 180.0
CURRENT_TIME = 0.03
"""[s] Time constant of the simulated current sensor."""
GAIN = 1.0 - np.exp(-CYCLE / CURRENT_TIME)
LIMBS = np.array([0, 1, 1, 2])
CARRIES = (LIMBS[:, None] == LIMBS[None, :]) | (LIMBS[:, None] == 0) | (LIMBS[None, :] == 0)


class Boards:
    """Four joints: one of the trunk, two of one limb, one of another."""

    def __init__(self, known: bool = True) -> None:
        n = len(LIMBS)
        self.law = BoardLaw(np.full(n, known), LIMBS, CARRIES, float(GAIN), 5)
        self.ticks = make_records(JointTick, n)
        self.thresholds = make_records(ThresholdState, n)
        self.commands = make_records(JointCommand, n)
        self.hands = np.zeros(n, dtype=np.int64)
        self.catches_up = self.jump = False

    def play(
        self,
        output: Iterable[float],
        motor: Iterable[float],
        *,
        joint: int = 1,
        by_model: float = 0.0,
        error: float = 0.0,
        good: bool = True,
    ) -> list[bool]:
        """True for each tick in which the target of the joint jumps; values in radians."""
        jumps = []
        for out, size in zip(output, motor, strict=True):
            self.ticks["good"], self.ticks["raw"] = good, 0.0
            self.ticks["output"][joint], self.ticks["motor"][joint] = out, size
            self.ticks["by_model"][joint] = by_model
            self.commands["target"][joint] = error
            self.count, self.jump, self.catches_up = self.law.step(
                self.commands, self.thresholds, self.hands, self.ticks
            )
            assert self.jump == self.ticks["jumps"].any()
            jumps.append(bool(self.ticks["jumps"][joint]))
        return jumps

    @property
    def saturated(self) -> bool:
        return bool((self.law.states["saturated_ticks"] > 0).any())

    @property
    def good(self) -> list[bool]:
        good: list[bool] = self.ticks["good"].tolist()
        return good


def sensed(torque: np.ndarray) -> np.ndarray:
    """Size of a torque / K as its smoothed current shows it."""
    smoothed, value = [], abs(float(torque[0]))
    for one in np.abs(torque):
        value += GAIN * (one - value)
        smoothed.append(value)
    return np.array(smoothed)


@given(
    before=st.floats(0.0, 5.0),
    push=st.floats(0.0, 8.0),
    rate=st.floats(1.0, 40.0),
    scale=st.floats(0.9, 1.1),
    side=st.sampled_from([-1.0, 1.0]),
)
def test_a_push_is_no_jump_however_strong(
    before: float, push: float, rate: float, scale: float, side: float
) -> None:
    """The current follows the output of the law, as late as its sensor, while the motor works against the push."""
    ramp = np.clip(np.arange(200) * CYCLE * rate, 0.0, push)
    output = side * (before + np.concatenate([np.zeros(100), ramp])) * DEG
    assert not any(Boards().play(output, scale * sensed(output)))


def test_a_current_that_rises_while_the_output_falls_is_a_jump() -> None:
    """A target that was 2 degrees off comes back: the motor drives the joint, which then lies nearer to its command."""
    output = np.concatenate([np.full(100, 2.7), np.linspace(2.7, 0.5, 8)]) * DEG
    motor = np.concatenate([np.full(100, 2.7), np.linspace(2.7, 3.4, 8)]) * DEG
    jumps = Boards().play(output, motor)
    assert not any(jumps[:100])
    assert any(jumps[100:])


def test_an_output_without_a_current_is_a_jump() -> None:
    """The joint leaves its place by 2.5 degrees within 60 ms, and its motor does not mind."""
    output = np.concatenate([np.full(100, 0.2), np.linspace(0.2, 2.7, 5), np.full(5, 2.7)]) * DEG
    jumps = Boards().play(output, np.full(110, 0.2 * DEG))
    assert any(jumps[100:])


@pytest.mark.parametrize("joint", [1, 2])
def test_a_jump_shows_at_no_limb_that_a_hand_pushes(joint: int) -> None:
    """A hand that lets go leaves a current that falls later than the output; the next hand may come soon."""
    push = np.concatenate([np.full(100, 6.0), np.zeros(SETTLING_TICKS + 40)]) * DEG
    boards = Boards()
    boards.hands[joint] = 1
    assert not any(boards.play(push[:100], sensed(push)[:100]))
    boards.hands[joint] = 0
    assert not any(boards.play(push[100:], sensed(push)[100:]))
    assert any(Boards().play(push, sensed(push)))


def test_a_blind_joint_shows_no_jump() -> None:
    """Its model follows the measured position, and so do the derivatives of its error."""
    output = np.concatenate([np.full(100, 6.0), np.zeros(40)]) * DEG
    boards = Boards()
    boards.ticks["blind"] = True
    assert not any(boards.play(output, sensed(output)))


def test_a_target_that_stays_off_is_a_jump_only_at_first() -> None:
    output = np.concatenate([np.full(100, 0.0), np.full(200, 3.0)]) * DEG
    jumps = Boards().play(output, np.zeros(300))
    assert any(jumps[100:150])
    assert not any(jumps[200:])


@pytest.mark.parametrize(("ticks", "found"), [(2, False), (3, True)])
def test_a_jump_shows_for_as_long_as_half_of_the_median_window(ticks: int, found: bool) -> None:
    """A shorter one does not reach the residual. The smoothed difference is large for these ticks alone."""
    boards = Boards()
    boards.play(np.zeros(50), np.zeros(50))
    step = MIN_DRIVE * 1.2 / GAIN
    motor = np.concatenate([[step], np.full(ticks - 1, MIN_DRIVE * 1.3), [0.0, 0.0]])
    assert any(boards.play(np.zeros(len(motor)), motor)) == found


def test_a_joint_whose_law_is_unknown_hides_no_other() -> None:
    boards = Boards()
    boards.law.states["known"][0] = False
    output = np.concatenate([np.full(100, 0.2), np.linspace(0.2, 2.7, 5), np.full(5, 2.7)]) * DEG
    assert any(boards.play(output, np.full(110, 0.2 * DEG)))


def test_a_jump_is_over_when_the_joint_cannot_be_judged() -> None:
    boards = Boards()
    output = np.concatenate([np.full(100, 0.2), np.linspace(0.2, 2.7, 5), np.full(6, 2.7)]) * DEG
    assert boards.play(output, np.full(111, 0.2 * DEG))[-1]
    assert boards.play([2.7 * DEG], [0.2 * DEG], good=False) == [False]
    assert boards.law.states["jump_ticks"][1] == boards.law.states["short_ticks"][1] == 0
    assert not any(boards.play(np.full(30, 2.7 * DEG), np.full(30, 0.2 * DEG)))


def test_a_target_that_is_off_from_the_start_is_no_jump() -> None:
    boards = Boards()
    assert not any(boards.play(np.full(50, 3.0 * DEG), np.zeros(50)))


def test_a_joint_that_could_not_be_judged_begins_again() -> None:
    """A limp joint has an error without a current, and none of both when it is stiff again."""
    boards = Boards()
    boards.play(np.full(50, 3.0 * DEG), np.zeros(50), good=False)
    assert not any(boards.play(np.zeros(50), np.zeros(50)))


def test_a_current_that_shows_no_torque_is_not_compared() -> None:
    output = np.concatenate([np.zeros(10), np.full(100, 12.0)]) * DEG
    boards = Boards(known=False)
    assert not any(boards.play(output, np.zeros(110), by_model=12.0 * DEG, error=12.0 * DEG))
    assert not boards.saturated


# -- saturated motors -------------------------------------------------------------------------------------------------

LIMIT = 7.0 * DEG
"""Largest torque of the motor / K."""


def fall_behind(boards: Boards, ticks: int = 40, joint: int = 1) -> None:
    """The motor gives all it has; the law asks for twice as much, and the joint is as far behind its model."""
    boards.play(
        np.full(ticks, 2.0 * LIMIT),
        np.full(ticks, LIMIT),
        joint=joint,
        by_model=LIMIT,
        error=2.0 * LIMIT,
    )


def catch_up(boards: Boards, ticks: int, joint: int = 1) -> None:
    """The joint is where it should be."""
    some = np.full(ticks, 0.3 * LIMIT)
    boards.play(some, some, joint=joint, error=0.3 * LIMIT)


def test_the_limb_of_a_saturated_motor_cannot_be_judged() -> None:
    boards = Boards()
    fall_behind(boards)
    assert boards.saturated
    assert boards.good == [True, False, False, True]
    assert boards.count == 2
    assert np.isnan(boards.ticks["raw"]).tolist() == [False, True, True, False]
    assert not boards.catches_up


@pytest.mark.parametrize(("joint", "judged"), [(0, [False] * 4), (1, [False, False, False, True])])
def test_nor_can_what_it_carries_and_the_base_while_it_catches_up(
    joint: int, judged: list[bool]
) -> None:
    boards = Boards()
    fall_behind(boards, joint=joint)
    catch_up(boards, 1, joint=joint)
    assert boards.catches_up
    assert boards.good == judged


def test_a_joint_settles_for_as_long_as_an_identification_leaves_out() -> None:
    assert round(SETTLING_TIME / CYCLE) == CATCHING_UP_TICKS


def test_they_are_judged_again_when_the_joint_has_caught_up_and_settled() -> None:
    boards = Boards()
    fall_behind(boards)
    # Its model starts from where it is, so that only board and error show that it is behind.
    boards.play(np.full(100, 2.0 * LIMIT), np.full(100, LIMIT), error=2.0 * LIMIT)
    assert boards.saturated
    catch_up(boards, CATCHING_UP_TICKS - 1)
    assert boards.saturated
    # The smoothed current is short for some ticks more.
    catch_up(boards, 10)
    assert not boards.saturated
    assert boards.good == [True] * 4


@pytest.mark.parametrize("output", [LIMIT, 1.05 * LIMIT])
def test_a_joint_that_rests_off_its_command_is_judged_as_soon_as_its_motor_gives_what_is_asked(
    output: float,
) -> None:
    boards = Boards()
    fall_behind(boards)
    boards.play(
        np.full(CATCHING_UP_TICKS + 10, output),
        np.full(CATCHING_UP_TICKS + 10, LIMIT),
        error=output,
    )
    assert not boards.saturated


def test_a_limp_joint_is_not_saturated() -> None:
    """It hangs off its command without a current: that says nothing of its limb or the trunk."""
    boards = Boards()
    fall_behind(boards)
    boards.play(np.full(3, 20.0 * DEG), np.zeros(3), error=20.0 * DEG, good=False)
    assert not boards.saturated
    assert not boards.catches_up


def test_a_motor_at_its_limit_for_a_moment_is_not_saturated() -> None:
    boards = Boards()
    fall_behind(boards, PUSH_TICKS - 2)
    assert not boards.saturated


@pytest.mark.parametrize(
    ("output", "by_model"),
    [(LIMIT + 0.9 * MIN_DRIVE, LIMIT), (2.0 * LIMIT, 0.99 * MAX_TARGET_DRIFT)],
)
def test_a_motor_that_gives_what_is_asked_or_a_joint_near_its_model_is_not_saturated(
    output: float, by_model: float
) -> None:
    boards = Boards()
    boards.play(np.full(100, output), np.full(100, LIMIT), by_model=by_model, error=output)
    assert not boards.saturated


@pytest.mark.parametrize("touched", [0, 1, 2])
def test_what_is_touched_is_judged_on(touched: int) -> None:
    """A strong push saturates a motor, too, and a touch of the trunk must not end because an arm falls behind."""
    boards = Boards()
    boards.thresholds["touched"][touched] = True
    fall_behind(boards)
    assert boards.good == [True] * 4


def test_a_touch_elsewhere_does_not_count() -> None:
    boards = Boards()
    boards.thresholds["touched"][3] = True
    fall_behind(boards)
    assert boards.good == [True, False, False, True]


# -- in the residuals -------------------------------------------------------------------------------------------------


def snap(law: bool) -> tuple[np.ndarray, np.ndarray]:
    """Thresholds and residuals of a robot at rest; the target of one board comes back from 0.05 rad."""
    ticks = []
    error = np.concatenate([np.full(200, 0.05), np.linspace(0.05, 0.0, 6), np.zeros(60)])
    for number, one in enumerate(error):
        errors = np.zeros(JOINTS)
        errors[0] = one
        made = tick(number, errors)
        # No current holds it there; one drives it home, and is the larger the nearer the joint is.
        made.measurement.current[0] = (0.05 - one) * (number < 212) / PER_AMPERE
        ticks.append(made)
    signal = fusion_generator(parts=FusionParts(law=law))
    played = play(signal, ticks)
    return np.array([one.threshold for one in played]), np.array([one.residual for one in played])


def test_a_jump_raises_the_threshold_of_its_joint_and_of_what_it_shakes() -> None:
    (with_law, _), (without, _) = snap(True), snap(False)
    ratio = with_law / without
    assert np.nanmin(ratio) >= 1.0 - 1e-9
    others = ratio[:, 1:]
    assert np.nanmax(others) == pytest.approx(HELD_FACTOR)
    # It lasts as long as the jump shows, and until the joint has settled.
    assert 1 <= np.count_nonzero(others[:, 0] > 1.01) <= 2 * SETTLING_TICKS + SETTINGS.fusion_window
    assert (ratio[:195] == 1.0).all()
