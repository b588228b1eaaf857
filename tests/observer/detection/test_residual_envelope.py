"""Residual envelope of a joint, against its definition: sorted block maxima of all samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.observer.detection.threshold import (
    BLOCK_TICKS,
    BLOCKS_PER_RANK,
    ENVELOPE_FACTOR,
    ENVELOPE_RANK,
    FEW_BLOCKS_FACTOR,
    FIRST_MOTION_TICKS,
    MAX_BLOCKS,
    MAX_ENVELOPE_FACTOR,
    MEDIAN_FACTOR,
    POST_CONTACT_TICKS,
    START_FACTOR,
    SUSPECT_TICKS,
    ResidualEnvelope,
)
from support.examples import examples

YES, NO = np.array([True]), np.array([False])
QUIET = 1e-3


def envelope(width: int = 1, identified: float = np.inf) -> ResidualEnvelope:
    """With thresholds so high, if nothing else is said, that nothing is suspected to be a touch."""
    return ResidualEnvelope(np.full(width, identified), np.full(width, START_FACTOR))


def learn_blocks(target: ResidualEnvelope, sizes: list[float]) -> None:
    """Half a second of motion for each of ``sizes``, the largest somewhere in it and the others less.

    And one more, quiet: a block counts when no touch has come in the next one.
    """
    for k, size in enumerate([*sizes, QUIET]):
        for sample in range(BLOCK_TICKS):
            here = sample == (7 * k) % BLOCK_TICKS
            target.learn(np.array([-size if here else 0.3 * size]), YES, YES)


def of_run(residual: FloatArray, seen: BoolArray, moving: BoolArray) -> list[float]:
    """Maxima of the blocks of one joint in a run that nothing touches, but for the last one."""
    maxima, begin = [], 0
    for end in (np.flatnonzero(seen & moving)[BLOCK_TICKS - 1 :: BLOCK_TICKS] + 1).tolist():
        inside = slice(begin, end)
        maxima.append(float(np.abs(residual[inside][seen[inside]]).max()))
        begin = end
    return maxima[:-1]


def defined(
    residual: FloatArray, seen: BoolArray, moving: BoolArray, touches: list[int]
) -> tuple[float, float]:
    """Bound and known fraction of one joint, from all samples at once."""
    maxima: list[float] = []
    for begin, end in zip([-1, *touches], [*touches, len(residual)], strict=True):
        run = slice(0 if begin < 0 else begin + 1 + POST_CONTACT_TICKS, end)
        maxima += of_run(residual[run], seen[run], moving[run])
    untouched = np.ones(len(residual), dtype=np.bool_)
    untouched[touches] = False
    known = min((seen & moving & untouched).sum() / FIRST_MOTION_TICKS, 1.0)
    kept = sorted(maxima[-MAX_BLOCKS:])
    if not kept:
        return 0.0, known
    largest = kept[-min(max(len(kept) // BLOCKS_PER_RANK, 1), ENVELOPE_RANK)]
    return min(ENVELOPE_FACTOR * largest, MEDIAN_FACTOR * kept[len(kept) // 2]), known


@examples(25)
@given(
    st.integers(1, 5000),
    st.floats(0.3, 1.0),
    st.floats(0.3, 1.0),
    st.lists(st.integers(0, 4999), max_size=4, unique=True),
    st.integers(0, 2**32 - 1),
)
def test_is_the_margin_over_a_high_rank_of_the_blocks(
    n: int, seen_share: float, moving_share: float, touches: list[int], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    residual = rng.standard_normal((n, 3)) * np.exp(rng.standard_normal((n, 1)))
    seen, moving = rng.uniform(size=(n, 3)) < seen_share, rng.uniform(size=(n, 3)) < moving_share
    touches = sorted(k for k in touches if k < n)
    target = envelope(3)
    for k, row in enumerate(zip(residual, seen, moving, strict=True)):
        if k in touches:
            target.touched()
        else:
            target.learn(*row)
    for joint in range(3):
        bound, known = defined(residual[:, joint], seen[:, joint], moving[:, joint], touches)
        assert target.envelopes["bound"][joint] == pytest.approx(bound, rel=1e-12)
        assert target.envelopes["known"][joint] == pytest.approx(known, rel=1e-12)


def test_forgets_what_was_longer_ago_than_it_remembers() -> None:
    target = envelope()
    learn_blocks(target, [0.2] * ENVELOPE_RANK + [0.1] * (MAX_BLOCKS - ENVELOPE_RANK))
    assert target.envelopes["bound"][0] == pytest.approx(ENVELOPE_FACTOR * 0.2)
    learn_blocks(target, [0.1] * ENVELOPE_RANK)
    assert target.envelopes["bound"][0] == pytest.approx(ENVELOPE_FACTOR * 0.1)


def test_two_touches_that_were_not_detected_have_no_effect() -> None:
    quiet = [0.1] * (BLOCKS_PER_RANK * ENVELOPE_RANK)
    target = envelope()
    learn_blocks(target, [*quiet, 0.2, *quiet[:5], 0.3])
    assert target.envelopes["bound"][0] == pytest.approx(ENVELOPE_FACTOR * 0.1)
    learn_blocks(target, [0.2])
    assert target.envelopes["bound"][0] == pytest.approx(ENVELOPE_FACTOR * 0.2)


def test_touches_in_every_fourth_block_do_not_make_it_deaf() -> None:
    target = envelope()
    learn_blocks(target, [9.0, 0.1, 0.1, 0.1] * 12)
    assert target.envelopes["bound"][0] == pytest.approx(MEDIAN_FACTOR * 0.1)


def test_of_the_first_blocks_the_largest_counts() -> None:
    """As long as they are too few, within FEW_BLOCKS_FACTOR medians: a touch is in few of them."""
    for identified, few in (
        (0.1, FEW_BLOCKS_FACTOR),
        (0.05, 2 * FEW_BLOCKS_FACTOR),
        (0.5, START_FACTOR),
    ):
        target = envelope(identified=identified)
        learn_blocks(target, [0.9, *[0.1] * (BLOCKS_PER_RANK - 2)])
        assert target.envelopes["bound"][0] == pytest.approx(MEDIAN_FACTOR * 0.1)
        assert target.envelopes["factor"][0] == pytest.approx(few)
        learn_blocks(target, [0.1])
        assert target.envelopes["factor"][0] == pytest.approx(
            min(MEDIAN_FACTOR * 0.1 / identified, MAX_ENVELOPE_FACTOR)
        )
    target = envelope(identified=0.1)
    learn_blocks(target, [0.2, *[0.1] * (BLOCKS_PER_RANK - 1)])
    assert target.envelopes["bound"][0] == pytest.approx(ENVELOPE_FACTOR * 0.2)
    learn_blocks(target, [0.1] * BLOCKS_PER_RANK)
    assert target.envelopes["bound"][0] == pytest.approx(ENVELOPE_FACTOR * 0.1)
    assert target.envelopes["factor"][0] == pytest.approx(ENVELOPE_FACTOR)


def test_all_is_known_after_the_first_blocks_of_motion() -> None:
    target = envelope()
    for k in range(BLOCKS_PER_RANK):
        assert target.envelopes["known"][0] == pytest.approx(k / BLOCKS_PER_RANK)
        target.touched()  # takes nothing of it away
        for _ in range(BLOCK_TICKS):
            target.learn(np.array([QUIET]), YES, YES)
    assert target.envelopes["known"][0] == 1.0
    learn_blocks(target, [QUIET] * MAX_BLOCKS)
    assert target.envelopes["known"][0] == 1.0


def test_rest_alone_proves_nothing_but_counts_with_motion() -> None:
    target = envelope()
    for _ in range(20 * BLOCK_TICKS):
        target.learn(np.array([0.2]), YES, NO)
    assert (target.envelopes["bound"][0], target.envelopes["known"][0]) == (0.0, 0.0)
    learn_blocks(target, [0.1] * BLOCKS_PER_RANK)
    assert target.envelopes["bound"][0] == pytest.approx(ENVELOPE_FACTOR * 0.2)


def test_the_beginning_of_a_touch_teaches_nothing() -> None:
    """It grows for a while before it is detected, and here the robot was at rest before."""
    target = envelope()
    learn_blocks(target, [0.1] * BLOCKS_PER_RANK)
    for _ in range(BLOCK_TICKS + BLOCK_TICKS // 2):
        target.learn(np.array([0.2]), YES, YES)
    target.touched()
    for _ in range(POST_CONTACT_TICKS):
        target.learn(np.array([0.1]), YES, YES)
    learn_blocks(target, [0.1] * 3)
    assert target.envelopes["bound"][0] == pytest.approx(ENVELOPE_FACTOR * 0.1)


def test_after_a_touch_nothing_is_learned_for_a_while() -> None:
    target = envelope()
    for touch in range(3):
        for _ in range(50):
            target.touched()
        # The last of them counts.
        for _ in range(POST_CONTACT_TICKS if touch == 2 else POST_CONTACT_TICKS // 2):
            target.learn(np.array([0.4]), YES, YES)
    learn_blocks(target, [0.1])
    assert target.envelopes["bound"][0] == pytest.approx(ENVELOPE_FACTOR * 0.1)


def test_a_touch_takes_nothing_of_what_was_learned_before() -> None:
    target = envelope()
    learn_blocks(target, [0.1] * BLOCKS_PER_RANK)
    target.touched()
    assert (target.envelopes["bound"][0], target.envelopes["known"][0]) == (
        pytest.approx(ENVELOPE_FACTOR * 0.1),
        1.0,
    )


def test_joints_that_cannot_be_judged_disturb_no_other() -> None:
    target = envelope(2)
    for _ in range((BLOCKS_PER_RANK + 1) * BLOCK_TICKS):
        target.learn(np.array([np.nan, 0.1]), np.array([False, True]), np.array([True, True]))
    np.testing.assert_allclose(target.envelopes["bound"], [0.0, ENVELOPE_FACTOR * 0.1])
    # Nor does it matter later that there was nothing.
    for _ in range(2 * BLOCK_TICKS):
        target.learn(np.array([0.2, 0.1]), np.array([True, True]), np.array([True, True]))
    np.testing.assert_allclose(
        target.envelopes["bound"], [ENVELOPE_FACTOR * 0.2, ENVELOPE_FACTOR * 0.1]
    )


def test_reset_forgets() -> None:
    target = envelope()
    learn_blocks(target, [9.0] * 30)
    for _ in range(BLOCK_TICKS // 2):  # of a block that is not full
        target.learn(np.array([9.0]), YES, YES)
    target.touched()
    target.reset()
    assert (target.envelopes["bound"][0], target.envelopes["known"][0]) == (0.0, 0.0)
    learn_blocks(target, [0.1] * BLOCKS_PER_RANK)
    assert target.envelopes["bound"][0] == pytest.approx(ENVELOPE_FACTOR * 0.1)


def test_long_after_a_touch_what_is_nearly_detected_counts_again() -> None:
    identified = 3.0 * ENVELOPE_FACTOR * QUIET
    target = envelope(identified=identified)
    learn_blocks(target, [QUIET] * (BLOCKS_PER_RANK + 2))
    target.touched()
    for _ in range(SUSPECT_TICKS + POST_CONTACT_TICKS):
        target.learn(np.array([QUIET]), YES, NO)
    before = float(target.envelopes["bound"][0])
    for _ in range(3 * BLOCK_TICKS):
        target.learn(np.array([0.9 * identified]), YES, YES)
    assert float(target.envelopes["bound"][0]) > before


@pytest.mark.parametrize(
    ("share", "touched", "counts"),
    [(0.9, True, False), (0.7, True, False), (0.5, True, True), (0.9, False, True)],
)
def test_what_is_nearly_detected_among_touches_widens_nothing(
    share: float, touched: bool, counts: bool
) -> None:
    """Once the envelope is known; without touch, all residuals count for the envelope."""
    identified = 3.0 * ENVELOPE_FACTOR * QUIET
    target = envelope(identified=identified)
    for _ in range((BLOCKS_PER_RANK + 2) * BLOCK_TICKS):
        target.learn(np.array([QUIET]), YES, YES)
    before = float(target.envelopes["bound"][0])
    assert target.envelopes["known"][0] == 1.0
    if touched:
        target.touched()
        for _ in range(POST_CONTACT_TICKS):
            target.learn(np.array([share * identified]), YES, YES)
    for _ in range(10 * BLOCK_TICKS):
        target.learn(np.array([share * identified]), YES, YES)
    assert (float(target.envelopes["bound"][0]) > before) == counts
