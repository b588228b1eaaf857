"""Ways of joints: splines, Bezier curves, steps towards a target."""

from itertools import accumulate, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.naoqi_server.almotion.curves import Bezier, Point, Spline, approach

angles = st.floats(-2.0, 2.0)
steps = st.lists(st.floats(0.1, 2.0), min_size=1, max_size=6)


@given(st.data(), angles, steps)
def test_a_spline_meets_its_points_and_stays_between_them(
    data: st.DataObject, start: float, gaps: list[float]
) -> None:
    times = list(accumulate(gaps))
    values = data.draw(st.lists(angles, min_size=len(times), max_size=len(times)))
    spline = Spline((start, 0.0), times, values)
    assert spline.at(0.0) == start
    assert [spline.at(time) for time in times] == pytest.approx(values)
    assert spline.at(times[-1] + 5) == values[-1]
    bounds = [(0.0, start), *zip(times, values, strict=True)]
    for (t0, v0), (t1, v1) in pairwise(bounds):
        inside = [spline.at(t) for t in np.linspace(t0, t1, 20)]
        assert min(inside) >= min(v0, v1) - 1e-9
        assert max(inside) <= max(v0, v1) + 1e-9


@given(angles, angles, st.floats(0.2, 3.0), st.floats(-0.5, 0.5))
def test_a_spline_begins_with_its_slope_and_ends_at_rest(
    start: float, end: float, time: float, slope: float
) -> None:
    spline = Spline((start, slope), [time], [end])
    dt = 1e-5
    assert (spline.at(dt) - spline.at(0.0)) / dt == pytest.approx(slope, abs=1e-2)
    assert (spline.at(time) - spline.at(time - dt)) / dt == pytest.approx(0.0, abs=1e-2)


def test_a_spline_is_fastest_in_the_middle_by_half_as_much_as_its_mean() -> None:
    spline = Spline((0.0, 0.0), [2.0], [1.0])
    assert (spline.at(1.0005) - spline.at(0.9995)) / 0.001 == pytest.approx(0.75, rel=1e-3)


def test_a_bezier_without_handles_is_straight_lines() -> None:
    curve = Bezier(0.0, [Point(time=1.0, value=1.0), Point(time=3.0, value=0.0)])
    assert [curve.at(t) for t in (0.0, 0.25, 1.0, 2.0, 3.0, 9.0)] == pytest.approx(
        [0.0, 0.25, 1.0, 0.5, 0.0, 0.0], abs=1e-6
    )


def test_a_bezier_with_handles_of_a_third_is_the_cubic_it_says() -> None:
    # Level handles at both ends over a third of the time: 3 s^2 - 2 s^3.
    points = [
        Point(time=0.5, value=0.0, after=(0.5, 0.0)),
        Point(time=2.0, value=1.0, before=(-0.5, 0.0)),
    ]
    curve = Bezier(0.0, points)
    for fraction in (0.1, 0.5, 0.8):
        expected = 3 * fraction**2 - 2 * fraction**3
        assert curve.at(0.5 + 1.5 * fraction) == pytest.approx(expected, abs=1e-6)


@given(
    st.lists(
        st.tuples(st.floats(0.1, 1.0), angles, *[st.floats(-3.0, 3.0)] * 4), min_size=1, max_size=4
    )
)
def test_time_never_runs_backwards_in_a_bezier(rows: list[tuple[float, ...]]) -> None:
    time, points = 0.0, []
    for gap, value, a, b, c, d in rows:
        time += gap
        points.append(Point(time=time, value=value, before=(a, b), after=(c, d)))
    curve = Bezier(0.0, points)
    for point in points:
        assert curve.at(point.time) == pytest.approx(point.value, abs=1e-4)


@given(angles, st.floats(-1.0, 1.0), angles, st.floats(0.1, 1.0))
def test_an_approach_arrives_within_its_limits(
    position: float, velocity: float, target: float, speed: float
) -> None:
    acceleration, dt = 4.0 * max(speed, abs(velocity)), 0.02
    for _ in range(5000):
        before = velocity
        position, velocity = approach(
            position, velocity, target, speed=speed, acceleration=acceleration, dt=dt
        )
        assert abs(velocity - before) <= acceleration * dt + 1e-9
        if abs(before) <= speed:
            assert abs(velocity) <= speed + 1e-9
        if position == target:
            break
    assert position == target
    assert velocity == 0.0


@given(angles, angles, st.floats(0.05, 1.0))
def test_from_rest_an_approach_does_not_overshoot(
    start: float, target: float, speed: float
) -> None:
    position, velocity, most = start, 0.0, abs(target - start)
    for _ in range(5000):
        position, velocity = approach(
            position, velocity, target, speed=speed, acceleration=4 * speed, dt=0.02
        )
        gap = abs(target - position)
        assert gap <= most + 1e-9
        most = gap
    assert position == target
