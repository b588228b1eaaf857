"""Costs of sweeps on a cluster: robot-hours per core-hour, and what scheduler and command add to each job.

An episode of free motion scored by `fusion` and a run of an identification are timed by the processor time they take,
best of some. Then a scheduler and two workers, processes on this machine, carry jobs that compute nothing and return as
many bytes as those do; the processor time of scheduler and command is divided by the jobs. From these follows what a
sweep over many robots costs. Needs the extra `cluster`. Run: python benchmarks/cluster.py --json cluster.json
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import psutil
from cloudpickle import dumps
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from pepper_driver.config import PepperError, load_experiment, load_robot
from pepper_driver.config.cluster import Cluster, connected
from pepper_driver.config.evaluation import load_evaluation
from pepper_driver.config.workers import run_jobs
from pepper_driver.evaluation.evaluate import run_job, suite_jobs
from pepper_driver.evaluation.observers_under_test import contestants
from pepper_driver.identification.identify import chosen_joints
from pepper_driver.identification.runs import IdentificationRun, perform, plan_runs, seeded_uri

PATIENCE = 60.0  # [s] for scheduler and workers to start


def best(repeats: int, work: Callable[[], int]) -> tuple[float, int]:
    """Minimum processor time [s] of some work, and the bytes that it returns."""
    times, size = [], 0
    for _ in range(repeats):
        before = time.process_time()
        size = work()
        times.append(time.process_time() - before)
    return min(times), size


def measure_work(repeats: int) -> dict[str, dict[str, float]]:
    """By kind of sweep: length of the job that was timed and of those of a whole sweep [s], and what it returns."""
    robot = load_robot()
    evaluation, fusion = load_evaluation(robot), contestants(["fusion"], [], robot)
    job, swept = suite_jobs(evaluation, ["fit"], robot)[0], evaluation.runs("fit")[0].seconds
    runs = identification_runs()
    run = min(runs, key=lambda run: run.seconds)
    work: dict[str, tuple[Callable[[], int], float, float]] = {
        "evaluate": (
            lambda: len(dumps(run_job(job, fusion))),
            swept,
            swept,
        ),
        "identify": (
            lambda: len(perform(seeded_uri("mujoco", run), run).as_bytes()),
            run.seconds,
            sum(run.seconds for run in runs) / len(runs),
        ),
    }
    measured = {}
    for name, (function, seconds, whole) in work.items():
        shortest, size = best(repeats, function)
        measured[name] = {
            "robot_hours_per_core_hour": seconds / shortest,
            "job_seconds": whole,
            "job_bytes": size * whole / seconds,
        }
    return measured


def identification_runs() -> tuple[IdentificationRun, ...]:
    """All runs of an identification by default."""
    robot = load_robot()
    experiment = load_experiment("identify", robot)
    joints, tested = chosen_joints(robot, experiment, None, mirror=True, share_types=False)
    body = load_experiment("calibration_motion", robot)
    return plan_runs(robot, joints, experiment, tested=tested, calibration=body)


@contextmanager
def local_cluster(workers: int) -> Iterator[tuple[Cluster, psutil.Process]]:
    """A scheduler with workers, and its process."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"

        def start(what: str, *options: str) -> subprocess.Popen[bytes]:
            command = [sys.executable, "-m", f"distributed.cli.dask_{what}", "--no-dashboard"]
            return subprocess.Popen(
                [*command, *options],
                cwd=folder,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )

        where = ("--host", "127.0.0.1", "--scheduler-file", str(file))
        processes = [start("scheduler", *where, "--port", "0")]
        try:
            end = time.monotonic() + PATIENCE
            while not (file.exists() and file.read_text().endswith("}")):
                if time.monotonic() > end or processes[0].poll() is not None:
                    sys.exit("cluster.py: the scheduler does not start")
                time.sleep(0.01)
            address = json.loads(file.read_text())["address"]
            processes += [
                start("worker", address, "--nthreads", "1", "--no-nanny") for _ in range(workers)
            ]
            with connected(address) as cluster:
                cluster.client.wait_for_workers(workers, timeout=PATIENCE)
                yield cluster, psutil.Process(processes[0].pid)
        finally:
            for process in processes:
                process.kill()
                process.wait()


def measure_carrying(jobs: int, sizes: dict[str, float]) -> dict[str, dict[str, float]]:
    """By kind of sweep: processor time of command and scheduler for a job that returns that many bytes [s]."""

    def used(scheduler: psutil.Process) -> tuple[float, float]:
        return time.process_time(), sum(scheduler.cpu_times()[:2])

    measured = {}
    with local_cluster(2) as (cluster, scheduler):
        list(run_jobs([partial(bytes, 1)] * 10, workers=cluster))  # what is done once
        for name, size in sizes.items():
            before = used(scheduler)
            for _ in run_jobs((partial(bytes, round(size)) for _ in range(jobs)), workers=cluster):
                pass
            client, server = (b - a for a, b in zip(before, used(scheduler), strict=True))
            measured[name] = {"command_s": client / jobs, "scheduler_s": server / jobs}
    return measured


def costs(measured: dict[str, float], robots: int, hours: float) -> dict[str, float]:
    """Costs of a sweep over many robots; docs/cluster.md has the equations."""
    robot_hours = robots * hours
    jobs = 3600.0 * robot_hours / measured["job_seconds"]
    slowest = max(measured["command_s"], measured["scheduler_s"])
    core_hours = robot_hours / measured["robot_hours_per_core_hour"]
    return {
        "robot_hours": robot_hours,
        "core_hours": core_hours,
        "jobs": jobs,
        "carrying_hours": jobs * slowest / 3600.0,
        "cores_one_scheduler_feeds": 3600.0 * core_hours / jobs / slowest,
        "results_gb": jobs * measured["job_bytes"] / 1e9,
    }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=10_000)
    parser.add_argument("--hours", type=float, default=30.0, help="of evaluation for each robot")
    parser.add_argument("--jobs", type=int, default=1000, help="that are carried, of each kind")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=Path, metavar="FILE")
    given = parser.parse_args()
    if min(given.robots, given.hours, given.jobs, given.repeats) <= 0:
        parser.error("numbers must be positive")
    try:
        with threadpool_limits(limits=1):  # as in a worker
            measured = measure_work(given.repeats)
        sizes = {name: values["job_bytes"] for name, values in measured.items()}
        for name, values in measure_carrying(given.jobs, sizes).items():
            measured[name].update(values)
    except PepperError as error:
        parser.error(str(error))
    recorded = sum(run.seconds for run in identification_runs()) / 3600.0
    hours = {"evaluate": given.hours, "identify": recorded}
    document: dict[str, Any] = {
        name: values | costs(values, given.robots, hours[name]) for name, values in measured.items()
    }
    table = Table("", *document)
    for key in next(iter(document.values())):
        table.add_row(
            key.replace("_", " "), *(f"{values[key]:.4g}" for values in document.values())
        )
    Console().print(table)
    if given.json is not None:
        given.json.write_text(json.dumps({"robots": given.robots, **document}, indent=2) + "\n")


if __name__ == "__main__":
    main()
