"""Plants that are drawn, of other days, too stiff or impossible, as the simulation takes them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.backends import make_backend
from pepper_driver.backends.mujoco_.plant_model import build_model
from pepper_driver.config import ConfigError, PlantConfig, load_plant, plant_hash
from pepper_driver.config.loading import package_file
from pepper_driver.config.plant import plant_names
from pepper_driver.config.population import HeldOutDrawError
from support.plant_files import ROBOT, variant


def stiff(folder: Path, factor: float, timestep: float = 0.002) -> PlantConfig:
    path = variant(folder, factors={"gear_stiffness": factor}, physics={"timestep": timestep})
    return load_plant(path, ROBOT)


@pytest.mark.parametrize("factor", [5.0, 9.0, 20.0, 100.0])
def test_a_step_too_coarse_for_the_stiffest_gear_is_refused(tmp_path: Path, factor: float) -> None:
    """The message names a step that is fine: it divides the cycle, loads and builds; the next coarser one does not."""
    plant = stiff(tmp_path, factor)
    with pytest.raises(ConfigError, match=r"mine\.yaml: key 'physics\.timestep'") as caught:
        build_model(ROBOT, plant)
    found = re.search(r"gear of (\w+) .*at most (\S+) s", str(caught.value))
    assert found is not None
    joint, step = found[1], float(found[2])
    assert joint in ROBOT.joint_names
    build_model(ROBOT, stiff(tmp_path, factor, step))
    coarser = ROBOT.cycle / (round(ROBOT.cycle / step) - 1)
    with pytest.raises(ConfigError, match=joint):
        build_model(ROBOT, replace(plant, physics=replace(plant.physics, timestep=coarser)))


def test_the_shipped_plants_are_far_from_that_limit() -> None:
    """W h below 1, half of what is stable: coarse enough to be quick, fine enough to be right."""
    for name in plant_names():
        plant = load_plant(name, ROBOT)
        drives = tuple(replace(a, gear_stiffness=4.0 * a.gear_stiffness) for a in plant.actuators)
        build_model(ROBOT, replace(plant, actuators=drives))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<mass value="11.6015"/>', '<mass value="-11.6015"/>'),
        ('ixx="0.129229"', 'ixx="-0.129229"'),
        ('ixx="0.129229"', 'ixx="0.9"'),
    ],
)
def test_an_impossible_link_is_refused(tmp_path: Path, old: str, new: str) -> None:
    text = package_file("pepper.urdf").read_text()
    assert old in text
    urdf = tmp_path / "odd.urdf"
    urdf.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError, match=r"odd\.urdf"):
        build_model(replace(ROBOT, urdf=urdf), load_plant("nominal", ROBOT))


def test_centres_of_mass_are_off_by_a_fraction_of_their_distance(tmp_path: Path) -> None:
    plant = load_plant(
        variant(tmp_path, randomise={"factors": {}, "values": {}, "model_error": [0.03, 0.08]}),
        ROBOT,
        draw=4,
    )
    at = build_model(ROBOT, load_plant("nominal", ROBOT)).mj
    moved = build_model(ROBOT, plant).mj
    for link, factor in plant.body.masses.items():
        body = at.body(link).id
        assert moved.body_mass[body] == pytest.approx(factor * at.body_mass[body])
        np.testing.assert_allclose(
            np.sort(moved.body_inertia[body]), np.sort(factor * at.body_inertia[body]), rtol=1e-9
        )
        shift = float(np.linalg.norm(moved.body_ipos[body] - at.body_ipos[body]))
        distance = float(np.linalg.norm(at.body_ipos[body]))
        assert 0.0299 * distance <= shift <= 0.0801 * distance


def test_a_robot_of_another_day_has_that_of_the_first_as_a_parent() -> None:
    def identity(day: int | None) -> str:
        return plant_hash(load_plant("random", ROBOT, draw=3, day=day), ROBOT)

    backend = make_backend("mujoco://?plant=random&draw=3&day=2", ROBOT)
    assert backend.info.identity == identity(2)
    assert backend.info.parents[0].identity == identity(None)
    assert identity(2) != identity(None)


@pytest.mark.parametrize("day", ["-1", "x", "1.5", ""])
def test_a_day_in_a_uri_is_a_whole_number(day: str) -> None:
    with pytest.raises(ConfigError, match="day must be a whole number, 0 or more"):
        make_backend(f"mujoco://?plant=random&draw=3&day={day}", ROBOT)


@pytest.mark.parametrize("draw", [100, 119, 10**17])
def test_draws_for_tests_are_refused(draw: int) -> None:
    with pytest.raises(HeldOutDrawError, match=f"draw {draw} is held out for the test split"):
        make_backend(f"mujoco://?plant=random&draw={draw}", ROBOT)
