"""Every shipped plant runs with the default observer, in free motion and at rest; nothing touches it."""

from collections.abc import Callable

import numpy as np
import pytest

from pepper_driver import Contact, Pepper
from pepper_driver.config import load_robot, plant_names

ROBOT = load_robot()
IDENTIFIED = ("integral", "nominal")
"""Plants with models of their own: on these nothing may be detected. The others are like a robot on another day."""
JOINTS = [name for chain in ("head", "left_arm", "right_arm") for name in ROBOT.chains[chain]]
MIDDLE, HALF_RANGE = (ROBOT.lower + ROBOT.upper) / 2, (ROBOT.upper - ROBOT.lower) / 2


def move(pepper: Pepper, postures: int, rng: np.random.Generator) -> None:
    """Go from one random posture of arms and head to the next, 2.5 s for each."""
    for _ in range(postures):
        posture = MIDDLE + 0.7 * HALF_RANGE * rng.uniform(-1.0, 1.0, len(MIDDLE))
        pepper.set_posture({name: posture[ROBOT.joint_index(name)] for name in JOINTS})
        pepper.run(2.5)


def false_contacts(plant: str, *, before: int, rest: float, after: int) -> list[Contact]:
    """Contacts of a run with that many postures before and after a time at rest [s]."""
    rng = np.random.default_rng([1, *plant.encode()])
    with Pepper(f"mujoco://?plant={plant}&seed=1") as pepper:
        start = pepper.time
        move(pepper, before, rng)
        pepper.set_posture("Stand", duration=2.5)
        pepper.run(rest)
        move(pepper, after, rng)
        assert pepper.time - start == pytest.approx(2.5 * (before + after) + rest, abs=0.5)
        assert pepper.observation is not None
        predicted = np.isfinite(pepper.observation.expected)
        assert not pepper.backend.truth.fallen
        detected = [event for event in pepper.contact_history if event.phase == "begin"]
    assert predicted.all(), "every joint has a model"
    return [event for event in detected if event.kind != "rebound"]


@pytest.mark.parametrize("plant", plant_names())
def test_a_plant_runs(plant: str) -> None:
    false = false_contacts(plant, before=2, rest=2.0, after=1)
    if plant in IDENTIFIED:
        assert not false


@pytest.mark.whole
@pytest.mark.parametrize("plant", plant_names())
def test_a_plant_runs_for_a_minute(
    plant: str, record_property: Callable[[str, object], None]
) -> None:
    false = false_contacts(plant, before=10, rest=20.0, after=6)
    record_property("false_contacts", len(false))
    places = ", ".join(f"{event.link} at {event.time:.1f} s" for event in false)
    print(f"{plant}: {len(false)} false contacts in 60 s: {places or 'none'}")
    if plant in IDENTIFIED:
        assert not false
