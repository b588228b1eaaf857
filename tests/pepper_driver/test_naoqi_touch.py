"""A touch that is detected through all of NAOqi, in virtual time."""

from __future__ import annotations

import pytest

from support.pushes import joints_of_a_push
from support.virtual_naoqi import VirtualNaoqi

pytestmark = pytest.mark.usefixtures("qi")


def test_a_whole_pepper_detects_a_push() -> None:
    with VirtualNaoqi() as robot:
        robot.wake_up()
        assert joints_of_a_push(robot.pepper(observer="fusion"))[:1] == ["LShoulderRoll"]
