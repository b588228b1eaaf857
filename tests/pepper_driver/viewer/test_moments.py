"""Moments of a log: the way of the base against the simulation, contacts against a plain scan of their events."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver import Pepper
from pepper_driver.log import read_log
from pepper_driver.observer import Contact
from pepper_driver.viewer.moments import Moments, base_path


@pytest.mark.parametrize("truth", [True, False])
def test_the_path_of_a_log_is_that_of_the_robot(truth: bool, tmp_path: Path) -> None:
    """By its wheels within a few centimetres, where the log has no truth."""
    path = tmp_path / "run.mcap"
    with Pepper("mujoco", observer=None, log=path) as pepper:
        pepper.drive(0.2, 0.05, 0.3, hold=True)
        pepper.run(4.0)
        end = pepper.backend.truth.base
    log = read_log(path)
    if not truth:
        object.__setattr__(log, "truth", None)
    base, _ = base_path(log)
    assert base[0] == pytest.approx(np.zeros(3), abs=1e-3)
    assert base[-1] == pytest.approx(end, abs=5e-3 if truth else 0.06)


@pytest.fixture(scope="module")
def touched(tmp_path_factory: pytest.TempPathFactory) -> Moments:
    path = tmp_path_factory.mktemp("touched") / "run.mcap"
    with Pepper("mujoco", log=path) as pepper:
        pepper.run(2.0)
        for link in ("LForeArm", "RForeArm"):
            pepper.push(link, [-25.0, 0.0, 0.0], duration=0.6)
            pepper.run(1.5)
    return Moments(read_log(path))


def test_ticks_are_found_by_their_time(touched: Moments) -> None:
    time = touched.log["time"]
    assert touched.row(-5.0) == touched.row(float(time[0])) == 0
    for row in (1, 77, len(time) - 1):
        assert touched.row(float(time[row])) == row
        assert touched.row(float(time[row]) - 1e-3) == row - 1
    assert touched.row(1e6) == len(time) - 1
    assert touched.picture(77).position == pytest.approx(touched.log["position"][77])


@given(moment=st.floats(0.0, 6.0))
def test_contacts_are_those_known_at_a_moment(touched: Moments, moment: float) -> None:
    known: dict[int, Contact] = {}
    for event in touched.log.contacts:
        if event.time <= moment:
            known[event.id] = event
    expected = [c for c in known.values() if c.phase != "end" and c.kind != "rebound"]
    assert touched.contacts(moment) == expected
    if len(expected) > 0:
        assert {c.limb for c in expected} <= {"left_arm", "right_arm"}


def test_true_forces_are_there_while_something_pushes(touched: Moments) -> None:
    """Forces of the truth that the posture of the base is from too."""
    assert touched.log.truth is not None
    rows = range(len(touched.log["time"]))
    pushed = {row: touched.picture(row).forces for row in rows if touched.picture(row).forces}
    times = touched.log["time"][list(pushed)]
    assert np.ptp(times) == pytest.approx(1.5 + 0.6, abs=0.1), "two pushes, with a pause"
    assert 2 * 0.5 < 0.012 * len(pushed) < 2 * 0.65
    largest = max(float(np.linalg.norm(f.force)) for fs in pushed.values() for f in fs)
    assert largest == pytest.approx(25.0, abs=0.5)
    assert {f.link for fs in pushed.values() for f in fs} == {"LForeArm", "RForeArm"}


def test_both_touches_are_detected(touched: Moments) -> None:
    limbs = [{c.limb for c in touched.contacts(t)} for t in touched.log["time"]]
    assert {"left_arm"} in limbs
    assert {"right_arm"} in limbs
    assert limbs[0] == set()
