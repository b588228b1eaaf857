"""The baseline ``momentum``: the torque balance of Eq. 10 on joints whose constants are known."""

import numpy as np
import pytest

from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.models.model_file import ModelSet
from pepper_driver.observer.residuals.momentum import MomentumGenerator
from support.fusion import ELBOW, STICK_SLIP, drive, fusion_model, push_profile, swing, ticks_of
from support.observer import CYCLE, JOINTS, ROBOT, SETTINGS


def signal(threshold: float = 0.02) -> MomentumGenerator:
    models = [fusion_model(STICK_SLIP) if joint == ELBOW else None for joint in range(JOINTS)]
    return MomentumGenerator(models, CYCLE, np.full(JOINTS, threshold), 5)


def test_a_push_in_motion_shows_as_its_torque_over_the_stiffness() -> None:
    motion = swing(8.0, 0.5, 1.5)
    push = push_profile(len(motion), 4.0, 1.5, 4.0)
    watched = signal()
    made = ticks_of(motion, drive(motion, torque=push))
    residual = np.array([watched.step(tick).residual[ELBOW] for tick in made])
    moving = np.abs(motion.velocity) > 0.2
    held = moving & (push > 0.99 * push.max())
    free = moving & (push == 0.0)
    free[: round(1.0 / CYCLE)] = False
    assert held.any()
    assert np.median(residual[held]) == pytest.approx(-STICK_SLIP.load_gain * 4.0, rel=0.25)
    assert np.abs(np.median(residual[free])) < 0.1 * STICK_SLIP.load_gain * 4.0


def test_joints_without_a_model_are_blind() -> None:
    motion = swing(1.0)
    made = ticks_of(motion, drive(motion))
    watched = signal()
    out = [watched.step(tick) for tick in made]
    assert all(one.blind.sum() == JOINTS - 1 for one in out)
    assert all(np.isnan(one.residual[~one.blind]).sum() == 0 for one in out)


def test_the_observer_momentum_uses_its_own_bound() -> None:
    model = fusion_model(STICK_SLIP)
    models = ModelSet(
        robot=ROBOT.name,
        joint_names=ROBOT.joint_names,
        identity="x",
        kind="fusion",
        cycle=ROBOT.cycle,
        estimation_fit={"LElbowRoll": 90.0},
        test_fit={"LElbowRoll": 90.0},
        threshold={"LElbowRoll": 0.02},
        version="0",
        models={"LElbowRoll": model},
    )
    observer = ContactObserver(ROBOT, models, SETTINGS, momentum=True)
    assert observer.describe().startswith("momentum: fusion models of 1 joints")
    assert f"{np.degrees(model.momentum_bound):.2f} deg" in observer.describe()
