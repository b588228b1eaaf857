"""Real contact with objects: measured forces against momentum, weight and MuJoCo's own constraint rows."""

from typing import Any

import mujoco
import numpy as np
import pytest

from pepper_driver.backends import Command
from pepper_driver.backends.mujoco_.plant_model import PlantModel
from pepper_driver.backends.mujoco_.simulation import Simulation
from pepper_driver.config import load_world
from pepper_driver.config.arrays import FloatArray
from support.contacts import CYCLE, FIXED, ROBOT, ROLLING, Robot, world
from support.pinocchio_robot import PinocchioRobot

STAND = ROBOT.posture("Stand")
G = 9.81


def ball(**changes: Any) -> dict[str, Any]:
    return {
        "shape": "sphere",
        "size": [0.1],
        "mass": 0.5,
        "position": [0.5, 0.0, 0.8],
        "velocity": [-3.0, 0.0, 0.5],
        **changes,
    }


def step_freely(simulation: Simulation) -> None:
    simulation.cycle(STAND, np.ones(17), np.zeros(3), np.ones(3))


@pytest.mark.parametrize("base", [FIXED, ROLLING], ids=["fixed", "rolling"])
def test_the_ball_loses_the_momentum_that_the_robot_gets(base: Any) -> None:
    robot = Robot(base, world(ball=ball(start=1.0)))
    mj, data = robot.mujoco
    dof = mj.joint("object_ball").dofadr[0]
    impulse, time, before = np.zeros(3), robot.time, np.array([-3.0, 0.0, 0.5])
    while robot.time < 1.3:
        robot.run(CYCLE)
        impulse += CYCLE * sum(
            (c.force for c in robot.truth.contacts if c.object == "ball"), np.zeros(3)
        )
    after = np.array(data.qvel[dof : dof + 3])
    fallen = np.array([0.0, 0.0, -G]) * (robot.time - 1.0)
    assert time <= 1.01
    assert after[0] > 0.0, "it must bounce off, or nothing is tested"
    np.testing.assert_allclose(impulse, 0.5 * (before + fallen - after), rtol=0.01, atol=1e-6)


def test_an_object_that_waits_hangs_still_and_then_flies_as_thrown() -> None:
    thing = ball(start=1.5, position=[2.0, 0.3, 1.5], orientation=[0.1, 0.2, 0.3])
    robot = Robot(FIXED, world(ball=thing))
    mj, data = robot.mujoco
    robot.run(0.48)
    assert robot.time == pytest.approx(83 * CYCLE + 40 * CYCLE)
    np.testing.assert_allclose(data.body("object_ball").xpos, thing["position"], atol=1e-12)
    robot.run(0.36)
    flown, h = robot.time - 1.5, float(mj.opt.timestep)
    steps = round(flown / h)
    falling = -0.5 * G * h**2 * steps * (steps + 1)  # as a semi-implicit step falls
    expected = np.array(thing["position"]) + np.array(thing["velocity"]) * flown
    expected[2] += falling
    address = mj.joint("object_ball").qposadr[0]
    np.testing.assert_allclose(data.qpos[address : address + 3], expected, atol=1e-9)


def test_a_thing_that_lies_on_the_head_weighs_what_it_weighs() -> None:
    robot = Robot(
        FIXED,
        world(
            plate={
                "shape": "box",
                "size": [0.1, 0.1, 0.02],
                "mass": 1.0,
                "position": [-0.033, 0.0, 1.25],
                "friction": 1.0,
            }
        ),
    )
    forces = []
    for _ in range(15):
        robot.run(CYCLE)
        forces += [c.force[2] for c in robot.truth.contacts if c.link == "Head"]
    if not forces:
        pytest.fail("the plate fell next to the head")
    assert np.mean(forces) == pytest.approx(-G, rel=0.05)


def raise_arm(robot: Robot, seconds: float) -> None:
    """Raise the left arm forward at 0.5 rad/s."""
    pitch = ROBOT.joint_index("LShoulderPitch")
    for _ in range(round(seconds / CYCLE)):
        robot.hold[pitch] -= 0.5 * CYCLE
        robot.exchange(Command(position=robot.hold, stiffness=np.ones(17), wheel_speed=np.zeros(3)))


def test_the_arm_meets_the_edge_of_the_table() -> None:
    robot = Robot(FIXED, load_world("table"))
    assert not robot.truth.contacts
    raise_arm(robot, 1.6)
    (contact,) = robot.truth.contacts
    assert (contact.kind, contact.object) == ("object", "top")
    assert contact.link in ("l_wrist", "LForeArm")
    assert contact.point[0] == pytest.approx(0.24, abs=0.01)
    assert contact.point[2] == pytest.approx(0.705, abs=0.02)
    assert contact.force[2] < -2.0, "the table's underside pushes the arm down"
    assert contact.torque[ROBOT.joint_index("LShoulderPitch")] > 0.5
    assert contact.peak >= np.linalg.norm(contact.force)
    pose = PinocchioRobot().link_pose(contact.link, robot.truth.position)
    point = np.linalg.inv(pose) @ [*contact.point, 1.0]
    jacobian = PinocchioRobot().point_jacobian(contact.link, point[:3], robot.truth.position)
    np.testing.assert_allclose(contact.torque, jacobian.T @ contact.force, atol=0.02)


def contact_rows(model: PlantModel, data: mujoco.MjData) -> FloatArray:
    """(nv,) efc_J^T efc_force of the rows of all contacts that are no floor's."""
    mj, torque = model.mj, np.zeros(model.mj.nv)
    full = np.array(data.efc_J).reshape(data.nefc, mj.nv)
    for contact in data.contact:
        if contact.efc_address >= 0 and "floor" not in (
            mj.geom(contact.geom1).name,
            mj.geom(contact.geom2).name,
        ):
            rows = slice(contact.efc_address, contact.efc_address + 2 * (contact.dim - 1))
            torque += full[rows].T @ data.efc_force[rows]
    return torque[model.link_dof]


@pytest.mark.parametrize("base", [FIXED, ROLLING], ids=["fixed", "rolling"])
def test_the_torque_is_that_of_the_contact_rows(base: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """An independent way to the same torque, through the solver's own rows; two things touch at once."""
    things = world(
        ball=ball(start=0.012, position=[0.31, 0.0, 0.8]),
        wall={"shape": "box", "size": [0.1, 1, 1], "mass": None, "position": [-0.3, 0, 0.4]},
        brick={
            "shape": "capsule",
            "size": [0.03, 0.1],
            "mass": 1.0,
            "position": [0.0, 0.0, 1.3],
            "orientation": [0.0, 1.57, 0.0],
        },
    )
    simulation = Simulation(ROBOT, base, things)
    simulation.reset(STAND)
    torques: list[FloatArray] = []
    step = simulation.contacts.step

    def spy() -> None:
        step()
        torques.append(contact_rows(simulation.model, simulation.data))

    monkeypatch.setattr(simulation.contacts, "step", spy)
    touched: set[str | None] = set()
    for _ in range(25):
        torques.clear()
        step_freely(simulation)
        touched |= {contact.object for contact in simulation.contacts.acted}
        np.testing.assert_allclose(simulation.contacts.torque, np.mean(torques, axis=0), atol=1e-10)
        np.testing.assert_allclose(
            simulation.contacts.peak_torque, np.abs(torques).max(axis=0), atol=1e-10
        )
    assert {"ball", "brick"} <= touched


def test_the_floor_is_no_contact() -> None:
    robot = Robot(ROLLING, world(stone=ball(position=[1.0, 0.0, 0.1], velocity=[0.0, 0.0, 0.0])))
    robot.run(0.5)
    assert robot.truth.wheel_load.sum() > 200.0
    assert robot.truth.contacts == ()
    height = robot.mujoco[1].body("object_stone").xpos[2]
    assert height == pytest.approx(0.1, abs=0.003), "the stone lies on the floor"


def test_friction_is_that_of_the_object() -> None:
    """Whatever it slides on: v^2 / (2 mu g)."""
    box = ball(shape="box", size=[0.2, 0.2, 0.05], position=[1, 0, 0.025], velocity=[1.0, 0.0, 0.0])
    robot = Robot(FIXED, world(box={**box, "friction": 0.2, "start": 1.0}))
    robot.run(0.8)
    slid = robot.mujoco[1].body("object_box").xpos[0] - 1.0
    assert slid == pytest.approx(1.0 / (2 * 0.2 * G), rel=0.05)


def test_a_fixed_robot_has_a_floor_for_things_only() -> None:
    robot = Robot(FIXED, world(stone=ball(position=[1.0, 0.0, 0.1], velocity=[0.0, 0.0, 0.0])))
    robot.run(0.5)
    assert robot.mujoco[1].body("object_stone").xpos[2] == pytest.approx(0.1, abs=0.003)
    assert robot.truth.contacts == ()


def test_a_world_far_away_does_not_change_the_robot() -> None:
    alone, accompanied = (
        Robot(FIXED),
        Robot(FIXED, world(far=ball(mass=None, velocity=[0, 0, 0], position=[9, 9, 1]))),
    )
    for robot in (alone, accompanied):
        robot.push("LForeArm", np.array([0.0, 8.0, 0.0]), duration=0.5)
    assert [m.position.tobytes() for m in alone.run(0.5)] == [
        m.position.tobytes() for m in accompanied.run(0.5)
    ]
