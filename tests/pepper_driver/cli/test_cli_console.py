"""Parts that the sub-commands share: progress where there is no terminal."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from pepper_driver.cli.console import LineProgress, duration_text


class Clock:
    def __init__(self) -> None:
        self.time = 100.0

    def __call__(self) -> float:
        return self.time


def progress(count: bool) -> tuple[LineProgress, Clock]:
    bars, clock = LineProgress(Console(file=io.StringIO()), count=count), Clock()
    assert bars.disable
    bars.get_time = clock
    return bars, clock


def test_a_line_for_each_tenth_with_the_time_that_remains() -> None:
    bars, clock = progress(count=False)
    bar = bars.add_task("moving", total=1.0)
    assert list(bars.lines()) == ["moving: 0%"]
    for fraction, line in (
        (0.05, []),
        (0.10, ["moving: 10%, about 90 s left"]),
        (0.19, []),
        (0.25, ["moving: 25%, about 75 s left"]),
    ):
        clock.time = 100.0 + 100.0 * fraction  # 100 s in all
        bars.update(bar, completed=fraction)
        assert list(bars.lines()) == line


def test_a_line_for_each_take_and_each_run() -> None:
    bars, clock = progress(count=True)
    bar = bars.add_task("evaluating", total=4)
    clock.time += 600.0
    bars.update(bar, completed=1)
    assert list(bars.lines()) == ["evaluating: 1 of 4, about 30 min left"]
    bars, clock = progress(count=False)
    bar = bars.add_task("LElbowRoll-1", total=1000.0)
    list(bars.lines())
    clock.time += 10.0
    bars.update(bar, completed=10.0, description="LElbowRoll-2")
    assert list(bars.lines()) == ["LElbowRoll-2: 1%, about 16 min left"]


def test_what_was_done_before_says_nothing_about_the_time() -> None:
    bars, clock = progress(count=False)
    bar = bars.add_task("recording", total=100.0, completed=80, before=80.0)
    assert list(bars.lines()) == ["recording: 80%"]
    clock.time += 60.0
    bars.update(bar, completed=90.0)
    assert list(bars.lines()) == ["recording: 90%, about 60 s left"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.2, "0 s"), (99.4, "99 s"), (100.0, "2 min"), (3599.0, "1 h 00 min"), (7500, "2 h 05 min")],
)
def test_durations_are_for_people(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text
