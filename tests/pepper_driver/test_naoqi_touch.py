"""A touch that is felt through all of NAOqi, in virtual time."""

from __future__ import annotations

import pytest

from pepper_driver.observer import Contact
from support.virtual_naoqi import VirtualNaoqi

pytestmark = pytest.mark.usefixtures("qi")


def test_a_whole_pepper_feels_a_push() -> None:
    felt: list[Contact] = []
    with VirtualNaoqi() as robot:
        robot.wake_up()
        with robot.pepper(observer="fusion") as pepper:
            pepper.on_contact()(felt.append)
            pepper.set_posture({"LShoulderRoll": 0.6}, duration=1.5)
            pepper.run(2.5)
            pepper.push("LBicep", [0.0, 30.0, 0.0], point=[0.16, 0.0, 0.0], duration=1.0)
            pepper.run(1.5)
    assert [contact.joint for contact in felt][:1] == ["LShoulderRoll"]
