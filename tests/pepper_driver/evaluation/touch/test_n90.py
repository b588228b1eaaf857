"""N90 against curves that are known, closed forms, and cases without a choice."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest, chi2

from pepper_driver.config.errors import ArgumentError
from pepper_driver.evaluation.touch.n90 import (
    N90,
    ForceTouch,
    n90,
    poisson_interval,
    recall_by_force,
    wilson_interval,
)
from support.examples import examples
from support.touch_records import FORCES


def drawn(
    middle: float, slope: float, lapse: float, *, robots: int, each: int, spread: float, seed: int
) -> list[ForceTouch]:
    """Touches of robots whose middles are spread by this in ln force."""
    rng = np.random.default_rng(seed)
    touches = []
    for robot in range(robots):
        own = math.log(middle) + spread * rng.standard_normal()
        for force in FORCES:
            fraction = (1 - lapse) / (1 + math.exp(-(math.log(force) - own) / slope))
            touches += [
                ForceTouch(force, bool(rng.random() < fraction), f"r{robot}") for _ in range(each)
            ]
    return touches


def expected(robot: str, fractions: dict[float, float], of: int) -> list[ForceTouch]:
    """Touches of which just these fractions are detected."""
    return [
        ForceTouch(force, number < round(fraction * of), robot)
        for force, fraction in fractions.items()
        for number in range(of)
    ]


def curve(middle: float, slope: float, lapse: float) -> dict[float, float]:
    return {f: (1 - lapse) / (1 + (middle / f) ** (1 / slope)) for f in FORCES}


@pytest.mark.parametrize("lapse", [0.0, 0.05])
@pytest.mark.parametrize("slope", [0.2, 0.45])
@pytest.mark.parametrize("middle", [4.0, 7.0])
def test_the_curve_behind_many_touches_is_found(middle: float, slope: float, lapse: float) -> None:
    result = n90(expected("a", curve(middle, slope, lapse), 1000))
    odds = 0.9 / (0.1 - lapse)
    assert result.newtons == pytest.approx(middle * odds**slope, rel=0.05)
    assert (result.slope, result.lapse) == (slope, lapse)
    assert (result.touches, result.robots) == (7000, 1)


@pytest.mark.parametrize(
    ("fractions", "text"),
    [
        (curve(20.0, 0.3, 0.0), "> 30"),
        (dict.fromkeys(FORCES, 0.0), "> 30"),
        # Stronger touches do not help: one in seven is not detected at any force.
        (curve(4.0, 0.2, 0.15), "> 30"),
        (dict.fromkeys(FORCES, 1.0), "< 2"),
        (curve(0.9, 0.2, 0.0), "< 2"),
        # Nothing is said of forces that were not tried.
        (dict.fromkeys((2.0, 3.0, 13.0), 0.0), "> 13"),
        (dict.fromkeys((5.0, 8.0), 1.0), "< 5"),
    ],
)
def test_a_force_that_is_not_reached_and_one_that_is_always_detected(
    fractions: dict[float, float], text: str
) -> None:
    result = n90([t for robot in "ab" for t in expected(robot, fractions, 200)])
    assert result.text == text
    if text.startswith("<"):
        assert result.below
        assert result.newtons == result.low == result.min_force == float(text[2:])
        assert result.worst == result.min_force
    else:
        assert not result.below
        assert result.newtons == result.high == result.worst == math.inf
        assert result.worst_text == text


def test_of_equal_curves_the_worst_counts() -> None:
    # Any middle between 2 and 30 N explains this.
    result = n90([ForceTouch(2.0, False, "a"), ForceTouch(30.0, True, "a")] * 10)
    assert 14.0 < result.newtons <= 30.0
    # One touch that is not detected says nothing of stronger ones.
    assert n90([ForceTouch(2.0, False, "a")]).newtons == math.inf


def test_the_worst_robot() -> None:
    touches = expected("good", curve(4.0, 0.2, 0.0), 400) + expected(
        "bad", curve(9.0, 0.2, 0.0), 400
    )
    result = n90(touches)
    assert result.worst_robot == "bad"
    # Its middle is its own, the slope that of both, which is flatter.
    assert result.slope > 0.2
    assert result.worst == pytest.approx(9.0 * 9.0**result.slope, rel=0.12)
    assert result.worst > result.newtons
    deaf = n90(touches + expected("deaf", dict.fromkeys(FORCES, 0.0), 400))
    assert (deaf.worst_robot, deaf.worst) == ("deaf", math.inf)


def test_the_interval_is_that_of_robots() -> None:
    alike = n90([t for r in "abcd" for t in expected(r, curve(5.0, 0.3, 0.02), 50)])
    assert alike.low == alike.newtons == alike.high
    unlike = n90(
        [
            t
            for r, m in zip("abcd", (3, 4, 6, 8), strict=True)
            for t in expected(r, curve(m, 0.2, 0.0), 50)
        ]
    )
    assert unlike.low is not None
    assert unlike.high is not None
    assert unlike.low < 0.85 * unlike.newtons
    assert unlike.high > 1.1 * unlike.newtons
    one = n90(expected("a", curve(5.0, 0.3, 0.0), 50))
    assert (one.low, one.high) == (None, None)
    assert one.text == f"{one.newtons:.1f}"


def test_the_interval_covers_the_truth() -> None:
    truth, covered, runs = 5.0 * 9.0**0.3, 0, 40
    for seed in range(runs):
        result = n90(drawn(5.0, 0.3, 0.0, robots=10, each=4, spread=0.2, seed=seed))
        assert result.low is not None
        assert result.high is not None
        covered += result.low <= truth <= result.high
        assert result.high < 3.0 * result.low
    # Of 40 intervals of 95 % fewer than 32 hold the truth once in 10^4 times; a bootstrap over ten is a little short.
    assert covered >= 32


def test_order_does_not_matter() -> None:
    touches = drawn(5.0, 0.3, 0.02, robots=5, each=3, spread=0.2, seed=1)
    result = n90(touches)
    assert n90(touches[::-1]) == result


def test_text() -> None:
    values = N90(
        newtons=7.42,
        low=6.1,
        high=9.0,
        worst=12.3,
        worst_robot="random 7",
        touches=10,
        robots=2,
        lapse=0.0,
        slope=0.3,
        min_force=2.0,
        max_force=30.0,
        below=False,
    )
    assert values.text == "7.4 (6.1-9.0)"
    assert values.worst_text == "12"
    assert replace(values, newtons=14.6, high=math.inf).text == "15 (6.1 to > 30)"
    assert replace(values, newtons=math.inf, high=math.inf).text == "> 30"
    assert replace(values, newtons=2.0, below=True).text == "< 2"


@examples(60)
@given(
    answers=st.lists(
        st.tuples(st.sampled_from(FORCES), st.booleans(), st.sampled_from("ab")),
        min_size=1,
        max_size=25,
    ),
    place=st.integers(0, 24),
    slope=st.sampled_from((0.08, 0.3, 1.0)),
    lapse=st.sampled_from((0.0, 0.05)),
)
def test_one_more_detection_never_raises_n90(
    answers: list[tuple[float, bool, str]], place: int, slope: float, lapse: float
) -> None:
    # With the slope given: a weak touch that is detected flattens a free curve, and moves its upper end up.
    before = [ForceTouch(*answer) for answer in answers]
    after = list(before)
    after[place % len(after)] = after[place % len(after)]._replace(detected=True)

    def value(touches: list[ForceTouch]) -> float:
        return n90(touches, slopes=(slope,), lapses=(lapse,)).newtons

    assert value(after) <= value(before)
    assert min(FORCES) <= n90(before).newtons


def test_bad_input() -> None:
    with pytest.raises(ArgumentError, match="at least one touch"):
        n90([])
    for force in (0.0, -2.0, math.nan, math.inf):
        with pytest.raises(ArgumentError, match="above 0 N"):
            n90([ForceTouch(force, True, "a")])


def test_recall_by_force() -> None:
    touches = [ForceTouch(8.0, n < 3, "a") for n in range(4)] + [ForceTouch(2.0, False, "b")]
    weak, strong = recall_by_force(touches)
    assert (weak.force, weak.detected, weak.of, weak.fraction) == (2.0, 0, 1, 0.0)
    assert (strong.force, strong.detected, strong.of, strong.fraction) == (8.0, 3, 4, 0.75)
    assert (strong.low, strong.high) == wilson_interval(3, 4)
    assert recall_by_force([]) == ()


@pytest.mark.parametrize(("count", "of"), [(0, 7), (7, 7), (3, 11), (63, 180)])
def test_wilson_interval(count: int, of: int) -> None:
    interval = binomtest(count, of).proportion_ci(0.95, method="wilson")
    assert wilson_interval(count, of) == pytest.approx((interval.low, interval.high))
    assert wilson_interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize(("count", "hours"), [(0, 3.0), (1, 0.5), (9, 0.5)])
def test_poisson_interval(count: int, hours: float) -> None:
    low = chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    high = chi2.ppf(0.975, 2 * count + 2) / 2
    assert poisson_interval(count, hours) == pytest.approx((low / hours, high / hours))
    assert poisson_interval(count, 0.0) == (0.0, math.inf)


def test_a_lapse_rate_is_that_of_ten_more_touches_that_were_detected() -> None:
    """3 of 21 strong touches are missed: with ten more detections a tenth, of which 0.08 is the nearest rate."""
    touches = [ForceTouch(2.0, False, "a") for _ in range(7)]
    touches += [
        ForceTouch(force, number > 0, "a") for force in (10.0, 20.0, 30.0) for number in range(7)
    ]
    assert n90(touches).lapse == 0.08
    # Of ten times as many they hardly count.
    assert n90(touches * 10).lapse == 0.15


def test_a_force_beyond_the_limit_is_not_reached() -> None:
    """At 20 N three touches in four are detected: the curve reaches nine in ten beyond it, where none was made."""
    touches = [
        ForceTouch(force, number < detected, f"r{number % 2}")
        for force, detected in ((5.0, 0), (8.0, 4), (12.0, 10), (20.0, 15))
        for number in range(20)
    ]
    beyond = n90(touches, lapses=(0.0,))
    assert 20.0 < beyond.newtons < 30.0
    within = n90(touches, lapses=(0.0,), limit=20.0)
    assert math.isinf(within.newtons)
    assert within.text == "> 20"
