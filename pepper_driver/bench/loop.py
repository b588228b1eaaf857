"""Time of each stage of a tick, speed of the simulation, and the cost of loop and plant compared with bare physics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time, thread_time
from typing import Any

import numpy as np

from pepper_driver.backends import Backend, Command, make_backend, with_query
from pepper_driver.backends.mujoco_.backend import MujocoBackend, Snapshot
from pepper_driver.bench.machine import one_core
from pepper_driver.bench.physics import RecordedSteps, StepRecorder
from pepper_driver.config import load_experiment
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Tick
from pepper_driver.log import read_log
from pepper_driver.observer import shipped
from pepper_driver.realtime import Statistics
from pepper_driver.reflexes import Hold
from pepper_driver.robot import Pepper
from pepper_driver.session import OnTick

RUNS = 5
"""The same motion again and again: of each tick, the quickest run counts."""

TURN = 2.0
"""[s] for which the loop runs before the plant alone, then bare physics, do the same."""

START = 1.0
"""[s] of the robot before the first turn."""

RANGE = 0.5
"""[rad] around the middle of the joint's range: where goals lie."""


@dataclass(frozen=True, kw_only=True)
class Speed:
    """Cost of one plant, with and without what is around it, for the same motion.

    Attributes:
        loop: Simulated time over wall time of the whole loop with its log.
        plant: The same of the plant without the layers above it, given the same commands.
        loop_us: One tick of the loop, with ``log_us`` [us].
        log_us: Processor time that the log's thread takes to write a tick [us].
        plant_us: One tick of the plant [us].
        physics_us: MuJoCo's steps of one tick alone, given the same states, controls and frictions [us].
    """

    loop: float
    plant: float
    loop_us: float
    log_us: float
    plant_us: float
    physics_us: float

    @property
    def loop_over_physics(self) -> float:
        """Time of the loop over that of the steps in it."""
        return self.loop_us / self.physics_us

    @property
    def plant_over_physics(self) -> float:
        """Time of the plant over that of the steps in it."""
        return self.plant_us / self.physics_us


@dataclass(frozen=True, kw_only=True)
class LoopBench:
    """Results of the loop.

    Attributes:
        ticks: Timing of the ticks on the first plant, in the quickest run on all cores: the log's thread may have one
            of its own. Their stages ``read`` and ``write`` are the simulated robot.
        observer_us: Median of a tick of the observer alone, which plays the ticks of the first plant again, of each the
            quickest run; on one core. None where no models are shipped for this plant.
        speed: By plant, on one core.
    """

    ticks: Statistics
    observer_us: float | None
    speed: dict[str, Speed]

    def as_json(self) -> dict[str, Any]:
        """``stage_us``, ``tick_us``, ``observer_us``, ``simulation``, ``loop_over_physics``, ``plant_over_physics``."""
        return {
            "stage_us": {stage: asdict(spread) for stage, spread in self.ticks.stages.items()},
            "tick_us": asdict(self.ticks.tick),
            "observer_us": self.observer_us,
            "simulation": {
                plant: {
                    "real_time_factor": speed.loop,
                    "plant_alone_real_time_factor": speed.plant,
                    "loop_us": speed.loop_us,
                    "log_us": speed.log_us,
                    "plant_us": speed.plant_us,
                    "physics_us": speed.physics_us,
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
    """Measure on the simulated robot, moving both arms, with observer, reflex and log.

    On one core, the loop, the plant alone and bare physics take turns with the same motion, so that a machine that
    slows down slows all of them. All is repeated, and of each tick the least time of each of the three counts, since
    others can only lengthen it; of these times the median is compared. Neither pushes nor grabs occur.

    Args:
        seconds: Simulated time of one run on one plant.
        plants: Names or files; the stages are timed on the first.
        on_progress: Called with the fraction done, 0..1.
    """
    report_progress = on_progress or (lambda fraction: None)
    speed, turns = {}, max(1, round(seconds / TURN))
    with TemporaryDirectory() as folder:
        log = Path(folder) / "bench.mcap"
        for number, plant in enumerate(plants):

            def advance(fraction: float, number: int = number) -> None:
                report_progress((number + fraction) / (len(plants) + 1))

            with one_core():
                speed[plant] = _measure_speed(plant, turns, log, advance)
        ticks = min(
            (_time_ticks(plants[0], turns, log) for _ in range(RUNS)),
            key=lambda run: run.tick.median,
        )
        observer_us = time_observer(plants[0], turns, log)
    report_progress(1.0)
    return LoopBench(ticks=ticks, observer_us=observer_us, speed=speed)


def _time_ticks(plant: str, count: int, log: Path) -> Statistics:
    """Have a robot run some turns; returns the times of its ticks."""
    with _robot(plant, log) as pepper:
        for posture in islice(_postures(pepper), count):
            _turn(pepper, posture, lambda tick, _: None)
        return pepper.statistics


def time_observer(plant: str, count: int, log: Path) -> float | None:
    """Return the median time in which the observer of a robot takes in a tick [us], None without an observer.

    Args:
        plant: Name or file.
        count: Number of turns whose ticks it takes in.
        log: Where the robot's log goes.
    """
    ticks: list[Tick] = []
    with _robot(plant, log) as pepper:
        observer = pepper.observer
        for posture in islice(_postures(pepper), count):
            _turn(pepper, posture, lambda tick, _: ticks.append(tick))
    if observer is None:
        return None
    times = np.empty((RUNS, len(ticks)))
    with one_core():
        for run in range(RUNS):
            observer.reset()
            marks = [perf_counter()]
            for tick in ticks:
                observer.step(tick)
                marks.append(perf_counter())
            times[run] = np.diff(marks)
    return 1e6 * float(np.median(times.min(axis=0)))


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


def _measure_speed(
    plant: str, count: int, log: Path, report_progress: Callable[[float], None]
) -> Speed:
    snapshot, turns = record_turns(plant, count, log)
    report_progress(1 / (RUNS + 1))
    length, steps = len(turns[0].commands), len(turns[0].steps)
    # By run, turn and tick: the time of the loop, of the plant alone, of bare physics.
    times = np.empty((3, RUNS, len(turns), length))
    meanwhile, log_time = np.empty((RUNS, len(turns))), np.empty(RUNS)
    for run in range(RUNS):
        before = _other_threads()
        with _robot(plant, log) as pepper, _plant(plant) as backend:
            backend.open()
            backend.restore(snapshot)
            for number, (turn, posture) in enumerate(zip(turns, _postures(pepper), strict=False)):
                times[0, run, number], meanwhile[run, number] = _time_loop(pepper, posture)
                times[1, run, number] = _time_plant(backend, turn.commands)
                each = turn.steps.replay().reshape(length, steps // length)
                times[2, run, number] = each.sum(axis=1)
        # The log's thread writes many ticks at a time, in any turn, and the last ones at the end: the whole run counts.
        log_time[run] = (_other_threads() - before) / len(read_log(log))
        report_progress((run + 2) / (RUNS + 1))
    loop_us, plant_us, physics_us = 1e6 * np.median(times.min(axis=1), axis=(1, 2))
    loops = (times[0].sum(axis=-1) - meanwhile).min(axis=0) / length
    plants = times[1].sum(axis=-1).min(axis=0) / length
    log_us = 1e6 * float(log_time.min())
    return Speed(
        loop=backend.info.cycle / (float(loops.mean()) + 1e-6 * log_us),
        plant=backend.info.cycle / float(plants.mean()),
        loop_us=float(loop_us) + log_us,
        log_us=log_us,
        plant_us=float(plant_us),
        physics_us=float(physics_us),
    )


def _time_loop(pepper: Pepper, posture: dict[str, float]) -> tuple[FloatArray, float]:
    """Have the robot run a turn; returns the time of each tick, and what the log's thread took meanwhile [s]."""
    before, marks = _other_threads(), [perf_counter()]
    _turn(pepper, posture, lambda tick, _: marks.append(perf_counter()))
    return np.diff(marks), _other_threads() - before


def _other_threads() -> float:
    """Return the processor time of all threads but this one, which are the log's [s]."""
    return process_time() - thread_time()


def _time_plant(backend: Backend, commands: Sequence[Command]) -> FloatArray:
    """Give a plant the commands of a turn; returns the time of each tick [s]."""
    marks = [perf_counter()]
    for command in commands:
        backend.exchange(command)
        marks.append(perf_counter())
    return np.diff(marks)


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


def _turn(pepper: Pepper, posture: dict[str, float], on_tick: OnTick) -> None:
    pepper.set_posture(posture)
    pepper.run(TURN, on_tick=on_tick)
