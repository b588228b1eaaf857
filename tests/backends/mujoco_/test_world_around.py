"""Worlds around the simulated robot: by name or file, refused when they start inside of it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends import Command, make_backend
from pepper_driver.backends.mujoco_ import MujocoBackend
from pepper_driver.config import ConfigError, UnknownNameError, load_world, world_names
from support.contacts import FIXED, ROBOT, ROLLING, world


@pytest.mark.parametrize("name", world_names())
def test_every_shipped_world_opens_around_either_base(name: str) -> None:
    for plant in (FIXED, ROLLING):
        for posture in ("Stand", "StandInit", "Crouch"):
            with MujocoBackend(ROBOT, plant, world=load_world(name), posture=posture) as backend:
                assert backend.open().tick == 0


def test_the_uri_names_a_world(tmp_path: Path) -> None:
    plain = make_backend("mujoco")
    with_table = make_backend("mujoco://?world=table")
    assert with_table.info.identity == plain.info.identity
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\ndescription: nothing\nobjects: {}\n")
    assert make_backend(f"mujoco://?world={path}").info.identity == plain.info.identity
    with pytest.raises(UnknownNameError, match="did you mean table"):
        make_backend("mujoco://?world=tabel")


def box(**changes: Any) -> dict[str, Any]:
    return {"shape": "box", "size": [0.1, 0.1, 0.1], "mass": 1.0, "position": [1, 0, 1], **changes}


@pytest.mark.parametrize(
    ("objects", "message"),
    [
        ({"box": box(position=[0.1, 0.0, 0.85])}, "torso"),
        ({"box": box(position=[0.1, 0.0, 0.85], mass=None)}, "torso"),
        ({"box": box(position=[0.1, 0.0, 0.85], start=1.0)}, "torso"),
        ({"a": box(), "b": box(position=[1.08, 0.0, 1.0])}, "'[ab]'"),
        ({"box": box(position=[1.0, 0.0, 0.04])}, "floor by 10 mm"),
    ],
)
def test_a_world_inside_the_robot_or_itself_is_refused(
    objects: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        MujocoBackend(ROBOT, FIXED, world=world(**objects))
    assert "objects." in str(caught.value)
    assert "\n" not in str(caught.value)


def test_fixed_objects_may_overlap_to_build_one_thing() -> None:
    parts = {"top": box(mass=None), "leg": box(mass=None, position=[1.0, 0.0, 0.95])}
    MujocoBackend(ROBOT, FIXED, world=world(**parts))


def test_whether_a_world_is_in_the_way_depends_on_the_posture() -> None:
    thing = world(box=box(mass=None, position=[0.3, 0.165, 0.88], size=[0.1, 0.1, 0.1]))
    MujocoBackend(ROBOT, FIXED, world=thing, posture="Stand")
    with pytest.raises(ConfigError, match="another posture"):
        MujocoBackend(ROBOT, FIXED, world=thing, posture="StandZero")


def test_the_thrown_ball_hits_the_chest() -> None:
    backend = MujocoBackend(ROBOT, FIXED, world=load_world("ball"))
    hold = np.clip(backend.open().position, ROBOT.lower, ROBOT.upper)
    backend.activate()
    links: list[tuple[float, str]] = []
    for _ in range(120):
        m = backend.exchange(Command(position=hold, stiffness=np.ones(17), wheel_speed=np.zeros(3)))
        links += [(m.time, contact.link) for contact in backend.truth.contacts]
    time, link = links[0]
    assert link == "torso"
    assert 2.2 < time < 2.4
