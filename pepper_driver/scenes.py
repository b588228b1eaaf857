"""Plans a scenario to its last goal and contact, before the robot moves."""

from __future__ import annotations

import numpy as np

from pepper_driver.backends import Backend
from pepper_driver.config import RobotConfig, Scenario
from pepper_driver.scene import Scene, scene_after
from pepper_driver.timeline import legs
from pepper_driver.touch_planning import TouchPlanner


def plan_scenes(
    scenario: Scenario,
    robot: RobotConfig,
    backend: Backend,
    rng: np.random.Generator,
    *,
    count: int | None = None,
) -> tuple[Scene, ...]:
    """All scenes of a scenario, times counted from the end of the settling. Nothing moves.

    Contacts are planned for a robot at rest in the goal that the motion has at their start.

    Args:
        scenario: What is to be performed.
        robot: Its description.
        backend: Where; need not be open.
        rng: Source of all that is random.
        count: How many goals, for motion of kind setpoints or holds, in place of the scenario's own number.

    Raises:
        ConfigError: A contact that the robot could not take, that comes too late, or on a robot that cannot be pushed
            by software; the message names file and key.
    """
    planner = TouchPlanner(scenario, robot, backend) if scenario.contacts else None
    scenes: list[Scene] = []
    for leg in legs(scenario, robot, rng, count=count):
        last = scenes[-1] if scenes else None
        scene = scene_after(last, leg, scenario, robot)
        if planner is not None and not leg.settling:
            scene = planner.with_random(scene, last, rng)
        scenes.append(scene)
    if planner is not None:
        planner.add_stated(scenes)
    for scene in scenes:
        scene.touches.sort(key=lambda touch: touch.delay)
    return tuple(scenes)
