"""The drives against textbook physics and an independent integration of the paper's Eq. 5 to 8."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pepper_driver.config import PlantConfig, load_robot
from pepper_driver.config.arrays import FloatArray
from support.plant import (
    INDEX,
    JOINT,
    ONE,
    ROBOT,
    STAND,
    Bench,
    friction,
    plain,
    standing,
    stepping,
    with_drive,
)

MOTOR, RATIO = ROBOT.motors.of(JOINT), ROBOT.motors.joints[JOINT].ratio
TORQUE_CONSTANT = MOTOR.torque_constant * RATIO  # [N m/A] at the joint
WIDE = 5.0
"""[rad] half a gap that nothing crosses."""
FRICTIONLESS = {"friction": friction(), "motor_damping": 0.0}


def swing(time: float) -> float:
    """A voltage with reversals that throw the joint through its gap."""
    return float(2.5 * np.sin(2 * np.pi * 0.9 * time) + 2.0 * np.sin(2 * np.pi * 2.3 * time))


def simulate(
    bench: Bench, seconds: float, *, ungated: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """(n, 2) link and motor angle, (n,) in gap, under ``swing`` held for each step.

    ``ungated`` is a damping of the teeth that acts in the gap too: what the plant must not do.
    """
    steps = round(seconds / bench.step_time)
    angles, gap = np.zeros((steps, 2)), np.zeros(steps)
    for n in range(steps):
        bench.data.ctrl[bench.actuator] = swing(n * bench.step_time)
        if ungated is None:
            bench.step()
        else:
            bench.friction.update()
            bench.model.mj.tendon_damping[bench.tendon] = ungated
            mujoco.mj_step(bench.model.mj, bench.data)
        angles[n] = bench.angles
        gap[n] = bench.model.in_gap(bench.data)[INDEX]
    return angles, gap


def reference(plant: PlantConfig, inertia: float, seconds: float) -> FloatArray:
    """(n, 2) the two-body equations by scipy: link and motor angle at the end of each step."""
    a, h = plant.actuator(JOINT), plant.physics.timestep
    rough = a.friction.contact
    reflected = RATIO**2 * MOTOR.rotor_inertia + 1e-9

    def rates(time: float, y: FloatArray, voltage: float) -> list[float]:
        q, theta, dq, dtheta = y
        phi, dphi = q - theta, dq - dtheta
        tooth = 0.0
        if abs(phi) > a.half_gap:
            tooth = -a.gear_stiffness * (phi - np.sign(phi) * a.half_gap) - a.gear_damping * dphi
        current = (voltage - TORQUE_CONSTANT * dtheta) / MOTOR.resistance
        drive = TORQUE_CONSTANT * current - RATIO**2 * a.motor_damping * dtheta
        on_link = rough.link_viscous * dq + rough.link * np.tanh(dq / 1e-3)
        on_motor = rough.motor_viscous * dtheta + rough.motor * np.tanh(dtheta / 1e-3)
        return [dq, dtheta, (tooth - on_link) / inertia, (drive - tooth - on_motor) / reflected]

    y, out = np.zeros(4), []
    for n in range(round(seconds / h)):
        solution = solve_ivp(
            rates,
            (0, h),
            y,
            args=(swing(n * h),),
            method="LSODA",
            rtol=1e-6,
            atol=1e-9,
            max_step=h / 4,
        )
        y = solution.y[:, -1]
        out.append(y[:2])
    return np.array(out)


def test_agrees_with_an_independent_integration() -> None:
    """Trap: damping that is not switched off in the gap drags there; the trajectory shows it."""
    plant = plain(half_gap=0.01, friction=friction(0.3, 0.1, viscous=(0.02, 0.02)))
    bench = Bench(plant)
    truth = reference(plant, bench.inertia(bench.link), 1.5)
    angles, gap = simulate(bench, 1.5)
    assert gap.mean() > 0.1, "the run must pass through the gap to mean anything"
    error = np.sqrt(np.mean((angles - truth) ** 2))
    assert error < 5e-4
    wrong, _ = simulate(Bench(plant), 1.5, ungated=plant.actuator(JOINT).gear_damping)
    assert np.sqrt(np.mean((wrong - truth) ** 2)) > 3 * error, "ungated damping must differ"


def test_nothing_drags_inside_the_gap() -> None:
    """Trap: MuJoCo's damping of a tendon knows no dead band."""
    bench = Bench(plain(half_gap=0.1, **FRICTIONLESS))
    bench.place(0.0, 0.0, (0.4, 0.0))
    bench.step(round(0.2 / bench.step_time))
    np.testing.assert_allclose(bench.speeds, [0.4, 0.0], atol=1e-6)
    bench.step(round(0.2 / bench.step_time))  # by now the teeth have met
    assert bench.speeds[0] < 0.39
    assert bench.angles[1] > 1e-4


def test_teeth_conserve_momentum_and_take_energy_only_in_contact() -> None:
    # MuJoCo's implicit tendon damping takes a few per cent of the impulse at 1 ms, less the finer the step.
    bench = Bench(stepping(plain(half_gap=0.02, **FRICTIONLESS), 1e-4))
    bench.model.mj.actuator_biasprm[:, 2] = 0.0  # no back-EMF
    inertia = np.array([bench.inertia(bench.link), bench.inertia(bench.motor)])
    bench.place(0.0, 0.0, (0.5, 0.0))
    momentum = []
    for _ in range(round(0.5 / bench.step_time)):
        bench.step()
        momentum.append(inertia @ bench.speeds)
    np.testing.assert_allclose(momentum, 0.5 * inertia[0], rtol=1e-2)
    energy = 0.5 * inertia @ bench.speeds**2
    assert 0.5 * (momentum[0] ** 2) / inertia.sum() <= energy < 0.9 * 0.125 * inertia[0]


def test_teeth_push_back_from_the_edge_of_the_gap() -> None:
    """Trap: Eq. 8 as printed, K (phi + alpha) for phi >= alpha, would jump by 2 alpha K at the edge."""
    plant = plain(half_gap=0.01, gear_damping=0.0, **FRICTIONLESS)
    bench, stiffness = Bench(plant), plant.actuator(JOINT).gear_stiffness
    for phi in (-0.013, -0.0101, -0.0099, 0.0, 0.0099, 0.0101, 0.013):
        bench.place(phi, 0.0)
        bench.friction.update()
        mujoco.mj_forward(bench.model.mj, bench.data)
        expected = -stiffness * np.sign(phi) * max(abs(phi) - 0.01, 0.0)
        assert bench.data.qfrc_passive[bench.link] == pytest.approx(expected, abs=1e-9)
        assert bench.data.qfrc_passive[bench.motor] == pytest.approx(-expected, abs=1e-9)


def test_the_gap_is_that_of_the_state_after_the_step() -> None:
    """Trap: after a step MuJoCo's tendon lengths still belong to the state before it."""
    bench = Bench(plain(half_gap=0.01, **FRICTIONLESS))
    bench.place(0.0, 0.0, (0.5, 0.0))
    stale = []
    for _ in range(60):
        bench.step()
        phi = bench.angles[0] - bench.angles[1]
        assert bench.model.in_gap(bench.data)[INDEX] == (abs(phi) <= 0.01)
        stale.append((abs(bench.data.ten_length[bench.tendon]) <= 0.01) != (abs(phi) <= 0.01))
    assert any(stale), "the run must cross the edge of the gap to mean anything"


def test_motor_reaches_its_no_load_speed_and_stall_torque() -> None:
    bench = Bench(plain(half_gap=WIDE, **FRICTIONLESS))
    rated = MOTOR.torque_constant * MOTOR.no_load_speed  # [V] the documented speed belongs to
    bench.data.ctrl[bench.actuator] = rated
    mujoco.mj_forward(bench.model.mj, bench.data)
    # At rest: the stall torque through the gear.
    assert bench.data.qfrc_actuator[bench.motor] == pytest.approx(
        MOTOR.stall_torque * RATIO, rel=2e-3
    )
    bench.step(round(0.4 / bench.step_time))
    assert bench.speeds[1] == pytest.approx(MOTOR.no_load_speed / RATIO, rel=1e-3)


def test_damping_of_the_motor_takes_from_its_no_load_speed() -> None:
    damping, voltage = 2e-5, 10.0  # [N m s/rad] at the shaft
    bench = Bench(plain(half_gap=WIDE, friction=friction(), motor_damping=damping))
    bench.data.ctrl[bench.actuator] = voltage
    bench.step(round(0.3 / bench.step_time))
    shaft = voltage / (MOTOR.torque_constant + damping * MOTOR.resistance / MOTOR.torque_constant)
    assert abs(bench.angles[1]) < WIDE
    assert bench.speeds[1] == pytest.approx(shaft / RATIO, rel=1e-3)


def test_motor_torque_is_that_of_the_current_the_board_reckons(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two places know the motor, MuJoCo's actuator and the board: hot motors, on the move, they agree."""
    plant = plain()
    heat = replace(plant.heat, start=plant.heat.reference + 40.0, copper=0.004, magnet=-0.002)
    simulation = standing(replace(plant, heat=heat))
    speeds, update = [], simulation.boards.update

    def spy(target: FloatArray, position: FloatArray, velocity: FloatArray) -> FloatArray:
        speeds.append(velocity.copy())
        return update(target, position, velocity)

    monkeypatch.setattr(simulation.boards, "update", spy)
    simulation.cycle(STAND + 0.2, ONE, np.zeros(3), np.ones(3))
    torque = simulation.data.qfrc_actuator[simulation.model.motor_dof]
    names = ROBOT.joint_names
    constant = [ROBOT.motors.of(n).torque_constant * ROBOT.motors.joints[n].ratio for n in names]
    expected = (1 - 0.002 * 40.0) * np.array(constant) * simulation.boards.current
    assert np.abs(expected).min() > 0.01
    np.testing.assert_allclose(torque, expected, rtol=1e-9)


def test_hands_carry_the_fingers_inertia() -> None:
    bench = Bench(plain(), "LHand")
    assert bench.inertia(bench.link) == pytest.approx(ROBOT.hands.finger_inertia, rel=1e-4)
    # and the wrist keeps the inertia that is documented for it
    wrist = Bench(plain(), "LWristYaw")
    assert wrist.inertia(wrist.link) == pytest.approx(0.000151643, rel=1e-2)


def test_motors_carry_their_rotor_through_the_gear() -> None:
    robot = load_robot()
    for name in ("KneePitch", JOINT, "LHand"):
        bench = Bench(plain(), name)
        ratio = robot.motors.joints[name].ratio
        assert bench.inertia(bench.motor) == pytest.approx(
            robot.motors.of(name).rotor_inertia * ratio**2, rel=1e-3
        )


@pytest.mark.parametrize("efficiency", [1.0, 0.5, 0.34])
def test_a_gear_that_passes_on_less_takes_more_current_for_the_same_weight(
    efficiency: float,
) -> None:
    """I = tau / (eta N Kt), and the error tau / (eta K): both readings of a recorded droop agree on this."""
    joint = "RShoulderRoll"
    smooth = replace(plain().actuator(joint).friction, load=0.0)
    free = replace(smooth, contact=replace(smooth.contact, motor=0.0, link=0.0))
    free = replace(free, gap=replace(smooth.gap, motor=0.0, link=0.0))
    plant = with_drive(plain(), [joint], efficiency=efficiency, friction=free)
    index = ROBOT.joint_index(joint)
    posture = STAND.copy()
    posture[index] = -1.0
    simulation = standing(plant, posture, settle=400)
    load = float(simulation.data.qfrc_bias[simulation.model.link_dof[index]])
    assert abs(load) > 0.5
    constant = ROBOT.motors.joint_torque_constant(joint)
    assert simulation.current[index] == pytest.approx(abs(load) / constant / efficiency, rel=0.03)
    full = plain().actuator(joint).kp * constant / ROBOT.motors.of(joint).resistance
    assert simulation.boards.stiffness[index] == pytest.approx(efficiency * full)
    error = posture[index] - simulation.position[index]
    assert error == pytest.approx(load / (efficiency * full), abs=np.radians(0.1))


def test_the_speed_of_a_free_motor_does_not_depend_on_the_efficiency() -> None:
    """Back-EMF is in the motor, before the gear: at no load w = u / (N Ke)."""
    speeds = []
    for efficiency in (1.0, 0.4):
        bench = Bench(plain(efficiency=efficiency, **FRICTIONLESS))
        bench.data.ctrl[bench.actuator] = 4.0
        bench.step(400)
        speeds.append(float(bench.speeds[0]))
    np.testing.assert_allclose(speeds, 4.0 / TORQUE_CONSTANT, rtol=0.02)


@pytest.mark.parametrize("factor", [1.5, 2.2])
def test_a_heavier_arm_takes_current_in_proportion(factor: float) -> None:
    joint = "RShoulderRoll"
    index = ROBOT.joint_index(joint)
    links = ("RShoulder", "RBicep", "RElbow", "RForeArm", "r_wrist", "r_gripper")
    posture = STAND.copy()
    posture[index] = -1.0
    loads = []
    for mass in (1.0, factor):
        body = replace(plain().body, masses=dict.fromkeys(links, mass))
        simulation = standing(replace(plain(), body=body), posture)
        mujoco.mj_forward(simulation.model.mj, simulation.data)
        loads.append(float(simulation.data.qfrc_bias[simulation.model.link_dof[index]]))
    # Fingers and thumbs keep their own mass, which is next to nothing.
    assert loads[1] / loads[0] == pytest.approx(factor, rel=0.02)


@pytest.mark.parametrize("lead", [0.002, 0.018])
def test_a_derivative_on_the_error_leads(lead: float) -> None:
    """q / x = (Td s + 1) / (J/K s2 + (D/K + Td) s + 1), with Td = kd / kp and s = i w, at 3 Hz."""
    plant = plain(**FRICTIONLESS, half_gap=1e-4)
    plant = replace(plant, board=replace(plant.board, encoder_bits=24))
    kp = plant.actuator(JOINT).kp
    simulation = standing(with_drive(plant, [JOINT], kd=lead * kp), settle=5)
    cycle, rate, size = ROBOT.cycle, 2 * np.pi * 3.0, 0.1
    goal, times, angles = STAND.copy(), [], []
    for tick in range(1, round(4.0 / cycle) + 1):
        goal[INDEX] = STAND[INDEX] + size * np.sin(rate * tick * cycle)
        simulation.cycle(goal, ONE, np.zeros(3), np.ones(3))
        times.append(tick * cycle)
        angles.append(float(simulation.position[INDEX] - STAND[INDEX]))
    late = np.array(times) > 2.0
    basis = np.exp(-1j * rate * np.array(times))[late]
    measured = 2j * np.mean(np.array(angles)[late] * basis) / size
    stiffness = kp * TORQUE_CONSTANT / MOTOR.resistance
    mass = np.zeros((simulation.model.mj.nv,) * 2)
    mujoco.mj_fullM(simulation.model.mj, simulation.data, mass)
    link, motor = simulation.model.link_dof[INDEX], simulation.model.motor_dof[INDEX]
    inertia = 1 / np.linalg.inv(mass)[link, link] + mass[motor, motor]
    drag = TORQUE_CONSTANT**2 / MOTOR.resistance
    s = 1j * rate
    # The command is a line over each cycle, and the derivative a low-pass of 4 ms.
    smooth = lead / (1 + s * plant.board.derivative_time)
    expected = (1 + s * smooth) / (
        inertia / stiffness * s**2 + (drag / stiffness) * s + s * smooth + 1
    )
    assert np.abs(measured - expected) < 0.03
    without = 1 / (inertia / stiffness * s**2 + drag / stiffness * s + 1)
    ahead = rate * lead * 0.3  # a third of what the zero at -1 / Td alone would turn it
    assert np.angle(measured / without) > ahead
