"""A run without the robot: controller and safety gate alone, to see beforehand that nothing stops them."""

from __future__ import annotations

import numpy as np

from pepper_driver.config import PepperError, load_robot
from pepper_driver.controller import Tick
from pepper_driver.experiments.plan import plan_experiment
from pepper_driver.identification.runs import Run
from pepper_driver.observer import Observation
from pepper_driver.robot import Pepper
from pepper_driver.safety import FaultError


class RehearsalError(PepperError, RuntimeError):
    """A run would not go as it should; nothing has moved."""


def rehearse(run: Run) -> None:
    """Have controller and gate play a run.

    Raises:
        RehearsalError: The gate would stop the robot or alter a command, or the controller would find no motion that
            keeps its constraints.
    """
    robot = load_robot()
    pepper = Pepper("mock", observer=None, robot=robot)
    time = 0.0

    def watch(tick: Tick, _: Observation | None) -> None:
        nonlocal time
        time = tick.measurement.time
        # Of the last cycle: it is the command of the next one.
        status = pepper.controller.status
        if status.solver != "solved":
            lost = ", ".join(status.unmet) or status.solver
            raise RehearsalError(f"the controller cannot keep its limits ({lost})")
        if tick.changed.any():
            joint = robot.joint_names[int(np.argmax(tick.changed))]
            raise RehearsalError(f"the safety gate would alter the command of {joint}")

    plan = plan_experiment(run.experiment, robot, pepper.backend, seed=run.seed)
    try:
        with pepper:
            pepper.play(plan, on_tick=watch, skip_settling=True)
    except (RehearsalError, FaultError) as error:
        raise RehearsalError(
            f"run {run.name} would fail {time:.1f} s after its start: {error}; nothing has moved"
        ) from error
