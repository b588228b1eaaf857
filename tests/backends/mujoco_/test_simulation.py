"""One cycle of the simulated robot: what the boards make of a command, and going on from a saved state."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends.mujoco_.simulation import Simulation
from pepper_driver.config import PlantConfig, load_plant, plant_names
from pepper_driver.config.arrays import FloatArray
from support.plant import INDEX, ONE, ROBOT, STAND, N, hold, plain, rolling, standing

CYCLE = ROBOT.cycle


def target_at(time: float) -> FloatArray:
    """(17,) a motion of all joints, within their ranges."""
    middle = (ROBOT.lower + ROBOT.upper) / 2
    swing = 0.3 * (1 - np.cos(2 * np.pi * np.linspace(0.4, 0.9, N) * time))
    return np.asarray(STAND + swing * (middle - STAND))


def act(simulation: Simulation, tick: int) -> None:
    wheels = np.array([1.0, -2.0, 1.5]) * np.sin(tick / 9)
    simulation.cycle(target_at(tick * CYCLE), ONE, wheels, np.full(3, float(tick % 90 < 70)))


def bits(simulation: Simulation) -> bytes:
    data = simulation.data
    parts: list[Any] = [data.qpos, data.qvel, data.ctrl, simulation.current, simulation.wheels.load]
    parts += [simulation.boards.current, simulation.supply.temperature, simulation.supply.charge]
    return b"".join(np.asarray(part).tobytes() for part in parts)


def trace(simulation: Simulation, first: int, last: int) -> list[bytes]:
    samples = []
    for tick in range(first, last):
        act(simulation, tick)
        samples.append(bits(simulation))
    return samples


def everything(base: str) -> PlantConfig:
    """A plant in which every part of the state matters."""
    plant = load_plant("random", ROBOT, draw=3)
    drives = tuple(
        replace(
            a,
            ki=20.0,
            dead_band=0.001,
            friction=replace(a.friction, breakaway=1.4, load=0.05, ripple=0.1, ripple_count=20.0),
        )
        for a in plant.actuators
    )
    assert base in ("fixed", "rolling")
    return replace(plant, base="fixed" if base == "fixed" else "rolling", actuators=drives)


@pytest.mark.parametrize("base", ["fixed", "rolling"])
def test_the_same_commands_give_the_same_bits(base: str) -> None:
    first, second = standing(everything(base)), standing(everything(base))
    runs = [trace(simulation, 0, 120) for simulation in (first, second)]
    assert runs[0] == runs[1]
    assert len(set(runs[0])) == 120
    first.reset(STAND)
    assert trace(first, 0, 120) == runs[0], "a reset leaves nothing behind"


@pytest.mark.parametrize("base", ["fixed", "rolling"])
def test_two_simulations_in_one_process_do_not_meet(base: str) -> None:
    alone = trace(standing(everything(base)), 0, 80)
    first, second = standing(everything(base)), standing(rolling())
    together = []
    for tick in range(80):
        act(first, tick)
        together.append(bits(first))
        hold(second, 1)
    assert together == alone


@pytest.mark.parametrize("base", ["fixed", "rolling"])
@pytest.mark.parametrize("at", [37, 75])
def test_goes_on_from_a_saved_state_bit_by_bit(base: str, at: int) -> None:
    """In mid-motion; with the wheels powered, and running out."""
    original = standing(everything(base))
    trace(original, 0, at)
    saved = original.save()
    expected = trace(original, at, at + 80)

    original.restore(saved)
    assert trace(original, at, at + 80) == expected
    other = standing(everything(base))
    other.restore(saved)
    assert trace(other, at, at + 80) == expected
    hold(other, 3)
    other.restore(saved)
    assert trace(other, at, at + 80) == expected, "what was saved is a copy"


def test_a_brake_that_holds_is_saved_too() -> None:
    where = STAND + 0.1
    original = standing(plain())
    hold(original, 60, where)
    limp, away = np.zeros(N), STAND + 0.3
    original.cycle(where, limp, np.zeros(3), np.zeros(3))
    saved = original.save()
    runs = []
    for simulation in (original, standing(plain())):
        simulation.restore(saved)
        for _ in range(40):
            simulation.cycle(away, limp, np.zeros(3), np.zeros(3))
        runs.append(bits(simulation))
    assert runs[0] == runs[1]
    legs = [ROBOT.joint_index(name) for name in plain().board.brakes]
    assert np.abs(original.position[legs] - where[legs]).max() < np.radians(1.0)


@pytest.mark.parametrize("name", plant_names())
def test_every_shipped_plant_stands_still(name: str) -> None:
    simulation = standing(load_plant(name, ROBOT), settle=120)
    assert not simulation.model.diverged(simulation.data)
    assert np.abs(simulation.position - STAND).max() < 0.3, "a weak wrist may sag"
    assert np.abs(simulation.data.qvel).max() < 0.5


@pytest.mark.parametrize("speed", [0.4, 1.0])
def test_a_board_with_a_speed_limit_runs_at_it(speed: float) -> None:
    plant = plain()
    limited = replace(plant, targets=replace(plant.targets, speed_limit=speed))
    simulation = standing(limited, settle=20)
    target = STAND.copy()
    target[INDEX] += 1.2
    angles = []
    for _ in range(round(1.6 / speed / CYCLE) + 20):
        hold(simulation, 1, target)
        angles.append(simulation.position[INDEX])
    speeds = np.diff(angles) / CYCLE
    moving = slice(round(0.3 / speed / CYCLE), round(1.0 / speed / CYCLE))
    assert speeds[moving].mean() == pytest.approx(speed, rel=0.02)
    assert np.abs(speeds[moving] / speed - 1).max() < 0.1
    assert angles[-1] == pytest.approx(target[INDEX], abs=0.03)
    free = standing(plant, settle=20)
    hold(free, 10, target)
    assert abs(free.data.qvel[free.model.link_dof[INDEX]]) > 2 * speed


def test_a_speed_limit_leaves_slower_commands_alone() -> None:
    plant = plain()
    runs = []
    for limit in (None, 50.0):
        simulation = standing(replace(plant, targets=replace(plant.targets, speed_limit=limit)))
        runs.append(trace(simulation, 0, 60))
    assert runs[0] == runs[1]


def test_the_board_interpolates_the_command_over_the_cycle(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ramp of commands must not reach the joint as stairs: the current shows the steps."""
    simulation = standing(plain(), settle=5)
    step = 0.5 * plain().physics.timestep  # of 0.5 rad/s
    position, targets, update = STAND.copy(), [], simulation.boards.update

    def spy(target: FloatArray, *rest: FloatArray) -> FloatArray:
        targets.append(float(target[INDEX]))
        return update(target, *rest)

    for tick in range(8):
        if tick == 5:
            monkeypatch.setattr(simulation.boards, "update", spy)
        position[INDEX] += 0.5 * CYCLE
        hold(simulation, 1, position)
    assert len(targets) == 3 * round(CYCLE / plain().physics.timestep)
    np.testing.assert_allclose(np.diff(targets), step, atol=1e-12)
    assert targets[-1] == pytest.approx(position[INDEX])
