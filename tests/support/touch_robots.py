"""Robots of a split for tests: identified at once, with takes of some seconds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

import pepper_driver.evaluation.touch.split as split
import pepper_driver.observer.models as models
from pepper_driver.config import load_robot
from pepper_driver.config.touch_suites import EVEN, load_touch_suites
from pepper_driver.evaluation.touch.split import Judging
from pepper_driver.evaluation.touch.takes import TakeSpec
from pepper_driver.identification import IdentifiedRobot

FAILS = 5
"""Draw of the robot that cannot be identified."""


def own_models(name: str) -> Path:
    """Return a shipped model file."""
    assert models.__file__ is not None
    return Path(models.__file__).parent / f"nominal-{name}.json"


def identified(
    uri: str,
    draws: Sequence[int],
    *args: object,
    progress: Callable[[IdentifiedRobot, int, int], None],
    **kwargs: object,
) -> tuple[IdentifiedRobot, ...]:
    """Stand in for an identification of several minutes: shipped models, and a robot that fails."""
    robots = []
    for draw in draws:
        robot = IdentifiedRobot(
            draw=draw,
            name=f"random-{draw}",
            state="identified",
            file=own_models("fusion"),
            other_files=(own_models("affine"), own_models("cart")),
            report={"fit": {"fusion": {"LElbowRoll": {"estimation": 90.0, "test": 80.0}}}},
        )
        if draw == FAILS:
            robot = replace(
                robot, state="failed", file=None, other_files=(), reason="it broke", report={}
            )
        progress(robot, 0, 0)
        robots.append(robot)
    return tuple(robots)


def two_takes(judging: Judging, draw: int) -> tuple[TakeSpec, ...]:
    """Return one short take with touches and one without, of the takes of a robot."""
    takes = plan(judging, draw)
    touched = next(take for take in takes if take.name == "touch-gesturing-0")
    free = next(take for take in takes if take.name == "free-gesturing-0")
    acts = [act for act in touched.acts if act.row.name == EVEN]
    return replace(touched, acts=tuple(acts[:2])), replace(free, seconds=2.0)


plan = Judging.specs


def short_judging(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Judging:
    """Return the judging of robots that are identified at once, with two takes of some seconds each."""
    monkeypatch.setattr(split, "identify_population", identified)
    monkeypatch.setattr(Judging, "specs", two_takes)
    return Judging(
        suites=load_touch_suites(load_robot()),
        free=40.0,
        observers=("fusion", "momentum"),
        folder=folder / "work",
        records=folder / "records",
    )
