"""Reflexes on the simulated robot: the detected torque of a push leads the arm, and its own motion keeps none alive."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pepper_driver import Comply, FollowHand, Hold, Pepper, ReflexEvent, Retract
from pepper_driver.controller import RobotModel, Tick

POSTURE = {"LShoulderPitch": 0.6, "LShoulderRoll": 0.3, "LElbowYaw": -1.0, "LElbowRoll": -0.2}
POINT = np.array([0.14, 0.0, 0.0])


def ready(pepper: Pepper) -> None:
    """In POSTURE, after some seconds of motion from which the observer knows the arm."""
    home = {**POSTURE, "RShoulderRoll": -0.3}
    pepper.set_posture(home, duration=1.5)
    pepper.run(1.8)
    for swing in (0.15, -0.2, 0.0):
        pepper.set_posture({name: angle + swing for name, angle in POSTURE.items()}, duration=1.0)
        pepper.run(1.3)
    pepper.set_posture(home, duration=1.0)
    pepper.run(2.0)


def reactions(pepper: Pepper, events: list[ReflexEvent]) -> list[tuple[str, str]]:
    return [(event.reflex, event.phase) for event in events]


@pytest.mark.parametrize("then", ["resume", "stay"])
def test_an_arm_gives_way_and_what_it_does_then_is_no_contact(then: Any) -> None:
    events: list[ReflexEvent] = []
    with Pepper("mujoco://?seed=5", reflexes=[Comply(then=then)]) as pepper:
        pepper.on_reflex(phase=None)(events.append)
        ready(pepper)
        assert pepper.contact_history == ()
        model, truth = RobotModel(pepper.config), pepper.backend.truth

        def place() -> Any:
            return (model.link_pose("LForeArm", truth.position) @ np.append(POINT, 1.0))[:3]

        start = place()
        pepper.push("LForeArm", [0.0, 14.0, 0.0], POINT, 1.2, rise=0.05)
        pepper.run(1.1)
        assert np.linalg.norm(place() - start) > 0.05
        pepper.run(1.0)
        reported = len(pepper.contact_history)
        led = place()
        pepper.run(4.0)
        away = np.linalg.norm(place() - start)
        assert away > 0.05 if then == "stay" else away < 0.03
        if then == "stay":
            assert np.linalg.norm(place() - led) < 0.02
        assert len(pepper.contact_history) == reported
        assert reactions(pepper, events) == [("comply", "begin"), ("comply", "end")]


def test_an_arm_goes_away_from_a_hand_that_holds_on() -> None:
    forces: dict[bool, float] = {}
    for reflexes in ([], [Retract(release_delay=3.0)]):
        with Pepper("mujoco://?seed=5", reflexes=reflexes) as pepper:
            ready(pepper)
            truth = pepper.backend.truth
            # Square to the forearm: a pull along it puts no torque on a joint.
            arm = truth.link_pose("LForeArm")[:3, 0]
            pull = 0.05 * (np.array([0.0, 1.0, 0.0]) - arm[1] * arm)
            pepper.backend.grab("LForeArm", pull, POINT, rise=0.3, hold=2.0, release=0.2)
            pepper.run(1.0)
            [hand] = truth.contacts
            forces[bool(reflexes)] = float(np.linalg.norm(hand.force))
    assert forces[True] < 0.5 * forces[False]  # docs/results/reflexes.md has the figures


def test_the_base_rolls_where_its_hand_is_pulled_to_and_stops_when_let_go() -> None:
    with Pepper("mujoco://?seed=5", reflexes=[FollowHand(follow_with="base")]) as pepper:
        ready(pepper)
        pepper.push("l_wrist", [0.0, 18.0, 0.0], [0.05, 0.0, 0.0], 3.0, rise=0.1)
        pepper.run(3.0)
        way = np.array(pepper.backend.truth.base)
        assert way[1] > 0.05
        pepper.run(2.0)
        before = np.array(pepper.backend.truth.base)
        pepper.run(2.0)
        assert np.linalg.norm(np.array(pepper.backend.truth.base) - before) < 0.005


def test_priorities_hold_on_the_robot() -> None:
    """The left forearm would be led; a push on the right arm makes everything stand still."""
    speeds: list[float] = []
    with Pepper("mujoco://?seed=5", reflexes=[Comply(link="LForeArm"), Hold()]) as pepper:
        ready(pepper)
        pepper.set_posture({"HeadYaw": 0.8}, duration=6.0)
        pepper.push("RForeArm", [0.0, -20.0, 0.0], POINT, 2.0, rise=0.05)
        pepper.run(0.8)
        head = pepper.config.joint_index("HeadYaw")

        def note(tick: Tick, _: object) -> None:
            speeds.append(abs(float(tick.reference.velocity[head])))

        pepper.run(1.0, on_tick=note)
    assert max(speeds) < 1e-3
