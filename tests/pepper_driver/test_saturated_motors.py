"""An arm whose load takes all torque of a motor falls behind and catches up: that is no touch."""

from pathlib import Path

import pytest

from pepper_driver import Contact, Pepper
from pepper_driver.config import load_robot
from pepper_driver.config.settings import load_observer_settings
from pepper_driver.observer import ContactObserver
from pepper_driver.observer.contact_observer import ObserverParts
from pepper_driver.observer.models.model_file import ModelSet, shipped
from pepper_driver.observer.residuals.fusion import FusionParts

ROBOT = load_robot()
SHOULDER = ROBOT.joint_index("RShoulderRoll")
MAX_CURRENT = 3.2
"""[A] Of the board of the shoulder roll."""

PLANT = """
name: heavy-arm
description: 0.8 kg in the right hand, worn gears
extends: nominal
factors: {efficiency: 0.8}
body:
  masses: {RBicep: 1.4, RForeArm: 1.6, r_gripper: 1.6}
  payloads: [{link: r_wrist, mass: 0.8, radius: 0.03, xyz: [0.08, 0.0, -0.03]}]
"""


def observer(law: bool) -> ContactObserver:
    """The observer of the project, with or without the law of the boards."""
    return ContactObserver(
        ROBOT,
        ModelSet.load(shipped("fusion")["nominal"], ROBOT),
        load_observer_settings(),
        parts=ObserverParts(residual=FusionParts(law=law)),
    )


def lift(folder: Path, *, law: bool) -> tuple[list[Contact], float]:
    """Contacts of an arm that is lifted sideways four times, and the seconds for which its motor is at its limit."""
    path = folder / "heavy-arm.yaml"
    path.write_text(PLANT)
    with Pepper(f"mujoco://?plant={path}", observer=observer(law)) as pepper:
        pepper.set_posture(
            {"RShoulderPitch": 1.5, "RShoulderRoll": -0.3, "RElbowRoll": 0.1, "RElbowYaw": 1.2}
        )
        pepper.run(4.0)
        ready, saturated = pepper.time, 0
        for goal in (-1.3, -0.4) * 4:
            pepper.set_posture({"RShoulderRoll": goal})
            for _ in range(round(2.5 / ROBOT.cycle)):
                pepper.step()
                saturated += pepper.measurement.current[SHOULDER] > 0.98 * MAX_CURRENT
        contacts = [c for c in pepper.contact_history if c.detection_time > ready]
    return contacts, saturated * ROBOT.cycle


def test_a_saturated_motor_is_no_touch(tmp_path: Path) -> None:
    contacts, saturated = lift(tmp_path, law=True)
    assert saturated > 3.0
    assert [c for c in contacts if c.limb == "right_arm"] == []


def test_without_the_law_of_the_boards_it_would_be_one(tmp_path: Path) -> None:
    contacts, _ = lift(tmp_path, law=False)
    assert {c.shown_by for c in contacts if c.limb == "right_arm"} == {"RShoulderRoll"}


@pytest.mark.parametrize("force", [-35.0, 35.0])
def test_a_strong_push_is_one_although_it_saturates_the_motor(force: float) -> None:
    with Pepper("mujoco") as pepper:
        pepper.set_posture({"RShoulderPitch": 1.5, "RShoulderRoll": -0.6, "RElbowRoll": 0.1})
        pepper.run(4.0)
        pushed, largest = pepper.time, 0.0
        pepper.push("r_wrist", [0.0, force, 0.0], duration=0.4)
        for _ in range(round(1.5 / ROBOT.cycle)):
            pepper.step()
            largest = max(largest, float(pepper.measurement.current[SHOULDER]))
        contact = next(c for c in pepper.contact_history if c.limb == "right_arm")
    assert largest > 0.98 * MAX_CURRENT
    assert pushed < contact.detection_time < pushed + 0.2


def push_twice(direction: list[float], *, law: bool) -> list[tuple[str, str | None]]:
    """Limb and kind of the contacts of a strong push, and of a weaker one 0.35 s after it."""
    with Pepper("mujoco", observer=observer(law)) as pepper:
        pepper.set_posture({"RShoulderPitch": 1.0, "RElbowRoll": 0.6})
        pepper.run(4.0)
        for force, duration, following in ((45.0, 0.3, 0.65), (25.0, 0.6, 1.5)):
            pepper.push("r_wrist", [force * part for part in direction], duration=duration)
            pepper.run(following)
        return [(contact.limb, contact.kind) for contact in pepper.contact_history]


@pytest.mark.parametrize("direction", [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
def test_a_push_soon_after_a_strong_one_is_the_same_as_without_the_law(
    direction: list[float],
) -> None:
    found = push_twice(direction, law=True)
    assert len(found) >= 2
    assert found == push_twice(direction, law=False)
