"""Friction: Eq. 7 in its two sets, and what a real gear adds. Measured as forces, holding torques and decelerations."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from pepper_driver.config.plant_parts import GapFriction
from support.plant import INDEX, JOINT, Bench, friction, plain, stepping

WIDE = 0.3
"""[rad] half a gap that nothing crosses."""
MOTOR, LINK = 0.5, 0.2
"""[N m] of the sides, where a test needs some."""


def gap(
    motor: float = 0.0,
    link: float = 0.0,
    *,
    viscous: tuple[float, float] = (0.0, 0.0),
    relative: float = 0.0,
    relative_viscous: float = 0.0,
) -> GapFriction:
    return GapFriction(
        motor=motor,
        link=link,
        motor_viscous=viscous[0],
        link_viscous=viscous[1],
        relative=relative,
        relative_viscous=relative_viscous,
    )


def passive(bench: Bench) -> Bench:
    """Without the motor's own drag."""
    bench.model.mj.actuator_biasprm[:, 2] = 0.0
    bench.model.mj.actuator_damping[:] = 0.0
    return bench


def slowdown(bench: Bench, dof: int, seconds: float = 0.002) -> float:
    """[N m] that brakes one side, from the speed it loses."""
    before = bench.data.qvel[dof]
    bench.step(round(seconds / bench.step_time))
    return float(bench.inertia(dof) * (before - bench.data.qvel[dof]) / seconds)


def moves(bench: Bench, dof: int, torque: float, **others: float) -> bool:
    """Return True if a side at rest gives way to ``torque``."""
    bench.data.qfrc_applied[:] = 0.0
    bench.data.qfrc_applied[dof] = torque
    for name, value in others.items():
        bench.data.qfrc_applied[getattr(bench, name)] = value
    before = bench.data.qpos.copy()
    bench.step(round(0.1 / bench.step_time))
    return bool(np.abs(bench.data.qpos - before).max() > 1e-3)


def holding(attempt: Callable[[float], bool], expected: float) -> None:
    """The friction holds 3 % less than ``expected`` and yields to 3 % more, either way."""
    for sign in (1, -1):
        assert not attempt(sign * 0.97 * expected), f"{sign * 0.97 * expected:.4g} N m moved it"
        assert attempt(sign * 1.03 * expected), f"{sign * 1.03 * expected:.4g} N m did not move it"


def test_holds_without_creeping() -> None:
    """Trap: MuJoCo's default friction creeps 15 to 24 mrad/s under a load it should hold."""
    for dof, sides in (("link", (0.0, 0.5)), ("motor", (0.5, 0.0))):
        bench = passive(Bench(plain(half_gap=WIDE, friction=friction(*sides))))
        index = getattr(bench, dof)
        bench.data.qfrc_applied[index] = 0.45
        bench.step(round(1.0 / bench.step_time))
        assert np.abs(bench.angles).max() < 1e-4


def test_opposes_motion_even_in_hard_braking() -> None:
    """Trap: soft friction pushes the wrong way while a joint is braked hard."""
    bench = Bench(plain(half_gap=WIDE, friction=friction(0.0, 0.4)))
    for torque in (0.0, -1.0, -2.0, -4.0):  # none strong enough to reverse the joint in one step
        bench.place(0.0, 0.0, (1.0, 0.0))
        bench.data.qfrc_applied[bench.link] = torque
        bench.friction.update()
        mujoco.mj_forward(bench.model.mj, bench.data)
        assert bench.data.qfrc_constraint[bench.link] == pytest.approx(-0.4, abs=0.02)


def test_inside_the_gap_each_side_has_its_own() -> None:
    apart = gap(MOTOR, LINK, viscous=(0.06, 0.03))
    # In contact it would be ten times as much.
    plant = plain(half_gap=WIDE, friction=friction(5.0, 2.0, viscous=(0.6, 0.3), gap=apart))
    for speed in (1.0, -2.0):
        bench = passive(Bench(plant))
        bench.place(0.0, 0.0, (speed, 0.0))
        braked = abs(slowdown(bench, bench.link))
        assert braked == pytest.approx(LINK + 0.03 * abs(speed), rel=0.03)
        bench.place(0.0, 0.0, (0.0, speed))
        braked = abs(slowdown(bench, bench.motor))
        assert braked == pytest.approx(MOTOR + 0.06 * abs(speed), rel=0.03)


def test_in_contact_the_other_set_holds() -> None:
    touching = friction(MOTOR, LINK, viscous=(0.06, 0.03), gap=gap(0.01, 0.01))
    plant = plain(half_gap=0.01, friction=touching)
    bench, speed = passive(Bench(stepping(plant, 1e-4))), 1.5
    # The link drags the motor along: the teeth carry what the motor's side takes.
    link, motor = bench.inertia(bench.link), bench.inertia(bench.motor)
    total = MOTOR + LINK + 0.09 * speed
    teeth = MOTOR + 0.06 * speed - motor * total / (link + motor)
    assert teeth > 0
    press = teeth / plant.actuator(JOINT).gear_stiffness
    bench.place(0.01 + press, 0.0, (speed, speed))
    seconds = 0.012
    steps = round(seconds / bench.step_time)
    for _ in range(steps):
        bench.step()
        assert not bench.model.in_gap(bench.data)[INDEX]
    lost = np.array([link, motor]) @ (speed - bench.speeds)
    mean = (speed + bench.speeds.mean()) / 2
    assert lost / seconds == pytest.approx(MOTOR + LINK + 0.09 * mean, rel=0.03)


def test_what_both_hold_in_contact() -> None:
    plant = plain(half_gap=0.01, friction=friction(MOTOR, LINK, gap=gap()))
    stiffness = plant.actuator(JOINT).gear_stiffness

    def attempt(torque: float) -> bool:
        bench = passive(Bench(plant))
        # The link gives way until the teeth carry what its own friction does not.
        carried = max(abs(torque) - LINK, 0.0)
        bench.place(float(np.sign(torque)) * (0.01 + carried / stiffness), 0.0)
        return moves(bench, bench.link, torque)

    holding(attempt, MOTOR + LINK)


def test_relative_friction_drags_the_two_sides_at_each_other() -> None:
    """Trap: it must not brake the joint as a whole, nor act on teeth in contact."""
    plant = plain(half_gap=WIDE, friction=friction(gap=gap(relative=0.05, relative_viscous=0.02)))
    bench = passive(Bench(plant))
    bench.place(0.0, 0.0, (1.0, -0.5))
    inertia = np.array([bench.inertia(bench.link), bench.inertia(bench.motor)])
    before, seconds = bench.speeds, 0.02
    bench.step(round(seconds / bench.step_time))
    lost = inertia * (before - bench.speeds)
    assert abs(lost.sum()) < 0.005 * abs(lost[0])
    slip = (before[0] - before[1] + bench.speeds[0] - bench.speeds[1]) / 2
    assert lost[0] / seconds == pytest.approx(0.05 + 0.02 * slip, rel=0.02)

    bench.place(WIDE + 0.01, 0.0, (0.0, 0.0))
    bench.friction.update()
    assert bench.model.mj.tendon_frictionloss[bench.tendon] == 0.0
    assert bench.model.mj.tendon_damping[bench.tendon] == plant.actuator(JOINT).gear_damping


@pytest.mark.parametrize("side", ["motor", "link"])
def test_breakaway_is_more_than_sliding_friction(side: str) -> None:
    coulomb, ratio, stribeck = 0.4, 1.6, 0.05
    sides = (coulomb, 0.0) if side == "motor" else (0.0, coulomb)
    rough = friction(*sides, breakaway=ratio, stribeck_velocity=stribeck)
    plant = plain(half_gap=WIDE, friction=rough)

    def attempt(torque: float) -> bool:
        bench = passive(Bench(plant))
        return moves(bench, getattr(bench, side), torque)

    holding(attempt, ratio * coulomb)
    bench = passive(Bench(plant))
    dof = getattr(bench, side)
    for speed in (2.0, 0.5, 0.2):
        bench.place(0.0, 0.0, (0.0, speed) if side == "motor" else (speed, 0.0))
        braked = slowdown(bench, dof, 2 * bench.step_time)
        mean = (speed + bench.data.qvel[dof]) / 2
        expected = coulomb * (1 + (ratio - 1) / (1 + (mean / stribeck) ** 2))
        assert braked == pytest.approx(expected, rel=0.03)


def test_breakaway_acts_on_the_set_of_the_gap_too() -> None:
    rough = friction(5.0, 5.0, gap=gap(MOTOR, LINK), breakaway=1.5)
    plant = plain(half_gap=WIDE, friction=rough)

    def attempt(torque: float) -> bool:
        bench = passive(Bench(plant))
        return moves(bench, bench.link, torque)

    holding(attempt, 1.5 * LINK)


def test_a_loaded_gear_has_more_friction() -> None:
    """The band in which the motor stays put is as wide as Coulomb friction plus the fraction of the load."""
    coulomb, fraction, load = 0.1, 0.3, 1.5
    plant = plain(half_gap=0.01, friction=friction(coulomb, load=fraction))
    press = 0.01 + load / plant.actuator(JOINT).gear_stiffness
    for direction in (1, -1):

        def attempt(extra: float, direction: int = direction) -> bool:
            bench = passive(Bench(plant))
            bench.place(direction * press, 0.0)
            # The load presses on the link; the motor holds against it, and a little more or less.
            return moves(bench, bench.motor, extra - direction * load, link=direction * load)

        holding(attempt, coulomb + fraction * load)


def test_friction_swells_and_shrinks_over_the_turn() -> None:
    coulomb, ripple, count = 0.4, 0.25, 12.0
    plant = plain(
        half_gap=WIDE, friction=friction(coulomb, LINK, ripple=ripple, ripple_count=count)
    )
    bench = passive(Bench(plant))
    angles = np.linspace(-0.6, 0.6, 25)
    braked = []
    for angle in angles:
        bench.place(angle, angle, (0.0, 2.0))
        braked.append(slowdown(bench, bench.motor, bench.step_time))
    expected = coulomb * (1 + ripple * np.cos(count * angles))
    np.testing.assert_allclose(braked, expected, rtol=0.02)
    bench.place(0.0, 0.0, (2.0, 0.0))
    assert slowdown(bench, bench.link) == pytest.approx(LINK, rel=0.02), "the link's is even"


@pytest.mark.parametrize("warmth", [0.5, 1.0, 2.0])
def test_all_friction_follows_the_warmth_of_the_grease(warmth: float) -> None:
    rough = friction(
        5.0, 5.0, gap=gap(MOTOR, LINK, viscous=(0.06, 0.03)), viscous=(0.6, 0.3), load=0.1
    )
    bench = passive(Bench(plain(half_gap=WIDE, friction=rough), warmth=warmth))
    bench.place(0.0, 0.0, (1.0, 0.0))
    assert slowdown(bench, bench.link) == pytest.approx(warmth * (LINK + 0.03), rel=0.03)
    bench.place(0.0, 0.0, (0.0, 1.0))
    assert slowdown(bench, bench.motor) == pytest.approx(warmth * (MOTOR + 0.06), rel=0.03)

    rubbing = friction(gap=gap(relative=0.05, relative_viscous=0.02))
    bench = passive(Bench(plain(half_gap=WIDE, friction=rubbing), warmth=warmth))
    bench.place(0.0, 0.0, (1.0, -1.0))
    assert slowdown(bench, bench.link) == pytest.approx(warmth * (0.05 + 0.02 * 2), rel=0.03)

    # And in contact, where the two sets are the same: viscous friction is then set only here.
    alike = friction(MOTOR, LINK, viscous=(0.06, 0.03))
    bench = passive(Bench(plain(half_gap=WIDE, friction=alike), warmth=warmth))
    bench.place(0.0, 0.0, (1.0, 0.0))
    assert slowdown(bench, bench.link) == pytest.approx(warmth * (LINK + 0.03), rel=0.03)
