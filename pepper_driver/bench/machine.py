"""The machine that is measured on: one core of it, its name, versions of packages."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process, with its threads, on one core where the system allows it."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def machine_as_json(*packages: str) -> dict[str, Any]:
    """``cpu``, ``versions``: of what all figures depend on, and of these packages."""
    names = sorted({"pepper-driver", "mujoco", "numba", "numpy", "pin", *packages})
    versions = {"python": platform.python_version(), **{name: version(name) for name in names}}
    return {"cpu": cpu_name(), "versions": versions}


def cpu_name() -> str:
    """Return the name of the first processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    found = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return found[0] if found else platform.processor()
