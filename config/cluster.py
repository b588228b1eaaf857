"""Jobs on the workers of a Dask cluster: connection, what its workers must be like, and the pool of joblib on them."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import logging
import os
import platform
import socket
import time
import traceback
import warnings
from collections.abc import Awaitable, Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeAlias, TypeVar
from urllib.parse import urlsplit

from joblib.parallel import ParallelBackendBase, SequentialBackend

from pepper_driver.config.errors import (
    ConfigError,
    MissingExtraError,
    PepperError,
    reason,
    short_reason,
    shown,
)
from pepper_driver.config.passwords import without_secrets

T = TypeVar("T")

DaskClient: TypeAlias = Any
DaskFuture: TypeAlias = Any
"""Both of a package that may not be installed."""

SCHEMES = ("tcp", "tls")
DEFAULT_PORT = 8786
"""Of a scheduler, by Dask's own default."""

CONNECT_TIME = 5.0
"""[s] for a scheduler to answer."""

CHECK_TIME = 60.0
"""[s] for all workers to say what they are."""

WORKER_TIME = 60.0
"""[s] in which the first worker must be there."""

LOST_TIME = 600.0
"""[s] without any worker after which a sweep is given up."""

WATCH_PERIOD = 5.0
"""[s] between two looks at the number of workers."""

IN_FLIGHT = 10_000
"""Jobs that the scheduler has at a time: two for each of 5000 workers, and it stays quick."""

PACKAGES = (
    "pepper-driver",
    "numpy",
    "numba",
    "mujoco",
    "pin",
    "scipy",
    "daqp",
    "osqp",
    "scikit-learn",
    "joblib",
    "cloudpickle",
    "dask",
    "distributed",
)
"""Packages that must be the same everywhere: they compute the results, or carry jobs and results."""

SOURCES = "sources"
"""Stands for the files of this package: one version may have been changed here and not there."""

_CURE = (
    "install the same on all machines, or give all the environment of this one (docs/cluster.md)"
)
_LAYERS = ("config", "backends", "controller", "observer")
_LOUD = ("distributed", "distributed.client", "tornado.application")
"""Loggers that print tracebacks of what is an error of one line here."""


class ClusterError(PepperError, ConnectionError):
    """A cluster cannot be reached, has no workers, or workers on which results would differ."""


class LostClusterError(ClusterError):
    """A cluster was lost, or a worker came that would compute otherwise, after the sweep had begun."""

    while_active = True


# -- what a worker must be like ---------------------------------------------------------------------------------------


@cache
def environment() -> dict[str, str]:
    """Return the versions in this process of all that must be the same on each machine."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            found[package] = version(package)
    return {**found, SOURCES: sources_hash()}


def sources_hash(apart: Collection[str] = ()) -> str:
    """Hash the files of the package that results depend on, wherever it is installed.

    Args:
        apart: Patterns of files that do not count, such as ``cli/*`` and ``config/plants/*``.
    """
    digest = hashlib.sha256()
    for layer in ("", *_LAYERS):
        spec = find_spec("pepper_driver" + (layer and f".{layer}"))
        assert spec is not None
        for folder in spec.submodule_search_locations or ():
            for path in sorted(Path(folder).rglob("*")):
                inside = path.relative_to(folder)
                if path.suffix not in (".py", ".yaml", ".json", ".urdf"):
                    continue
                if not layer and inside.parts[0] in (*_LAYERS, "examples"):
                    continue
                name = f"{layer}/{inside.as_posix()}"
                if not any(fnmatchcase(name.removeprefix("/"), pattern) for pattern in apart):
                    digest.update(f"{name}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def _difference(there: Mapping[str, str | None], here: Mapping[str, str]) -> str:
    """Return in words what differs first; empty if nothing does."""
    for name, own in here.items():
        if name in there and there[name] != own:
            return f"has {name} {there[name] or '(none)'} and this machine {own}"
    return ""


def _perform(
    payload: bytes, expected: Mapping[str, str], folder: str
) -> tuple[Any, Exception | None]:
    """Perform jobs on a worker; workers come and go, so each is looked at again.

    Args:
        payload: The jobs: the scheduler does not open it.
        expected: The environment that they are of.
        folder: Where relative paths begin, if this machine has it.
    """
    if difference := _difference(environment(), expected):
        error = LostClusterError(f"worker on {platform.node()} {difference}; {_CURE}")
        return None, error
    from cloudpickle import loads

    _one_thread()
    there = os.path.isdir(folder) and os.access(folder, os.X_OK)
    with contextlib.chdir(folder) if there else contextlib.nullcontext():
        try:
            return loads(payload)(), None
        except Exception as error:  # of a job, and not of the cluster
            if not isinstance(error, PepperError):
                error.add_note(f"on {platform.node()}: {traceback.format_exc()}")
            return None, error


@cache
def _one_thread() -> None:
    """Limit the threads of algebra: a worker has one processor, and sums in another order differ in the last bit."""
    from threadpoolctl import threadpool_limits

    threadpool_limits(limits=1)


# -- connection -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Cluster:
    """Workers of a Dask scheduler, all like this process; made by :func:`connected`.

    Attributes:
        address: Of the scheduler, as it may be shown.
        client: The connection, a ``distributed.Client``.
        workers: By address, names of the workers that were there at the beginning, for messages.
    """

    address: str
    client: DaskClient = field(repr=False)
    workers: Mapping[str, str]

    def __str__(self) -> str:
        hosts = len({urlsplit(address).hostname for address in self.workers})
        count = len(self.workers)
        return (
            f"cluster {self.address}: {count} worker{'s' * (count != 1)} on "
            f"{hosts} machine{'s' * (hosts != 1)}"
        )

    def check(self, function: Callable[[], object], advice: str) -> None:
        """Call a function on each worker, in the folder of this process.

        Raises:
            ClusterError: It failed on a worker.
        """
        from cloudpickle import dumps

        task = partial(_perform, dumps(function), environment(), os.getcwd())
        for address, (_, error) in _on_all(self.client, task, self.address).items():
            if error is not None:
                name = self.workers.get(address, address)
                raise ClusterError(
                    f"cluster {self.address}: worker {name}: {error}; {advice}"
                ) from error


@contextmanager
def connected(
    address: str, *, waiting: Callable[[str], None] = lambda line: None
) -> Iterator[Cluster]:
    """Connect to a Dask scheduler, and look at its workers.

    Args:
        address: ``tcp://host:port`` or ``tls://host:port``.
        waiting: Called with a line when there is no worker yet.

    Raises:
        MissingExtraError: Dask is not installed.
        ConfigError: It is no address, or holds a password.
        ClusterError: No scheduler answers, it has no workers, or one of them differs from this process.
    """
    address = _parsed(address)
    if find_spec("distributed") is None:
        raise MissingExtraError("a cluster", "cluster")
    with _quiet():
        from distributed import Client

        _probe(address)
        try:
            client = Client(address, timeout=CONNECT_TIME, set_as_default=False)
        except Exception as error:
            raise ClusterError(f"cluster {address}: {_why(address, error)}") from error
        try:
            _wait_for_workers(client, address, waiting)
            yield Cluster(address=address, client=client, workers=_checked(client, address))
        finally:
            with contextlib.suppress(TimeoutError):  # without a scheduler
                client.close(timeout=CONNECT_TIME)


def _parsed(text: str) -> str:
    """Return the address of a scheduler, whole."""
    whole = text if "://" in text else f"tcp://{text}"
    given = shown(without_secrets(whole))
    try:
        parts = urlsplit(whole)
        host, port = parts.hostname, parts.port or DEFAULT_PORT
    except ValueError as error:
        raise ConfigError(
            f"cluster {given}: no address; write tcp://host:{DEFAULT_PORT}"
        ) from error
    if "@" in text or parts.query:
        raise ConfigError(
            f"cluster {given}: a scheduler takes no user and no password, but tls:// certificates (docs/cluster.md)"
        )
    if parts.scheme not in SCHEMES or not host or parts.path.strip("/") or not text.isprintable():
        raise ConfigError(
            f"cluster {given}: write tcp://host:{DEFAULT_PORT} or tls://host:{DEFAULT_PORT}"
        )
    return f"{parts.scheme}://{f'[{host}]' if ':' in host else host}:{port}"


def _probe(address: str) -> None:
    """See that a scheduler answers, before a client tries to connect again and again."""
    parts = urlsplit(address)
    try:
        socket.create_connection((parts.hostname, parts.port or 0), CONNECT_TIME).close()
    except OSError as error:
        why = "it does not answer" if isinstance(error, TimeoutError) else reason(error).lower()
        raise ClusterError(
            f"cluster {address}: no scheduler there ({why}); start one with 'dask scheduler' (docs/cluster.md)"
        ) from error

    async def identity() -> Mapping[str, Any]:
        from distributed import rpc
        from distributed.security import Security

        arguments = Security().get_connection_args("client")
        async with rpc(address, timeout=CONNECT_TIME, connection_args=arguments) as scheduler:
            return dict(await scheduler.identity())

    async def in_time() -> Mapping[str, Any]:
        return await asyncio.wait_for(identity(), CONNECT_TIME)

    try:
        with ThreadPoolExecutor(1) as thread:  # a notebook has a loop in its own
            kind = thread.submit(asyncio.run, in_time()).result()["type"]
    except Exception as error:  # what decodes the bytes of other programs raises anything
        raise ClusterError(f"cluster {address}: {_why(address, error)}") from error
    if kind != "Scheduler":
        raise ClusterError(
            f"cluster {address}: this is a {str(kind).lower()}; give the address of the scheduler"
        )


def _why(address: str, error: Exception) -> str:
    if address.startswith("tls"):
        return (
            "no scheduler there that trusts this machine and is trusted by it; tls:// needs certificates in the "
            f"settings of Dask, distributed.comm.tls ({short_reason(error)}; docs/cluster.md)"
        )
    return "something answers there, but no Dask scheduler of this version without tls://"


def _wait_for_workers(client: DaskClient, address: str, waiting: Callable[[str], None]) -> None:
    if client.scheduler_info()["n_workers"]:
        return
    waiting(f"cluster {address}: no worker yet, waiting {WORKER_TIME:.0f} s for the first")
    try:
        client.wait_for_workers(1, timeout=WORKER_TIME)
    except TimeoutError as error:
        raise ClusterError(
            f"cluster {address}: no worker in {WORKER_TIME:.0f} s; start some with "
            f"'dask worker {address} --nthreads 1' (docs/cluster.md)"
        ) from error


def _checked(client: DaskClient, address: str) -> dict[str, str]:
    """Return the workers by their address; all have one thread and the same versions as this process."""
    about = client.scheduler_info(n_workers=-1)["workers"]
    names = {
        worker: f"{worker} ({info['name']})" if str(info["name"]) != worker else worker
        for worker, info in about.items()
    }
    for worker, info in about.items():
        if info["nthreads"] != 1:
            raise ClusterError(
                f"cluster {address}: worker {names[worker]} has {info['nthreads']} threads, which would wait for each "
                "other; start it with --nthreads 1, and with --nworkers for more processes"
            )
    here = environment()
    versions = _in_time(client, address, partial(client.get_versions, packages=PACKAGES))
    found = {"the scheduler": versions["scheduler"]} | {
        f"worker {names.get(worker, worker)}": there
        for worker, there in versions["workers"].items()
    }
    for who, there in found.items():
        packages: dict[str, Any] = dict(there["packages"])
        # Python by its first three numbers, as people know it.
        packages["python"] = ".".join(str(packages["python"]).split(".")[:3])
        if difference := _difference(packages, here):
            raise ClusterError(f"cluster {address}: {who} {difference}; {_CURE}")
    # Of the same Python, so that it can be sent code.
    for worker, there in _on_all(client, environment, address).items():
        if difference := _difference(there, here):
            raise ClusterError(
                f"cluster {address}: worker {names.get(worker, worker)} {difference}; {_CURE}"
            )
    return names


def _on_all(client: DaskClient, function: Callable[[], T], address: str) -> dict[str, T]:
    """Return the results of a function on each worker that is there."""
    results = _in_time(client, address, partial(client.run, function, on_error="return"))
    for worker, result in results.items():
        if isinstance(result, Exception):
            raise ClusterError(
                f"cluster {address}: worker {worker} cannot run code of this version of pepper_driver "
                f"({type(result).__name__}: {' '.join(str(result).split())}); {_CURE}"
            ) from result
    return dict(results)


def _in_time(client: DaskClient, address: str, call: Callable[[], Awaitable[T]]) -> T:
    """Call the client in its own thread, where it waits for workers, and not longer than CHECK_TIME."""

    async def awaited() -> T:
        return await call()

    try:
        results: T = client.sync(awaited, callback_timeout=CHECK_TIME)
    except TimeoutError as error:
        raise ClusterError(
            f"cluster {address}: a worker does not answer in {CHECK_TIME:.0f} s; look for it on its machine, and end it"
        ) from error
    except OSError as error:
        raise ClusterError(f"cluster {address}: the connection was lost") from error
    return results


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask from printing what is raised here as an error, and advice that a user cannot take."""
    with warnings.catch_warnings():
        for message in ("(?s).*Mismatched versions found", "(?s).*Sending large graph"):
            warnings.filterwarnings("ignore", message=message)
        import distributed  # noqa: F401 sets up its loggers

        levels = {name: logging.getLogger(name).level for name in _LOUD}
        for name in levels:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        try:
            yield
        finally:
            for name, level in levels.items():
                logging.getLogger(name).setLevel(level)


# -- pool -------------------------------------------------------------------------------------------------------------


class ClusterBackend(ParallelBackendBase):  # type: ignore[misc]
    """Backend of joblib that sends jobs to the workers of a cluster.

    joblib's own such backend waits for ever when a job ends its workers, and performs the jobs in this process where
    there is one worker.
    """

    supports_retrieve_callback = True
    default_n_jobs = -1

    def __init__(self, cluster: Cluster) -> None:
        super().__init__()
        self._cluster, self._client = cluster, cluster.client
        self._futures: set[DaskFuture] = set()
        self._problem = "the connection to the scheduler was lost"
        self._calling = False

    def effective_n_jobs(self, n_jobs: int | None) -> int:
        """More than one, for which joblib would stay in this process; joblib only divides jobs by it."""
        return max(2, len(self._cluster.workers))

    def get_nested_backend(self) -> tuple[Any, int]:
        """Jobs that use joblib themselves stay in their worker."""
        return SequentialBackend(nesting_level=1), 1

    def start_call(self) -> None:
        """Begin to look after the workers."""
        self._calling = True
        self._client.loop.add_callback(self._watch)

    def stop_call(self) -> None:
        """End it."""
        self._calling = False

    def submit(self, func: Callable[[], Any], callback: Callable[[Any], None]) -> DaskFuture:
        """Send jobs; ``callback`` is called in any case."""
        from cloudpickle import dumps

        future = self._client.submit(
            _perform, dumps(func), environment(), os.getcwd(), pure=False, key=_key()
        )
        self._futures.add(future)
        self._client.loop.add_callback(self._collect, future, callback)
        return future

    async def _collect(self, future: DaskFuture, callback: Callable[[Any], None]) -> None:
        try:
            outcome = await future
        except Exception as error:
            outcome = None, self._lost(error)
        self._futures.discard(future)
        callback(outcome)

    def retrieve_result_callback(self, out: tuple[T, Exception | None]) -> T:
        """Return the results of jobs, or raise what one of them raised."""
        result, error = out
        if error is not None:
            raise error
        return result

    def abort_everything(self, ensure_ready: bool = True) -> None:
        """Take back what was sent; jobs that workers are performing end there, and their results are dropped."""
        self._calling = False
        futures = list(self._futures)
        self._client.loop.add_callback(self._take_back, futures)

    async def _take_back(self, futures: Iterable[DaskFuture]) -> None:
        with contextlib.suppress(Exception):  # without a scheduler there is nothing to take back
            await self._client.cancel(list(futures))

    async def _watch(self) -> None:
        """Give up where no worker is left and none comes."""
        seen = time.monotonic()
        while self._calling:
            await asyncio.sleep(WATCH_PERIOD)
            with contextlib.suppress(OSError):  # a lost scheduler is reported by each job
                if (await self._client.scheduler.identity(n_workers=0))["n_workers"]:
                    seen = time.monotonic()
            if self._calling and time.monotonic() - seen > LOST_TIME:
                self._problem = f"no worker has been there for {LOST_TIME:.0f} s"
                await self._take_back(self._futures)
                return

    def _lost(self, error: Exception) -> LostClusterError:
        """Say what became of jobs that did not come back."""
        from distributed import KilledWorker

        if isinstance(error, CancelledError | OSError):
            why = self._problem
        elif isinstance(error, KilledWorker):
            why = (
                f"a job ended each of the workers that tried it, last {error.last_worker.address} (is there enough "
                "memory for each worker?)"
            )
        else:
            text = " ".join(str(error).split())
            why = f"a job could not be carried there or back ({type(error).__name__}: {text[:200]})"
        return LostClusterError(
            f"cluster {self._cluster.address}: {why}; the same command goes on with what is kept"
        )


def _key() -> str:
    return f"pepper-{os.urandom(12).hex()}"
