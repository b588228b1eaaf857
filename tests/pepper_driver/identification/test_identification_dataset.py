"""Recordings are kept run by run; an interruption costs the run under way, and nothing else is taken for them."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from pepper_driver.identification import (
    MANIFEST,
    RecordingFolderError,
    fit_folder,
    load_recordings,
    plan_runs,
    read_manifest,
    record_joints,
)
from pepper_driver.identification import identify as identify_module
from pepper_driver.identification.dataset import open_folder
from pepper_driver.identification.runs import IdentificationRun, perform
from pepper_driver.observer import Recording, RecordingError
from pepper_driver.testing.faults import pressed
from support.identification import ROBOT, SHORT, SlowRobot, short_body, use_backends
from support.once import made_once

JOINT = "LElbowRoll"


@pytest.fixture(scope="module")
def whole(request: pytest.FixtureRequest) -> Path:
    """Made at one go."""

    def make(folder: Path) -> None:
        record_joints("mujoco", [JOINT], SHORT, folder, calibration=short_body(), workers=1)

    return made_once(request, "elbow", make)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def copied(folder: Path, to: Path) -> Path:
    to.mkdir()
    for name, content in contents(folder).items():
        (to / name).write_bytes(content)
    return to


def test_an_interrupted_recording_goes_on_and_ends_with_the_same_bytes(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, done = tmp_path / "new", []
    driven = [f"{JOINT}-test", "calibration-4"]

    def third_time_interrupted(uri: str, run: IdentificationRun, *, identity: str) -> Recording:
        """Drive the robot for the first and the last run after the interruption; of the others it is known."""
        done.append(run.name)
        if len(done) == 3:
            raise KeyboardInterrupt
        if run.name in driven:
            return perform(uri, run, identity=identity)
        return Recording.load(whole / f"{run.name}.npz", ROBOT)

    body = short_body()
    monkeypatch.setattr(identify_module, "perform", third_time_interrupted)
    with pytest.raises(KeyboardInterrupt):
        record_joints("mujoco", [JOINT], SHORT, folder, calibration=body, workers=1)
    kept = contents(folder)
    assert set(kept) == {MANIFEST, f"{JOINT}-1.npz", f"{JOINT}-2.npz"}
    with pytest.raises(RecordingFolderError, match=f"5 of 7 runs are missing.* {JOINT}-test"):
        load_recordings(folder, ROBOT)

    reported: list[tuple[float, float]] = []
    record_joints(
        "mujoco",
        [JOINT],
        SHORT,
        folder,
        calibration=body,
        workers=1,
        progress=lambda what, d, total: reported.append((d, total)),
    )
    assert done[3:] == [f"{JOINT}-test", *(f"calibration-{n}" for n in range(1, 5))]
    assert contents(folder) == contents(whole)
    runs = plan_runs(ROBOT, [JOINT], SHORT, calibration=body)
    assert reported[0] == pytest.approx(
        (runs[0].seconds + runs[1].seconds, sum(r.seconds for r in runs))
    )
    a, b = (fit_folder(where, "affine") for where in (folder, whole))
    assert a.models == b.models


def test_what_is_there_is_not_made_again(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = contents(whole)
    monkeypatch.setattr(identify_module, "perform", None)
    again = record_joints("mujoco", [JOINT], SHORT, whole, calibration=short_body(), workers=1)
    assert contents(whole) == before
    assert [entry.joint for entry in again.sweeps] == [JOINT]
    assert len(again.sweeps[0].estimation) == 2
    assert len(again.calibration) == 4


def test_a_deleted_run_is_made_again(whole: Path, tmp_path: Path) -> None:
    folder = copied(whole, tmp_path / "copy")
    (folder / f"{JOINT}-2.npz").unlink()
    record_joints("mujoco", [JOINT], SHORT, folder, calibration=short_body(), workers=1)
    assert contents(folder) == contents(whole)


def test_a_damaged_run_is_set_aside_and_made_again(
    whole: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = copied(whole, tmp_path / "copy")
    path = folder / f"{JOINT}-2.npz"
    damaged = path.read_bytes()[:-2000]
    path.write_bytes(damaged)
    record_joints("mujoco", [JOINT], SHORT, folder, calibration=short_body(), workers=1)
    kept = folder / f"{path.name}.early-1"
    assert contents(folder) == {**contents(whole), kept.name: damaged}
    (line,) = caplog.messages
    assert line.startswith(f"{path}: damaged")
    assert line.endswith(f"it is kept as {kept}, and the run is made again")


SLOWER = SHORT.with_goals(sweeps=2)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"seed": 1}, "with the seed 0, not 1"),
        ({"joints": ["HeadYaw"]}, f"of the joints {JOINT}, not HeadYaw"),
        ({"joints": [JOINT, "HeadYaw"]}, f"of the joints {JOINT}, not {JOINT}, HeadYaw"),
        ({"tested": ["HeadYaw"]}, "for a test only of the joints none, not HeadYaw"),
        ({"calibration": None}, "with the calibration motion calibration_motion, not none"),
        ({"experiment": SLOWER}, "content of the motion file"),
        ({"experiment": replace(SHORT, name="other")}, "with the motion identify, not other"),
        ({"uri": "mujoco://?plant=worn"}, "of the robot "),
        ({"uri": "mujoco://?seed=3"}, r"with the backend mujoco, not mujoco://\?seed=3"),
    ],
)
def test_recordings_of_something_else_are_refused(
    changes: dict[str, object], word: str, whole: Path
) -> None:
    before = contents(whole)
    given: dict[str, object] = {
        "uri": "mujoco",
        "joints": [JOINT],
        "experiment": SHORT,
        "calibration": short_body(),
        **changes,
    }
    with pytest.raises(RecordingFolderError, match=word) as caught:
        record_joints(folder=whole, workers=1, **given)  # type: ignore[arg-type]
    assert str(whole) in str(caught.value)
    assert "another folder" in str(caught.value)
    assert contents(whole) == before


def test_a_real_robot_is_known_by_its_body_not_by_its_address(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = use_backends(monkeypatch, SlowRobot)
    record_joints("fake://pepper.local", ["HeadYaw"], SHORT, tmp_path, workers=1)
    count = len(made)
    record_joints("fake://10.0.0.5", ["HeadYaw"], SHORT, tmp_path, workers=1)
    assert len(made) == count + 1, "asked who it is, and nothing else"
    assert not read_manifest(tmp_path).simulated
    monkeypatch.setattr(SlowRobot, "identity", "body 2")
    with pytest.raises(RecordingFolderError, match="of the robot body 1, not body 2"):
        record_joints("fake://pepper.local", ["HeadYaw"], SHORT, tmp_path, workers=1)


class TouchedRobot(SlowRobot):
    """A real robot with a jammed sensor; a person touches another one in the middle of a run, twice."""

    def __init__(self) -> None:
        super().__init__()
        jammed, both = pressed("touch", 2), pressed("touch", 2, 4)
        self.faults = dict.fromkeys(range(10_000), jammed)
        self.faults |= dict.fromkeys((*range(300, 320), *range(340, 350)), both)


@pytest.mark.parametrize("again", [True, False])
def test_a_touch_is_reported_at_once_and_the_run_is_offered_again(
    again: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = use_backends(monkeypatch, SlowRobot, TouchedRobot, SlowRobot)
    sensor = list(ROBOT.sensors.touch)[4]
    reported: list[tuple[str, str, bool]] = []
    offered: list[tuple[str, tuple[str, ...]]] = []
    path = tmp_path / "HeadYaw-1.npz"

    def on_touch(run: IdentificationRun, name: str) -> None:
        reported.append((run.name, name, path.exists()))

    def repeat(run: IdentificationRun, sensors: Sequence[str]) -> bool:
        offered.append((run.name, tuple(sensors)))
        assert path.exists(), "it is kept"
        return again

    record_joints(
        "fake://robot", ["HeadYaw"], SHORT, tmp_path, workers=1, on_touch=on_touch, repeat=repeat
    )
    assert reported == 2 * [("HeadYaw-1", sensor, False)]
    assert offered == [("HeadYaw-1", (sensor,))]
    assert len(list(tmp_path.glob("HeadYaw-*.npz"))) == 3
    assert (tmp_path / f"{path.name}.early-1").exists() is again
    assert len(made) == 1 + 3 + again


def test_runs_are_not_paired_by_two_delays(whole: Path) -> None:
    manifest = read_manifest(whole)
    later = replace(manifest, response_delay=manifest.response_delay + 3)
    with pytest.raises(RecordingFolderError, match="with a delay in ticks of 3, not 6"):
        open_folder(whole, later)


def test_a_folder_of_unknown_recordings_is_refused(whole: Path, tmp_path: Path) -> None:
    folder = copied(whole, tmp_path / "copy")
    (folder / MANIFEST).unlink()
    with pytest.raises(RecordingFolderError, match="so their robot is unknown"):
        record_joints("mujoco", [JOINT], SHORT, folder, workers=1)
    with pytest.raises(RecordingFolderError, match="no recordings there"):
        fit_folder(tmp_path / "nowhere", "affine")


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 2}', '{"format": 1}', "\x80"])
def test_a_damaged_manifest_is_one_line(text: str, tmp_path: Path) -> None:
    (tmp_path / MANIFEST).write_bytes(text.encode("latin-1"))
    with pytest.raises(RecordingFolderError, match=r"manifest\.json") as caught:
        fit_folder(tmp_path, "affine")
    assert "\n" not in str(caught.value)


def test_a_manifest_leads_to_no_file_outside_its_folder(whole: Path, tmp_path: Path) -> None:
    folder = copied(whole, tmp_path / "copy")
    manifest = json.loads((folder / MANIFEST).read_text())
    manifest["runs"][0]["name"] = "../copy/LElbowRoll-1"
    (folder / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(RecordingFolderError, match=r"runs\.0\.name"):
        fit_folder(folder, "affine")


def test_a_damaged_recording_is_named(whole: Path, tmp_path: Path) -> None:
    folder = copied(whole, tmp_path / "copy")
    path = folder / f"{JOINT}-1.npz"
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(RecordingError, match=f"{JOINT}-1.npz"):
        fit_folder(folder, "affine")


def test_recordings_of_another_robot_are_refused(whole: Path) -> None:
    other = replace(ROBOT, name="salt")
    with pytest.raises(RecordingFolderError, match="of robot 'pepper', not of 'salt'"):
        load_recordings(whole, other)
