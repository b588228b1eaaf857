"""Folder of a first hour, with the parts that a reader looks at."""

import zipfile
from dataclasses import asdict, replace
from pathlib import Path

from pepper_driver import Pepper
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import load_robot
from pepper_driver.config.files import make_folder, write_json
from pepper_driver.config.touch_prompts import load_touch_prompts
from pepper_driver.first_hour.bundle import PLACES
from pepper_driver.first_hour.state import STATE, STEPS, FirstHour, new_hour, save_state
from pepper_driver.identification.dataset import Manifest, RunEntry, recording_path
from pepper_driver.observer.models.model_file import ModelSet, shipped

ROBOT = load_robot()
INFO = MockBackend(ROBOT).info


def open_hour() -> FirstHour:
    """Return the state of an hour of the mock robot before its first step."""
    return new_hour(
        ROBOT, INFO, plan="p", prompts=load_touch_prompts(ROBOT), label="head", weight=None
    )


def finished_hour() -> FirstHour:
    """Return the same after its last step."""
    hour = open_hour()
    for name in STEPS:
        hour = hour.begun(name).done(name, {"figure": 1.5})
    return hour


def manifest(identity: str) -> Manifest:
    """Return the manifest of an identification with one run."""
    run = RunEntry(
        name="HeadYaw-1", joint="HeadYaw", role="estimation", stiffness=2.0, seed=(0,), seconds=1.0
    )
    return Manifest(
        format=3,
        robot=ROBOT.name,
        joint_names=ROBOT.joint_names,
        backend="naoqi://anna@pepper-7.lab.example",
        identity=identity,
        simulated=False,
        real_time=True,
        response_delay=3,
        experiment="identify",
        experiment_hash="0",
        calibration=None,
        calibration_hash=None,
        seed=0,
        joints=("HeadYaw",),
        tested=(),
        versions={},
        runs=(run,),
    )


def make_hour(folder: Path) -> FirstHour:
    """Write a folder as a finished hour of the mock robot leaves it; the logs are short, the recording is empty."""
    hour = finished_hour()
    recordings = folder / PLACES["identification"]
    make_folder(recordings)
    write_json(recordings / "manifest.json", asdict(manifest(hour.identity)))
    recording_path(recordings, "HeadYaw-1").write_bytes(b"")
    models = ModelSet.load(shipped("fusion")["nominal"])
    replace(models, identity=hour.identity).save(folder / PLACES["models"])
    with Pepper("mock", observer=None, log=folder / PLACES["rest"]) as pepper:
        pepper.run(0.1)
    for part in ("free", "touches"):
        (folder / f"{part}.mcap").write_bytes((folder / PLACES["rest"]).read_bytes())
    with zipfile.ZipFile(folder / PLACES["doctor"], "w") as archive:
        archive.writestr("report.json", "{}")
    save_state(folder / STATE, hour)
    return hour


def zip_of(folder: Path, path: Path) -> Path:
    """Pack all files of a folder as they are."""
    with zipfile.ZipFile(path, "w") as archive:
        for file in sorted(folder.rglob("*")):
            if file.is_file():
                archive.write(file, file.relative_to(folder).as_posix())
    return path
