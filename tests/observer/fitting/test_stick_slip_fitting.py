"""Identification of the stick-slip model finds the constants of a joint that another integrator simulates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from pepper_driver.config import load_plant, load_robot, plant_names
from pepper_driver.observer.fitting import stick_slip as stick_slip_fitting
from pepper_driver.observer.fitting.stick_slip import (
    START_UP_TIME,
    STARTS,
    BoundedConstant,
    bounded_constants,
    fit_stick_slip,
)
from pepper_driver.observer.fitting.tree import FittingError
from pepper_driver.observer.models.stick_slip import (
    MIN_TRANSPORT,
    PARAMETERS,
    StickSlipParameters,
)
from pepper_driver.observer.recording import Recording
from support.fusion import ELBOW, STICK_SLIP, TORQUE_CONSTANT, drive, recording_of, swing
from support.observer import CYCLE, recording

JOINT = "LElbowRoll"
TRUE = replace(
    STICK_SLIP,
    lag=0.035,
    friction=0.011,
    load_friction=0.0,
    load_gain=0.013,
    offset=-0.004,
    breakaway=1.2,
)


def runs(
    parameters: StickSlipParameters = TRUE, seconds: float = 6.0, *, derivative: float = 0.0
) -> list[Recording]:
    """Free motion of different speeds, with the encoder's steps."""
    made = []
    for size, rate, gravity, rest in ((0.5, 1.0, 3.0, 1.0), (0.4, 2.2, -3.0, 0.5)):
        motion = swing(seconds, size, rate, gravity=gravity, rest=rest)
        made.append(recording_of(motion, drive(motion, parameters, derivative=derivative)))
    return made


def total_lag(parameters: StickSlipParameters) -> float:
    return parameters.lag + parameters.transport * CYCLE


@pytest.fixture(scope="module")
def found() -> StickSlipParameters:
    return fit_stick_slip(JOINT, runs(), CYCLE)


def test_finds_the_constants_of_the_joint(found: StickSlipParameters) -> None:
    # At these speeds a lag in time looks like one of the motor: only their sum is determined well.
    assert total_lag(found) == pytest.approx(TRUE.lag, abs=0.0015)
    assert found.friction == pytest.approx(TRUE.friction, rel=0.12)
    assert found.load_gain == pytest.approx(TRUE.load_gain, rel=0.05)
    assert found.offset == pytest.approx(TRUE.offset, abs=4e-4)
    assert found.inertia == pytest.approx(TRUE.inertia, abs=2e-4)
    # What is not there is not found.
    assert found.dead_band == found.integral_rate == 0.0


def test_a_target_that_was_limited_for_a_while_is_no_lag_of_the_joint(
    found: StickSlipParameters,
) -> None:
    chasing = []
    for run in runs():
        position = run.position.copy()
        position[250:280] -= 0.5
        chasing.append(replace(run, position=position))
    there = fit_stick_slip(JOINT, chasing, CYCLE)
    assert total_lag(there) == pytest.approx(total_lag(found), abs=0.002)
    assert there.friction == pytest.approx(found.friction, rel=0.15)


def test_a_joint_that_falls_behind_in_all_of_its_runs_is_refused() -> None:
    behind = recording(np.zeros((400, 3)), np.full(400, 0.5))
    with pytest.raises(FittingError, match=f"{JOINT}: none of its samples counts"):
        fit_stick_slip(JOINT, [behind], CYCLE)


def test_what_comes_a_tick_late_is_found_as_late(found: StickSlipParameters) -> None:
    late = []
    for run in runs():
        position = run.position.copy()
        position[1:] = run.position[:-1]
        late.append(replace(run, position=position))
    there = fit_stick_slip(JOINT, late, CYCLE)
    assert there.transport > found.transport + 0.3
    assert total_lag(there) == pytest.approx(TRUE.lag + CYCLE, abs=0.0015)
    assert there.friction == pytest.approx(TRUE.friction, rel=0.12)


def test_a_board_that_leads_is_found() -> None:
    """18 ms of derivative on its error: a tick and a half earlier, and a lag that is 18 ms longer."""
    leading = fit_stick_slip(JOINT, runs(derivative=0.018), CYCLE)
    assert leading.transport == pytest.approx(-1.5, abs=0.4)
    assert total_lag(leading) == pytest.approx(TRUE.lag, abs=0.0015)
    assert bounded_constants(leading) == ()


def test_constants_at_a_bound_are_named_but_for_natural_ones(found: StickSlipParameters) -> None:
    assert bounded_constants(found) == ()
    none = {"inertia": 0.0, "friction": 0.0, "load_friction": 0.0, "breakaway": 1.0}
    assert bounded_constants(replace(found, **none, dead_band=0.0, integral_rate=0.0)) == ()
    # A solver of bounded problems ends a little inside.
    stopped = replace(found, transport=MIN_TRANSPORT + 0.001, lag=0.3, load_friction=0.499)
    assert bounded_constants(stopped) == (
        BoundedConstant(name="lag", bound=0.3, side="upper"),
        BoundedConstant(name="load_friction", bound=0.5, side="upper"),
        BoundedConstant(name="transport", bound=MIN_TRANSPORT, side="lower"),
    )


def test_a_dead_band_is_found_where_it_is() -> None:
    band = fit_stick_slip(JOINT, runs(replace(TRUE, dead_band=0.006)), CYCLE)
    assert band.dead_band == pytest.approx(0.006, abs=0.003)


def test_an_integral_is_found_where_it_is() -> None:
    board = fit_stick_slip(JOINT, runs(replace(TRUE, integral_rate=0.8)), CYCLE)
    assert board.integral_rate == pytest.approx(0.8, abs=0.25)


def test_the_current_gives_the_stiffness_of_a_joint_without_load() -> None:
    light = replace(TRUE, load_gain=STICK_SLIP.load_gain)
    made = []
    for size, rate in ((0.5, 1.0), (0.4, 2.2)):
        motion = replace(swing(6.0, size, rate, rest=1.0), load=np.zeros(round(7.0 / CYCLE)))
        made.append(recording_of(motion, drive(motion, light)))
    found = fit_stick_slip(JOINT, made, CYCLE, torque_constant=TORQUE_CONSTANT)
    assert found.load_gain == pytest.approx(light.load_gain, rel=0.1)


def test_the_current_while_sliding_gives_the_stiffness_of_a_wrist() -> None:
    """At rest noise and dead band hide it, and the load of the description is a quarter of the true one."""
    robot, wrist, stiffness = load_robot(), "LWristYaw", 0.5
    index = robot.joint_index(wrist)
    torque_constant = robot.motors.joint_torque_constant(wrist)
    resistance = robot.motors.of(wrist).resistance
    weak = replace(
        TRUE,
        load_gain=1.0 / stiffness,
        lag=torque_constant**2 / (stiffness * resistance),  # that of the back-EMF
        friction=0.016,
        dead_band=0.006,
        offset=0.0,
    )
    noise = np.random.default_rng(3)
    made = []
    for size, rate in ((2.0, 0.4), (1.5, 0.9)):
        motion = swing(20.0, size, rate, rest=3.0, gravity=0.0)
        load = 0.004 * np.sin(motion.position + 0.4)
        driven = drive(replace(motion, load=load), weak)
        run = recording_of(replace(motion, load=load / 4.0), driven, index)
        current = np.zeros_like(run.current)
        current[:, index] = stiffness * driven.motor / torque_constant
        current[:, index] += noise.normal(0.0, 0.01, len(motion))
        made.append(replace(run, current=np.abs(current)))
    fit = partial(fit_stick_slip, wrist, made, CYCLE, torque_constant=torque_constant)
    assert fit(resistance=resistance).load_gain == pytest.approx(weak.load_gain, rel=0.15)
    assert fit().load_gain != pytest.approx(weak.load_gain, rel=0.3)


def test_samples_that_cannot_be_used_do_not_count() -> None:
    """The start and the end of a shorter run do not count either."""
    long, short = runs(seconds=1.5)
    short = replace(
        short, **{name: getattr(short, name)[:120] for name in vars(short) if name != "joint_names"}
    )
    spoilt = []
    for run in (long, short):
        position, limited, age = run.position.copy(), run.limited.copy(), run.age.copy()
        limited[90:100, ELBOW] = True
        age[70:75] = 0.05
        spoilt.append((replace(run, limited=limited, age=age), position))
    clean = fit_stick_slip(JOINT, [run for run, _ in spoilt], CYCLE)
    garbage = []
    for run, position in spoilt:
        for span in (slice(1, round(START_UP_TIME / CYCLE)), slice(90, 100), slice(70, 75)):
            position[span, ELBOW] += 0.15  # within the working range
        garbage.append(replace(run, position=position))
    assert fit_stick_slip(JOINT, garbage, CYCLE) == clean
    garbage[1] = replace(garbage[1], limited=np.zeros_like(garbage[1].limited))
    assert fit_stick_slip(JOINT, garbage, CYCLE) != clean


@pytest.mark.parametrize("number", range(len(STARTS)))
def test_what_is_found_does_not_depend_on_the_start(
    number: int, found: StickSlipParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stick_slip_fitting, "STARTS", STARTS[number : number + 1])
    alone = fit_stick_slip(JOINT, runs(), CYCLE)
    assert total_lag(alone) == pytest.approx(total_lag(found), abs=0.001)
    assert alone.friction == pytest.approx(found.friction, rel=0.05)
    assert alone.load_gain == pytest.approx(found.load_gain, rel=0.02)
    assert alone.offset == pytest.approx(found.offset, abs=1e-4)


@pytest.mark.parametrize("name", plant_names())
def test_the_fit_begins_at_no_constant_of_a_plant(name: str) -> None:
    """Else simulated robots would get better models than real ones. The other constants differ from joint to joint."""
    robot = load_robot()
    plant = load_plant(name, robot)
    own = {
        "load_friction": plant.per_joint("friction.load", robot),
        "breakaway": plant.per_joint("friction.breakaway", robot),
        "dead_band": plant.per_joint("dead_band", robot),
        "integral_rate": plant.per_joint("ki", robot) / plant.per_joint("kp", robot),
    }
    for key, values in own.items():
        if len(set(values)) < 5:  # of a plant that is drawn, some joint is near any number
            for start in STARTS:
                assert (np.abs(values / start[key] - 1.0) > 0.02).all(), key


@pytest.mark.parametrize(("dead_band", "taken"), [(0.02, False), (0.0, False), (0.005, True)])
def test_a_dead_band_at_a_bound_is_not_included(
    dead_band: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As wide as can be, it stands for friction, however much it improves the fit."""
    plain = {name: getattr(STICK_SLIP, name) for name in PARAMETERS}

    def solve(
        self: object, names: tuple[str, ...], start: Mapping[str, float]
    ) -> tuple[dict[str, float], float]:
        changes = {"dead_band": dead_band, "integral_rate": 0.02}
        found = {name: changes.get(name, plain[name]) for name in names}
        return found, 0.1 if "dead_band" in names else 1.0

    monkeypatch.setattr(stick_slip_fitting._Fit, "solve", solve)
    found = fit_stick_slip(JOINT, runs(seconds=3.0), CYCLE)
    assert found.dead_band == (dead_band if taken else 0.0)
    assert found.integral_rate == 0.0
