"""Bundle of a first hour: read from its folder or its archive; what is wrong with it is said in one line."""

import json
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.first_hour.bundle import (
    PLACES,
    BundleError,
    Part,
    is_bundle,
    open_bundle,
)
from pepper_driver.first_hour.state import (
    STATE,
    STEPS,
    FirstHourError,
    check_same_hour,
    load_state,
    save_state,
)
from pepper_driver.log import read_log
from pepper_driver.observer.models.model_file import ModelSet
from support.examples import examples
from support.first_hour import finished_hour, make_hour, open_hour, zip_of


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished hour; copy it before a change."""
    folder = tmp_path_factory.mktemp("hour") / "hour"
    make_hour(folder)
    return folder


@pytest.fixture
def hour(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "hour"))


@pytest.mark.parametrize("packed", [False, True])
def test_a_folder_and_an_archive_have_the_same_parts(
    whole: Path, tmp_path: Path, packed: bool
) -> None:
    path = zip_of(whole, tmp_path / "sent.zip") if packed else whole
    assert is_bundle(path)
    with open_bundle(path) as bundle:
        assert bundle.source == path
        assert bundle.state.next_step is None
        assert len(bundle.state.prompts.touches) == 30
        assert ModelSet.load(bundle.models).identity == bundle.state.identity
        assert len(read_log(bundle.rest)) > 5
        assert (bundle.identification / "manifest.json").is_file()
        assert zipfile.is_zipfile(bundle.doctor)
    assert bundle.models.exists() is not packed  # the temporary folder is removed


@pytest.mark.parametrize("part", PLACES)
def test_a_missing_part_is_named_unless_it_is_not_asked_for(hour: Path, part: Part) -> None:
    place = hour / PLACES[part]
    shutil.rmtree(place) if place.is_dir() else place.unlink()
    step = "identify" if part in ("models", "identification") else part
    remedy = f"'--again {step}' makes it again"
    with (
        pytest.raises(BundleError, match=f"{PLACES[part]} is missing; .*{remedy}"),
        open_bundle(hour),
    ):
        pass
    others: list[Part] = [other for other in PLACES if other != part]
    with open_bundle(hour, parts=others) as bundle:
        assert bundle.place_of(part) == place


def test_a_step_that_is_not_done_is_named(hour: Path) -> None:
    save_state(hour / STATE, finished_hour().reopened("free"))
    with pytest.raises(BundleError, match="step 'free' is not done"), open_bundle(hour):
        pass
    with open_bundle(hour, parts=["models", "rest"]):
        pass


def other_models(hour: Path) -> None:
    models = ModelSet.load(hour / "models.json")
    replace(models, identity="another").save(hour / "models.json")


def other_manifest(hour: Path) -> None:
    path = hour / "identification" / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"identity": "another"}))


def other_state(hour: Path) -> None:
    save_state(hour / STATE, replace(finished_hour(), identity="another"))


@pytest.mark.parametrize("change", [other_models, other_manifest, other_state])
def test_parts_of_two_robots_are_refused(hour: Path, change: Callable[[Path], None]) -> None:
    change(hour)
    with pytest.raises(BundleError, match="two robots are mixed"), open_bundle(hour):
        pass


@pytest.mark.parametrize("change", [{"cycle": 0.01}, {"robot": "nao"}, {"joint_names": ("A",)}])
def test_an_hour_of_another_kind_of_robot_is_refused(hour: Path, change: dict[str, Any]) -> None:
    save_state(hour / STATE, replace(finished_hour(), **change))
    with pytest.raises(BundleError, match="other joints or another clock"), open_bundle(hour):
        pass


def test_logs_of_another_robot_are_refused(hour: Path) -> None:
    log = (hour / "rest.mcap").read_bytes()
    identity = finished_hour().identity
    assert identity.encode() in log
    # The metadata have a checksum: a changed name damages them.
    (hour / "rest.mcap").write_bytes(log.replace(identity.encode(), b"x" * len(identity)))
    with pytest.raises(BundleError, match=r"rest\.mcap"), open_bundle(hour):
        pass


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ('{"format": 2}', "format 2 is not the format 1"),
        ("{}", "is not the state of a first hour"),
        ("[]", "is not the state of a first hour"),
        ("{", "cannot be read"),
        ('{"format": 1}', "missing"),
        ("\x00", "cannot be read"),
    ],
)
def test_a_state_that_is_not_one_is_refused(hour: Path, content: str, message: str) -> None:
    (hour / STATE).write_text(content)
    with pytest.raises(FirstHourError, match=message):
        load_state(hour / STATE)
    with pytest.raises(BundleError, match=message), open_bundle(hour):
        pass


@pytest.mark.parametrize("part", ["models", "rest", "doctor"])
def test_a_damaged_part_is_named(hour: Path, part: Part) -> None:
    (hour / PLACES[part]).write_bytes(b"{")
    with pytest.raises(BundleError, match=PLACES[part]), open_bundle(hour):
        pass


def test_what_is_no_bundle_is_refused(tmp_path: Path) -> None:
    text = tmp_path / "text.zip"
    text.write_text("no archive")
    (tmp_path / "empty").mkdir()
    for path in (tmp_path / "none.zip", text, tmp_path / "empty"):
        assert not is_bundle(path)
        with pytest.raises(BundleError) as raised, open_bundle(path):
            pass
        assert str(path) in str(raised.value)
        assert "\n" not in str(raised.value)


def test_an_archive_writes_only_what_belongs_to_an_hour(whole: Path, tmp_path: Path) -> None:
    path = zip_of(whole, tmp_path / "sent.zip")
    with zipfile.ZipFile(path, "a") as archive:
        for name in ("../evil.json", "identification/../../evil.npz", "more.txt", "/evil.mcap"):
            archive.writestr(name, "x")
    with open_bundle(path) as bundle:
        there = {p.name for p in bundle.models.parent.rglob("*") if p.is_file()}
        assert not {"evil.json", "evil.npz", "more.txt", "evil.mcap"} & there
        assert not (bundle.models.parent.parent / "evil.json").exists()


@pytest.mark.parametrize("part", PLACES)
def test_of_an_archive_only_what_was_asked_for_is_unpacked(
    whole: Path, tmp_path: Path, part: Part
) -> None:
    path = zip_of(whole, tmp_path / "sent.zip")
    with open_bundle(path, parts=[part]) as bundle:
        folder = bundle.models.parent
        there = {p.relative_to(folder) for p in folder.rglob("*") if p.is_file()}
        assert there == {
            p.relative_to(whole)
            for p in whole.rglob("*")
            if p.is_file() and p.relative_to(whole).parts[0] in (STATE, PLACES[part])
        }


@examples(60)
@given(data=st.data())
def test_a_damaged_archive_ends_in_one_line_or_reads(
    whole: Path, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = zip_of(whole, tmp_path_factory.mktemp("bad") / "sent.zip")
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    try:
        with open_bundle(path) as bundle:
            assert bundle.state.steps
    except BundleError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"identity": "another"}, "of the robot mock"),
        ({"version": "0.0.1"}, "with version"),
        ({"cycle": 0.01}, "clock"),
        ({"label": "key"}, "with the label head, not key"),
        ({"plan": "q"}, "plan"),
    ],
)
def test_an_hour_goes_on_only_as_it_was_begun(change: dict[str, object], message: str) -> None:
    there = replace(open_hour(), identity="mock")
    check_same_hour(there, there.begun("doctor"), Path("x"))
    asked: Any = {"identity": "mock", **change}
    with pytest.raises(FirstHourError, match=message):
        check_same_hour(there, replace(there, **asked), Path("x"))


def test_steps_come_in_their_order(tmp_path: Path) -> None:
    hour = open_hour()
    for name in STEPS:
        assert hour.next_step == name
        hour = hour.begun(name)
        assert hour.next_step == name  # one that was ended early is made again
        hour = hour.done(name, {"a": True, "b": ("x", "y"), "c": None, "d": "text", "e": 2})
        save_state(tmp_path / STATE, hour)
        assert load_state(tmp_path / STATE) == hour
    assert hour.next_step is None
    again = hour.reopened("rest")
    save_state(tmp_path / STATE, again)
    assert load_state(tmp_path / STATE) == again
    assert [step.name for step in again.steps if step.progress == "open"] == ["rest", "pack"]
    packed = hour.reopened("pack")
    assert [step.name for step in packed.steps if step.progress == "open"] == ["pack"]
