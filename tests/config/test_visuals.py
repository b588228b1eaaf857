"""Visual geometry of the robot: whole, symmetric, where the robot is, and the same to other programs."""

from __future__ import annotations

import dataclasses
import re
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from pepper_driver.config import ConfigError, RobotConfig, load_plant, load_robot
from pepper_driver.config.plant import plant_hash
from pepper_driver.config.visuals import Visual, load_visuals


@pytest.fixture(scope="module")
def robot() -> RobotConfig:
    return load_robot()


@cache
def link_pose(urdf: Path, link: str) -> np.ndarray:
    """(4, 4) pose of a link in the world, the joints at 0, as Pinocchio has it."""
    model = pin.buildModelFromUrdf(str(urdf))
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    pose: np.ndarray = data.oMf[model.getBodyId(link)].homogeneous
    return pose


def world_points(robot: RobotConfig, visual: Visual) -> np.ndarray:
    """(n, 3) points of a shape's surface in the world, the joints at 0."""
    angle, height = np.linspace(0.0, 2 * np.pi, 24), np.linspace(-1.0, 1.0, 7)
    turn, level = (grid.ravel() for grid in np.meshgrid(angle, height))
    if visual.shape == "box":
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        points = 0.5 * corners * np.array(visual.size)
    elif visual.shape == "cylinder":
        radius, length = visual.size
        points = np.stack(
            [radius * np.cos(turn), radius * np.sin(turn), 0.5 * length * level], axis=1
        )
    else:
        ring = np.sqrt(1.0 - level**2)
        points = visual.size[0] * np.stack(
            [ring * np.cos(turn), ring * np.sin(turn), level], axis=1
        )
    pose = link_pose(robot.urdf, visual.link) @ visual.transform_visual_to_link
    placed: np.ndarray = points @ pose[:3, :3].T + pose[:3, 3]
    return placed


def test_every_link_that_has_a_body_is_drawn(robot: RobotConfig) -> None:
    assert {visual.link for visual in load_visuals(robot)} == set(robot.links) - {"base_link"}


def test_it_has_the_size_of_pepper(robot: RobotConfig) -> None:
    """1.21 m high, standing on the floor; 0.48 m wide, the arms aside (NAOqi 2.5, dimensions)."""
    points = np.concatenate([world_points(robot, visual) for visual in load_visuals(robot)])
    assert points[:, 2].min() == pytest.approx(0.0, abs=0.03)
    assert points[:, 2].max() == pytest.approx(1.21, abs=0.03)
    assert np.ptp(points[:, 1]) == pytest.approx(0.48, abs=0.05)


def test_left_and_right_are_alike(robot: RobotConfig) -> None:
    """Seen in a mirror it is the same robot."""

    def places(side: float) -> list[tuple[object, ...]]:
        return sorted(
            (v.shape, *v.size, *np.round(world_points(robot, v).mean(axis=0) * [1.0, side, 1.0], 3))
            for v in load_visuals(robot)
        )

    for one, other in zip(places(1.0), places(-1.0), strict=True):
        assert one[0] == other[0]
        assert np.allclose(one[1:], other[1:], atol=2e-3), (one, other)  # type: ignore[arg-type]


def test_what_is_seen_is_what_collides(robot: RobotConfig) -> None:
    """The surface of each collision shape is near what is drawn of its link."""
    model = pin.buildModelFromUrdf(str(robot.urdf))
    shapes = pin.buildGeomFromUrdf(model, str(robot.urdf), pin.GeometryType.COLLISION)
    by_link: dict[str, list[np.ndarray]] = {}
    for visual in load_visuals(robot):
        pose = visual.transform_visual_to_link
        by_link.setdefault(visual.link, []).append(pose[:3, 3])
    for shape in shapes.geometryObjects:
        link = model.frames[shape.parentFrame].name
        place = (model.frames[shape.parentFrame].placement.inverse() * shape.placement).translation
        nearest = min(float(np.linalg.norm(place - drawn)) for drawn in by_link[link])
        assert nearest < 0.1, (link, place)


def test_other_programs_read_the_same(robot: RobotConfig) -> None:
    """Pinocchio finds as many shapes, in the same places."""
    model = pin.buildModelFromUrdf(str(robot.urdf))
    shapes = pin.buildGeomFromUrdf(model, str(robot.urdf), pin.GeometryType.VISUAL)
    found: dict[str, list[np.ndarray]] = {}
    for shape in shapes.geometryObjects:
        frame = model.frames[shape.parentFrame]
        place = (frame.placement.inverse() * shape.placement).homogeneous
        found.setdefault(frame.name, []).append(place)
    visuals = load_visuals(robot)
    assert len(shapes.geometryObjects) == len(visuals)
    for visual in visuals:
        places = found[visual.link]
        assert any(np.allclose(p, visual.transform_visual_to_link, atol=1e-6) for p in places)


def test_it_has_no_effect_on_physics(robot: RobotConfig) -> None:
    """MuJoCo's model is the same without it."""
    text = robot.urdf.read_text()
    bare = re.sub(r"<visual>.*?</visual>", "", text)
    assert bare != text
    one, other = (mujoco.MjSpec.from_string(t).compile() for t in (text, bare))
    assert one.ngeom == other.ngeom
    for name in ("body_mass", "body_inertia", "geom_size", "geom_pos", "dof_armature"):
        assert np.array_equal(getattr(one, name), getattr(other, name))


def test_it_has_no_effect_on_the_identity_of_a_plant(robot: RobotConfig, tmp_path: Path) -> None:
    """Models stay valid when only the looks change, and not when a mass does."""
    plant = load_plant("nominal", robot)
    text = robot.urdf.read_text()
    identity = plant_hash(plant, robot)
    changed = {
        "looks": re.sub(r"  +<(visual>|material name=.*<color).*\n", "", text),
        "mass": text.replace('<mass value="11.6015"/>', '<mass value="11.6016"/>'),
    }
    found = {}
    for what, content in changed.items():
        assert content != text
        urdf = tmp_path / f"{what}.urdf"
        urdf.write_text(content)
        found[what] = plant_hash(plant, dataclasses.replace(robot, urdf=urdf))
    assert found["looks"] == identity
    assert found["mass"] != identity


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<cylinder", "<cone"),
        ('<material name="white"/>', '<material name="whit"/>'),
        ('rgba="0.94 0.94 0.95 1.0"', 'rgba="0.94 0.94"'),
        ('<material name="white"/>', ""),
    ],
)
def test_a_mistake_is_one_line(old: str, new: str, robot: RobotConfig, tmp_path: Path) -> None:
    text = robot.urdf.read_text()
    start = text.index("<visual>") if old != 'rgba="0.94 0.94 0.95 1.0"' else 0
    place = text.index(old, start)
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(text[:place] + new + text[place + len(old) :])
    with pytest.raises(ConfigError) as error:
        load_visuals(dataclasses.replace(robot, urdf=urdf))
    assert "\n" not in str(error.value)
    assert str(urdf) in str(error.value)
