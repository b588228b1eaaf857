"""Every loader of YAML: a damaged file loads, or one line says what is wrong with it. Nothing else ever comes out."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from pepper_driver.config import (
    PepperError,
    load_controller_settings,
    load_experiment,
    load_network,
    load_observer_settings,
    load_plant,
    load_recordings,
    load_robot,
    load_safety_settings,
    load_self_collision,
    load_world,
)
from pepper_driver.config.evaluation_baselines import load_evaluation_baselines
from pepper_driver.config.loading import package_file, read_yaml
from support import ROOT
from support.examples import examples
from support.yaml_values import ANYTHING, JARGON, damaged, damaged_text, dump

ROBOT = load_robot()
EXPERIMENTS = ROOT / "examples" / "experiments"
BRANCHES = ROOT / "tests" / "facts" / "branches.yaml"
Loader = Callable[[Path], object]
LOADERS: dict[str, tuple[Path, Loader]] = {
    "motion": (package_file("motions", "reach.yaml"), lambda p: load_experiment(p, ROBOT)),
    "contacts": (
        package_file("experiments", "reach_and_push.yaml"),
        lambda p: load_experiment(p, ROBOT),
    ),
    "random goals": (
        package_file("experiments", "demo.yaml"),
        lambda p: load_experiment(p, ROBOT),
    ),
    "sweeps": (
        package_file("experiments", "identify.yaml"),
        lambda p: load_experiment(p, ROBOT),
    ),
    "plant": (package_file("plants", "nominal.yaml"), lambda p: load_plant(str(p), ROBOT)),
    "variant": (package_file("plants", "random.yaml"), lambda p: load_plant(str(p), ROBOT)),
    "world": (package_file("worlds", "table.yaml"), lambda p: load_world(str(p))),
    "network": (package_file("networks", "wifi.yaml"), lambda p: load_network(str(p))),
    "controller": (
        package_file("controller.yaml"),
        lambda p: load_controller_settings(ROBOT, p),
    ),
    "observer": (package_file("observer.yaml"), load_observer_settings),
    "safety": (package_file("safety.yaml"), load_safety_settings),
    "self-collision": (
        package_file("self_collision.yaml"),
        lambda p: load_self_collision(ROBOT, p),
    ),
    "baselines": (package_file("evaluation_baselines.yaml"), load_evaluation_baselines),
    "recordings": (package_file("recordings.yaml"), lambda p: load_recordings(ROBOT, p)),
    "experiment": (EXPERIMENTS / "known_pushes.yaml", lambda p: load_experiment(p, ROBOT)),
    "other experiment": (EXPERIMENTS / "retract.yaml", lambda p: load_experiment(p, ROBOT)),
    "branches": (BRANCHES, lambda p: load_experiment(p, ROBOT)),
}
WHOLE: dict[str, Any] = {name: read_yaml(path) for name, (path, _) in LOADERS.items()}
FEW = examples(
    40,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


def check(name: str, path: Path) -> None:
    try:
        LOADERS[name][1](path)
    except PepperError as error:
        assert len(str(error).splitlines()) == 1, str(error)
        assert ".yaml" in str(error)
        assert not JARGON.search(str(error)), str(error)


@pytest.mark.parametrize("name", LOADERS)
def test_a_copy_loads(name: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(dump(WHOLE[name]))
    LOADERS[name][1](path)


@pytest.mark.parametrize("name", LOADERS)
def test_damaged_values(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("fuzz") / "mine.yaml"

    @FEW
    @given(damaged(WHOLE[name]))
    def damage(data: Any) -> None:
        path.write_text(dump(data), encoding="utf-8")
        check(name, path)

    damage()


@pytest.mark.parametrize("name", LOADERS)
def test_damaged_text(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("fuzz") / "mine.yaml"

    @FEW
    @given(damaged_text(LOADERS[name][0].read_text()))
    def damage(text: str) -> None:
        path.write_text(text, encoding="utf-8")
        check(name, path)

    damage()


@FEW
@given(data=ANYTHING, name=st.sampled_from(sorted(LOADERS)))
def test_anything(tmp_path_factory: pytest.TempPathFactory, data: Any, name: str) -> None:
    path = tmp_path_factory.mktemp("fuzz") / "mine.yaml"
    path.write_text(dump(data), encoding="utf-8")
    check(name, path)
