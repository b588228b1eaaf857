"""Time until a robot can be used, and its memory: measured in processes of their own."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

from pepper_driver.config import PepperError

RUNS = 5

SECONDS = 4.0
"""[s] a robot runs before its memory is read: its buffers are then as large as they become."""

# Linux counts in ``ru_maxrss`` also the process that this one was started from.
_PROGRAM = f"""
import json, sys, time
from tempfile import TemporaryDirectory

begin = time.perf_counter()
from pepper_driver import Pepper
imported = time.perf_counter()
from pepper_driver.reflexes import Hold

def peak_memory():
    if sys.platform == "linux":
        with open("/proc/self/status") as lines:
            return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024
    if sys.platform == "win32":
        import psutil
        return psutil.Process().memory_info().peak_wset
    import resource
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

with TemporaryDirectory() as folder:
    start = time.perf_counter()
    with Pepper("mujoco", log=folder + "/bench.mcap", reflexes=[Hold()]) as pepper:
        active = time.perf_counter()
        pepper.set_posture({{"LShoulderRoll": 0.6, "RElbowRoll": 0.8}})
        pepper.run({SECONDS})
print(json.dumps({{
    "import_s": imported - begin,
    "start_s": active - start,
    "memory_mb": peak_memory() / 1e6,
}}))
"""


class StartupError(PepperError, RuntimeError):
    """A process that was to be measured failed."""


@dataclass(frozen=True, kw_only=True)
class Startup:
    """The least of several runs each, one after the other, so that files are in memory.

    Attributes:
        import_s: ``from pepper_driver import Pepper`` in a new interpreter [s].
        cli_help_s: ``pepper --help``, the whole process [s].
        start_s: From ``Pepper(...)`` to a simulated robot that is active [s].
        memory_mb: Peak of the resident memory of a process that runs a simulated robot with observer, reflex and log
            [MB].
    """

    import_s: float
    cli_help_s: float
    start_s: float
    memory_mb: float

    def as_json(self) -> dict[str, Any]:
        """All figures by name."""
        return asdict(self)


def run_startup_bench(*, on_progress: Callable[[float], None] | None = None) -> Startup:
    """Start processes, one after the other.

    Args:
        on_progress: Called with the fraction done, 0..1.

    Raises:
        StartupError: One of them failed.
    """
    report_progress = on_progress or (lambda fraction: None)
    best: dict[str, float] = {}
    for run in range(RUNS):
        begin = perf_counter()
        _output("-m", "pepper_driver", "--help")
        figures = {"cli_help_s": perf_counter() - begin}
        figures |= json.loads(_output("-c", _PROGRAM))
        best = {name: min(value, best.get(name, value)) for name, value in figures.items()}
        report_progress((run + 1) / RUNS)
    return Startup(**best)


def _output(*arguments: str) -> str:
    """Run an interpreter like this one; returns what it prints."""
    command = [sys.executable, *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise StartupError(f"a new Python process cannot be started: {error}") from error
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise StartupError(f"a new Python process failed: {last}")
    return done.stdout
