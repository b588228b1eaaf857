"""Identification, evaluation and calibration on a cluster: the same bytes as here, also after an interruption."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pepper_driver.calibration import calibrate
from pepper_driver.cli import calibrate as calibrate_command
from pepper_driver.cli import evaluate as evaluate_command
from pepper_driver.cli.app import run
from pepper_driver.config import TrackingTable, load_calibration, load_robot
from pepper_driver.config.evaluation import load_evaluation
from pepper_driver.evaluation import episodes
from pepper_driver.identification import MANIFEST
from support import ROOT
from support.clusters import DaskCluster, refuses_folder
from support.evaluation import at_once
from support.identification import short_files
from support.waiting import PATIENCE, wait_until

pytest.importorskip("distributed", reason="comes with the extra 'cluster'")

ROBOT = load_robot()


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    with DaskCluster(tmp_path_factory.mktemp("dask")) as running:
        yield running


def recordings(folder: Path) -> dict[str, bytes]:
    return {
        path.name: path.read_bytes() for path in folder.iterdir() if not path.name.startswith(".")
    }


# -- options ----------------------------------------------------------------------------------------------------------


UNREACHABLE = ["--cluster", "tcp://127.0.0.1:1"]
REFUSED = "no scheduler there (connection refused); start one"


@pytest.mark.parametrize(
    ("command", "options", "said"),
    [
        ("evaluate --suite paper", UNREACHABLE, REFUSED),
        ("calibrate", UNREACHABLE, REFUSED),
        ("identify --out x.json", UNREACHABLE, REFUSED),
        (
            "identify --out x.json",
            ["--cluster", "here", "--workers", "2"],
            "'--workers': with '--cluster' all workers of",
        ),
        (
            "identify --out x.json",
            ["--cluster", "udp://here"],
            "cluster 'udp://here': write tcp://host:8786 or tls://",
        ),
        (
            "identify --out x.json",
            ["--cluster", "tcp://me:hunter2@here:1"],
            "takes no user and no password",
        ),
        ("identify --out x.json", ["--cluster", ""], "option '--cluster': must not be empty"),
    ],
)
def test_a_wrong_cluster_is_one_line_and_code_2(
    command: str,
    options: list[str],
    said: str,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run([*command.split(), *options]) == 2
    shown, errors = capfd.readouterr()
    assert len(errors.splitlines()) == 1
    assert said in errors
    assert "hunter2" not in shown + errors
    assert list(tmp_path.iterdir()) == [], "nothing was begun"


# -- identification ---------------------------------------------------------------------------------------------------

JOINTS = ["--joints", "LElbowRoll", "--calibration", "none"]


def identify(folder: Path, *options: str) -> dict[str, bytes]:
    """Identify with short motions; returns the files, by name."""
    arguments = [*short_files(folder.parent)[:3], *JOINTS, "--recordings", str(folder)]
    out, figures = folder.parent / "models.json", folder.parent / "figures.json"
    assert run(["identify", "--out", str(out), "--json", str(figures), *arguments, *options]) == 0
    return {"models": out.read_bytes(), "figures": figures.read_bytes(), **recordings(folder)}


@pytest.fixture(scope="module")
def identified_here(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return identify(tmp_path_factory.mktemp("here") / "kept", "--workers", "1")


@pytest.mark.whole
def test_recordings_and_models_are_the_same_as_here(
    dask: DaskCluster,
    identified_here: dict[str, bytes],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    there = identify(tmp_path / "kept", "--cluster", dask.address)
    assert there == identified_here
    shown, errors = capfd.readouterr()
    assert f"cluster {dask.address}: 2 workers on 1 machine" in shown
    assert errors == ""


@pytest.mark.whole
def test_an_interrupted_identification_goes_on_with_other_workers(
    dask: DaskCluster, identified_here: dict[str, bytes], tmp_path: Path
) -> None:
    """By Ctrl-C: what came back is kept, the rest is taken from the cluster; then here, then there again."""
    folder = tmp_path / "kept"
    command = ["identify", "--out", str(tmp_path / "models.json"), "--recordings", str(folder)]
    command += [*short_files(tmp_path)[:3], *JOINTS, "--cluster", dask.address]
    process = subprocess.Popen(
        [sys.executable, "-m", "pepper_driver", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert wait_until(lambda: list(folder.glob("*.npz")), 4 * PATIENCE)
        process.send_signal(signal.SIGINT)
        shown, errors = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 130
    assert errors == "pepper: interrupted\n"
    assert "of 3 runs are kept in" in shown
    assert wait_until(lambda: dask.tasks == 0)
    kept = recordings(folder)
    assert 1 < len(kept) < 4
    times = {path: path.stat().st_mtime_ns for path in folder.glob("*.npz")}
    assert identify(folder, "--cluster", dask.address) == identified_here
    assert all(path.stat().st_mtime_ns == time for path, time in times.items()), "made twice"


@pytest.mark.whole
def test_a_worker_killed_in_an_identification_costs_no_run(
    identified_here: dict[str, bytes], tmp_path: Path
) -> None:
    with DaskCluster(tmp_path) as two:
        folder = tmp_path / "run" / "kept"
        folder.parent.mkdir()
        process = two.add_worker()
        command = ["identify", "--out", str(folder.parent / "models.json"), *JOINTS]
        command += ["--json", str(folder.parent / "figures.json"), "--recordings", str(folder)]
        command += [*short_files(folder.parent)[:3], "--cluster", two.address]
        with subprocess.Popen(
            [sys.executable, "-m", "pepper_driver", *command], stdout=subprocess.DEVNULL
        ) as sweep:
            assert wait_until(lambda: two.tasks == 3, 4 * PATIENCE)
            two.kill(process.pid)
            assert sweep.wait(20 * PATIENCE) == 0
        assert {
            "models": (folder.parent / "models.json").read_bytes(),
            "figures": (folder.parent / "figures.json").read_bytes(),
            **recordings(folder),
        } == identified_here


@pytest.mark.whole
def test_a_plant_that_is_another_one_on_the_workers_is_refused(
    dask: DaskCluster, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Their folder has no such file, and this process had another one when it looked."""
    plant = tmp_path / "mine.yaml"
    plant.write_text("extends: nominal\nname: mine\n")
    folder = tmp_path / "kept"
    arguments = [*short_files(tmp_path)[:3], *JOINTS, "--recordings", str(folder)]
    arguments += ["--backend", f"mujoco://?plant={plant}", "--cluster", dask.address]
    changed = {"done": False}

    def change_then_connect(*given: Any, **options: Any) -> Any:
        from pepper_driver.identification.dataset import open_folder

        open_folder(*given, **options)
        changed["done"] = True
        plant.write_text("extends: worn\nname: mine\n")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pepper_driver.identification.identify.open_folder", change_then_connect)
        assert run(["identify", "--out", str(tmp_path / "m.json"), *arguments]) == 2
    assert changed["done"]
    assert "is another robot on" in capfd.readouterr().err
    assert set(recordings(folder)) == {MANIFEST}


# -- evaluation -------------------------------------------------------------------------------------------------------


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Experiments of Table I with one set-point that is pushed at, and no free motion before it."""
    whole = load_evaluation(ROBOT)
    entries = tuple(replace(entry, plants=("swaying",)) for entry in whole.suites["paper"][:2])
    experiments = dict(whole.experiments)
    for entry in entries:
        experiments[entry.experiment] = at_once(experiments[entry.experiment])
    small = replace(whole, suites={"paper": entries}, experiments=experiments)
    monkeypatch.setattr(evaluate_command, "load_evaluation", lambda robot: small)


def scores(folder: Path, *options: str) -> Any:
    """Evaluate; returns the figures without the date."""
    figures = folder / "figures.json"
    arguments = ["--suite", "paper", "--observer", "fusion,paper", "--json", str(figures)]
    assert run(["evaluate", *arguments, *options]) == 0
    content = json.loads(figures.read_text())
    del content["date"]
    return content


@pytest.mark.whole
@pytest.mark.usefixtures("short")
def test_scores_are_the_same_as_here_and_episodes_stay_there(
    dask: DaskCluster,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    alone = scores(tmp_path, "--workers", "1", "--cache", str(here))
    monkeypatch.chdir(tmp_path)
    # A relative folder is that of the command, not of the worker.
    assert scores(tmp_path, "--cluster", dask.address, "--cache", "there") == alone
    assert capfd.readouterr().err == ""
    assert alone["hours"] > 0
    files = {path.relative_to(here) for path in here.rglob("*") if path.is_file()}
    assert files == {path.relative_to(there) for path in there.rglob("*") if path.is_file()}
    assert len(files) == 6
    for path in files:
        assert (here / path).read_bytes() == (there / path).read_bytes(), path
    # One episode is there, as after an interruption: only the other is performed again, and gives the same.
    lost = sorted(there.glob("*/episode.json"))[0]
    lost.unlink()
    kept = {path: path.stat().st_mtime_ns for path in there.glob("*/episode.json")}
    assert scores(tmp_path, "--cluster", dask.address, "--cache", str(there)) == alone
    assert lost.is_file()
    assert all(path.stat().st_mtime_ns == time for path, time in kept.items())
    # And here nothing is left to be performed.
    monkeypatch.setattr(episodes, "_performed", None)
    assert scores(tmp_path, "--workers", "1", "--cache", str(there)) == alone


@pytest.mark.whole
@pytest.mark.usefixtures("short")
def test_files_that_workers_do_not_have_are_refused_before_the_sweep(
    dask: DaskCluster, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    cache = tmp_path / "cache"
    arguments = ["evaluate", "--suite", "paper", "--cluster", dask.address, "--cache", str(cache)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluate_command, "make_folder", refuses_folder)
        assert run(arguments) == 2
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluate_command, "file_hash", lambda path: "another")
        models = tmp_path / "mine.json"
        shipped = ROOT / "observer" / "models" / "nominal-fusion.json"
        models.write_bytes(shipped.read_bytes())
        assert run([*arguments, "--models", str(models)]) == 2
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 2
    assert all(f"{dask.address}: worker tcp://127.0.0.1:" in line for line in lines)
    assert f"{cache}: cannot be made (no permission); give '--cache' a folder" in lines[0]
    assert f"{models}: its content is another one there; put it into a folder that all" in lines[1]


# -- calibration ------------------------------------------------------------------------------------------------------


@pytest.mark.whole
def test_a_calibration_is_the_same_as_here(
    dask: DaskCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = load_calibration(ROBOT)
    tables = {
        name: TrackingTable(velocity=(-0.5, 0.5), torque=(0.0,), expected_error_deg=((-1.5, 1.5),))
        for name in real.recordings.tables
    }
    ramps = replace(real.settings.ramps, wait=0.1, time=0.3, arrival_time=0.1)
    small = replace(
        real,
        recordings=replace(real.recordings, tables=tables),
        settings=replace(real.settings, ramps=ramps, fit_count=2),
        holds=replace(real.holds, count=25, move=0.2, hold=0.1),
    )
    monkeypatch.setattr(calibrate_command, "load_calibration", lambda robot: small)
    monkeypatch.setattr(calibrate, "integration_error", lambda robot, plant: 2e-4)
    monkeypatch.setattr(calibrate, "real_time_factor", lambda robot, plant: 10.0)
    results = []
    for where in (["--workers", "1"], ["--workers", "2"], ["--cluster", dask.address]):
        out, figures = tmp_path / "mine.yaml", tmp_path / "figures.json"
        assert run(["calibrate", "--out", str(out), "--json", str(figures), *where]) == 0
        results.append((out.read_bytes(), figures.read_bytes()))
        out.unlink()
    assert results[0] == results[1] == results[2]
