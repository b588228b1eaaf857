"""Driving a robot over NAOqi every 12 ms: against the stand-in, over real qi on this machine, in real time.

bare: the backend alone, stepped by the loop's pacer. whole: a moving Pepper with controller, observer, gate. Of both:
missed ticks, when ticks end after they were due, how old samples are, dropped commands, and processor time of client,
stand-in NAOqi and simulated robot. Of the whole one also: how far the DCM was from the command that each sample is said
to answer, by the stand-in's black box; and tracking errors and residuals against those of the same motion with the
simulation driven directly, next to those with another seed of the sensors' noise. The gate lets old samples pass
here, and it is counted how often it would have held or stopped the robot. With --busy, only: ticks of the loop thread
while the program computes in Python all the time, in its main thread or in a worker process.

The reaction is counted in cycles of the robot: from the cycle of a sample to the cycle in which the device manager
follows the command computed from it, in the first tick that has the sample. The command is found in the stand-in's
black box by its value. Ticks count while the joints move, so that each command has a value of its own. The median is
over ticks with a fresh sample only; the p99 also counts samples that came late.

Run on an idle machine: python benchmarks/naoqi.py --seconds 60 --json naoqi.json
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NoReturn
from unittest.mock import patch

import numpy as np
from rich.console import Console
from rich.table import Table

from pepper_driver import Pepper
from pepper_driver.backends import Backend, Command, make_backend
from pepper_driver.backends.interface import MAX_RESPONSE_DELAY
from pepper_driver.backends.naoqi.backend import NaoqiBackend
from pepper_driver.backends.naoqi.dcm_channel import NORMAL_AGE
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.backends.naoqi_server.shared_values import BlackBox
from pepper_driver.bench.ticks import compute
from pepper_driver.config import (
    PepperError,
    RobotConfig,
    load_network,
    load_robot,
    load_safety_settings,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.files import check_writable, write_json
from pepper_driver.controller import Tick
from pepper_driver.observer import Observation
from pepper_driver.realtime import (
    Quantiles,
    RealTimePacer,
    priority_obstacle,
    realtime_process,
    realtime_thread,
)

ROBOT = "mujoco://?seed={seed}"
SWING, WAY, REST = 0.3, 1.5, 0.3  # [rad] around the starting posture, [s] there, [s] of rest
WARM_UP = 1.0  # [s] before the measurement begins
MAX_RUN_TIME = 100.0  # [s] of a run
PROCESSES = ("client", "NAOqi", "robot")
SAME_POSTURE = 1e-9  # [rad] commands reach the black box as the numbers they are
MIN_MOTION = 1e-7  # [rad] between the commands of two ticks that count for the reaction


class Processors:
    """Fraction of a processor that processes take."""

    def __init__(self, stand_in: StandIn) -> None:
        self._of = (os.getpid(), stand_in.naoqi_process.pid, stand_in.robot_process.pid)
        self._began, self._spent = time.monotonic(), self._now()

    def fractions(self) -> dict[str, float]:
        """Since this was made, by process."""
        wall = time.monotonic() - self._began
        return {
            name: (now - then) / wall
            for name, now, then in zip(PROCESSES, self._now(), self._spent, strict=True)
        }

    def _now(self) -> list[float]:
        ticks = os.sysconf("SC_CLK_TCK")
        stats = [
            Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split() for pid in self._of
        ]
        return [(int(stat[11]) + int(stat[12])) / ticks for stat in stats]


def swing(time: float, start: FloatArray) -> FloatArray:
    """(17,) a posture around ``start`` [rad], all joints of the upper body in slow motion."""
    posture = start.copy()
    phases = np.arange(3, len(start))
    posture[3:] += SWING / 2 * (1.0 - np.cos((0.8 + 0.05 * phases) * time)) * (-1.0) ** phases
    return posture


def bare(uri: str, stand_in: StandIn, robot: RobotConfig, seconds: float) -> dict[str, Any]:
    """Results of the backend alone."""
    backend = make_backend(uri, robot)
    ends, steps, ages, missed = [], [], [], 0
    with backend:
        backend.open()
        measurement = backend.activate()
        hold = np.clip(measurement.position, robot.lower, robot.upper)
        pacer = RealTimePacer(robot.cycle, backend)
        with realtime_process(), realtime_thread():
            pacer.wait()
            warm = round(WARM_UP / robot.cycle)
            for tick in range(warm + round(seconds / robot.cycle)):
                if tick == warm:
                    processors, missed = Processors(stand_in), 0
                    dropped_commands = measurement.dropped_commands
                missed += pacer.wait()
                began = time.perf_counter_ns()
                measurement = backend.read()
                posture = np.clip(swing(tick * robot.cycle, hold), robot.lower, robot.upper)
                command = Command(position=posture, stiffness=np.ones(17), wheel_speed=np.zeros(3))
                backend.write(command)
                now = time.perf_counter_ns()
                assert pacer.due is not None
                ends.append((now - pacer.due) * 1e-6)
                steps.append((now - began) * 1e-6)
                ages.append(measurement.age * 1e3)
        fractions = processors.fractions()
    return {
        "ticks": len(ends) - warm,
        "missed": missed,
        "tick_end_ms": asdict(Quantiles.from_values(np.array(ends[warm:]))),
        "step_ms": asdict(Quantiles.from_values(np.array(steps[warm:]))),
        "sample_age_ms": asdict(Quantiles.from_values(np.array(ages[warm:]))),
        "dropped_commands": measurement.dropped_commands - dropped_commands,
        "processors": fractions,
    }


@contextmanager
def request_leads(backend: type[Backend]) -> Iterator[list[float]]:
    """Note the time from each request for a sample to the beginning of its tick [ms], as long as the block lasts.

    The list stays empty where a backend is not asked ahead of its tick.
    """
    leads: list[float] = []
    request, read = getattr(backend, "request", None), getattr(backend, "read", None)
    if request is None or read is None:
        yield leads
        return
    requested: int | None = None

    def timed_request(self: Backend) -> None:
        nonlocal requested
        requested = time.perf_counter_ns()
        request(self)

    def timed_read(self: Backend) -> object:
        nonlocal requested
        if requested is not None:
            leads.append((time.perf_counter_ns() - requested) * 1e-6)
            requested = None
        return read(self)

    # In the class: the pacer may have taken the method from the robot before anything runs.
    with patch.object(backend, "request", timed_request), patch.object(backend, "read", timed_read):
        yield leads


class Recorder:
    """Keeps the ticks of a robot, and the posture that each of them computed."""

    def __init__(self, pepper: Pepper) -> None:
        self._pepper = pepper
        self.ticks: list[Tick] = []
        self.computed: list[FloatArray] = []
        self.residuals: list[FloatArray] = []

    def __call__(self, tick: Tick, observation: Observation | None) -> None:
        self.ticks.append(tick)
        self.computed.append(self._pepper.controller.position)
        assert observation is not None
        self.residuals.append(observation.residual)

    def of(self, value: Callable[[Tick], FloatArray]) -> FloatArray:
        """(n, 17) a value of each tick."""
        return np.array([value(tick) for tick in self.ticks])

    @property
    def sent(self) -> FloatArray:
        """(n, 17) commands that the samples answer [rad]."""
        return self.of(lambda tick: tick.sent.position)

    @property
    def error(self) -> FloatArray:
        """(n, 17) tracking errors [rad]."""
        return self.of(lambda tick: tick.sent.position - tick.measurement.position)


def move(pepper: Pepper, recorder: Recorder, seconds: float) -> None:
    """Postures drawn from one seed, one after the other."""
    rng, home, robot = np.random.default_rng(0), pepper.target, pepper.config
    lower, upper = robot.lower + 0.02, robot.upper - 0.02
    for _ in range(max(1, round(seconds / (WAY + REST)))):
        posture = home.copy()
        posture[3:] += rng.uniform(-SWING, SWING, len(home) - 3)
        pepper.set_posture(np.clip(posture, lower, upper), duration=WAY)
        pepper.run(WAY + REST, on_tick=recorder)


def whole(
    uri: str, stand_in: StandIn, robot: RobotConfig, seconds: float
) -> tuple[dict[str, Any], Recorder]:
    """Results of a moving Pepper, and its ticks."""
    safety = load_safety_settings()
    patient = replace(safety, stale_hold=9.0, stale_fault=10.0)
    with (
        request_leads(NaoqiBackend) as leads,
        Pepper(uri, robot=robot, safety=patient) as pepper,
    ):
        pepper.run(WARM_UP)
        pepper.clear_statistics()
        leads.clear()
        recorder, processors = Recorder(pepper), Processors(stand_in)
        move(pepper, recorder, seconds)
        fractions, statistics = processors.fractions(), pepper.statistics
        contacts = len(pepper.contact_history)
        delay = pepper.backend.info.response_delay
    commands = commands_by_cycle(stand_in.black_box())
    begin, off_by = matched(recorder, commands)
    first, last = recorder.ticks[0].measurement, recorder.ticks[-1].measurement
    assert statistics.begin is not None
    assert statistics.end is not None
    return {
        "ticks": statistics.ticks,
        "missed": statistics.missed,
        "tick_begin_ms": asdict(statistics.begin),
        "tick_end_ms": asdict(statistics.end),
        "step_ms": {k: 1e-3 * v for k, v in asdict(statistics.stages["read"]).items()},
        "all_but_backend_ms": {k: 1e-3 * v for k, v in asdict(statistics.tick).items()},
        "sample_age_ms": asdict(statistics.sample_age),
        "dropped_commands": last.dropped_commands - first.dropped_commands,
        "processors": fractions,
        "would_hold": gaps(recorder, safety.stale_hold),
        "would_stop": gaps(recorder, safety.stale_fault),
        "contacts": contacts,
        "response_delay": response_delays(recorder),
        "dcm_off_by_rad": off_by,
        "reaction_cycles": reaction(recorder, commands, begin + delay, robot.cycle),
        "request_lead_ms": median_and_p99(leads),
    }, recorder


def gaps(recorder: Recorder, age: float) -> int:
    """Count how often samples became older than ``age`` [s]."""
    old = np.array([tick.measurement.age > age for tick in recorder.ticks])
    return int(np.count_nonzero(old[1:] & ~old[:-1]) + old[0])


def response_delays(recorder: Recorder) -> dict[str, int]:
    """Count the ticks by the delay [ticks] of their command."""
    ago = [tick.measurement.response_delay for tick in recorder.ticks]
    return {str(n): ago.count(n) for n in sorted({n for n in ago if n is not None})}


def commands_by_cycle(box: BlackBox) -> FloatArray:
    """Return what the DCM sent to the joints (n, 17) [rad], from the first cycle kept on; NaN for one left out."""
    cycles = box.cycle - box.cycle[0]
    commands = np.full((int(cycles[-1]) + 1, box.position_command.shape[1]), np.nan)
    commands[cycles] = box.position_command
    return commands


def matched(recorder: Recorder, commands: FloatArray) -> tuple[int, float]:
    """Match the cycles that the ticks count with those of the black box, by the commands that fresh samples answer.

    Returns:
        The row of ``commands`` that is tick 0 of the robot, where it shows the answered commands; and the largest
        distance of the two [rad].
    """
    fresh = [tick for tick in recorder.ticks if tick.measurement.age == 0.0]
    cycles = np.array([tick.measurement.tick for tick in fresh])
    sent = np.array([tick.sent.position for tick in fresh])
    best, begin, off_by = np.inf, 0, np.inf
    for row in range(len(commands) - int(cycles[-1] - cycles[0])):
        if np.abs(commands[row] - sent[0]).max() > 1e-3:
            continue
        off = np.abs(commands[row + cycles - cycles[0]] - sent)
        if np.nanmean(off) < best:
            best, begin, off_by = (
                float(np.nanmean(off)),
                row - int(cycles[0]),
                float(np.nanmax(off)),
            )
    return begin, off_by


def reaction(
    recorder: Recorder, commands: FloatArray, begin: int, cycle: float
) -> dict[str, float | int | None]:
    """Return how many cycles after that of a sample the DCM follows the command computed from it.

    Args:
        recorder: The ticks.
        commands: (n, 17) what the DCM sent to the joints in each cycle [rad].
        begin: The row of ``commands`` of the robot's cycle 0, as ticks count.
        cycle: Of the robot [s].

    Returns:
        ``median`` over ``ticks`` with a fresh sample, and ``p99`` over these and those whose new sample was ``late``,
        None where there are none; and how many commands the DCM was never at (``not_followed``).
    """
    computed = np.array(recorder.computed)
    moved = np.abs(np.diff(computed, axis=0)).max(axis=1) > MIN_MOTION
    fresh: list[int] = []
    late: list[int] = []
    not_followed = 0
    for number in np.flatnonzero(moved[:-1] & moved[1:]) + 1:
        before, now = (recorder.ticks[n].measurement for n in (number - 1, number))
        # Above NORMAL_AGE the age does not determine the cycle of the sample.
        if now.age > NORMAL_AGE or np.array_equal(now.current, before.current):
            continue
        sample = begin + now.tick - round(now.age / cycle)
        off = np.abs(commands[sample : sample + MAX_RESPONSE_DELAY] - computed[number]).max(axis=1)
        if (off <= SAME_POSTURE).any():
            (late if now.age > 0.0 else fresh).append(int(np.argmax(off <= SAME_POSTURE)))
        else:
            not_followed += 1
    return {
        "median": float(np.median(fresh)) if fresh else None,
        "p99": float(np.percentile(fresh + late, 99)) if fresh + late else None,
        "ticks": len(fresh),
        "late": len(late),
        "not_followed": not_followed,
    }


def median_and_p99(values: Sequence[float]) -> dict[str, float] | None:
    """Return both; None where there are no values."""
    if not values:
        return None
    spread = Quantiles.from_values(np.array(values, dtype=np.float64))
    return {"median": spread.median, "p99": spread.p99}


def busy(
    uri: str, robot: RobotConfig, seconds: float, compute: Callable[[float], object]
) -> dict[str, Any]:
    """Results of a Pepper whose program computes in Python all the time, in parallel with the loop thread."""
    patient = replace(load_safety_settings(), stale_hold=9.0, stale_fault=10.0)
    with Pepper(uri, robot=robot, safety=patient) as pepper:
        pepper.run(WARM_UP)
        pepper.clear_statistics()
        compute(seconds)
        statistics = pepper.statistics
    assert statistics.begin is not None
    assert statistics.end is not None
    return {
        "ticks": statistics.ticks,
        "missed": statistics.missed,
        "tick_begin_ms": asdict(statistics.begin),
        "tick_end_ms": asdict(statistics.end),
        "sample_age_ms": asdict(statistics.sample_age),
        "priority": priority_obstacle() or "real-time",
    }


def direct(seed: int, robot: RobotConfig, seconds: float) -> Recorder:
    """Simulate this motion of this robot without NAOqi."""
    with Pepper(ROBOT.format(seed=seed), robot=robot) as pepper:
        pepper.run(WARM_UP)
        recorder = Recorder(pepper)
        move(pepper, recorder, seconds)
    return recorder


def compared(one: Recorder, other: Recorder) -> dict[str, Any]:
    """Compare ticks of equal commands: rms difference of errors and residuals [deg], worst joint and its own rms."""
    start = other.sent[:100]
    shift = min(range(20), key=lambda n: float(np.abs(one.sent[n : n + 100] - start).max()))
    count = min(len(one.ticks) - shift, len(other.ticks))
    part, rest = slice(shift, shift + count), slice(count)
    results: dict[str, Any] = {
        "ticks_apart": shift,
        "sent_deg": float(np.degrees(np.abs(one.sent[part] - other.sent[rest]).max())),
    }
    pairs = {
        "error": (one.error[part], other.error[rest]),
        "residual": (np.array(one.residuals)[part], np.array(other.residuals)[rest]),
    }
    for name, (ours, theirs) in pairs.items():
        difference = np.degrees(np.sqrt(np.nanmean((ours - theirs) ** 2, axis=0)))
        own = np.degrees(np.sqrt(np.nanmean(theirs**2, axis=0)))
        worst = int(np.nanargmax(difference))
        results[name] = {
            "median_deg": float(np.nanmedian(difference)),
            "worst_deg": float(difference[worst]),
            "worst_joint": worst,
            "own_deg": float(own[worst]),
        }
    return results


def spread(results: dict[str, float], digits: int = 2) -> str:
    return " / ".join(f"{results[key]:.{digits}f}" for key in ("median", "p99", "max"))


def pair(results: dict[str, float] | None, digits: int = 2) -> str:
    if results is None or results["median"] is None:
        return ""
    return " / ".join(f"{results[key]:.{digits}f}" for key in ("median", "p99"))


def busy_table(results: dict[str, Any]) -> Table:
    """Table of the runs in parallel with a program that computes."""
    table = Table("over NAOqi, while the program computes in", *results)
    rows: dict[str, Callable[[dict[str, Any]], str]] = {
        "ticks / missed": lambda f: f"{f['ticks']} / {f['missed']}",
        "tick begins late by, median / p99 / largest [ms]": lambda f: spread(f["tick_begin_ms"]),
        "tick ends after, median / p99 / largest [ms]": lambda f: spread(f["tick_end_ms"]),
        "age of samples [ms]": lambda f: spread(f["sample_age_ms"], 0),
        "priority of the loop thread": lambda f: f["priority"],
    }
    for label, cell in rows.items():
        table.add_row(label, *map(cell, results.values()))
    return table


def shown(results: dict[str, Any], robot: RobotConfig) -> list[Table]:
    """Tables of all results."""
    runs = {name: results[name] for name in ("bare", "whole") if name in results}
    table = Table("over NAOqi, against the stand-in", *runs)
    rows: dict[str, Callable[[dict[str, Any]], str]] = {
        "ticks": lambda f: str(f["ticks"]),
        "missed": lambda f: str(f["missed"]),
        "tick ends after, median / p99 / largest [ms]": lambda f: spread(f["tick_end_ms"]),
        "backend's read, bare: with write [ms]": lambda f: spread(f["step_ms"]),
        "age of samples [ms]": lambda f: spread(f["sample_age_ms"], 0),
        "dropped commands": lambda f: str(f["dropped_commands"]),
        "processor of client / NAOqi / robot": lambda f: " / ".join(
            f"{f['processors'][name]:.0%}" for name in PROCESSES
        ),
        "gate would hold / stop": lambda f: (
            f"{f['would_hold']} / {f['would_stop']}" if "would_hold" in f else ""
        ),
        "contacts": lambda f: str(f.get("contacts", "")),
        "DCM off by [rad]": lambda f: f"{f['dcm_off_by_rad']:.1e}" if "dcm_off_by_rad" in f else "",
        "reaction, median of fresh samples / p99 [cycles]": lambda f: pair(
            f.get("reaction_cycles"), 0
        ),
        "fresh samples / late ones / commands not followed": lambda f: (
            " / ".join(str(f["reaction_cycles"][key]) for key in ("ticks", "late", "not_followed"))
            if "reaction_cycles" in f
            else ""
        ),
        "request before the tick, median / p99 [ms]": lambda f: pair(f.get("request_lead_ms")),
    }
    for label, cell in rows.items():
        table.add_row(label, *(cell(run) for run in runs.values()))
    tables = [table]
    if "against_direct" in results:
        columns = ("difference of", "median joint [deg]", "worst joint [deg]", "of [deg]", "joint")
        table = Table(
            *columns, title="The same motion: over NAOqi and driven directly, and with other noise"
        )
        for label, key in (("over NAOqi", "against_direct"), ("other noise", "other_noise")):
            for name in ("error", "residual"):
                part = results[key][name]
                cells = (f"{part[k]:.3f}" for k in ("median_deg", "worst_deg", "own_deg"))
                table.add_row(f"{name}s, {label}", *cells, robot.joint_names[part["worst_joint"]])
        tables.append(table)
    return tables


class Parser(argparse.ArgumentParser):
    """Argument parser that reports an error in one line."""

    def error(self, message: str) -> NoReturn:
        print(f"naoqi.py: {message}", file=sys.stderr)
        sys.exit(2)


def arguments() -> argparse.Namespace:
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each run (default: 60)")
    parser.add_argument(
        "--network", default="none", help="of the stand-in: clear, wired, wifi or a file"
    )
    parser.add_argument("--seed", type=int, default=3, help="of the sensors' noise (default: 3)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the results to FILE")
    parser.add_argument(
        "--busy", action="store_true", help="only: ticks while the program computes"
    )
    given = parser.parse_args()
    if not 1.0 <= given.seconds <= MAX_RUN_TIME:
        parser.error(f"--seconds must be 1 to {MAX_RUN_TIME:g}: the black box holds two minutes")
    try:
        if given.network != "none":
            load_network(given.network)
        if given.json is not None:
            check_writable(given.json)
    except PepperError as error:
        parser.error(str(error))
    return given


def main() -> int:
    """Command line: 0 well, 2 a wrong input or a robot that refuses."""
    given = arguments()
    robot = load_robot()
    network = None if given.network == "none" else given.network
    results: dict[str, Any] = {"simulated": True, "network": given.network}
    try:
        with StandIn(ROBOT.format(seed=given.seed), network=network, consent=True) as stand_in:
            uri = f"naoqi://127.0.0.1:{stand_in.port}"
            sleeper = Pepper(uri, observer=None)
            sleeper.services.wake_up()
            sleeper.stop()
            if given.busy:
                with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as worker:
                    worker.submit(compute, 0.0).result()  # it has imported everything
                    ways: dict[str, Callable[[float], object]] = {
                        "the main thread": compute,
                        "a worker process": lambda time: worker.submit(compute, time).result(),
                    }
                    runs = {
                        name: busy(uri, robot, given.seconds, way) for name, way in ways.items()
                    }
                results["busy"] = runs
                show(results, [busy_table(runs)], given.json)
                return 0
            # First, while its motors are as cold as those of the robot it is compared with.
            results["whole"], over_naoqi = whole(uri, stand_in, robot, given.seconds)
            results["bare"] = bare(uri, stand_in, robot, given.seconds)
    except PepperError as error:
        print(f"naoqi.py: {error}", file=sys.stderr)
        return 2
    once = direct(given.seed, robot, given.seconds)
    results["against_direct"] = compared(over_naoqi, once)
    results["other_noise"] = compared(direct(given.seed + 1, robot, given.seconds), once)
    show(results, shown(results, robot), given.json)
    return 0


def show(results: dict[str, Any], tables: list[Table], file: Path | None) -> None:
    """Print tables, and write the results to a file where one is asked for."""
    console = Console(soft_wrap=True, highlight=False, markup=False)  # units stand in brackets
    for table in tables:
        console.print(table)
    if file is not None:
        write_json(file, results)


if __name__ == "__main__":
    sys.exit(main())
