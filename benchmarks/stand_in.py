"""Cost of the stand-in NAOqi: regularity of its robot's cycles, time of calls, load of its processes.

No client asks (idle), then one reads 80 keys and orders 17 joints every 12 ms, over real qi on this machine. Of both:
when samples are published after their cycle was due, cycles left out, processor time and growth of memory of both
processes, without memory that they share. Then calls one after the other, one every 12 ms: their times, round trip.

Run on an idle machine: python benchmarks/stand_in.py --seconds 60 --json stand_in.json
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Console
from rich.table import Table

from pepper_driver.backends.naoqi.qi_library import load_qi
from pepper_driver.backends.naoqi_server.dcm import wrapped
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import PepperError, load_robot
from pepper_driver.config.files import check_writable, write_json

CYCLE = 0.012
KEYS = 80


class Cost:
    """Processor time and memory of both processes, since this was made."""

    def __init__(self, stand_in: StandIn) -> None:
        pids = {"NAOqi": stand_in.naoqi_process.pid, "robot": stand_in.robot_process.pid}
        self._processes = {name: Path(f"/proc/{pid}") for name, pid in pids.items()}
        self._began, self._before = time.monotonic(), self._now()

    def results(self) -> dict[str, float]:
        """Fractions of a processor, and growth [kB]."""
        wall, now = time.monotonic() - self._began, self._now()
        found: dict[str, float] = {}
        for name, (spent, size) in now.items():
            found[f"{name}_cpu"] = round((spent - self._before[name][0]) / wall, 4)
            found[f"{name}_growth_kb"] = size - self._before[name][1]
        return found

    def _now(self) -> dict[str, tuple[float, float]]:
        return {name: (_spent(path), _size(path)) for name, path in self._processes.items()}


def _spent(process: Path) -> float:
    fields = (process / "stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _size(process: Path) -> float:
    lines = (process / "status").read_text().splitlines()
    return float(next(line.split()[1] for line in lines if line.startswith("RssAnon")))


def spread(milliseconds: ArrayLike) -> dict[str, float]:
    """Median, p99 and largest [ms]."""
    found = np.percentile(milliseconds, [50, 99, 100]).round(3).tolist()
    return dict(zip(("median", "p99", "max"), found, strict=True))


def during(stand_in: StandIn, seconds: float, act: Callable[[], None]) -> dict[str, Any]:
    """Results of so many seconds in which ``act`` is called every 12 ms."""
    cost, begin, tick = Cost(stand_in), time.monotonic(), 0
    while (due := begin + tick * CYCLE) < begin + seconds:
        time.sleep(max(0.0, due - time.monotonic()))
        act()
        tick += 1
    results: dict[str, Any] = cost.results()
    box = stand_in.black_box()
    rows = box.begin >= begin
    results["published_ms"] = spread(1000 * (box.end - box.begin)[rows])
    results["left_out"] = int((np.diff(box.cycle[rows]) - 1).sum())
    return results


def timed(call: Callable[[], object], seconds: float) -> dict[str, float]:
    """Times of a call [ms], once every 12 ms."""
    times, begin = [], time.monotonic()
    for number in range(round(seconds / CYCLE)):
        time.sleep(max(0.0, begin + number * CYCLE - time.monotonic()))
        called = time.perf_counter()
        call()
        times.append(1000 * (time.perf_counter() - called))
    return spread(times)


def measure(seconds: float, seed: int) -> dict[str, Any]:
    """All results."""
    session = load_qi().Session()  # before the stand-in: see its reasons
    with StandIn(f"mujoco://?seed={seed}") as stand_in:
        session.connect(stand_in.url)
        dcm, memory = session.service("DCM"), session.service("ALMemory")
        prefix = "Device/SubDeviceList/"
        joints = [f"{prefix}{joint}/Position/Actuator/Value" for joint in load_robot().joint_names]
        dcm.createAlias(["joints", joints])
        rest = memory.getListData(joints)
        keys = ["DCM/Time", *[key for key in stand_in.robot.keys if "/Sensor/" in key][: KEYS - 1]]

        def order() -> object:
            at = wrapped(stand_in.robot.time() + 36)
            return dcm.setAlias(
                ["joints", "ClearAfter", "time-separate", 0, [at], [[value] for value in rest]]
            )

        def serve() -> None:
            memory.getListData(keys)
            order()

        found = {
            "idle": during(stand_in, seconds, lambda: None),
            "client": during(stand_in, seconds, serve),
            "calls_ms": {
                "DCM.getTime": timed(lambda: dcm.getTime(0), seconds),
                f"ALMemory.getListData of {KEYS}": timed(lambda: memory.getListData(keys), seconds),
                f"DCM.setAlias of {len(joints)}": timed(order, seconds),
            },
        }
        session.close()
    return found


def show(results: dict[str, Any]) -> None:
    """Print them."""
    console = Console()
    table = Table("", "idle", "client every 12 ms", title="the stand-in")
    for key in results["idle"]:
        table.add_row(key, str(results["idle"][key]), str(results["client"][key]))
    console.print(table)
    table = Table("call [ms]", "median", "p99", "max")
    for name, times in results["calls_ms"].items():
        table.add_row(name, *[f"{value:.2f}" for value in times.values()])
    console.print(table)


def main() -> int:
    """Entry of the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of each part")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--json", type=Path, metavar="FILE")
    given = parser.parse_args()
    try:
        if given.json is not None:
            check_writable(given.json)
        results = measure(given.seconds, given.seed)
    except PepperError as error:
        print(f"stand_in: {error}", file=sys.stderr)
        return 2
    show(results)
    if given.json is not None:
        write_json(given.json, results)
    return 0


if __name__ == "__main__":
    sys.exit(main())
