"""Excursions of one joint beyond its threshold: their states, their onsets, and the joints that friction holds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.observer.constants import CORRECTION_TIME, SETTLING_TICKS
from pepper_driver.observer.detection.excursions import ONSET_LEVEL, JointMonitor, ResidualHistory
from pepper_driver.observer.interface import JointState
from support.observer import CYCLE, SETTINGS, THRESHOLD

FREE, CONTACT, RELEASE, REBOUND, BLIND = (
    JointState.FREE,
    JointState.CONTACT,
    JointState.RELEASE,
    JointState.REBOUND,
    JointState.BLIND,
)
GAP = round(SETTINGS.merge_gap / CYCLE)
SETTLING_TIME = SETTLING_TICKS * CYCLE
WINDOW = int(SETTINGS.rebound_window / CYCLE)


def monitor() -> JointMonitor:
    return JointMonitor(3, SETTINGS, lambda joint, sign, threshold: -1.0)


def play(target: JointMonitor, *parts: tuple[float, int], start: int = 0) -> list[JointState]:
    """States for a residual that has each value for so many ticks, as multiples of the threshold."""
    states = []
    k = start
    for value, ticks in parts:
        for _ in range(ticks):
            states.append(target.step(k * CYCLE, value * THRESHOLD, THRESHOLD))
            k += 1
    return states


def test_a_touch_from_begin_to_end() -> None:
    joint = monitor()
    states = play(joint, (0.5, 5), (1.5, 4), (2.5, 3), (1.2, 3), (0.2, GAP + 5))
    assert states[:5] == [FREE] * 5
    assert states[5:15] == [CONTACT] * 10
    # Still within the gap at its very end, free with the next tick.
    assert states[15 : 15 + GAP + 1] == [RELEASE] * (GAP + 1)
    assert states[15 + GAP + 1 :] == [FREE] * 4
    assert joint.excursion is None


def test_an_excursion_keeps_its_figures() -> None:
    joint = monitor()
    play(joint, (0.5, 5), (-1.5, 4), (-2.5, 3), (-1.2, 3), (0.0, 2))
    excursion = joint.excursion
    assert excursion is not None
    assert (excursion.joint, excursion.sign, excursion.kind) == (3, -1, "contact")
    assert excursion.peak == pytest.approx(2.5 * THRESHOLD)
    assert excursion.begin_time == pytest.approx(5 * CYCLE)
    assert excursion.fall_time == pytest.approx(15 * CYCLE)
    assert excursion.onset_time == -1.0


def test_on_the_threshold_is_not_over_it() -> None:
    assert play(monitor(), (1.0, 3), (-1.0, 3)) == [FREE] * 6


@pytest.mark.parametrize(("gap", "same"), [(1, True), (GAP, True), (GAP + 1, False)])
def test_a_return_on_the_same_side_within_the_gap_goes_on(gap: int, same: bool) -> None:
    joint = monitor()
    play(joint, (1.5, 5))
    first = joint.excursion
    states = play(joint, (0.1, gap), (1.2, 3), start=5)
    assert states[-3:] == [CONTACT] * 3
    assert (joint.excursion is first) is same
    assert joint.excursion is not None
    assert joint.excursion.peak == pytest.approx((1.5 if same else 1.2) * THRESHOLD)


@pytest.mark.parametrize(
    ("gap", "rebound"), [(0, True), (1, True), (WINDOW, True), (WINDOW + 1, False)]
)
def test_the_other_side_soon_after_is_a_rebound(gap: int, rebound: bool) -> None:
    joint = monitor()
    states = play(joint, (3.0, 10), (0.0, gap), (-1.5, 4), (0.0, 3))
    state = REBOUND if rebound else CONTACT
    assert states[10 + gap : 14 + gap] == [state] * 4
    assert states[14 + gap :] == [RELEASE] * 3
    assert joint.excursion is not None
    assert joint.excursion.kind == ("rebound" if rebound else "contact")


def test_the_same_side_is_never_a_rebound() -> None:
    states = play(monitor(), (3.0, 10), (0.0, GAP + 2), (1.5, 4))
    assert states[-4:] == [CONTACT] * 4


def test_a_rebound_of_a_rebound_is_one_too() -> None:
    states = play(monitor(), (3.0, 10), (0.0, 5), (-1.5, 5), (0.0, 5), (1.2, 3))
    assert states[15:20] == [REBOUND] * 5
    assert states[-3:] == [REBOUND] * 3


def test_a_rebound_that_stays_is_a_contact() -> None:
    states = play(monitor(), (3.0, 10), (0.0, 5), (-1.5, WINDOW + 10))[15:]
    assert states[: WINDOW + 1] == [REBOUND] * (WINDOW + 1)
    assert states[WINDOW + 1 :] == [CONTACT] * 9


def test_a_blind_tick_ends_and_forgets_everything() -> None:
    joint = monitor()
    states = play(joint, (3.0, 10), (math.nan, 1), (-1.5, 2))
    assert states[10] is BLIND
    assert states[11:] == [CONTACT] * 2
    other = monitor()
    assert play(other, (3.0, 10), (0.0, 2), (math.nan, 2), (0.0, 1)) == (
        [CONTACT] * 10 + [RELEASE] * 2 + [BLIND] * 2 + [FREE]
    )


def test_reset_forgets() -> None:
    joint = monitor()
    play(joint, (3.0, 10), (0.0, 2))
    joint.reset()
    assert joint.excursion is None
    assert play(joint, (-1.5, 1), start=12) == [CONTACT]


@given(st.lists(st.floats(-3, 3) | st.just(math.nan), max_size=120))
def test_state_and_excursion_agree_for_any_signal(values: list[float]) -> None:
    joint = monitor()
    for k, value in enumerate(values):
        state = joint.step(k * CYCLE, value * THRESHOLD, THRESHOLD)
        excursion = joint.excursion
        if math.isnan(value):
            assert state is BLIND
        elif abs(value * THRESHOLD) > THRESHOLD:
            assert state in (CONTACT, REBOUND)
            assert excursion is not None
            assert excursion.over
            assert excursion.sign == math.copysign(1, value)
            assert excursion.peak >= abs(value * THRESHOLD)
            assert (state is REBOUND) == (excursion.kind == "rebound")
        else:
            assert state in (FREE, RELEASE)
        assert (excursion is None) == (state in (FREE, BLIND))


@given(
    st.lists(st.tuples(st.booleans(), st.floats(-0.99, 0.99), st.floats(-0.99, 0.99)), max_size=150)
)
def test_values_under_the_threshold_change_nothing(rows: list[tuple[bool, float, float]]) -> None:
    one, other = monitor(), monitor()
    for k, (over, first, second) in enumerate(rows):
        push = math.copysign(2.0, first) if over else 0.0
        a = one.step(k * CYCLE, (push or first) * THRESHOLD, THRESHOLD)
        b = other.step(k * CYCLE, (push or second) * THRESHOLD, THRESHOLD)
        assert a == b
        assert one.excursion == other.excursion


BAND = 2.5 * THRESHOLD
STUCK = round(SETTLING_TIME / CYCLE)
MAX_TICKS = math.ceil(CORRECTION_TIME / CYCLE)


class Settler:
    """A monitor of a joint whose model can be reset; residuals and bands as multiples of the threshold."""

    def __init__(self) -> None:
        self.joint = JointMonitor(
            3, SETTINGS, lambda joint, sign, threshold: -1.0, settling_time=SETTLING_TIME
        )
        self.k = 0
        self.settled: list[int] = []

    def play(self, value: float, ticks: int, band: float = BAND) -> list[JointState]:
        states = []
        for _ in range(ticks):
            states.append(self.joint.step(self.k * CYCLE, value * THRESHOLD, THRESHOLD, band))
            if self.joint.settled:
                self.settled.append(self.k)
            self.k += 1
        return states


def test_a_joint_that_friction_holds_away_from_its_target_is_released() -> None:
    player = Settler()
    player.play(4.0, 20)
    states = player.play(2.0, STUCK + 1)
    first = states.index(RELEASE)
    assert first == pytest.approx(STUCK, abs=1)
    assert player.settled == [20 + first]
    assert states[:first] == [CONTACT] * first
    # Its model can be reset now; if the residual stays all the same, it is another contact.
    rest = player.play(2.0, STUCK + 2)
    assert rest.index(CONTACT) == pytest.approx(STUCK, abs=1)
    assert set(rest[: rest.index(CONTACT)]) == {RELEASE}


@pytest.mark.parametrize("value", [2.61, -1.01])
def test_a_joint_that_was_released_may_be_touched_before_its_model_is_reset(value: float) -> None:
    """A residual that grows by 0.3 of itself, or has the other side."""
    player = Settler()
    player.play(4.0, 20)
    assert player.play(2.0, STUCK + 1)[-1] is RELEASE
    assert player.play(2.59, 2) == [RELEASE] * 2
    assert set(player.play(value, 2)) <= {CONTACT, REBOUND}


def test_nothing_is_left_over_after_reset() -> None:
    player = Settler()
    player.play(4.0, 20)
    assert player.play(2.0, STUCK + 1)[-1] is RELEASE
    player.joint.reset()
    assert player.play(2.0, 1) == [CONTACT]


def test_a_rebound_that_comes_to_rest_is_no_contact() -> None:
    """One that lasts longer is a contact, but where it fell and is constant, friction holds the joint."""
    for band, last in ((BAND, RELEASE), (0.0, CONTACT)):
        player = Settler()
        player.play(4.0, 20)
        states = [*player.play(-4.0, WINDOW // 2), *player.play(-2.0, STUCK + 1, band)]
        assert len(states) > WINDOW
        assert states[-1] is last
        assert (CONTACT in states) == (last is CONTACT)


def test_a_hand_that_still_pulls_is_no_friction() -> None:
    # Beyond what friction can hold, moving, or never fallen from its peak.
    for band, value in ((1.9 * THRESHOLD, 2.0), (0.0, 2.0)):
        player = Settler()
        player.play(4.0, 20, band)
        assert set(player.play(value, 3 * MAX_TICKS, band)) == {CONTACT}
    player = Settler()
    player.play(4.0, 20)
    for k in range(3 * MAX_TICKS):
        assert player.play(2.0 + 0.4 * math.sin(k / 3), 1) == [CONTACT]
    player = Settler()
    assert set(player.play(2.0, MAX_TICKS - 1)) == {CONTACT}


def test_one_that_never_fell_is_released_later() -> None:
    player = Settler()
    assert player.play(2.0, MAX_TICKS + 3).index(RELEASE) == pytest.approx(MAX_TICKS, abs=1)


def test_time_and_fraction_of_friction() -> None:
    """Settling time below 0.7 of the peak, or the time in which models follow."""
    for value, wait in ((2.7, SETTLING_TIME), (2.9, CORRECTION_TIME)):
        player = Settler()
        player.play(4.0, 20, 0.0)
        states = player.play(value, 140, 5.0 * THRESHOLD)
        assert states.index(RELEASE) * CYCLE == pytest.approx(wait, abs=2.1 * CYCLE)


@pytest.mark.parametrize(("wait", "kind"), [(0.02, REBOUND), (0.1, CONTACT)])
def test_a_hand_that_friction_outlasted_left_when_the_residual_became_constant(
    wait: float, kind: JointState
) -> None:
    """So the other side is its rebound for as long as if it had left then: 0.35 s."""
    player = Settler()
    player.play(4.0, 20)
    assert player.play(1.3, STUCK + 1)[-1] is RELEASE
    player.play(0.0, round(wait / CYCLE))
    assert player.play(-4.0, 1) == [kind]


def test_a_moment_in_which_a_hand_must_be_there_begins_the_wait_again() -> None:
    player = Settler()
    player.play(4.0, 20)
    assert RELEASE not in player.play(2.0, STUCK - 2)
    player.play(2.0, 1, band=1.9 * THRESHOLD)
    assert player.play(2.0, STUCK + 2).index(RELEASE) == pytest.approx(STUCK, abs=1)


def test_a_residual_that_has_moved_is_constant_from_then_on() -> None:
    player = Settler()
    player.play(4.0, 20)
    assert RELEASE not in player.play(2.7, STUCK - 2)
    assert player.play(1.8, STUCK + 2).index(RELEASE) == pytest.approx(STUCK, abs=1)


@pytest.mark.parametrize(
    "values",
    [
        (4.0, 1.2, 2.1),
        (4.0, 1.6, 4.0),
        (1.35, 1.2, 4.0),
    ],
)
def test_a_hand_that_pulls_less_and_more_is_one_touch(values: tuple[float, float, float]) -> None:
    player = Settler()
    for value in values:
        player.play(value, 60, band=0.0)
        assert player.joint.excursion is not None
        assert player.joint.excursion.begin_time == 0.0


def test_a_blind_tick_begins_the_wait_again() -> None:
    player = Settler()
    player.play(4.0, 3)
    assert RELEASE not in player.play(2.0, STUCK - 2)
    player.play(math.nan, 1)
    player.play(4.0, 1)
    assert RELEASE not in player.play(2.0, STUCK - 2)


def settler() -> JointMonitor:
    return JointMonitor(
        0, SETTINGS, lambda joint, sign, threshold: -1.0, settling_time=SETTLING_TIME
    )


def stuck(peak: float, values: tuple[float, float], band: float) -> bool:
    """True if a residual that has two values in turn, after a peak, is taken for friction within half a second."""
    joint = settler()
    joint.step(0.0, peak, 1.0, band)
    states = [joint.step(0.01 + 0.01 * k, values[k % 2], 1.0, band) for k in range(50)]
    return RELEASE in states


def test_what_is_exactly_at_its_bound_may_be_friction() -> None:
    """Residual at the band, two values that differ by 0.3 of the larger; but at 0.7 of its peak it has not fallen."""
    assert stuck(8.0, (2.0, 2.0), band=2.0)
    assert not stuck(8.0, (2.0, 2.0), band=1.99)
    assert stuck(8.0, (2.0, 2.59), band=3.0)
    assert not stuck(8.0, (2.0, 2.87), band=3.0)
    assert not stuck(2.0, (0.71 * 2.0, 0.71 * 2.0), band=3.0)
    assert stuck(2.0, (0.69 * 2.0, 0.69 * 2.0), band=3.0)


def test_without_a_band_nothing_is_friction() -> None:
    joint = settler()
    states = {joint.step(0.01 * k, 0.6 if k else 2.0, 0.5) for k in range(200)}
    assert states == {CONTACT}


def test_nothing_has_settled_at_first() -> None:
    assert not monitor().settled


def test_where_no_model_can_be_reset_nothing_is_ever_stuck() -> None:
    joint = monitor()
    values = [4.0] + [2.0] * 3 * MAX_TICKS
    states = {
        joint.step(k * CYCLE, value * THRESHOLD, THRESHOLD, BAND) for k, value in enumerate(values)
    }
    assert states == {CONTACT}


@given(st.lists(st.floats(-3, 3) | st.just(math.nan), max_size=200), st.floats(0.0, 4.0))
def test_a_joint_that_settles_has_ended_an_excursion(values: list[float], band: float) -> None:
    player = Settler()
    before = None
    for value in values:
        player.settled.clear()
        [state] = player.play(value, 1, band * THRESHOLD)
        now = player.joint.excursion
        if player.settled:
            assert before is not None
            assert now is not before
        assert (state is BLIND) == math.isnan(value)
        if now is None:
            assert state in (FREE, BLIND) or player.settled
        else:
            assert state in (CONTACT, REBOUND, RELEASE)
        before = now
    player.play(0.0, 3 * GAP)
    assert player.joint.excursion is None
    assert player.joint.idle


# -- onset ------------------------------------------------------------------------------------------------------------

BEYOND = 0.03


def history(signal: list[float], window: int = 11, lookback: int = 40) -> ResidualHistory:
    past = ResidualHistory(window, lookback, 2)
    for k, value in enumerate(signal):
        past.append(k * CYCLE, np.array([0.0, value]), 0.0)
    return past


def test_onset_is_where_the_ramp_passes_a_third_of_the_threshold() -> None:
    ramp = [0.0] * 30 + [0.004 * k for k in range(1, 14)]
    # 0.004 k reaches 0.01 with k = 3: sample 32.
    assert history(ramp).onset(1, 1, BEYOND) == pytest.approx(32 * CYCLE)
    mirrored = [-value for value in ramp]
    assert history(mirrored).onset(1, -1, BEYOND) == pytest.approx(32 * CYCLE)


def test_onset_does_not_depend_on_samples_before_the_run() -> None:
    ramp = [0.004 * k for k in range(1, 14)]
    for before in (0.0, -0.05, 0.009, float("nan")):
        assert history([before] * 30 + ramp).onset(1, 1, BEYOND) == pytest.approx(32 * CYCLE)


def test_a_step_is_dated_at_its_first_sample_in_the_window() -> None:
    assert history([0.0] * 50 + [0.1] * 6).onset(1, 1, BEYOND) == pytest.approx(50 * CYCLE)


def test_a_drop_inside_the_window_does_not_hide_the_onset() -> None:
    signal = [0.0] * 50 + [0.02, 0.04, 0.05, 0.0, 0.05, 0.05, 0.05, 0.05]
    assert history(signal).onset(1, 1, BEYOND) == pytest.approx(50 * CYCLE)


@pytest.mark.parametrize("before", [0, 3])
def test_a_drop_does_not_hide_the_onset_in_a_short_history(before: int) -> None:
    signal = [0.0] * before + [0.04, 0.0, 0.04]
    assert history(signal).onset(1, 1, BEYOND) == pytest.approx(before * CYCLE)


def test_what_is_exactly_at_the_threshold_or_its_third() -> None:
    """At the threshold is not over it; at a third of it is not free."""
    assert history([3.0, 0.0, 4.0]).onset(1, 1, 3.0) == pytest.approx(2 * CYCLE)
    assert history([0.5, 3.0 * ONSET_LEVEL, 4.0]).onset(1, 1, 3.0) == pytest.approx(CYCLE)


def test_growth_longer_than_the_history_is_put_at_its_beginning() -> None:
    slow = [0.02] * 200 + [0.04] * 6
    first = 206 - 51
    assert history(slow).onset(1, 1, BEYOND) == pytest.approx(first * CYCLE)
    assert history([0.04] * 3).onset(1, 1, BEYOND) == 0.0


def test_without_a_sample_over_the_threshold_the_newest_counts() -> None:
    assert history([0.0] * 20).onset(1, 1, BEYOND) == pytest.approx(19 * CYCLE)


def test_a_history_forgets_with_a_reset() -> None:
    past = history([0.04] * 30)
    past.reset()
    for k in (5, 6):
        past.append(float(k), np.array([0.0, 0.04]), 0.0)
    assert past.onset(1, 1, BEYOND) == 5.0


def test_the_base_is_the_column_after_the_joints() -> None:
    past = ResidualHistory(11, 40, 2)
    for k in range(50):
        joint, base = (0.04 if k >= 40 else 0.0), (-0.04 if k >= 45 else 0.0)
        past.append(k * CYCLE, np.array([0.0, joint]), base)
    assert past.onset(1, 1, BEYOND) == pytest.approx(40 * CYCLE)
    assert past.onset(2, -1, BEYOND) == pytest.approx(45 * CYCLE)
