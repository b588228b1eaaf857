"""Hands on the stand-in's robot from another process, and the state that it reports for a picture."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from pepper_driver.backends import BackendError, CommandError
from pepper_driver.backends.naoqi_server.hands import RemoteHand
from pepper_driver.config import PepperError, UnknownNameError
from support.virtual_naoqi import VirtualNaoqi

pytestmark = pytest.mark.usefixtures("qi")

CYCLE = 0.012  # [s]


@pytest.fixture
def robot() -> Iterator[VirtualNaoqi]:
    with VirtualNaoqi() as robot:
        yield robot


def hold(robot: VirtualNaoqi, hand: RemoteHand, way: list[float], seconds: float) -> None:
    """Move a hand to a place next to where it is, again and again."""
    goal = hand.point + way
    for _ in range(round(seconds / 0.1)):
        hand.move(goal)
        robot.time.sleep(0.1)


def test_its_force_is_that_of_its_spring_and_the_truth_has_it(robot: VirtualNaoqi) -> None:
    hand = robot.robot.take_hand("torso", [0.1, 0.0, 0.2], stiffness=1000.0, max_force=60.0)
    robot.time.sleep(CYCLE)
    goal = hand.point + np.array([0.02, 0.0, 0.0])
    for _ in range(20):
        hand.move(goal)
        robot.time.sleep(0.1)
    assert hand.holds
    assert hand.position == pytest.approx(goal, abs=1e-4)
    assert hand.force == pytest.approx(1000.0 * (goal - hand.point), abs=0.5)
    (contact,) = robot.robot.look().contacts
    assert (contact.kind, contact.link) == ("hand", "torso")
    assert contact.force == pytest.approx(hand.force, abs=0.2)


def test_its_force_stays_within_its_limit(robot: VirtualNaoqi) -> None:
    hand = robot.robot.take_hand("torso", None, stiffness=1000.0, max_force=60.0)
    robot.time.sleep(CYCLE)
    goal = hand.point + np.array([0.1, 0.0, 0.0])
    for _ in range(10):
        hand.move(goal, max_force=5.0)
        robot.time.sleep(0.1)
    assert np.linalg.norm(hand.force) == pytest.approx(5.0, abs=0.1)


def test_who_falls_silent_lets_go(robot: VirtualNaoqi) -> None:
    """As when the program that moves it was killed: no other program would open the hand."""
    hand = robot.robot.take_hand("torso", None, stiffness=1000.0, max_force=60.0)
    hold(robot, hand, [0.03, 0.0, 0.0], 1.0)
    assert robot.robot.look().contacts
    robot.time.sleep(0.7)
    assert not hand.holds
    assert robot.robot.look().contacts == ()


def test_released_it_lets_go_and_another_may_take_the_link(robot: VirtualNaoqi) -> None:
    hand = robot.robot.take_hand("torso", None, stiffness=1000.0, max_force=60.0)
    hold(robot, hand, [0.03, 0.0, 0.0], 0.5)
    with pytest.raises(CommandError, match="already holds torso"):
        robot.robot.take_hand("torso", None, stiffness=1000.0, max_force=60.0)
    hand.release()
    robot.time.sleep(0.2)
    assert robot.robot.look().contacts == ()
    robot.robot.take_hand("torso", None, stiffness=1000.0, max_force=60.0)
    hand.move([0.0, 0.0, 1.0])  # does nothing
    with pytest.raises(BackendError, match="has let go"):
        _ = hand.force


def test_what_is_wrong_is_refused(robot: VirtualNaoqi) -> None:
    with pytest.raises(UnknownNameError, match="Haed"):
        robot.robot.take_hand("Haed", None, stiffness=1000.0, max_force=60.0)
    hand = robot.robot.take_hand("Head", None, stiffness=1000.0, max_force=60.0)
    for wrong in ([np.nan, 0.0, 0.0], [0.0, 1.0]):
        with pytest.raises(PepperError):
            hand.move(wrong)


def test_the_scene_is_that_of_the_black_box(robot: VirtualNaoqi) -> None:
    robot.time.sleep(0.5)
    scene, box = robot.robot.look(), robot.black_box(1)
    assert np.array_equal(scene.position, box.position[-1])
    assert np.array_equal(scene.base, box.base[-1])
    assert np.abs(scene.tilt).max() < 0.01
