"""Capsules against the collision primitives of the URDF, pairs against the postures, mistakes and their messages."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.spatial.transform import Rotation

from pepper_driver.config import (
    Capsule,
    ConfigError,
    RobotConfig,
    load_robot,
    load_self_collision,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.loading import package_file

ROBOT = load_robot()
SETTINGS = load_self_collision(ROBOT)
MIRRORED = {"LBicep": "RBicep", "LForeArm": "RForeArm", "l_wrist": "r_wrist"}
# Of the robot's public module; wrists stand for hands.
PUBLISHED = [
    *[(f"{side}{part}", "Head") for side in "LR" for part in ("Bicep", "ForeArm")],
    *[(f"{side}ForeArm", part) for side in "LR" for part in ("torso", "Pelvis")],
    *[(f"{side}_wrist", part) for side in "lr" for part in ("Head", "torso", "Pelvis")],
    ("l_wrist", "r_wrist"),
]


def primitives(link: str) -> list[tuple[str, dict[str, str], FloatArray, FloatArray]]:
    """Kind, sizes, place and turn of the collision primitives of a link."""
    found = []
    for element in ElementTree.parse(ROBOT.urdf).getroot().iter("link"):
        for collision in element.iter("collision") if element.get("name") == link else ():
            origin, geometry = collision.find("origin"), collision.find("geometry")
            assert origin is not None
            assert geometry is not None
            place = np.array(origin.attrib["xyz"].split(), dtype=float)
            angles = np.array(origin.attrib["rpy"].split(), dtype=float)
            turn = Rotation.from_euler("xyz", angles).as_matrix()
            found.append((geometry[0].tag, dict(geometry[0].attrib), place, turn))
    return found


def surface(link: str, random: np.random.Generator, count: int = 3000) -> FloatArray:
    """Points of the surface of the primitives of a link, in its frame."""
    points = []
    for kind, size, place, turn in primitives(link):
        unit = random.normal(size=(count, 3))
        unit /= np.linalg.norm(unit, axis=1)[:, None]
        if kind == "box":
            half = np.array(size["size"].split(), dtype=float) / 2
            local = unit / np.abs(unit / half).max(axis=1)[:, None]
        elif kind == "sphere":
            local = unit * float(size["radius"])
        else:
            half = np.array([float(size["radius"]), float(size["length"]) / 2])
            scale = np.maximum(
                np.hypot(unit[:, 0], unit[:, 1]) / half[0], np.abs(unit[:, 2]) / half[1]
            )
            local = unit / scale[:, None]
        points.append(local @ turn.T + place)
    return np.concatenate(points)


def outside(points: FloatArray, capsules: tuple[Capsule, ...]) -> FloatArray:
    """Distance of each point from the nearest capsule [m], negative inside."""
    distances = []
    for capsule in capsules:
        start, end = np.array(capsule.start), np.array(capsule.end)
        along = end - start
        fraction = np.clip((points - start) @ along / max(along @ along, 1e-12), 0, 1)
        nearest = start + fraction[:, None] * along
        distances.append(np.linalg.norm(points - nearest, axis=1) - capsule.radius)
    least: FloatArray = np.min(distances, axis=0)
    return least


BARE = {
    "Head": 0.001,
    "Pelvis": 0.001,
    "LBicep": 0.001,
    "LForeArm": 0.001,
    "l_wrist": 0.005,
    "Hip": 0.012,
}


@pytest.mark.parametrize("link", BARE)
def test_capsules_cover_the_primitives_of_the_urdf(link: str) -> None:
    points = surface(link, np.random.default_rng(0))
    assert outside(points, SETTINGS.capsules[link]).max() <= BARE[link]


@pytest.mark.parametrize("link", ["torso", "Tibia"])
def test_capsules_leave_only_sharp_corners_bare(link: str) -> None:
    bare = outside(surface(link, np.random.default_rng(0)), SETTINGS.capsules[link])
    assert bare.max() < 0.05
    assert np.mean(bare > 0.01) < 0.1


@pytest.mark.parametrize(
    ("link", "proud"),
    [("Head", 0.001), ("Pelvis", 0.001), ("LBicep", 0.001), ("torso", 0.012), ("Tibia", 0.018)],
)
def test_capsules_stick_out_of_them_little(link: str, proud: float) -> None:
    random = np.random.default_rng(1)
    worst = 0.0
    shapes = []
    for kind, size, place, turn in primitives(link):
        numbers = {key: np.array(value.split(), dtype=float) for key, value in size.items()}
        shape: Any = (
            coal.Box(*numbers["size"])
            if kind == "box"
            else coal.Sphere(numbers["radius"][0])
            if kind == "sphere"
            else coal.Cylinder(numbers["radius"][0], numbers["length"][0])
        )
        shapes.append((shape, coal.Transform3s(turn, place)))
    for capsule in SETTINGS.capsules[link]:
        unit = random.normal(size=(300, 3))
        unit /= np.linalg.norm(unit, axis=1)[:, None]
        for end in (capsule.start, capsule.end):
            for point in np.array(end) + capsule.radius * unit:
                probe = (coal.Sphere(1e-6), coal.Transform3s(np.eye(3), point))
                gap = min(
                    coal.distance(*probe, *shape, coal.DistanceRequest(), coal.DistanceResult())
                    for shape in shapes
                )
                worst = max(worst, gap)
    assert worst <= proud


def test_hands_cover_the_open_fingers() -> None:
    # Ends of the box around the public meshes of open fingers, in its middle: x 0.139, z -0.0585 and 0.0125.
    tips = np.array([[0.137, 0.0, -0.02], [0.09, 0.0, -0.0585], [0.09, 0.0, 0.0125]])
    assert outside(tips, SETTINGS.capsules["l_wrist"]).max() <= 0.0


def test_arms_are_mirrored() -> None:
    for left, right in MIRRORED.items():
        for one, other in zip(SETTINGS.capsules[left], SETTINGS.capsules[right], strict=True):
            assert one.radius == other.radius
            for a, b in ((one.start, other.start), (one.end, other.end)):
                assert a == (b[0], -b[1], b[2])


def test_published_pairs_are_there() -> None:
    given = {frozenset(pair) for pair in SETTINGS.pairs}
    assert len(PUBLISHED) == 15
    assert {frozenset(pair) for pair in PUBLISHED} <= given


def link_distances(robot: RobotConfig, posture: FloatArray) -> list[float]:
    """Distances of all pairs of capsules, each by a call of its own to coal."""
    model = pin.buildModelFromUrdf(str(robot.urdf))
    data = model.createData()
    q = pin.neutral(model)
    for name, angle in zip(robot.joint_names, posture, strict=True):
        q[model.joints[model.getJointId(name)].idx_q] = angle
    pin.framesForwardKinematics(model, data, q)

    def placed(link: str, capsule: Capsule) -> tuple[Any, Any]:
        start, end = (
            data.oMf[model.getFrameId(link)].act(np.array(p)) for p in (capsule.start, capsule.end)
        )
        length = float(np.linalg.norm(end - start))
        axis = (end - start) / length if length else np.array([0.0, 0.0, 1.0])
        turn = Rotation.align_vectors([axis], [[0.0, 0.0, 1.0]])[0].as_matrix()
        return coal.Capsule(capsule.radius, length), coal.Transform3s(turn, (start + end) / 2)

    return [
        coal.distance(
            *placed(a, one), *placed(b, other), coal.DistanceRequest(), coal.DistanceResult()
        )
        for a, b in SETTINGS.pairs
        for one in SETTINGS.capsules[a]
        for other in SETTINGS.capsules[b]
    ]


@pytest.mark.parametrize("posture", sorted(ROBOT.postures))
def test_postures_keep_the_security_distance(posture: str) -> None:
    distances = link_distances(ROBOT, ROBOT.posture(posture))
    assert min(distances) > SETTINGS.security_distance


def test_pairs_are_mostly_free_so_none_overlaps_by_construction() -> None:
    random = np.random.default_rng(2)
    postures = [random.uniform(ROBOT.lower, ROBOT.upper) for _ in range(60)]
    overlapping = np.mean([np.array(link_distances(ROBOT, p)) < 0 for p in postures], axis=0)
    assert overlapping.max() < 0.2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"interaction_distance": 0.01}, "not above the security distance"),
        ({"security_distance": -0.01}, "security_distance"),
        ({"pairs": [["l_wrist", "Hed"]]}, "did you mean Head?"),
        ({"pairs": [["l_wrist", "Neck"]]}, "no capsules for link 'Neck'"),
        ({"pairs": [["Head", "Head"]]}, "apart from itself"),
        ({"pairs": [["Head", "l_wrist"], ["l_wrist", "Head"]]}, "given twice"),
        (
            {"capsules": {"Hed": [{"start": [0, 0, 0], "end": [0, 0, 0], "radius": 1}]}},
            "unknown link 'Hed'",
        ),
        ({"capsules": {"Head": []}}, "capsules.Head"),
        (
            {"capsules": {"Head": [{"start": [0.0, 0.0], "end": [0.0, 0.0, 0.0], "radius": 1.0}]}},
            "start",
        ),
        ({"capsules": {"Head": [{"begin": [0.0, 0.0, 0.0]}]}}, "unknown key"),
        ({"speed": 1.0}, "unknown key 'speed'"),
    ],
)
def test_mistakes_name_file_and_key(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    data = yaml.safe_load(package_file("self_collision.yaml").read_text())
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump(data | change))
    with pytest.raises(ConfigError) as error:
        load_self_collision(ROBOT, file)
    assert str(file) in str(error.value)
    assert message in str(error.value)
