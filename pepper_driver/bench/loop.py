"""Time of each stage of a tick, speed of the simulation, and what loop and plant cost beside bare physics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np

from pepper_driver.backends import Backend, Command, make_backend, with_query
from pepper_driver.backends.mujoco_.backend import MujocoBackend, Snapshot
from pepper_driver.bench.machine import one_core
from pepper_driver.bench.physics import RecordedSteps, StepRecorder
from pepper_driver.config import load_experiment
from pepper_driver.controller import Tick
from pepper_driver.observer import shipped
from pepper_driver.realtime import Statistics
from pepper_driver.reflexes import Hold
from pepper_driver.robot import Pepper
from pepper_driver.session import OnTick

RUNS = 5
"""The same motion again and again: of each turn, the quickest run counts."""

TURN = 2.0
"""[s] for which the loop runs before the plant alone, then bare physics, do the same."""

START = 1.0
"""[s] of the robot before the first turn."""

RANGE = 0.5
"""[rad] around the middle of the joint's range: where goals lie."""


@dataclass(frozen=True, kw_only=True)
class Speed:
    """Speed of one plant, simulated time over wall time, and ratios of wall times for the same motion.

    Attributes:
        loop: Speed of the whole loop with its log.
        plant: Speed of the plant without the layers above it, given the same commands.
        physics: Speed of MuJoCo's steps alone, given the same states, controls and frictions.
    """

    loop: float
    plant: float
    physics: float

    @property
    def loop_over_physics(self) -> float:
        """Wall time of the loop over that of the steps in it."""
        return self.physics / self.loop

    @property
    def plant_over_physics(self) -> float:
        """Wall time of the plant over that of the steps in it."""
        return self.physics / self.plant


@dataclass(frozen=True, kw_only=True)
class LoopBench:
    """Figures of the loop.

    Attributes:
        ticks: Timing of the ticks on the first plant, in the quickest run; their stages ``read`` and ``write`` are the
            simulated robot.
        speed: By plant.
    """

    ticks: Statistics
    speed: dict[str, Speed]

    def as_json(self) -> dict[str, Any]:
        """``stage_us``, ``tick_us``, ``simulation``, ``loop_over_physics``, ``plant_over_physics``."""
        return {
            "stage_us": {stage: asdict(spread) for stage, spread in self.ticks.stages.items()},
            "tick_us": asdict(self.ticks.tick),
            "simulation": {
                plant: {
                    "real_time_factor": speed.loop,
                    "plant_alone_real_time_factor": speed.plant,
                    "physics_real_time_factor": speed.physics,
                }
                for plant, speed in self.speed.items()
            },
            "loop_over_physics": {
                plant: speed.loop_over_physics for plant, speed in self.speed.items()
            },
            "plant_over_physics": {
                plant: speed.plant_over_physics for plant, speed in self.speed.items()
            },
        }


def run_loop_bench(
    seconds: float = 20.0,
    *,
    plants: Sequence[str] = ("nominal",),
    on_progress: Callable[[float], None] | None = None,
) -> LoopBench:
    """Measure on the simulated robot, moving both arms, with observer, reflex and log, on one core.

    The loop, the plant alone and bare physics take turns with the same motion, so that a machine that slows down slows
    all of them. All is repeated, and of each turn the least time of each of the three counts: others can only lengthen
    it. Neither pushes nor grabs occur.

    Args:
        seconds: Simulated time of one run on one plant.
        plants: Names or files; the stages are timed on the first.
        on_progress: Called with the fraction done, 0..1.
    """
    report_progress = on_progress or (lambda fraction: None)
    measured = []
    with one_core(), TemporaryDirectory() as folder:
        for number, plant in enumerate(plants):

            def advance(fraction: float, number: int = number) -> None:
                report_progress((number + fraction) / len(plants))

            measured.append(_measure(plant, seconds, Path(folder) / "bench.mcap", advance))
    return LoopBench(
        ticks=measured[0][0],
        speed={plant: speed for plant, (_, speed) in zip(plants, measured, strict=True)},
    )


@dataclass(frozen=True, kw_only=True)
class RecordedTurn:
    """Effect of a turn of the loop on the simulated robot: commands, and steps of physics."""

    commands: Sequence[Command]
    steps: RecordedSteps


def record_turns(plant: str, count: int, log: Path) -> tuple[Snapshot, list[RecordedTurn]]:
    """Have a robot run some turns; returns its state before the first one, and what it did in each.

    Args:
        plant: Name or file.
        count: Number of turns.
        log: Where the robot's log goes.
    """
    with _robot(plant, log) as pepper:
        info = pepper.backend.info
        length = round(TURN / info.cycle)
        config = pepper.backend.plant.config
        assert config is not None  # of MuJoCo
        assert isinstance(pepper.backend, MujocoBackend)
        snapshot = pepper.backend.snapshot()
        ticks: list[Tick] = []
        with StepRecorder(length * round(info.cycle / config.physics.timestep)) as recorder:
            for posture in islice(_postures(pepper), count):
                _turn(pepper, posture, lambda tick, _: ticks.append(tick))
        # A tick has the command that its measurement answers: the last ones come with later ticks.
        pepper.run(info.response_delay * info.cycle, on_tick=lambda tick, _: ticks.append(tick))
    commands = [tick.sent for tick in ticks[info.response_delay :]]
    return snapshot, [
        RecordedTurn(commands=commands[number * length : (number + 1) * length], steps=steps)
        for number, steps in enumerate(recorder.recordings)
    ]


def _measure(
    plant: str, seconds: float, log: Path, report_progress: Callable[[float], None]
) -> tuple[Statistics, Speed]:
    snapshot, turns = record_turns(plant, max(1, round(seconds / TURN)), log)
    report_progress(1 / (RUNS + 1))
    times = np.empty((RUNS, 3, len(turns)))
    statistics: list[Statistics] = []
    for run, time in enumerate(times):
        with _robot(plant, log) as pepper, _plant(plant) as backend:
            backend.open()
            backend.restore(snapshot)
            for number, (turn, posture) in enumerate(zip(turns, _postures(pepper), strict=False)):
                time[0, number] = _time(partial(_turn, pepper, posture))
                time[1, number] = _time(partial(_exchange, backend, turn.commands))
                time[2, number] = turn.steps.replay()
            statistics.append(pepper.statistics)
        report_progress((run + 2) / (RUNS + 1))
    simulated = sum(len(turn.commands) for turn in turns) * backend.info.cycle
    loop, alone, physics = simulated / times.min(axis=0).sum(axis=-1)
    quickest = int(times[:, 0].sum(axis=-1).argmin())
    return statistics[quickest], Speed(loop=float(loop), plant=float(alone), physics=float(physics))


@contextmanager
def _robot(plant: str, log: Path) -> Iterator[Pepper]:
    """Yield a robot with all that a tick may have, some time after its start."""
    observer = "fusion" if plant in shipped("fusion") else None
    with Pepper(_uri(plant), observer=observer, log=log, reflexes=[Hold()]) as pepper:
        pepper.run(START)
        pepper.clear_statistics()
        yield pepper


def _plant(plant: str) -> MujocoBackend:
    backend = make_backend(_uri(plant))
    assert isinstance(backend, MujocoBackend)
    return backend


def _uri(plant: str) -> str:
    return with_query("mujoco", plant=plant)


def _postures(pepper: Pepper) -> Iterator[dict[str, float]]:
    """Yield a random goal for each turn, the same for each robot."""
    rng, robot = np.random.default_rng(0), pepper.config
    middle = (robot.lower + robot.upper) / 2
    joints = load_experiment("demo", robot).touched_joints
    while True:
        offset = rng.uniform(-RANGE, RANGE, len(joints))
        yield {
            name: float(middle[robot.joint_index(name)] + way)
            for name, way in zip(joints, offset, strict=True)
        }


def _turn(pepper: Pepper, posture: dict[str, float], on_tick: OnTick | None = None) -> None:
    pepper.set_posture(posture)
    pepper.run(TURN, on_tick=on_tick)


def _exchange(backend: Backend, commands: Sequence[Command]) -> None:
    for command in commands:
        backend.exchange(command)


def _time(work: Callable[[], None]) -> float:
    begin = process_time()
    work()
    return process_time() - begin
