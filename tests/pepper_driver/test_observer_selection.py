"""Models serve the robot they were identified on, and its simulated variants; those of a foreign robot are refused."""

import logging
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from pepper_driver import Pepper
from pepper_driver.backends import make_backend
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import PepperError, RobotIdentity, load_robot, plant_names
from pepper_driver.config.loading import package_file, read_yaml
from pepper_driver.observer import ModelFileError, ModelSet, load_shipped, shipped
from pepper_driver.observers import find_models, make_observer

ROBOT = load_robot()
OWN = ("integral", "nominal")
"""Plants with models of their own."""


def source(uri: str) -> str:
    """The plant whose models a robot of this URI uses, as its observer says."""
    observer = Pepper(uri).observer
    assert observer is not None
    (name,) = (
        name
        for name, path in shipped("fusion").items()
        if ModelSet.load(path).identity in observer.describe()
    )
    return name


def save(folder: Path, name: str, **content: object) -> str:
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump({"description": "", **content, "name": name}))
    return str(path)


@pytest.mark.parametrize(
    ("uri", "models"),
    [
        *((f"mujoco://?plant={plant}", "nominal") for plant in ("worn", "drift", "random")),
        ("mujoco://?plant=drift&draw=5", "nominal"),
        ("mujoco://?plant=swaying", "nominal"),
        ("mujoco://?plant=swaying-integral", "integral"),
    ],
)
def test_a_variant_uses_the_models_of_what_it_extends_and_one_line_says_so(
    uri: str, models: str, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        assert source(uri) == models
    (record,) = caplog.records
    name = make_backend(uri).info.name
    assert record.getMessage() == (
        f"'{name}' uses the models of plant '{models}', of which it is a variant"
    )


@pytest.mark.parametrize("plant", OWN)
def test_a_plant_with_models_uses_its_own_without_a_word(
    plant: str, caplog: pytest.LogCaptureFixture
) -> None:
    assert source(f"mujoco://?plant={plant}") == plant
    assert not caplog.records


@pytest.mark.parametrize("observer", ["fusion", "paper", "momentum"])
def test_every_observer_finds_them(observer: str, caplog: pytest.LogCaptureFixture) -> None:
    Pepper("mujoco://?plant=worn", observer=observer)
    assert len(caplog.records) == 1


def test_a_users_plant_uses_the_nearest_models(tmp_path: Path) -> None:
    swaying = save(tmp_path, "mine", extends="swaying-integral", battery={"charge": 0.4})
    assert source(f"mujoco://?plant={swaying}") == "integral"
    renamed = save(tmp_path, "renamed", extends=swaying)
    assert source(f"mujoco://?plant={renamed}") == "integral"


def test_a_plant_that_extends_nothing_is_reported_by_its_name(tmp_path: Path) -> None:
    content = read_yaml(package_file("plants", "nominal.yaml"))
    path = save(tmp_path, **{**content, "name": "stranger", "base": "fixed"})
    with pytest.raises(ModelFileError) as caught:
        Pepper(f"mujoco://?plant={path}")
    message = str(caught.value)
    assert message.startswith("no models come with the package for 'stranger', only for the plants")
    assert message.endswith("; identify the robot with 'pepper identify'")
    assert make_backend(f"mujoco://?plant={path}").info.identity not in message


def test_a_file_of_a_parent_serves_a_variant_and_no_other_robot(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Models of the worn robot serve what extends it, not what it extends, nor a robot next to it."""
    path = tmp_path / "worn.json"
    models = ModelSet.load(shipped("fusion")["nominal"])
    replace(models, identity=make_backend("mujoco://?plant=worn").info.identity).save(path)
    mine = save(tmp_path, "mine", extends="worn", heat={"start": 15.0})
    Pepper(f"mujoco://?plant={mine}", models=path)
    (record,) = caplog.records
    assert record.getMessage() == "'mine' uses the models of plant 'worn', of which it is a variant"
    for plant in ("nominal", "cold", "integral"):
        with pytest.raises(ModelFileError) as caught:
            Pepper(f"mujoco://?plant={plant}", models=path)
        assert str(caught.value) == (
            f"{path}: identified on another robot than '{plant}'; identify this one with 'pepper identify'"
        )


def test_a_file_of_the_first_draw_serves_another(tmp_path: Path) -> None:
    path = tmp_path / "drift.json"
    models = ModelSet.load(shipped("fusion")["nominal"])
    first, fifth = (make_backend(f"mujoco://?plant=drift&draw={n}").info for n in (0, 5))
    replace(models, identity=first.identity).save(path)
    assert find_models(fifth.identities, path, "fusion", ("fusion",)).identity == first.identity
    replace(models, identity=fifth.identity).save(path)
    with pytest.raises(ModelFileError, match="another robot than 'drift-0'"):
        find_models(first.identities, path, "fusion", ("fusion",))


def test_a_robot_that_is_not_simulated_has_its_own_models_only() -> None:
    info = MockBackend(ROBOT, uri="mock://?posture=Stand").info
    assert info.identities == (RobotIdentity(name="mock://?posture=Stand", identity="mock"),)
    with pytest.raises(PepperError, match="no models come with the package for 'mock://"):
        make_observer("fusion", ROBOT, info.identities)


def test_the_nearest_of_several_shipped_models_is_taken() -> None:
    integral, nominal = (make_backend(f"mujoco://?plant={plant}").info for plant in OWN)
    assert load_shipped("fusion", integral.identities).identity == integral.identity
    turned = tuple(reversed(integral.identities))
    assert load_shipped("fusion", turned).identity == nominal.identity


def test_every_shipped_plant_has_an_observer() -> None:
    assert len(plant_names()) == 16
    for plant in plant_names():
        info = make_backend(f"mujoco://?plant={plant}").info
        assert load_shipped("fusion", info.identities).models.keys() == set(ROBOT.joint_names)
