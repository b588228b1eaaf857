"""Structure that gives way beyond the encoder: as much as torque over stiffness, at its natural frequency, unseen."""

from collections.abc import Iterable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from pepper_driver.backends.mujoco_.plant_model import build_model
from pepper_driver.backends.mujoco_.simulation import Simulation
from pepper_driver.config import ConfigError, PlantConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.plant_parts import Flexibility
from support.plant import ROBOT, STAND, Bench, friction, hold, plain, push, standing

ROLL = ROBOT.joint_index("HipRoll")
STIFFNESS = 400.0


def soft(
    plant: PlantConfig, joint: str = "HipRoll", axis: Iterable[float] = (-1, 0, 0), **changes: float
) -> PlantConfig:
    x, y, z = (float(a) for a in axis)
    values = {"stiffness": STIFFNESS, "damping": 5.0, "inertia": 0.03, **changes}
    return replace(plant, flexibilities=(Flexibility(joint=joint, axis=(x, y, z), **values),))


def spring(simulation: Simulation) -> float:
    """[rad] by which the structure has given way."""
    return float(simulation.data.joint("flexibility_0").qpos[0])


def pushed(plant: PlantConfig, force: FloatArray, height: float) -> Simulation:
    """Without gravity, at rest under a force on the torso at a height over the hip."""
    simulation = standing(plant)
    simulation.model.mj.opt.gravity[:] = 0.0
    point = simulation.data.xpos[simulation.model.bodies["torso"]] + [0.0, 0.0, height]
    push(simulation, "torso", force, point)
    hold(simulation, 300)
    return simulation


def test_gives_way_by_torque_over_stiffness_and_the_encoder_does_not_see_it() -> None:
    force, height = 25.0, 0.25
    side = np.array([0.0, force, 0.0])
    stiff, flexible = pushed(plain(), side, height), pushed(soft(plain()), side, height)
    torque = force * height  # about -x, the axis of the hip roll and of the spring
    assert spring(flexible) == pytest.approx(torque / STIFFNESS, rel=0.01)
    seen = flexible.position[ROLL] - STAND[ROLL]
    rough = plain().actuator("HipRoll")
    band = (rough.friction.contact.motor + rough.friction.contact.link) / flexible.boards.stiffness[
        ROLL
    ] + rough.half_gap
    assert seen == pytest.approx(stiff.position[ROLL] - STAND[ROLL], abs=2 * band)

    def lean(simulation: Simulation) -> float:
        rotation = simulation.data.xmat[simulation.model.bodies["torso"]].reshape(3, 3)
        return float(np.arctan2(rotation[2, 1], rotation[2, 2]))

    assert lean(flexible) - lean(stiff) == pytest.approx(
        -spring(flexible) - seen + stiff.position[ROLL] - STAND[ROLL], abs=2e-4
    )


@pytest.mark.parametrize(("joint", "axis"), [("HipRoll", (-2, 0, 0)), ("HeadPitch", (1, 0, 0))])
def test_rings_at_its_natural_frequency(joint: str, axis: tuple[float, float, float]) -> None:
    """Omega = sqrt(k / I), I of all that the spring carries; every joint is stuck."""
    plant = soft(plain(friction=friction(1e4, 1e4)), joint, axis, damping=0.0)
    bench = Bench(plant, joint)
    hinge = bench.model.mj.joint("flexibility_0")
    inertia = bench.inertia(hinge.dofadr[0])
    bench.data.qpos[hinge.qposadr[0]] = 0.02
    angles = []
    period = 2 * np.pi / np.sqrt(STIFFNESS / inertia)
    count = round(8.2 * period / bench.step_time)
    for _ in range(count):
        bench.step()
        angles.append(float(bench.data.qpos[hinge.qposadr[0]]))
    swing = np.array(angles)
    up = np.flatnonzero((swing[:-1] < 0) & (swing[1:] >= 0))
    crossings = up - swing[up] / (swing[up + 1] - swing[up])
    measured = np.diff(crossings).mean() * bench.step_time
    assert len(crossings) >= 7
    assert measured == pytest.approx(period, rel=0.02)
    assert np.abs(swing[-round(period / bench.step_time) :]).max() > 0.015, "nothing damps it"


def test_damping_takes_the_energy() -> None:
    """An amplitude falls by exp(-zeta omega t)."""
    damping = 3.0
    plant = soft(plain(friction=friction(1e4, 1e4)), damping=damping)
    bench = Bench(plant, "HipRoll")
    hinge = bench.model.mj.joint("flexibility_0")
    decay = damping / (2 * bench.inertia(hinge.dofadr[0]))
    bench.data.qpos[hinge.qposadr[0]] = 0.02
    bench.step(round(1.5 / decay / bench.step_time))
    energy = 0.5 * STIFFNESS * bench.data.qpos[hinge.qposadr[0]] ** 2
    energy += 0.5 * bench.inertia(hinge.dofadr[0]) * bench.data.qvel[hinge.dofadr[0]] ** 2
    assert energy == pytest.approx(0.5 * STIFFNESS * 0.02**2 * np.exp(-3.0), rel=0.2)


def test_a_spring_parts_the_joints_and_nothing_else_changes() -> None:
    """A passive hinge lies between two joints in MuJoCo's vectors; a stiff one leaves the motion as it was."""
    rigid, almost = (
        standing(plain()),
        standing(soft(plain(), "HeadYaw", (0, 1, 0), stiffness=2e3, damping=5.0, inertia=0.0)),
    )
    first, last = almost.model.link_qpos[0], almost.model.link_qpos[-1]
    assert last - first > len(ROBOT.joint_names) - 1
    for tick in range(60):
        target = STAND + 0.1 * np.sin(3.0 * tick * ROBOT.cycle)
        for simulation in (rigid, almost):
            hold(simulation, 1, target)
    assert np.abs(rigid.position - STAND).max() > 0.05
    np.testing.assert_allclose(almost.position, rigid.position, atol=2e-3)


def test_axes_of_any_length_mean_the_same() -> None:
    models = [build_model(ROBOT, soft(plain(), axis=(-scale, 0, 0))).mj for scale in (1, 7)]
    np.testing.assert_allclose(models[0].jnt_axis, models[1].jnt_axis)


def test_along_the_joint_there_must_be_an_inertia() -> None:
    with pytest.raises(ConfigError, match=r"flexibilities\.0\.inertia"):
        build_model(ROBOT, soft(plain(), inertia=0.0))
    build_model(ROBOT, soft(plain(), axis=(0, 1, 0), inertia=0.0))
    data = mujoco.MjData(build_model(ROBOT, soft(plain())).mj)
    assert data.qpos.shape == (mujoco.MjData(build_model(ROBOT, plain()).mj).qpos.size + 1,)


def test_a_spring_too_stiff_for_the_step_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"flexibilities\.0 of HipRoll .*: at most 0\.000"):
        build_model(ROBOT, soft(plain(), stiffness=1e6, inertia=0.08))
