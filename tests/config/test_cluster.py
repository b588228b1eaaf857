"""Jobs on a cluster, with a scheduler and workers that are processes: lost ones, wrong ones, none."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from pepper_driver.config import ConfigError, MissingExtraError, cluster
from pepper_driver.config.cluster import ClusterError, LostClusterError, connected
from pepper_driver.config.workers import run_jobs
from support.certificates import certificate_in
from support.clusters import (
    DaskCluster,
    begun,
    ends_its_worker,
    makes_what_cannot_be_sent,
    noted,
    refuses,
    threads_of_algebra,
)
from support.waiting import wait_until

pytest.importorskip("distributed", reason="comes with the extra 'cluster'")

JOBS = 12


@pytest.fixture
def notes(tmp_path: Path) -> Path:
    folder = tmp_path / "notes"
    folder.mkdir()
    return folder


# -- addresses --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("tcp://", "'tcp://': write tcp://host:8786"),
        ("http://here:1", "'http://here:1': write tcp://host:8786 or tls://host:8786"),
        ("tcp://here:port", "'tcp://here:port': no address; write tcp://host:8786"),
        ("tcp://here:99999", "'tcp://here:99999': no address"),
        ("tcp://here:1/path", "write tcp://host:8786"),
        ("he re\n", "write tcp://host:8786"),
        ("tcp://me:hunter2@here:8786", "'tcp://here:8786': a scheduler takes no user and no pass"),
        ("me:hunter2@here", "'tcp://here': a scheduler takes no user and no password"),
        ("tcp://here:1?token=hunter2", "'tcp://here:1?token=...': a scheduler takes no user"),
    ],
)
def test_what_is_no_address(address: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught, connected(address):
        pass
    assert said in str(caught.value)
    assert "hunter2" not in str(caught.value)


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "find_spec", lambda name: None)
    with (
        pytest.raises(MissingExtraError, match=r'pip install "pepper-driver\[cluster\]"'),
        connected("here"),
    ):
        pass


@pytest.fixture(params=["closed", "silent", "web"])
def not_a_scheduler(request: pytest.FixtureRequest) -> Iterator[tuple[str, str]]:
    """A port that no program listens on, a program that says nothing, or one of another protocol."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        if request.param == "closed":
            yield (
                address,
                "no scheduler there (connection refused); start one with 'dask scheduler'",
            )
            return
        listener.listen()

        def answer() -> None:
            while True:
                try:
                    peer, _ = listener.accept()
                    with peer:
                        peer.recv(100)
                        peer.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
                except OSError:
                    return

        if request.param == "web":
            threading.Thread(target=answer, daemon=True).start()
        yield address, "something answers there, but no Dask scheduler"
        listener.shutdown(socket.SHUT_RDWR)


def test_an_address_without_a_scheduler(
    not_a_scheduler: tuple[str, str],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(cluster, "CONNECT_TIME", 0.5)
    address, said = not_a_scheduler
    with pytest.raises(ClusterError) as caught, connected(address):
        pass
    assert f"cluster {address}: {said}" in str(caught.value)
    assert capfd.readouterr() == ("", ""), "the error says it all"


def test_tls_without_certificates_says_where_they_go() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = f"tls://127.0.0.1:{listener.getsockname()[1]}"
        with pytest.raises(ClusterError, match=r"distributed\.comm\.tls"), connected(address):
            pass


@pytest.mark.whole
def test_a_cluster_behind_tls(tmp_path: Path, notes: Path) -> None:
    """Certificates from the settings of Dask, as docs/cluster.md has them."""
    import dask

    certificate, key = map(str, certificate_in(tmp_path))
    mine = {"ca-file": certificate, "client.cert": certificate, "client.key": key}
    settings = {"DASK_DISTRIBUTED__COMM__TLS__CA_FILE": certificate}
    for role in ("SCHEDULER", "WORKER"):
        settings[f"DASK_DISTRIBUTED__COMM__TLS__{role}__CERT"] = certificate
        settings[f"DASK_DISTRIBUTED__COMM__TLS__{role}__KEY"] = key
    with (
        dask.config.set({f"distributed.comm.tls.{name}": file for name, file in mine.items()}),
        DaskCluster(tmp_path, protocol="tls", settings=settings) as closed,
    ):
        assert closed.address.startswith("tls://")
        with connected(closed.address) as workers:
            jobs = [partial(noted, notes, number) for number in range(5)]
            assert [number for number, _ in run_jobs(jobs, workers=workers)] == list(range(5))
        plain = closed.address.replace("tls", "tcp")
        with pytest.raises(ClusterError, match="no Dask scheduler"), connected(plain):
            pass


# -- one sweep --------------------------------------------------------------------------------------------------------


def test_a_worker_that_is_killed_costs_nothing(
    notes: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Its job is done again by the other: each result comes once, in order, from another process than this."""
    with DaskCluster(tmp_path) as dask:
        with connected(dask.address) as workers:
            results: list[tuple[int, int]] = []
            jobs = (partial(noted, notes, number, 0.3) for number in range(JOBS))
            for number, pid in run_jobs(jobs, workers=workers):
                if not results:
                    dask.kill(pid)
                results.append((number, pid))
        assert dask.tasks == 0, "the scheduler keeps nothing"
    numbers, pids = zip(*results, strict=True)
    assert numbers == tuple(range(JOBS))
    assert len(set(pids)) == 2
    assert os.getpid() not in pids
    assert set(begun(notes)) == set(range(JOBS))
    assert len(begun(notes)) > JOBS, "one was broken off and begun again"
    assert capfd.readouterr() == ("", "")


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    """Two workers, for tests that leave them there."""
    with DaskCluster(tmp_path_factory.mktemp("dask")) as running:
        yield running


@pytest.mark.whole
def test_jobs_of_a_cluster_with_one_worker_are_not_done_here(tmp_path: Path, notes: Path) -> None:
    with DaskCluster(tmp_path, workers=1) as small, connected(small.address) as workers:
        assert str(workers) == f"cluster {small.address}: 1 worker on 1 machine"
        jobs = [partial(noted, notes, number) for number in range(3)]
        assert {pid for _, pid in run_jobs(jobs, workers=workers)}.isdisjoint({os.getpid()})


@pytest.mark.whole
def test_workers_that_come_later_work_too(tmp_path: Path, notes: Path) -> None:
    with DaskCluster(tmp_path, workers=1) as small, connected(small.address) as workers:
        pids = set()
        for done, (_, pid) in enumerate(
            run_jobs((partial(noted, notes, n, 0.3) for n in range(40)), workers=workers)
        ):
            pids.add(pid)
            if done == 0:
                small.add_worker()
        assert len(pids) == 2
    assert begun(notes) == list(range(40))


@pytest.mark.whole
def test_an_error_of_a_job_is_raised_here_and_ends_the_sweep(
    dask: DaskCluster, notes: Path
) -> None:
    with connected(dask.address) as workers:
        jobs: list[Callable[[], object]] = [refuses]
        jobs += [partial(noted, notes, number, 0.2) for number in range(50)]
        with pytest.raises(ValueError, match="not this one") as caught:
            list(run_jobs(jobs, workers=workers))
        assert "in refuses" in caught.value.__notes__[0], "where it was raised"
        assert wait_until(lambda: dask.tasks == 0)
        before = len(begun(notes))
        assert before < 10, "the others were taken back"
        assert [number for number, _ in run_jobs([partial(noted, notes, 99)], workers=workers)] == [
            99
        ]


@pytest.mark.whole
def test_jobs_whose_results_are_not_read_are_taken_back(dask: DaskCluster, notes: Path) -> None:
    with connected(dask.address) as workers:
        results = run_jobs([partial(noted, notes, n, 0.2) for n in range(100)], workers=workers)
        next(results)
        results.close()  # type: ignore[attr-defined]
        assert wait_until(lambda: dask.tasks == 0)
    assert len(begun(notes)) < 10


@pytest.mark.whole
def test_a_result_that_cannot_be_sent_is_an_error_in_one_line(dask: DaskCluster) -> None:
    with connected(dask.address) as workers, pytest.raises(LostClusterError, match="carried"):
        list(run_jobs([makes_what_cannot_be_sent], workers=workers))


@pytest.mark.whole
def test_a_worker_takes_one_thread_of_algebra(tmp_path: Path) -> None:
    with DaskCluster(tmp_path, workers=1) as small, connected(small.address) as workers:
        assert list(run_jobs([threads_of_algebra], workers=workers)) == [{1}]


@pytest.mark.whole
def test_relative_paths_begin_where_the_command_was_called(
    dask: DaskCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path)
    with connected(dask.address) as workers:
        list(run_jobs([partial(noted, Path("here"), 1)], workers=workers))
        with pytest.raises(ClusterError, match=r"worker tcp.*: not this one; mend it"):
            workers.check(refuses, "mend it")
    assert begun(tmp_path / "here") == [1]


# -- what goes wrong --------------------------------------------------------------------------------------------------


@pytest.mark.whole
def test_a_job_that_ends_every_worker_is_an_error(
    tmp_path: Path, notes: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """As many as the scheduler allows; joblib's own backend waits for ever."""
    with DaskCluster(tmp_path, workers=3) as large, connected(large.address) as workers:
        jobs: list[Callable[[], object]] = [ends_its_worker]
        jobs += [partial(noted, notes, n, 0.5) for n in range(20)]
        with pytest.raises(LostClusterError, match="a job ended each of the workers") as caught:
            list(run_jobs(jobs, workers=workers))
        assert caught.value.while_active, "exit code 1"
    assert capfd.readouterr() == ("", "")


@pytest.mark.whole
def test_a_scheduler_that_is_lost_is_an_error(
    tmp_path: Path, notes: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with DaskCluster(tmp_path) as small, connected(small.address) as workers:
        results = run_jobs([partial(noted, notes, n, 0.3) for n in range(50)], workers=workers)
        next(results)
        small.kill(small.scheduler.pid)
        with pytest.raises(LostClusterError, match="the connection to the scheduler was lost"):
            list(results)
    assert capfd.readouterr() == ("", "")


@pytest.mark.whole
def test_a_sweep_without_workers_is_given_up(
    tmp_path: Path, notes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "WATCH_PERIOD", 0.1)
    monkeypatch.setattr(cluster, "LOST_TIME", 1.0)
    with DaskCluster(tmp_path, workers=1) as small, connected(small.address) as workers:
        results = run_jobs([partial(noted, notes, n, 0.3) for n in range(50)], workers=workers)
        _, pid = next(results)
        small.kill(pid)
        with pytest.raises(LostClusterError, match="no worker has been there for 1 s"):
            list(results)


@pytest.mark.whole
def test_a_cluster_without_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "WORKER_TIME", 1.0)
    lines: list[str] = []
    with DaskCluster(tmp_path, workers=0) as empty:
        expected = (
            f"cluster {empty.address}: no worker in 1 s; start some with 'dask worker {empty.address} "
            "--nthreads 1' (docs/cluster.md)"
        )
        with (
            pytest.raises(ClusterError) as caught,
            connected(empty.address, waiting=lines.append),
        ):
            pass
        assert str(caught.value) == expected
        assert lines == [f"cluster {empty.address}: no worker yet, waiting 1 s for the first"]
        monkeypatch.undo()
        empty.add_worker(wait=False)
        with connected(empty.address, waiting=lines.append) as workers:
            assert len(workers.workers) == 1


@pytest.mark.whole
def test_the_address_of_a_worker_is_not_that_of_a_scheduler(dask: DaskCluster) -> None:
    with connected(dask.address) as workers:
        worker = next(iter(workers.workers))
    with pytest.raises(ClusterError, match="this is a worker"), connected(worker):
        pass


# -- workers that differ ----------------------------------------------------------------------------------------------


def other_version(folder: Path, package: str) -> Path:
    """A folder in front of which Python finds another version of a package, or of itself."""
    folder.mkdir()
    if package == "python":
        (folder / "sitecustomize.py").write_text(
            "import platform, sys\n"
            "class Version(tuple):\n"
            "    major, minor, micro, releaselevel, serial = *sys.version_info[:2], 99, 'final', 0\n"
            "sys.version_info = Version((*sys.version_info[:2], 99, 'final', 0))\n"
            "platform.python_version = lambda: '.'.join(map(str, sys.version_info[:3]))\n"
        )
        return folder
    info = folder / f"{package.replace('-', '_')}-0.0.7.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 0.0.7\n")
    return folder


@pytest.mark.whole
@pytest.mark.parametrize("package", ["pepper-driver", "mujoco", "numpy", "numba", "python"])
def test_a_worker_of_another_version_is_refused(
    package: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    here = cluster.environment()[package]
    there = f"{here.rpartition('.')[0]}.99" if package == "python" else "0.0.7"
    with DaskCluster(tmp_path, workers=1) as mixed:
        mixed.add_worker(path=[other_version(tmp_path / "site", package)], name="old-one")
        with pytest.raises(ClusterError) as caught, connected(mixed.address):
            pass
    said = str(caught.value)
    assert f"(old-one) has {package} {there} and this machine {here}" in said
    assert "worker tcp://127.0.0.1:" in said
    assert said.endswith("give all the environment of this one (docs/cluster.md)")
    assert capfd.readouterr() == ("", "")


@pytest.mark.whole
def test_a_worker_with_changed_sources_is_refused(tmp_path: Path) -> None:
    """The version is the same: as on a machine with another commit."""
    from support import ROOT

    copy = tmp_path / "copy"
    copy.mkdir()
    for layer in ("pepper_driver", "backends", "controller", "observer"):
        (copy / layer).symlink_to(ROOT / layer)
    # A package of its own, since the links of the checkout lead to its own layers.
    changed = copy / "changed"
    (changed / "pepper_driver").mkdir(parents=True)
    for path in (ROOT / "pepper_driver").iterdir():
        if path.name != "config" and path.name != "__pycache__":
            (changed / "pepper_driver" / path.name).symlink_to(path)
    (changed / "pepper_driver" / "config").mkdir()
    for path in (ROOT / "config").iterdir():
        if path.name not in ("observer.yaml", "__pycache__"):
            (changed / "pepper_driver" / "config" / path.name).symlink_to(path)
    settings = (ROOT / "config" / "observer.yaml").read_text()
    (changed / "pepper_driver" / "config" / "observer.yaml").write_text(f"{settings}# changed\n")
    with DaskCluster(tmp_path, workers=1) as mixed:
        mixed.add_worker(path=[changed], name="other-commit")
        with (
            pytest.raises(ClusterError, match=r"\(other-commit\) has sources \w{12} and this"),
            connected(mixed.address),
        ):
            pass


@pytest.mark.whole
def test_a_worker_without_the_package_is_refused(tmp_path: Path) -> None:
    """Its Dask answers, and it has a package of this name that is another one."""
    other = tmp_path / "site"
    (other / "pepper_driver").mkdir(parents=True)
    (other / "pepper_driver" / "__init__.py").write_text("")
    with DaskCluster(tmp_path, workers=1) as mixed:
        mixed.add_worker(path=[other])
        with (
            pytest.raises(ClusterError, match="cannot run code of this version of pepper_driver"),
            connected(mixed.address),
        ):
            pass


@pytest.mark.whole
def test_a_worker_of_another_version_that_comes_later_ends_the_sweep(
    tmp_path: Path, notes: Path
) -> None:
    """Nothing that it made is counted."""
    with DaskCluster(tmp_path, workers=1) as mixed, connected(mixed.address) as workers:
        good, results = (
            None,
            run_jobs((partial(noted, notes, n, 0.2) for n in range(200)), workers=workers),
        )
        _, good = next(results)
        mixed.add_worker(path=[other_version(tmp_path / "site", "mujoco")])
        counted: list[tuple[int, int]] = []
        with pytest.raises(LostClusterError, match=r"has mujoco 0\.0\.7 and this machine"):
            counted.extend(results)
        assert {pid for _, pid in counted} <= {good}


@pytest.mark.whole
def test_a_worker_with_threads_is_refused(tmp_path: Path) -> None:
    with DaskCluster(tmp_path, workers=0) as threaded:
        threaded.add_worker("--nthreads", "3", name="threads")
        with (
            pytest.raises(ClusterError, match=r"\(threads\) has 3 threads.*--nthreads 1"),
            connected(threaded.address),
        ):
            pass
