"""A Dask cluster on this machine, each part a process, and jobs for it that leave a trace."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from uuid import uuid4

from pepper_driver.config.files import OutputError
from support import ROOT
from support.waiting import PATIENCE, wait_until

START_TIME = 2 * PATIENCE
"""[s] for a process of Dask to import and to connect, on a busy machine."""

TEXT = "import runpy, sys; runpy.run_module('distributed.cli.dask_{}', run_name='__main__')"


class DaskCluster:
    """A scheduler and its workers on 127.0.0.1; use it as a context manager.

    Args:
        folder: For files of the workers.
        workers: How many to begin with.
        protocol: ``tcp`` or ``tls``.
        settings: Of Dask, as environment variables.
    """

    def __init__(
        self,
        folder: Path,
        workers: int = 2,
        *,
        protocol: str = "tcp",
        settings: Mapping[str, str] | None = None,
    ) -> None:
        self.folder, self._protocol, self._settings = folder, protocol, settings or {}
        self._processes: list[subprocess.Popen[bytes]] = []
        file = folder / "scheduler.json"
        self.scheduler = self._start(
            "scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)
        )
        # Its last letter, which it is written with.
        assert wait_until(lambda: file.exists() and file.read_text().endswith("}"), START_TIME)
        self.address: str = json.loads(file.read_text())["address"]
        for _ in range(workers):
            self.add_worker(wait=False)
        self.wait_for(workers)

    def add_worker(
        self,
        *options: str,
        wait: bool = True,
        path: Sequence[Path] = (),
        name: str | None = None,
    ) -> subprocess.Popen[bytes]:
        """Start a worker.

        Args:
            options: For ``dask worker``.
            wait: Until it is there.
            path: Folders in front of those that Python imports from.
            name: As the scheduler knows it.
        """
        before = self.count
        where = ["--local-directory", str(self.folder), "--no-nanny", "--no-dashboard"]
        named = ["--name", name or f"worker-{uuid4().hex[:8]}"]
        options = options or ("--nthreads", "1")
        process = self._start("worker", self.address, *where, *named, *options, path=path)
        if wait:
            self.wait_for(before + 1)
        return process

    @property
    def count(self) -> int:
        """Workers that are there."""
        with self._client() as client:
            return int(client.scheduler_info()["n_workers"])

    @property
    def tasks(self) -> int:
        """Jobs that the scheduler knows of."""
        with self._client() as client:
            return int(client.run_on_scheduler(_count_tasks))

    def _client(self) -> Any:
        from distributed import Client

        warnings.filterwarnings("ignore", message="(?s).*Mismatched versions found")
        return Client(self.address, timeout=START_TIME, set_as_default=False)

    def wait_for(self, count: int) -> None:
        """Wait until that many workers are there."""
        assert wait_until(lambda: self.count == count, START_TIME), self.count

    def kill(self, pid: int) -> None:
        """Kill one of its processes, as a machine that fails does."""
        assert pid in [process.pid for process in self._processes]
        os.kill(pid, signal.SIGKILL)

    def _start(
        self, what: str, *options: str, path: Sequence[Path] = ()
    ) -> subprocess.Popen[bytes]:
        folders = [*map(str, path), str(ROOT), str(ROOT / "tests")]
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(folders),
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
            **self._settings,
        }
        where = ["--host", "127.0.0.1", "--protocol", self._protocol]
        process = subprocess.Popen(
            [sys.executable, "-c", TEXT.format(what), *options, *where],
            cwd=self.folder,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for the command alone, as on another machine
        )
        self._processes.append(process)
        return process

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        for process in self._processes:
            process.kill()
            process.wait()


def _count_tasks(dask_scheduler: Any) -> int:
    return len(dask_scheduler.tasks)


# -- jobs -----------------------------------------------------------------------------------------------------------


def noted(folder: Path, number: int, seconds: float = 0.0) -> tuple[int, int]:
    """Leave a file that says it began here; return its number and process."""
    (folder / f"{number}-{uuid4().hex}").write_text(str(os.getpid()))
    time.sleep(seconds)
    return number, os.getpid()


def begun(folder: Path) -> list[int]:
    """The numbers of the jobs that began, each as often as it did."""
    return sorted(int(path.name.split("-")[0]) for path in folder.iterdir())


def ends_its_worker() -> None:
    """As where there is not enough memory."""
    os.kill(os.getpid(), signal.SIGKILL)


def refuses() -> None:
    """As a job that cannot be done."""
    raise ValueError("not this one")


def refuses_folder(path: Path) -> None:
    """As on a machine where it cannot be made."""
    raise OutputError(f"{path}: cannot be made (no permission)")


def makes_what_cannot_be_sent() -> Callable[[], object]:
    """A generator, of which there is no copy."""
    return (n for n in range(3)).__next__


def threads_of_algebra() -> set[int]:
    """Number of threads that each library here takes."""
    import numpy  # noqa: F401
    from threadpoolctl import threadpool_info

    return {int(library["num_threads"]) for library in threadpool_info()}
