from __future__ import annotations

import pickle
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver.config.files import OutputError
from pepper_driver.observer.recording import Recording, RecordingBuilder, RecordingError
from support.observer import JOINTS, ROBOT, random_ticks


@pytest.fixture
def run() -> Recording:
    builder = RecordingBuilder(ROBOT)
    for one in random_ticks(6, seed=2):
        builder.append(one)
    return builder.finish()


def test_a_file_gives_the_recording_back(run: Recording, tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    run.save(path)
    again = Recording.load(path, ROBOT)
    assert again.joint_names == run.joint_names
    for field in fields(run):
        before, after = getattr(run, field.name), getattr(again, field.name)
        if field.name != "joint_names":
            np.testing.assert_array_equal(after, before)
            assert after.dtype == before.dtype
            assert not after.flags.writeable
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.npz"]


def test_the_name_of_the_file_is_kept_as_it_is(run: Recording, tmp_path: Path) -> None:
    run.save(tmp_path / "run.recording")
    assert Recording.load(tmp_path / "run.recording").joint_names == run.joint_names


def arrays_of(path: Path) -> dict[str, Any]:
    with np.load(path) as file:
        return dict(file)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("recording_format", np.array(99), "of format 99, not the format 2"),
        ("recording_format", np.array([1, 1]), "not the format 2"),
        ("recording_format", None, "is no recording, it is arrays of something else"),
        ("wheel_speed", None, "without wheel_speed"),
        ("surplus", np.zeros(3), "with unknown surplus"),
        ("position", np.zeros((6, 4)), "'position' has shape"),
        ("position", np.full((6, JOINTS), np.nan), "'position' of KneePitch is not finite"),
        ("position", np.zeros((6, JOINTS), dtype=int), "'position' is of shape .* type int64"),
        ("limited", np.zeros((6, JOINTS)), "'limited' is of shape .* type float64"),
        ("time", np.array(1.0), "'time' is of shape"),
        ("joint_names", np.arange(JOINTS), "'joint_names' is of shape"),
    ],
)
def test_a_file_with_something_wrong_inside_is_refused_in_one_line(
    run: Recording, tmp_path: Path, name: str, value: Any, message: str
) -> None:
    path = tmp_path / "run.npz"
    run.save(path)
    arrays = arrays_of(path)
    arrays.pop(name, None)
    if value is not None:
        arrays[name] = value
    np.savez(path, **arrays)
    with pytest.raises(RecordingError, match=message) as caught:
        Recording.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_damaged_files_are_refused_in_one_line(run: Recording, tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    run.save(path)
    whole = path.read_bytes()
    middle = len(whole) // 2
    np.save(tmp_path / "one.npy", np.zeros(3))
    broken = [
        b"",
        b"nothing of the kind",
        whole[:100],
        whole[:middle],
        whole[:middle] + b"\xff" * 60 + whole[middle + 60 :],
        pickle.dumps({"time": 1}),
        (tmp_path / "one.npy").read_bytes(),
    ]
    for content in broken:
        path.write_bytes(content)
        with pytest.raises(RecordingError) as caught:
            Recording.load(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)


def test_loading_never_runs_a_pickle(run: Recording, tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    run.save(path)
    arrays = arrays_of(path)
    arrays["joint_names"] = np.array([Tripwire()] * JOINTS, dtype=object)
    np.savez(path, **arrays)
    with pytest.raises(RecordingError, match="damaged"):
        Recording.load(path)
    assert not Tripwire.tripped


class Tripwire:
    """Notes when it is rebuilt from a pickle."""

    tripped = False

    def __reduce__(self) -> tuple[Any, ...]:
        return (_trip, ())


def _trip() -> None:
    Tripwire.tripped = True


def test_another_robot_is_refused(run: Recording, tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    other = replace(run, joint_names=tuple(f"Joint{k}" for k in range(JOINTS)))
    other.save(path)
    assert Recording.load(path).joint_names == other.joint_names
    with pytest.raises(RecordingError, match="other joints"):
        Recording.load(path, ROBOT)


def test_a_failed_save_leaves_what_was_there(
    run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.npz"
    run.save(path)
    before = path.read_bytes()

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OutputError, match="the disk is full"):
        replace(run, age=run.age + 1.0).save(path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.npz"]


def test_places_that_cannot_be_used_are_refused(run: Recording, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        run.save(tmp_path / "missing" / "run.npz")
    with pytest.raises(RecordingError, match="cannot be read"):
        Recording.load(tmp_path / "missing.npz")
    with pytest.raises(RecordingError, match="cannot be read"):
        Recording.load(tmp_path)
