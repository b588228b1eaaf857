from __future__ import annotations

import hashlib
import json
import math
import os
import pickle
import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given
from hypothesis import strategies as st

from pepper_driver.config import PepperError
from pepper_driver.config.files import OutputError
from pepper_driver.observer.fitting.tree import fit_joint
from pepper_driver.observer.models.fusion_model import TAPS, BaseModel, FusionModel
from pepper_driver.observer.models.model_file import (
    MODEL_TYPES,
    ModelFileError,
    ModelSet,
    predict_recording,
    shipped,
)
from pepper_driver.observer.models.tree import TREE_TYPES, AffineTree
from support.examples import examples
from support.fusion import MODEL, fusion_set
from support.observer import AFFINE, CYCLE, ROBOT, SILENT, free_run, models

AFFINE_SET = models({"HeadYaw": AFFINE, "LHand": AFFINE}, kind="affine")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "models.json"
    AFFINE_SET.save(path)
    return path


@pytest.mark.parametrize("kind", ["affine", "cart"])
def test_what_was_saved_is_loaded_bit_for_bit(kind: str, tmp_path: Path) -> None:
    run = free_run(3.0, 0)
    if kind == "affine":
        saved = models({"HeadYaw": fit_joint("HeadYaw", [run], "affine")}, kind="affine")
    else:
        saved = models({"HeadYaw": fit_joint("HeadYaw", [run], "cart")}, kind="cart")
    path = tmp_path / "models.json"
    saved.save(path)
    loaded = ModelSet.load(path, ROBOT)
    assert loaded == saved
    one, other = (
        predict_recording(models.models["HeadYaw"], "HeadYaw", run) for models in (saved, loaded)
    )
    assert (one == other).all()


def test_equal_sets_give_equal_bytes_without_times_or_paths(tmp_path: Path) -> None:
    one, other = tmp_path / "a.json", tmp_path / "other.json"
    AFFINE_SET.save(one)
    replace(AFFINE_SET, models=dict(reversed(list(AFFINE_SET.models.items())))).save(other)
    assert one.read_bytes() == other.read_bytes()
    header = json.loads(one.read_text())
    assert header.pop("models").keys() == {"HeadYaw", "LHand"}
    assert header == {
        "format": 2,
        "robot": "pepper",
        "joint_names": list(ROBOT.joint_names),
        "identity": "plant-0123",
        "kind": "affine",
        "cycle": CYCLE,
        "estimation_fit": {"HeadYaw": 91.5, "LHand": 91.5},
        "test_fit": {"HeadYaw": 89.25, "LHand": 89.25},
        "threshold": {"HeadYaw": math.radians(2.5), "LHand": math.radians(2.5)},
        "version": "0.0.0",
        "base": None,
        "measured": None,
        "created_by": "pepper identify",
    }


def test_the_hash_is_that_of_the_file(tmp_path: Path) -> None:
    paths = [path for kind in MODEL_TYPES for path in shipped(kind).values()]
    AFFINE_SET.save(tmp_path / "a.json")
    for path in (*paths, tmp_path / "a.json"):
        assert ModelSet.load(path).sha256() == hashlib.sha256(path.read_bytes()).hexdigest()


def test_saving_replaces_the_file_and_leaves_nothing_else(file: Path) -> None:
    replace(AFFINE_SET, identity="another").save(file)
    assert ModelSet.load(file).identity == "another"
    assert os.listdir(file.parent) == [file.name]


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_a_save_that_fails_leaves_the_old_file(
    step: str, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_space(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, step, no_space)
    with pytest.raises(OutputError, match=r"cannot be written .the disk is full"):
        replace(AFFINE_SET, identity="another").save(file)
    assert ModelSet.load(file) == AFFINE_SET
    assert os.listdir(file.parent) == [file.name]


def test_places_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        AFFINE_SET.save(tmp_path / "no" / "such" / "folder.json")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="cannot be written"):
        AFFINE_SET.save(tmp_path / "folder")
    assert os.listdir(tmp_path) == ["folder"]
    for path in (tmp_path / "missing.json", tmp_path / "folder"):
        with pytest.raises(ModelFileError, match=r"cannot be read .*pepper identify"):
            ModelSet.load(path)


def test_shipped_files_have_a_place_in_the_package() -> None:
    for kind in TREE_TYPES:
        for plant, path in shipped(kind).items():
            assert path.name == f"{plant}-{kind}.json"
            assert path.parent.name == "models"
            assert (path.parent / "__init__.py").exists()


def edited(path: Path, edit: Callable[[dict[str, Any]], object]) -> None:
    data = json.loads(path.read_text())
    edit(data)
    path.write_text(json.dumps(data))


def set_in(*keys: str | int, value: object) -> Callable[[dict[str, Any]], None]:
    def edit(data: dict[str, Any]) -> None:
        place: Any = data
        for key in keys[:-1]:
            place = place[key]
        place[keys[-1]] = value

    return edit


MODEL_OF = ("models", "HeadYaw")


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (set_in("format", value=1), "format 1 is not the format 2"),
        (set_in("format", value=None), "format null is not"),
        (lambda data: data.pop("format"), "not a model file"),
        (lambda data: data.pop("models"), "there are no models"),
        (set_in("models", value=[]), "there are no models"),
        (set_in("models", value={}), "there is no model"),
        (lambda data: data.pop("identity"), "'identity' is missing"),
        (set_in("extra", value=1), "unknown key 'extra'"),
        (set_in("kind", value="forest"), "kind"),
        (set_in("kind", value="cart"), "unknown key"),
        (set_in("cycle", value=-0.012), "cycle"),
        (set_in("cycle", value="0.012"), "cycle"),
        (set_in("test_fit", "HeadYaw", value=None), "test_fit.HeadYaw"),
        (set_in("test_fit", "HeadPitch", value=1.0), "'test_fit' is not of the joints"),
        (set_in("joint_names", 0, value="HeadYaw"), "named twice"),
        (set_in("models", "Tail", value={}), "model of Tail"),
        (lambda data: data["models"].pop("LHand"), "not of the joints"),
        (set_in(*MODEL_OF, value=[1.0]), "the model of HeadYaw is no mapping"),
        (set_in(*MODEL_OF, "left", 0, value=0), "node 0 of 5 has child 0"),
        (set_in(*MODEL_OF, "left", 2, value=1), "node 2 of 5 has child 1"),
        (set_in(*MODEL_OF, "right", 0, value=9), "node 0 of 5 has child 9"),
        (set_in(*MODEL_OF, "right", 0, value=10**30), "has child 1000"),
        (set_in(*MODEL_OF, "right", 0, value=2.0), "right.0"),
        (set_in(*MODEL_OF, "right", 0, value=True), "right.0"),
        (set_in(*MODEL_OF, "feature", 0, value=3), "splits on feature 3"),
        (set_in(*MODEL_OF, "threshold", value=[0.0]), "'threshold' has 1 entries"),
        (set_in(*MODEL_OF, "threshold", 0, value=float("nan")), "NaN is not finite"),
        (set_in(*MODEL_OF, "threshold", 0, value=float("inf")), "Infinity is not finite"),
        (set_in(*MODEL_OF, "threshold", 0, value=10**400), "threshold.0"),
        (set_in(*MODEL_OF, "coefficients", 1, value=[0.0, 1.0]), "coefficients"),
        (set_in(*MODEL_OF, "coefficients", 1, 0, value="0.0"), "coefficients"),
        (set_in(*MODEL_OF, "lower", value=[9.0, 9.0, 9.0]), "above upper"),
        (set_in(*MODEL_OF, "surprise", value=1), "unknown key 'surprise'"),
        (lambda data: data["models"]["HeadYaw"].pop("upper"), "'upper' is missing"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    edit: Callable[[dict[str, Any]], object], message: str, file: Path
) -> None:
    edited(file, edit)
    with pytest.raises(ModelFileError) as caught:
        ModelSet.load(file)
    text = str(caught.value)
    assert message in text
    assert text.startswith(f"{file}: ")
    assert "'pepper identify'" in text
    assert "\n" not in text
    assert len(text) < 600


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x00" * 100,
        b"\xff\xfe{}",
        b"[1, 2]",
        b"null",
        b'"text"',
        b"{" * 100_000,
        b"[" * 100_000,
        b'{"format": 2, "format": 2}',
        b'{"format": 1e999}',
        b'{"format": 2, "robot": "\\ud800", "models": {}}',
        b'{"format": 2, "models": {}, "cycle": ' + b"9" * 5000 + b"}",
        pickle.dumps(AFFINE_SET),
    ],
)
def test_files_of_another_kind_are_refused(content: bytes, file: Path) -> None:
    file.write_bytes(content)
    with pytest.raises(ModelFileError) as caught:
        ModelSet.load(file)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


def test_a_key_given_twice_is_refused(file: Path) -> None:
    text = file.read_text()
    line = ' "identity": "plant-0123",'
    assert line in text
    file.write_text(text.replace(line, f"{line} {line}"))
    with pytest.raises(ModelFileError, match="a key is given twice"):
        ModelSet.load(file)


def test_nothing_in_a_file_is_ever_run(file: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Callable[[int], None], tuple[int]]:
            return os._exit, (3,)

    file.write_bytes(pickle.dumps(Trap()))
    with pytest.raises(ModelFileError):
        ModelSet.load(file)


def test_a_file_cut_short_is_refused_wherever_it_is_cut(file: Path) -> None:
    content = file.read_bytes()
    for length in range(0, len(content.rstrip()), 37):
        file.write_bytes(content[:length])
        with pytest.raises(ModelFileError):
            ModelSet.load(file)


@examples(
    400,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
@given(st.randoms(use_true_random=False), st.integers(1, 4))
@example(random.Random(0), 1)
def test_a_file_with_bytes_altered_is_refused_or_makes_a_valid_model(
    file: Path, rng: random.Random, times: int
) -> None:
    AFFINE_SET.save(file)
    content = bytearray(file.read_bytes())
    for _ in range(times):
        place = rng.randrange(len(content))
        match rng.randrange(4):
            case 0:
                content[place] = rng.randrange(256)
            case 1:
                content[place] = rng.choice(b'0123456789-+.eE,:[]{}" ntfNI')
            case 2:
                del content[place : place + rng.randrange(1, 20)]
            case _:
                content[place:place] = content[place : place + rng.randrange(1, 20)]
    file.write_bytes(bytes(content))
    try:
        loaded = ModelSet.load(file, ROBOT)
    except ModelFileError as error:
        assert "\n" not in str(error)
        return
    assert loaded.models.keys() == AFFINE_SET.models.keys()
    assert loaded.joint_names == ROBOT.joint_names
    for model in loaded.models.values():
        assert isinstance(model, AffineTree)
        assert len(model.feature) == len(AFFINE.feature)
        assert np.isfinite(model.predict(np.array([[0.1, -0.2, 0.3]]))).all()


def test_models_of_another_robot_are_refused(file: Path) -> None:
    assert ModelSet.load(file, ROBOT) == AFFINE_SET
    for other, message in (
        (replace(ROBOT, name="nao"), "are of robot 'pepper', not of 'nao'"),
        (replace(ROBOT, joints=ROBOT.joints[::-1]), "another order"),
        (replace(ROBOT, joints=ROBOT.joints[:-1]), "other joints"),
        (replace(ROBOT, cycle=0.01), "cycle of 0.012 s, not 0.01 s"),
    ):
        with pytest.raises(ModelFileError, match=message) as caught:
            ModelSet.load(file, other)
        assert str(caught.value).startswith(f"{file}: ")


def test_sets_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ModelFileError, match="is a CartTree, not of kind 'affine'"):
        models({"HeadYaw": SILENT}, kind="affine")
    with pytest.raises(ModelFileError, match="'Tail', which is no joint"):
        models({"Tail": SILENT})
    with pytest.raises(ModelFileError, match="no model"):
        models({})
    with pytest.raises(ModelFileError, match="'test_fit' is not finite"):
        replace(AFFINE_SET, test_fit={"HeadYaw": float("nan"), "LHand": 1.0})
    assert issubclass(ModelFileError, PepperError)
    assert issubclass(ModelFileError, ValueError)


# -- fusion ---------------------------------------------------------------------------------------------------------

BASE = BaseModel(
    coefficients=tuple((0.1 * k, -1e-7 * k, 1.0 / 3.0, 0.0, 1e9, -0.2) for k in range(2 * TAPS)),
    still=(0.01, 0.02, 0.03, 1e-9, 0.1 + 0.2, 1e6),
    moving=(0.04, 0.05, 0.06, 0.07, 0.08, 0.09),
    shaking=(0.1, 0.11, 0.12, 0.13, 0.131, 0.132),
    driving=(0.14, 0.15, 0.16, 0.17, 0.18, 0.19),
)
ODD = replace(
    MODEL,
    momentum_bound=math.pi / 1e2,
    twin=replace(MODEL.twin, lag=0.1 + 0.2, integral_rate=1e-300),
)
FUSION_SET = fusion_set({"HeadYaw": MODEL, "LHand": ODD}, BASE)


@pytest.fixture
def fusion_file(tmp_path: Path) -> Path:
    path = tmp_path / "fusion.json"
    FUSION_SET.save(path)
    return path


def test_fusion_models_are_loaded_bit_for_bit(fusion_file: Path) -> None:
    assert ModelSet.load(fusion_file, ROBOT) == FUSION_SET
    without = replace(FUSION_SET, base=None)
    without.save(fusion_file)
    assert ModelSet.load(fusion_file, ROBOT) == without


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (set_in(*MODEL_OF, "twin", "lag", value=-0.1), "'lag' is negative"),
        (set_in(*MODEL_OF, "twin", "load_gain", value=0.0), "load_gain above 0"),
        (set_in(*MODEL_OF, "twin", "breakaway", value="1.0"), "breakaway"),
        (set_in(*MODEL_OF, "twin", "spin", value=1.0), "spin"),
        (lambda data: data["models"]["HeadYaw"]["twin"].pop("friction"), "friction"),
        (lambda data: data["models"]["HeadYaw"].pop("twin"), "'twin' is missing"),
        (set_in(*MODEL_OF, "twin", value=3.0), "twin"),
        (set_in(*MODEL_OF, "momentum", "source", value="guess"), "source"),
        (set_in(*MODEL_OF, "momentum", "torque_per_ampere", value=0.0), "torque_per_ampere"),
        (set_in(*MODEL_OF, "weight", value=[0.5, 0.5]), "weight"),
        (set_in(*MODEL_OF, "spread", value=[0.5, 0.5]), "spread"),
        (set_in(*MODEL_OF, "spread", value=[0.5, 0.5, 0.5, 0.5]), "spread"),
        (lambda data: data["models"]["HeadYaw"].pop("spread"), "'spread' is missing"),
        (set_in(*MODEL_OF, "spread", 0, value=0.0), "'spread' must be above 0"),
        (set_in(*MODEL_OF, "momentum_bound", value=0.0), "'momentum_bound' must be above 0"),
        (set_in(*MODEL_OF, "remainder", value={}), "remainder"),
        (set_in("base", "still", value=[0.1, 0.1, 0.1]), "base.still"),
        (set_in("base", "standing", value=[0.1, 0.1, 0.1]), "standing"),
        (set_in("base", "driving", 1, value=0.0), "a spread must be above 0"),
        (set_in("base", "coefficients", value=[]), "base.coefficients"),
        (lambda data: data["base"]["coefficients"].pop(), "multiple of 25"),
        (set_in("base", value=[]), "base"),
        (set_in("kind", value="affine"), "unknown key"),
    ],
)
def test_what_is_wrong_with_a_fusion_file_is_said_in_one_line(
    edit: Callable[[dict[str, Any]], object], message: str, fusion_file: Path
) -> None:
    edited(fusion_file, edit)
    with pytest.raises(ModelFileError) as caught:
        ModelSet.load(fusion_file)
    text = str(caught.value)
    assert message in text
    assert text.startswith(f"{fusion_file}: ")
    assert "'pepper identify'" in text
    assert "\n" not in text
    assert len(text) < 600


@examples(
    150,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
@given(st.randoms(use_true_random=False), st.integers(1, 3))
def test_a_fusion_file_with_bytes_altered_is_refused_or_makes_a_valid_model(
    fusion_file: Path, rng: random.Random, times: int
) -> None:
    FUSION_SET.save(fusion_file)
    content = bytearray(fusion_file.read_bytes())
    for _ in range(times):
        content[rng.randrange(len(content))] = rng.choice(b'0123456789-+.eE,:[]{}" ntfNI')
    fusion_file.write_bytes(bytes(content))
    try:
        loaded = ModelSet.load(fusion_file, ROBOT)
    except ModelFileError as error:
        assert "\n" not in str(error)
        return
    assert all(isinstance(model, FusionModel) for model in loaded.models.values())


def test_sets_that_mix_kinds_are_refused() -> None:
    with pytest.raises(ModelFileError, match="is a CartTree, not of kind 'fusion'"):
        models({"HeadYaw": SILENT}, kind="fusion")
    with pytest.raises(ModelFileError, match="is a FusionModel, not of kind 'cart'"):
        models({"HeadYaw": MODEL})
