"""Orders to the stand-in and their dates, over its services in virtual time: lines, a clock that rolls over."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi_server.dcm import wrapped
from pepper_driver.config import load_robot
from support.stand_in_session import PREFIX
from support.virtual_naoqi import VirtualNaoqi

pytestmark = pytest.mark.usefixtures("qi")

YAW = load_robot().joint_index("HeadYaw")
HEAD = f"{PREFIX}HeadYaw/Position/Actuator/Value"
HARDNESS = f"{PREFIX}HeadYaw/Hardness/Actuator/Value"


@contextmanager
def stiff_head(clock: int = 5_000_000) -> Iterator[tuple[VirtualNaoqi, Connection]]:
    """A robot whose head has stiffness, and a client."""
    with VirtualNaoqi(clock=clock) as robot:
        client = robot.connect()
        now = client.call("DCM", "getTime", 0)
        client.call("DCM", "set", [HARDNESS, "ClearAll", [[1.0, now]]])
        yield robot, client


def test_a_joint_moves_along_a_straight_line_in_time() -> None:
    with stiff_head() as (robot, client):
        start = client.call("DCM", "getTime", 200)
        line = [[0.1, start], [0.5, wrapped(start + 400)]]
        client.call("DCM", "set", [HEAD, "ClearAll", line])
        robot.time.sleep(1.5)
        box = robot.black_box()
        assert client.call("ALMemory", "getData", HEAD) == 0.5
        seen = client.call("ALMemory", "getData", f"{PREFIX}HeadYaw/Position/Sensor/Value")
    on_way = (box.date > start) & (box.date < start + 400)
    assert on_way.sum() in (33, 34), "every 12 ms"
    expected = 0.1 + 0.4 * (box.date[on_way] - start) / 400
    assert box.position_command[on_way, YAW] == pytest.approx(expected, abs=1e-12)
    assert box.position[-1, YAW] == pytest.approx(0.5, abs=0.03)
    assert seen == pytest.approx(0.5, abs=0.03)


def test_a_clock_that_rolls_over_on_the_way() -> None:
    with stiff_head(clock=2**31 - 700) as (robot, client):
        before = client.call("DCM", "getTime", 0)
        far = client.call("DCM", "getTime", 2000)
        assert far < 0 < before
        client.call("DCM", "set", [HEAD, "ClearAll", [[0.6, far]]])
        robot.time.sleep(2.5)
        assert client.call("ALMemory", "getData", "DCM/Time") < 0
        box = robot.black_box()
    assert box.date[0] > 0 > box.date[-1]
    np.testing.assert_array_equal(np.diff(box.cycle), 1)
    on_way = np.array([wrapped(int(date) - far) < 0 for date in box.date])
    on_way &= box.position_command[:, YAW] > 0.0
    left = np.array([wrapped(far - int(date)) for date in box.date[on_way]])
    assert on_way.sum() > 160
    slope = np.diff(box.position_command[on_way, YAW]) / -np.diff(left)
    assert slope == pytest.approx(slope[0]), "one line"
    assert 0.6 / 2000 <= slope[0] < 0.6 / 1900, "from when the order came"
    assert box.position_command[on_way, YAW] == pytest.approx(0.6 - slope[0] * left)
    assert box.position_command[-1, YAW] == 0.6
