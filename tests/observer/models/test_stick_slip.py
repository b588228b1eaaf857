"""Stick-slip model, against closed forms and against a joint integrated in small steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from pepper_driver.config import PepperError
from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer.models.stick_slip import (
    NO_LIMIT,
    PARAMETERS,
    StickSlipError,
    StickSlipModel,
    StickSlipParameters,
)
from support.examples import examples
from support.fusion import STICK_SLIP, Motion, drive, swing
from support.observer import CYCLE

SMOOTH = replace(STICK_SLIP, friction=0.0, load_friction=0.0, breakaway=1.0)


def play(
    parameters: StickSlipParameters,
    target: FloatArray,
    load: FloatArray | float = 0.0,
    *,
    start: float | None = None,
    cycle: float = CYCLE,
) -> FloatArray:
    """(n,) positions of one model [rad]."""
    model = StickSlipModel.from_parameters([parameters], cycle)
    model.start(np.array([target[0] if start is None else start]), target[:1])
    loads = np.broadcast_to(load, len(target))
    rows = [
        model.step(np.array([x]), np.array([tau]))["position"]
        for x, tau in zip(target, loads, strict=True)
    ]
    return np.concatenate(rows)


def ramp(velocity: float, seconds: float = 3.0) -> FloatArray:
    return np.asarray(velocity * CYCLE * np.arange(round(seconds / CYCLE)), dtype=np.float64)


@pytest.mark.parametrize("velocity", [0.4, -0.7])
@pytest.mark.parametrize("load", [0.0, 2.0, -3.0])
@pytest.mark.parametrize(
    "changes",
    [{}, {"offset": 0.003}, {"dead_band": 0.004}, {"transport": 0.6}, {"transport": 1.7}],
)
def test_at_constant_velocity_the_error_is_lag_friction_and_load(
    velocity: float, load: float, changes: dict[str, float]
) -> None:
    parameters = replace(STICK_SLIP, **changes)
    target = ramp(velocity)
    error = (target - play(parameters, target, load))[-1]
    load_angle = parameters.load_gain * load + parameters.offset
    friction = parameters.friction + parameters.load_friction * abs(load_angle)
    motor = parameters.lag * velocity + np.sign(velocity) * friction + load_angle
    expected = (
        motor + np.sign(motor) * parameters.dead_band + parameters.transport * CYCLE * velocity
    )
    assert error == pytest.approx(expected, rel=1e-9)


def test_the_integral_removes_the_sag_under_a_load() -> None:
    board = replace(STICK_SLIP, integral_rate=1.5)
    still = np.full(round(12.0 / CYCLE), 0.3)
    at = play(board, still, 4.0)
    assert still[0] - at.min() > 0.02
    assert abs(still[0] - at[-1]) < 1e-4
    # Without it friction alone holds the rest of the load.
    size = STICK_SLIP.friction + STICK_SLIP.load_friction * 0.04
    sag = still[0] - play(STICK_SLIP, still, 4.0)[-1]
    assert 0.04 - STICK_SLIP.breakaway * size <= sag <= 0.04 + size


def test_the_integral_removes_the_lag_of_a_constant_velocity() -> None:
    target = ramp(0.4, 10.0)
    at = play(replace(STICK_SLIP, integral_rate=1.5), target, 4.0)
    assert abs(target[-1] - at[-1]) < 1e-4
    assert abs((target - play(STICK_SLIP, target, 4.0))[-1]) > 0.05


def analytic(time: FloatArray) -> tuple[FloatArray, FloatArray]:
    target = 0.4 * time + 0.1 * (1 - np.cos(4.0 * time))
    return target, 2.0 * np.sin(3.0 * time)


INTEGRATING = replace(SMOOTH, integral_rate=0.8, offset=0.002)


@pytest.mark.parametrize("board", [SMOOTH, INTEGRATING])
def test_without_friction_it_converges_to_the_differential_equation(
    board: StickSlipParameters,
) -> None:
    def law(t: float, state: FloatArray) -> tuple[float, float, float]:
        q, v, integral = state
        x, load = analytic(np.asarray(t))
        net = x - q + integral - board.lag * v - board.load_gain * load - board.offset
        return v, float(net) / board.inertia, board.integral_rate * float(x - q)

    errors = []
    for cycle in (CYCLE, CYCLE / 8):
        time = np.arange(0.0, 3.0, cycle)
        target, load = analytic(time)
        truth = solve_ivp(law, (0.0, 3.0), np.zeros(3), t_eval=time, max_step=2e-3, rtol=1e-8).y[0]
        at = play(board, target, load, cycle=cycle)
        errors.append(float(np.abs(at - truth)[time > 0.5].max()))
        assert np.abs(target - truth).max() > 0.02
    # Of first order in the cycle, and small against an encoder step of 1.5 mrad at 12 ms.
    assert errors[0] < 1e-3
    assert errors[1] < errors[0] / 5


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"integral_rate": 0.6},
        {"dead_band": 0.003},
        {"load_friction": 0.15, "offset": -0.004},
        {"friction": 0.02, "breakaway": 1.0},
    ],
)
def test_sticks_and_slips_as_a_joint_in_small_steps(changes: dict[str, float]) -> None:
    parameters = replace(STICK_SLIP, **changes)
    motion = swing(6.0, gravity=3.0, rest=1.0)
    truth = drive(motion, parameters).position
    at = play(parameters, motion.position, motion.load)
    error = motion.position - truth
    assert np.sqrt(np.mean((at - truth) ** 2)) < 0.04 * error.std()
    # Friction makes max_friction of the error: without it the model is far off.
    smooth = play(
        replace(parameters, friction=0.0, load_friction=0.0), motion.position, motion.load
    )
    assert np.sqrt(np.mean((at - truth) ** 2)) < 0.3 * np.sqrt(np.mean((smooth - truth) ** 2))


def creep(size: float) -> Motion:
    """Goals that drift to and fro so slowly that the joint sticks again and again."""
    time = np.arange(round(20.0 / CYCLE)) * CYCLE
    return Motion(
        position=size * (1 - np.cos(0.6 * time)),
        velocity=0.6 * size * np.sin(0.6 * time),
        acceleration=0.36 * size * np.cos(0.6 * time),
        load=np.zeros_like(time),
    )


def test_creeping_goals_leave_it_where_friction_holds_it() -> None:
    """The memory of friction: at one goal it rests on either side, as it came there."""
    rough = replace(STICK_SLIP, breakaway=1.0)
    motion = creep(0.02)
    at, truth = play(rough, motion.position), drive(motion, rough).position
    np.testing.assert_allclose(at, truth, atol=5e-4)
    middle = np.isclose(motion.position, 0.02, atol=2e-4)
    up = middle & (motion.velocity > 0)
    assert at[up].max() < 0.02 - 0.007
    assert at[middle & ~up].min() > 0.02 + 0.007


@given(st.floats(-1.0, 1.0), st.floats(-6.0, 6.0), st.floats(0.0, 0.3))
def test_sticks_exactly_up_to_breakaway(ratio: float, load: float, load_friction: float) -> None:
    parameters = replace(STICK_SLIP, load_friction=load_friction, offset=0.002)
    load_angle = parameters.load_gain * load + parameters.offset
    max_friction = parameters.breakaway * (parameters.friction + load_friction * abs(load_angle))
    start = 0.7
    target = np.full(50, start + load_angle + 0.999 * ratio * max_friction)
    at = play(parameters, target, load, start=start)
    assert (at == start).all()
    # A little more, and it goes where it is pulled.
    sign = 1.0 if ratio >= 0 else -1.0
    at = play(
        parameters, np.full(50, start + load_angle + 1.001 * sign * max_friction), load, start=start
    )
    assert sign * (at[0] - start) > 0
    assert (sign * np.diff(at) >= 0).all()


def test_friction_is_what_holds_it_and_opposes_motion() -> None:
    model = StickSlipModel.from_parameters([STICK_SLIP], CYCLE)
    model.start(np.zeros(1), np.zeros(1))
    state = model.step(np.array([0.006]), np.array([0.2]))
    assert state["velocity"][0] == 0.0
    assert state["friction"][0] == pytest.approx(0.006 - 0.002)
    state = model.step(np.array([0.1]), np.array([0.0]))
    assert state["velocity"][0] > 0
    assert state["friction"][0] == pytest.approx(STICK_SLIP.friction)
    model.start(np.zeros(1), np.zeros(1))
    state = model.step(np.array([-0.1]), np.array([0.0]))
    assert state["velocity"][0] < 0
    assert state["friction"][0] == pytest.approx(-STICK_SLIP.friction)


PARAMETER_SETS = st.builds(
    replace,
    st.just(STICK_SLIP),
    inertia=st.floats(0.0, 0.01),
    lag=st.floats(0.03, 0.3),
    friction=st.floats(1e-3, 0.1),
    load_friction=st.floats(0.0, 0.5),
    breakaway=st.floats(1.0, 2.0),
    load_gain=st.floats(1e-4, 5.0),
    offset=st.floats(-0.03, 0.03),
    dead_band=st.floats(0.0, 0.02),
)


@examples(25)
@given(PARAMETER_SETS, st.floats(-1.0, 1.0), st.floats(-2.0, 2.0))
def test_always_comes_to_rest_where_friction_can_hold_it(
    parameters: StickSlipParameters, goal: float, load: float
) -> None:
    n = round(6.0 / CYCLE)
    at = play(parameters, np.full(n, goal), load, start=0.0)
    load_angle = parameters.load_gain * load + parameters.offset
    size = parameters.friction + parameters.load_friction * abs(load_angle)
    assert abs(at[-1] - at[-2]) < 1e-4
    assert (
        abs(goal - at[-1] - load_angle) <= parameters.breakaway * size + parameters.dead_band + 2e-3
    )


@pytest.mark.parametrize("transport", [0.0, 0.25, 1.0, 1.5, 2.0])
def test_transport_reads_commands_between_ticks(transport: float) -> None:
    rng = np.random.default_rng(1)
    target = np.cumsum(0.02 * rng.standard_normal(200))
    k = np.arange(200.0)
    older = np.interp(np.maximum(k - transport, 0.0), k, target)
    late = play(replace(STICK_SLIP, transport=transport), target)
    np.testing.assert_allclose(late, play(STICK_SLIP, older, start=target[0]), atol=1e-12)


@pytest.mark.parametrize("ticks", [0.7, 1.5, 3.0])
def test_negative_transport_looks_ahead_along_the_last_step(ticks: float) -> None:
    rng = np.random.default_rng(2)
    target = np.cumsum(0.02 * rng.standard_normal(200))
    ahead = target + ticks * np.diff(target, prepend=target[0])
    early = play(replace(STICK_SLIP, transport=-ticks), target)
    np.testing.assert_allclose(early, play(STICK_SLIP, ahead, start=target[0]), atol=1e-12)


def test_put_moves_only_the_joints_named() -> None:
    model = StickSlipModel.from_parameters([STICK_SLIP, STICK_SLIP, STICK_SLIP], CYCLE)
    model.start(np.zeros(3), np.zeros(3))
    goal, nothing = np.full(3, 0.1), np.zeros(3)
    for _ in range(5):
        model.step(goal, nothing)
    before = model.states.copy()
    where = np.array([False, True, True])
    # More than friction off its goal, but no more than breakaway: at rest the one stays, the other continues.
    model.put(where, np.full(3, 0.091), np.array([9.0, 0.0, 0.3]), np.full(3, 0.0))
    assert model.states[0] == before[0]
    assert model.states["position"][1:].tolist() == [0.091, 0.091]
    position = model.step(goal, nothing)["position"]
    assert position[1] == 0.091
    assert position[2] > 0.091


def test_put_gives_the_board_its_integral() -> None:
    board = replace(STICK_SLIP, integral_rate=0.5)
    model = StickSlipModel.from_parameters([board, board], CYCLE)
    model.start(np.zeros(2), np.zeros(2))
    # Exactly what the load needs: there it stays, and without it it sinks.
    model.put(np.array([True, False]), np.zeros(2), np.zeros(2), np.full(2, 0.05))
    for _ in range(20):
        position = model.step(np.zeros(2), np.full(2, 5.0))["position"]
    assert position[0] == 0.0
    assert position[1] < -0.02


def test_models_of_several_joints_are_independent() -> None:
    motion = swing(2.0)
    kinds = [
        STICK_SLIP,
        None,
        replace(STICK_SLIP, integral_rate=0.6),
        replace(STICK_SLIP, dead_band=0.004),
    ]
    model = StickSlipModel.from_parameters(kinds, CYCLE)
    start = np.full(4, motion.position[0])
    model.start(start, start)
    rows = [
        model.step(np.full(4, x), np.full(4, tau))["position"]
        for x, tau in zip(motion.position, motion.load, strict=True)
    ]
    together = np.array(rows)
    for column, parameters in enumerate(kinds):
        if parameters is not None:
            alone = play(parameters, motion.position, motion.load)
            np.testing.assert_allclose(together[:, column], alone, atol=1e-15)


@given(PARAMETER_SETS, st.floats(0.0, 1.0), st.floats(-0.1, 0.1))
def test_a_whole_run_has_the_bits_of_its_steps(
    parameters: StickSlipParameters, integral_rate: float, off: float
) -> None:
    board = replace(parameters, integral_rate=integral_rate)
    motion, start = swing(1.0), 0.2 + off
    model = StickSlipModel.from_parameters([None, board], CYCLE)
    before = model.states.copy()
    states = model.play(1, start, motion.position, motion.load)
    steps = play(board, motion.position, motion.load, start=start)
    np.testing.assert_array_equal(states["position"], steps)
    np.testing.assert_array_equal(model.states, before)


def test_states_handed_out_are_not_written_to_later() -> None:
    model = StickSlipModel.from_parameters([STICK_SLIP], CYCLE)
    model.start(np.zeros(1), np.zeros(1))
    first = (handed_out := model.step(np.array([0.2]), np.zeros(1))).copy()
    model.step(np.array([0.4]), np.zeros(1))
    model.put(np.array([True]), np.ones(1), np.ones(1), np.ones(1))
    np.testing.assert_array_equal(first, handed_out)


@pytest.mark.parametrize("name", PARAMETERS)
def test_parameters_that_are_not_finite_are_refused(name: str) -> None:
    with pytest.raises(StickSlipError, match="not finite"):
        replace(STICK_SLIP, **{name: float("nan")})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"inertia": -1e-9}, "'inertia' is negative"),
        ({"friction": -1e-9}, "'friction' is negative"),
        ({"load_gain": 0.0}, "load_gain above 0"),
        ({"breakaway": 0.99}, "breakaway of 1 or more"),
        ({"transport": 2.01}, "transport of -3 to 2"),
        ({"transport": -3.01}, "transport of -3 to 2"),
    ],
)
def test_parameters_that_make_no_joint_are_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(StickSlipError, match=message):
        replace(STICK_SLIP, **changes)
    assert issubclass(StickSlipError, PepperError)


def test_stiffness_is_the_torque_per_angle() -> None:
    assert STICK_SLIP.stiffness == pytest.approx(100.0)


@pytest.mark.parametrize("integral_rate", [0.0, 0.4, 4.0])
@pytest.mark.parametrize("lag", [0.01, 0.02])
def test_after_its_settling_time_a_swing_has_a_twentieth_of_its_size(
    lag: float, integral_rate: float
) -> None:
    p = replace(SMOOTH, inertia=2e-3, lag=lag, integral_rate=integral_rate)
    # Of position, velocity and integral, with the target at 0.
    stiff = 1.0 / p.inertia
    rates = np.array([[0.0, 1.0, 0.0], [-stiff, -stiff * lag, stiff], [-integral_rate, 0.0, 0.0]])
    frequencies, motions = np.linalg.eig(rates)
    swing_alone = motions[:, frequencies.imag > 0.0][:, 0]
    settled = expm(rates * p.settling_time) @ swing_alone
    assert np.linalg.norm(settled) == pytest.approx(0.05 * np.linalg.norm(swing_alone))


def test_settling_time_of_joints_that_do_not_swing_or_swing_for_ever() -> None:
    assert replace(SMOOTH, inertia=1e-4, lag=0.05).settling_time == 0.0
    assert replace(SMOOTH, inertia=0.0).settling_time == 0.0
    assert replace(SMOOTH, inertia=2e-3, lag=0.01, integral_rate=6.0).settling_time == np.inf


def test_a_limited_target_is_a_slower_command() -> None:
    limited = replace(STICK_SLIP, target_speed=1.0, transport=0.6)
    command = np.concatenate((ramp(3.0, 0.6), np.full(200, ramp(3.0, 0.6)[-1]), ramp(-0.5, 2.0)))
    slower = [0.0]
    for goal in command[1:]:
        slower.append(slower[-1] + float(np.clip(goal - slower[-1], -CYCLE, CYCLE)))
    expected = play(replace(limited, target_speed=NO_LIMIT), np.array(slower))
    np.testing.assert_allclose(play(limited, command), expected, atol=1e-12)
    assert np.abs(expected - play(replace(limited, target_speed=NO_LIMIT), command)).max() > 0.5


@pytest.mark.parametrize("speed", [0.0, -1.0])
def test_a_target_that_cannot_move_is_refused(speed: float) -> None:
    with pytest.raises(StickSlipError, match="target_speed"):
        replace(STICK_SLIP, target_speed=speed)
