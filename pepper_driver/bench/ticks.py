"""Time of each stage of a tick, of whole ticks in real time, and speed of the simulation."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np

from pepper_driver.backends import Command, make_backend
from pepper_driver.config import load_experiment
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import ComTask, PositionTask
from pepper_driver.observer import shipped
from pepper_driver.realtime import Statistics
from pepper_driver.reflexes import Hold
from pepper_driver.robot import Pepper


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Figures of one run.

    Attributes:
        ticks: Timing of the ticks on the first plant; their stages ``read`` and ``write`` are the physics.
        real_time_factor: By plant: simulated time over wall-clock time, whole tick with log, on one core.
        plant_alone: The same for the plant without the layers above it.
    """

    ticks: Statistics
    real_time_factor: dict[str, float]
    plant_alone: dict[str, float]

    def as_json(self) -> dict[str, Any]:
        """``stage_us``, ``tick_us``, ``simulation``."""
        return {
            "stage_us": {stage: asdict(spread) for stage, spread in self.ticks.stages.items()},
            "tick_us": asdict(self.ticks.tick),
            "simulation": {
                plant: {
                    "real_time_factor": self.real_time_factor[plant],
                    "plant_alone_real_time_factor": self.plant_alone[plant],
                }
                for plant in self.real_time_factor
            },
        }


def run_bench(
    seconds: float = 20.0,
    *,
    plants: Sequence[str] = ("nominal",),
    on_progress: Callable[[float], None] | None = None,
) -> Bench:
    """Measure on the simulated robot, moving both arms, with observer, reflex and log, on one core.

    Args:
        seconds: Simulated time for each plant.
        plants: Names or files; the stages are timed on the first.
        on_progress: Called with the fraction done, 0..1.
    """
    report_progress = on_progress or (lambda fraction: None)
    statistics: list[Statistics] = []
    factor, alone = {}, {}
    with _one_core(), TemporaryDirectory() as folder:
        for number, plant in enumerate(plants):
            ticks, factor[plant] = _whole(plant, seconds, Path(folder) / f"{number}.mcap")
            statistics.append(ticks)
            report_progress((number + 0.6) / len(plants))
            alone[plant] = _alone(plant, seconds)
            report_progress((number + 1) / len(plants))
    return Bench(ticks=statistics[0], real_time_factor=factor, plant_alone=alone)


def _whole(plant: str, seconds: float, log: Path) -> tuple[Statistics, float]:
    """Measure the times of the stages, and the real-time factor of the whole loop."""
    observer = "fusion" if plant in shipped("fusion") else None
    pepper = Pepper(f"mujoco://?plant={plant}", observer=observer, log=log, reflexes=[Hold()])
    rng = np.random.default_rng(0)
    joints = load_experiment("demo", pepper.config).touched_joints
    with pepper:
        pepper.run(1.0)
        pepper.clear_statistics()
        begin, start = perf_counter(), pepper.time
        while pepper.time - start < seconds:
            middle = (pepper.config.lower + pepper.config.upper) / 2
            pepper.set_posture(
                {
                    name: float(middle[pepper.config.joint_index(name)] + rng.uniform(-0.5, 0.5))
                    for name in joints
                }
            )
            pepper.run(2.0)
        factor = (pepper.time - start) / (perf_counter() - begin)
        return pepper.statistics, factor


def _alone(plant: str, seconds: float) -> float:
    """Real-time factor of the plant with a command that moves one arm."""
    with make_backend(f"mujoco://?plant={plant}") as backend:
        backend.open()
        hold = backend.activate().position
        index = backend.info.joint_names.index("LShoulderRoll")
        ticks = round(seconds / backend.info.cycle)
        stiffness, wheels = np.ones(len(hold)), np.zeros(3)
        begin = perf_counter()
        for tick in range(ticks):
            position = hold.copy()
            position[index] += 0.3 * (1 - np.cos(tick * backend.info.cycle * 3.0))
            backend.exchange(Command(position=position, stiffness=stiffness, wheel_speed=wheels))
        return seconds / (perf_counter() - begin)


@contextmanager
def _one_core() -> Iterator[None]:
    """Keep this process, with its log thread, on one core where the system allows it."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


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
