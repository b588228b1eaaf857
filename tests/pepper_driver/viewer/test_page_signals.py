"""Curves of the joint that matters, and contacts as text and over a time line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser")
import viser

from pepper_driver.config import load_robot
from pepper_driver.observer import Contact
from pepper_driver.viewer.picture import Picture
from pepper_driver.viewer.signals import AUTOMATIC, Curves, pair_table, time_line

ROBOT = load_robot()
ROLL, HIP = ROBOT.joint_index("LShoulderRoll"), ROBOT.joint_index("HipRoll")


def contact(number: int, onset: float, end: float, **changes: Any) -> Contact:
    values: dict[str, Any] = {
        "id": number,
        "phase": "end",
        "kind": "contact",
        "limb": "left_arm",
        "link": "LBicep",
        "joint": "LShoulderPitch",
        "shown_by": "LShoulderRoll",
        "direction": 1,
        "intensity_deg": 3.0,
        "torque": 2.0,
        "torque_std": 0.5,
        "onset_time": onset,
        "detection_time": onset,
        "time": end,
    }
    return Contact(**(values | changes))


def picture(time: float, **excess: float) -> Picture:
    residual = np.zeros(17)
    for joint, value in excess.items():
        residual[ROBOT.joint_index(joint)] = 0.02 * value
    still = np.zeros(17)
    return Picture(
        time=time,
        position=still,
        commanded=still,
        residual=residual,
        threshold=np.full(17, 0.02),
        torque=still,
        torque_std=still,
        state=np.zeros(17, dtype=np.int64),
        base=np.zeros(3),
        tilt=np.zeros(2),
    )


@pytest.fixture
def curves() -> Iterator[Curves]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield Curves(server, ROBOT, AUTOMATIC)
    server.stop()


def shown(curves: Curves, moment: Picture, *contacts: Contact) -> float:
    """Residual [deg] in the chart, of which each joint has another."""
    curves.update([moment], moment, contacts)
    return float(np.asarray(curves._residual.data[1])[0])


def test_the_joint_that_shows_a_contact_is_drawn_though_another_has_a_larger_residual(
    curves: Curves,
) -> None:
    touch = contact(1, 0.0, 1.0)
    degrees = np.degrees(0.02)
    loaded = {"LShoulderRoll": 1.2, "HipRoll": 1.5}
    assert shown(curves, picture(1.0, **loaded)) == pytest.approx(1.5 * degrees)
    assert shown(curves, picture(1.1, **loaded), touch) == pytest.approx(1.2 * degrees)
    after = picture(2.0, **loaded)
    assert shown(curves, after) == pytest.approx(1.2 * degrees), "it stays for a while"
    assert shown(curves, picture(9.0, **loaded)) == pytest.approx(1.5 * degrees)
    curves.choice.value = "HipRoll"  # type: ignore[misc]  # the setter stands apart
    assert shown(curves, picture(9.1, **loaded), touch) == pytest.approx(1.5 * degrees)


def test_contacts_are_bars_over_the_time_of_the_log() -> None:
    first, second = contact(1, 2.0, 4.0), contact(2, 9.0, 9.5, phase="update")
    rebound = contact(3, 5.0, 5.001, kind="rebound")
    line = time_line([(first, None), (second, first), (rebound, None)], 0.0, 10.0, recomputed=True)
    bars = re.findall(r'<rect x="([\d.]+)" width="([\d.]+)" y="(\d+)"', line)
    found = {(float(x), float(w), y) for x, w, y in bars}
    assert found == {
        (200.0, 200.0, "1"),
        (900.0, 100.0, "1"),  # it lasts: the log does not say when it ended
        (200.0, 200.0, "13"),
        (500.0, 2.0, "1"),  # wide enough to be seen
    }
    assert line.count("#7F7F7F") == 1, "the rebound is grey"
    assert "recomputed" not in time_line([(first, None)], 0.0, 10.0, recomputed=False)


def test_pairs_stand_next_to_each_other_the_newest_first() -> None:
    pairs = [(contact(1, 2.0, 3.0), contact(1, 2.1, 3.0)), (None, contact(2, 5.0, 6.0))]
    cells = re.findall(r"<td>(.*?)</td>", pair_table(pairs, recomputed=True))
    assert cells == [
        "&ndash;",
        "5.00 s left bicep, contact, 3.0 deg",
        "2.00 s left bicep, contact, 3.0 deg",
        "2.10 s left bicep, contact, 3.0 deg",
    ]
    alone = pair_table([(contact(1, 2.0, 3.0, link="<b>"), None)], recomputed=False)
    assert re.findall(r"<td>(.*?)</td>", alone) == ["2.00 s &lt;b&gt;, contact, 3.0 deg"]
    assert "none until now" in pair_table([], recomputed=False)
