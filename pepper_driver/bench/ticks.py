"""Time of whole ticks in real time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import ComTask, PositionTask
from pepper_driver.realtime import Statistics
from pepper_driver.reflexes import Hold
from pepper_driver.robot import Pepper

TARGET_TIME = 2.4
"""[s] from one pair of targets of the hands to the next."""

REACH = 0.05
"""[m] Targets of a hand lie around its place in the posture, this far along each axis at most."""

WRISTS = ("l_wrist", "r_wrist")

# The arms bent before the body: straight ones could not reach their targets.
POSTURE = {
    "LShoulderPitch": 0.9,
    "LShoulderRoll": 0.3,
    "LElbowYaw": -0.8,
    "LElbowRoll": -0.9,
    "RShoulderPitch": 0.9,
    "RShoulderRoll": -0.3,
    "RElbowYaw": 0.8,
    "RElbowRoll": 0.9,
}


def run_tick_bench(
    seconds: float = 20.0,
    *,
    busy: bool = False,
    on_progress: Callable[[float], None] | None = None,
) -> Statistics:
    """Time ticks of a simulated robot in real time: controller of five tasks, observer, reflex, gate and log.

    Between two ticks the processor sleeps and caches grow cold, as they do with a robot: a tick takes longer than when
    ticks follow one another.

    Args:
        seconds: How long [s].
        busy: Compute in Python all the time in the main thread, next to the loop thread, in place of waiting.
        on_progress: Called with the fraction done, 0..1.
    """
    report_progress = on_progress or (lambda fraction: None)
    rng = np.random.default_rng(0)
    with TemporaryDirectory() as folder:
        log = Path(folder) / "bench.mcap"
        with Pepper("mujoco", log=log, reflexes=[Hold()], real_time=True) as pepper:
            pepper.set_posture(POSTURE, duration=1.5)
            pepper.run(2.0)
            wrists, homes = _five_tasks(pepper)
            pepper.clear_statistics()
            for number in range(rounds := max(1, round(seconds / TARGET_TIME))):
                for wrist, home in zip(wrists, homes, strict=True):
                    wrist.target = home + rng.uniform(-REACH, REACH, 3)
                if busy:
                    compute(TARGET_TIME)
                else:
                    pepper.run(TARGET_TIME)
                report_progress((number + 1) / rounds)
            return pepper.statistics


def compute(seconds: float) -> None:
    """Compute in Python for a time [s], as user code may, and never release the interpreter."""
    end = perf_counter() + seconds
    while perf_counter() < end:
        sum(range(1000))


def _five_tasks(pepper: Pepper) -> tuple[list[PositionTask], list[FloatArray]]:
    """Tasks of both hands and the centre of mass, in addition to posture and base; and the poses of the hands."""
    controller = pepper.controller
    wrists = [PositionTask(link, base=True, robot=pepper.config) for link in WRISTS]
    for task in (*wrists, ComTask(base=True, robot=pepper.config)):
        pepper.add(task)
    return wrists, [controller.model.link_pose(link, controller.position)[:3, 3] for link in WRISTS]
