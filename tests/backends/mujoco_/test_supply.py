"""Battery and heat against closed forms, and what they do to the motors."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends.mujoco_.motors import COLDEST_FRICTION, WARMEST_FRICTION, Supply
from pepper_driver.config import PlantConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.plant_parts import Battery
from support.plant import INDEX, JOINT, ONE, ROBOT, STAND, STUCK, N, friction, hold, plain, standing

CYCLE = ROBOT.cycle
RESISTANCE = np.array([ROBOT.motors.of(n).resistance for n in ROBOT.joint_names])


def with_heat(plant: PlantConfig, **changes: Any) -> PlantConfig:
    return replace(plant, heat=replace(plant.heat, **changes))


def with_battery(plant: PlantConfig, **changes: float) -> PlantConfig:
    return replace(plant, battery=replace(plant.battery, **changes))


def rise_of(plant: PlantConfig) -> FloatArray:
    return np.array([plant.heat.rise[ROBOT.motors.joints[n].type] for n in ROBOT.joint_names])


BATTERY = Battery(
    charge=0.6, full_voltage=29.0, empty_voltage=23.0, resistance=0.1, energy=5e4, idle_power=50.0
)


def test_the_charge_falls_by_the_energy_used() -> None:
    supply = Supply(ROBOT, replace(plain(), battery=BATTERY))
    power, cycles = np.linspace(0.0, 200.0, 1000), 1000
    for n in range(cycles):
        supply.step(np.zeros(N), float(power[n]))
    used = np.sum(power + BATTERY.idle_power) * CYCLE
    assert supply.charge == pytest.approx(BATTERY.charge - used / BATTERY.energy, rel=1e-9)


def test_the_voltage_sags_under_load() -> None:
    supply = Supply(ROBOT, replace(plain(), battery=BATTERY))
    open_voltage = 23.0 + 6.0 * BATTERY.charge
    assert supply.voltage == pytest.approx(open_voltage)
    supply.step(np.zeros(N), 250.0)
    current = (250.0 + BATTERY.idle_power) / open_voltage
    assert supply.voltage == pytest.approx(open_voltage - BATTERY.resistance * current, abs=5e-3)
    supply.step(np.zeros(N), 0.0)
    recovered = open_voltage - BATTERY.resistance * BATTERY.idle_power / open_voltage
    assert supply.voltage == pytest.approx(recovered, abs=5e-3)


def test_an_empty_battery_is_empty() -> None:
    supply = Supply(ROBOT, replace(plain(), battery=replace(BATTERY, energy=1.0, resistance=0.0)))
    for _ in range(100):
        supply.step(np.zeros(N), 100.0)
    assert supply.charge == 0.0
    assert supply.voltage == pytest.approx(BATTERY.empty_voltage)


@pytest.mark.parametrize("copper", [0.0, 0.004])
def test_motors_warm_towards_ambient_plus_rise_times_loss(copper: float) -> None:
    """T' = (T_a + rise R (1 + c (T - T_ref)) i^2 - T) / tau, which is linear in T."""
    plant = with_heat(
        plain(), ambient=20.0, start=25.0, reference=30.0, time_constant=2.0, copper=copper
    )
    rise = rise_of(plant)
    square = 20.0 / (rise * RESISTANCE)  # 20 K of warming at the reference
    supply = Supply(ROBOT, plant)
    feedback = rise * RESISTANCE * square * copper
    settled = (20.0 + 20.0 - feedback * 30.0) / (1 - feedback)
    for seconds in (1.2, 12.0):
        supply.reset()
        for _ in range(round(seconds / CYCLE)):
            supply.step(np.sqrt(square), 0.0)
        expected = settled + (25.0 - settled) * np.exp(-seconds * (1 - feedback) / 2.0)
        np.testing.assert_allclose(supply.temperature, expected, rtol=2e-3)


def at(supply: Supply, temperature: float) -> None:
    """Let all motors have this temperature [deg C]."""
    supply.restore({**supply.save(), "temperature": np.full(N, temperature)})


def test_factors_are_linear_around_the_reference_and_bounded() -> None:
    plant = with_heat(
        plain(), start=60.0, reference=40.0, copper=0.004, magnet=-0.001, grease=-0.006
    )
    supply = Supply(ROBOT, plant)
    np.testing.assert_allclose(supply.warmth.copper, 1.08)
    np.testing.assert_allclose(supply.warmth.magnet, 0.98)
    np.testing.assert_allclose(supply.warmth.grease, 0.88)
    at(supply, 40.0)
    for factor in (supply.warmth.copper, supply.warmth.magnet, supply.warmth.grease):
        np.testing.assert_allclose(factor, 1.0)
    at(supply, 1e4)
    np.testing.assert_allclose(supply.warmth.grease, WARMEST_FRICTION)
    assert (supply.warmth.magnet > 0).all()
    at(supply, -1e4)
    np.testing.assert_allclose(supply.warmth.grease, COLDEST_FRICTION)
    assert (supply.warmth.copper > 0).all()


def test_a_reset_gives_a_fresh_battery_and_cold_motors() -> None:
    plant = replace(plain(), battery=BATTERY)
    supply = Supply(ROBOT, plant)
    supply.step(ONE, 500.0)
    supply.reset()
    assert supply.charge == 0.6
    assert supply.voltage == pytest.approx(23.0 + 6.0 * 0.6)
    np.testing.assert_array_equal(supply.temperature, plant.heat.start)


def test_a_hot_winding_stalls_at_less_current() -> None:
    """Stuck, far from its target, no limit but the battery's voltage: V / (R copper)."""
    plant = plain(friction=friction(STUCK, STUCK), current_limit=1e3)
    for above in (0.0, 60.0):
        heat = with_heat(plant, start=plant.heat.reference + above, copper=0.004, time_constant=1e9)
        simulation = standing(heat)
        hold(simulation, 3, STAND + 3.0)
        expected = plant.board.voltage / (RESISTANCE * (1 + 0.004 * above))
        np.testing.assert_allclose(simulation.current, expected, rtol=1e-3)
        constant = np.array(
            [
                ROBOT.motors.of(n).torque_constant * ROBOT.motors.joints[n].ratio
                for n in ROBOT.joint_names
            ]
        )
        torque = simulation.data.qfrc_actuator[simulation.model.motor_dof]
        np.testing.assert_allclose(torque, constant * expected, rtol=1e-3)


def test_a_weak_battery_stalls_at_less_current() -> None:
    plant = plain(friction=friction(STUCK, STUCK), current_limit=1e3)
    volts = 0.8 * plant.board.voltage
    simulation = standing(with_battery(plant, full_voltage=volts, empty_voltage=volts / 2))
    hold(simulation, 3, STAND + 3.0)
    np.testing.assert_allclose(simulation.current, volts / RESISTANCE, rtol=1e-3)


@pytest.mark.parametrize(("below", "holds"), [(0.0, False), (40.0, True)])
def test_cold_grease_holds_more(below: float, holds: bool) -> None:
    """At 40 K below the reference 40 % more friction: 1.2 times the friction does not move it."""
    plant = with_drive_friction(0.3)
    cold = with_heat(plant, start=plant.heat.reference - below, ambient=0.0, grease=-0.01)
    simulation = standing(cold)
    torque = 1.2 * 0.6
    simulation.data.qfrc_applied[simulation.model.link_dof[INDEX]] = torque
    for _ in range(40):
        simulation.cycle(STAND, np.zeros(N), np.zeros(3), np.ones(3))
    drive, moved = plant.actuator(JOINT), abs(simulation.position[INDEX] - STAND[INDEX])
    wound = 2 * drive.half_gap + torque / drive.gear_stiffness
    assert moved < 1.1 * wound if holds else moved > 20 * wound


def with_drive_friction(side: float) -> PlantConfig:
    return plain(friction=friction(side, side), half_gap=1e-4)


def test_work_and_rest_show_in_the_battery() -> None:
    """Held still, the motors take their copper losses; the wheels and the rest take ``idle_power``."""
    plant = plain(friction=friction(STUCK, STUCK))
    simulation = standing(replace(plant, battery=replace(BATTERY, resistance=0.0)))
    offset = 0.25 * np.minimum(plant.per_joint("current_limit", ROBOT) * RESISTANCE, 20.0)
    target = STAND + offset / plant.per_joint("kp", ROBOT)
    hold(simulation, 20, target)
    before = simulation.supply.charge
    hold(simulation, 100, target)
    losses = float(np.sum(RESISTANCE * simulation.current**2))
    assert losses > 1.0
    used = (before - simulation.supply.charge) * BATTERY.energy
    assert used == pytest.approx((losses + BATTERY.idle_power) * 100 * CYCLE, rel=1e-3)


def test_a_motor_at_work_warms() -> None:
    plant = with_heat(
        plain(friction=friction(STUCK, STUCK)), ambient=20.0, start=20.0, time_constant=60.0
    )
    simulation = standing(plant)
    target = STAND.copy()
    target[INDEX] += 0.5
    hold(simulation, 250, target)
    loss = RESISTANCE[INDEX] * simulation.current[INDEX] ** 2
    expected = rise_of(plant)[INDEX] * loss * (1 - np.exp(-3.0 / 60.0))
    warmed = simulation.supply.temperature - 20.0
    assert warmed[INDEX] == pytest.approx(expected, rel=0.02)
    assert np.delete(warmed, INDEX).max() < 0.02 * warmed[INDEX]
