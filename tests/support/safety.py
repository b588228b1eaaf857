"""The gate with the shipped settings, as most tests of it make it."""

from dataclasses import replace
from typing import Any

import numpy as np

from pepper_driver.config import load_controller_settings, load_robot, load_safety_settings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.safety import SafetyGate

ROBOT = load_robot()
SAFETY = load_safety_settings()
CONTROLLER = load_controller_settings(ROBOT)
STAND = ROBOT.posture("Stand")
ONES, STILL = np.ones(17), np.zeros(3)
"""All joints stiff, all wheels at rest."""


def new_gate(**settings: Any) -> SafetyGate:
    """A gate before it is activated, with some other settings."""
    return SafetyGate(ROBOT, replace(SAFETY, **settings), CONTROLLER)


def active_gate(position: FloatArray = STAND, **settings: Any) -> SafetyGate:
    """A gate of a robot that stands at ``position`` (17,) [rad], with some other settings."""
    gate = new_gate(**settings)
    gate.activate(position)
    return gate
