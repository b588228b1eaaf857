"""The controller of replays: in every cycle in the state that the recorded one was in."""

from __future__ import annotations

import numpy as np

from pepper_driver.config import load_controller_settings
from pepper_driver.controller import Reference, WholeBodyController
from pepper_driver.replay.playback import PlaybackController
from support.controller import ROBOT

SETTINGS = load_controller_settings(ROBOT)


def moving() -> WholeBodyController:
    controller = WholeBodyController(ROBOT, SETTINGS)
    controller.reset(ROBOT.posture("Stand"))
    controller.posture.target = np.clip(
        ROBOT.posture("Stand") + 0.2, controller.lower, controller.upper
    )
    controller.base_velocity.target = [0.2, -0.1, 0.5]
    return controller


def test_it_goes_through_the_same_states_bit_for_bit() -> None:
    then = moving()
    references: list[Reference] = []
    states = []
    for _ in range(100):
        references.append(then.step())
        states.append((then.position, then.velocity, then.base_pose))
    now = PlaybackController(ROBOT, SETTINGS, references)
    now.reset(ROBOT.posture("Stand"))
    for reference, (position, velocity, base) in zip(references, states, strict=True):
        assert now.step() is reference
        assert now.position.tobytes() == position.tobytes()
        assert now.velocity.tobytes() == velocity.tobytes()
        np.testing.assert_allclose(now.base_pose, base, atol=1e-9)
    assert now.step() is references[-1], "after the end it stays as it is"


def test_what_the_gate_changes_leads_to_the_same_state() -> None:
    then = moving()
    references, states = [], []

    def limited(step: int, controller: WholeBodyController) -> None:
        if step in (5, 6, 20):
            position = controller.position
            position[3] -= 0.004
            controller.override_state(position, np.zeros(3) if step == 20 else None)

    for step in range(40):
        references.append(then.step())
        limited(step, then)
        states.append((then.position, then.velocity))
    now = PlaybackController(ROBOT, SETTINGS, references)
    now.reset(ROBOT.posture("Stand"))
    for step, (position, velocity) in enumerate(states):
        now.step()
        limited(step, now)
        assert now.position.tobytes() == position.tobytes(), step
        assert now.velocity.tobytes() == velocity.tobytes(), step


def test_tasks_change_nothing() -> None:
    references = [moving().step() for _ in range(3)]
    now = PlaybackController(ROBOT, SETTINGS, references)
    now.reset(ROBOT.posture("Stand"))
    now.posture.target = ROBOT.posture("StandZero")
    now.hold = True
    assert [now.step() for _ in range(3)] == references


def test_without_references_it_is_a_controller_like_any_other() -> None:
    now, then = PlaybackController(ROBOT, SETTINGS, []), WholeBodyController(ROBOT, SETTINGS)
    for controller in (now, then):
        controller.reset(ROBOT.posture("Stand"))
        controller.posture.target = ROBOT.posture("StandZero")
    assert now.step().position.tobytes() == then.step().position.tobytes()
