"""The observer from ticks to events: rules of mode ``paper``, and those that all modes share."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import ArgumentError
from pepper_driver.config.kernels import CHECK_VARIABLE
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.fitting.tree import fit_joint
from pepper_driver.observer.interface import Contact, JointState, Observation
from pepper_driver.observer.models.model_file import ModelFileError, ModelSet, shipped
from support.examples import examples
from support.fusion import MODEL, fusion_observer, fusion_set, touched
from support.observer import (
    CYCLE,
    JOINTS,
    ROBOT,
    SETTINGS,
    SILENT,
    THRESHOLD,
    check_life,
    free_error,
    free_run,
    models,
    motion,
    random_ticks,
    run,
    same,
    spoilt,
    tick,
)

ELBOW = ROBOT.joint_index("LElbowRoll")
HEAD = ROBOT.joint_index("HeadYaw")
WINDOW = SETTINGS.median_window


def observer() -> ContactObserver:
    return ContactObserver(ROBOT, models(), SETTINGS)


def error_of(joint: int, value: float) -> FloatArray:
    error = np.zeros(JOINTS)
    error[joint] = value
    return error


def test_a_touch_from_begin_to_end() -> None:
    pushed = range(100, 160)
    ticks = [tick(k, error_of(ELBOW, -0.08 if k in pushed else 0.0)) for k in range(250)]
    observations, events = run(observer(), ticks)
    check_life(events)
    assert [event.phase for event in events] == ["begin", "end"]
    begin, end = events[0], events[-1]
    assert (begin.joint, begin.link, begin.kind) == ("LElbowRoll", "LForeArm", "contact")
    assert begin.direction == 1
    assert begin.intensity_deg == pytest.approx(math.degrees(0.08))
    # The median of 11 changes with the sixth sample, in both directions.
    assert begin.detection_time == begin.time == pytest.approx(105 * CYCLE)
    assert begin.onset_time == pytest.approx(100 * CYCLE)
    assert end.time == pytest.approx(165 * CYCLE)
    states = [JointState(int(one.state[ELBOW])) for one in observations]
    assert set(states[:105]) == {JointState.FREE}
    assert set(states[105:165]) == {JointState.CONTACT}
    gap = round(SETTINGS.merge_gap / CYCLE)
    assert set(states[165 : 166 + gap]) == {JointState.RELEASE}
    assert set(states[166 + gap :]) == {JointState.FREE}
    assert observations[-1].state[HEAD] == JointState.FREE


def test_the_onset_of_a_touch_that_grows_slowly_is_its_beginning() -> None:
    """It grows for 0.4 s from a third of the threshold, below which it may be free motion, to the threshold."""
    begin, growth = 60, round(0.4 / CYCLE)
    error = THRESHOLD * np.clip(1.0 / 3.0 + (np.arange(150) - begin) / (1.5 * growth), 0.0, 1.5)
    error[:begin] = 0.0
    _, events = run(observer(), [tick(k, error_of(ELBOW, -error[k])) for k in range(150)])
    [first] = events[:1]
    assert first.detection_time > (begin + growth) * CYCLE
    assert first.onset_time == pytest.approx(begin * CYCLE, abs=1.1 * CYCLE)


def test_a_contact_goes_before_doubt() -> None:
    """A hand lets go, and its joint stays off its place: in doubt only once the contact is over."""
    begin, end = 60, 100
    gap = round(SETTINGS.merge_gap / CYCLE)
    states = []
    target = fusion_observer()
    for k in range(150):
        one = touched(k, LElbowRoll=1.5 if begin <= k else 0.0)
        if k >= end:
            one.measurement.current[:] = 0.0
        states.append(JointState(int(target.step(one).state[ELBOW])))
    late = SETTINGS.fusion_window // 2
    assert set(states[begin + late : end + late]) == {JointState.CONTACT}
    over = end + late + gap + 1
    assert set(states[end + late : over]) == {JointState.RELEASE}
    assert states[over] == JointState.DOUBTFUL


def test_chains_are_independent() -> None:
    both = error_of(ELBOW, 0.08) + error_of(HEAD, -0.09)
    _, events = run(observer(), [tick(k, both if k > 20 else 0.0) for k in range(40)])
    begins = {event.joint: event for event in events if event.phase == "begin"}
    assert begins.keys() == {"LElbowRoll", "HeadYaw"}
    assert begins["LElbowRoll"].id != begins["HeadYaw"].id
    assert (begins["LElbowRoll"].direction, begins["HeadYaw"].direction) == (-1, 1)


def test_joints_without_a_model_are_blind() -> None:
    target = ContactObserver(ROBOT, models({"HeadYaw": SILENT}), SETTINGS)
    observations, events = run(target, [tick(k, 0.5) for k in range(60)])
    assert {event.joint for event in events} == {"HeadYaw"}
    for observation in observations:
        for values in (observation.expected, observation.residual, observation.threshold):
            assert np.isfinite(values[HEAD])
            assert np.isnan(np.delete(values, HEAD)).all()
        assert (np.delete(observation.state, HEAD) == JointState.BLIND).all()


MODES: dict[str, Callable[[], ContactObserver]] = {
    "paper": observer,
    "fusion": partial(fusion_observer, adapt=True),
    "momentum": lambda: ContactObserver(ROBOT, fusion_set(MODEL), SETTINGS, momentum=True),
}
ONE = tick(30)


@pytest.mark.parametrize("mode", ["paper", "momentum"])
@pytest.mark.parametrize(
    "bad",
    [
        tick(30, error_of(ELBOW, 3.0), limited=[ELBOW]),
        spoilt(ONE, "measurement", "position", math.nan, ELBOW),
        spoilt(ONE, "measurement", "position", math.inf, ELBOW),
        spoilt(ONE, "sent", "position", math.nan, ELBOW),
        spoilt(ONE, "sent", "stiffness", 0.5, ELBOW),
        spoilt(ONE, "sent", "stiffness", math.nan, ELBOW),
        spoilt(ONE, "reference", "velocity", math.nan, ELBOW),
        spoilt(ONE, "reference", "acceleration", -math.inf, ELBOW),
        spoilt(ONE, "reference", "load_torque", math.nan, ELBOW),
    ],
)
def test_a_bad_tick_makes_its_joint_blind_for_a_median_window(bad: Tick, mode: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        observations, events = run(MODES[mode](), [bad if k == 30 else tick(k) for k in range(60)])
    assert events == []
    for k, observation in enumerate(observations):
        blind = 30 <= k < 30 + WINDOW
        assert (observation.state[ELBOW] == JointState.BLIND) == blind
        for name in ("expected", "residual", "threshold"):
            assert np.isnan(getattr(observation, name)[ELBOW]) == blind
        assert np.isnan(observation.torque[ELBOW]) == (blind or mode == "paper")
        assert observation.state[HEAD] == JointState.FREE
        assert np.isfinite(observation.residual[HEAD])


def foreign(part: Any) -> Any:
    """The same numbers with gaps, in another order of bytes, and read-only."""
    changes = {}
    for field in fields(part):
        values = getattr(part, field.name)
        if isinstance(values, np.ndarray) and values.dtype == np.float64:
            wide = np.zeros((len(values), 2), dtype=">f8")
            wide[:, 0] = values
            wide.flags.writeable = False
            changes[field.name] = wide[:, 0]
        elif is_dataclass(values):
            changes[field.name] = foreign(values)
    return replace(part, **changes)


def test_kernels_that_do_not_look_at_their_arguments_compute_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As robots have them: with base and loads of the hands; the ticks are late, foreign, or not valid in places."""
    made = partial(ContactObserver, ROBOT, ModelSet.load(shipped("fusion")["nominal"]), SETTINGS)
    looks = made()
    monkeypatch.delenv(CHECK_VARIABLE)
    trusts = made()
    for k, one in enumerate(random_ticks(60, 1) + [tick(k) for k in range(60, 200)]):
        if k % 7 == 0:
            one.measurement.position[ELBOW] = math.nan
        expected, found = looks.step(one), trusts.step(foreign(one) if k % 5 == 0 else one)
        for field in fields(Observation):
            np.testing.assert_array_equal(getattr(found, field.name), getattr(expected, field.name))


@pytest.mark.parametrize("mode", MODES)
def test_arrays_may_be_of_any_layout(mode: str) -> None:
    here, there = MODES[mode](), MODES[mode]()
    for one in random_ticks(40, 1):
        sent = replace(one.sent, stiffness=np.ones(JOINTS))
        one = replace(one, sent=sent, measurement=replace(one.measurement, age=0.0))
        expected, found = here.step(one), there.step(foreign(one))
        for field in fields(Observation):
            np.testing.assert_array_equal(getattr(found, field.name), getattr(expected, field.name))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("size", [JOINTS - 1, JOINTS + 1])
@pytest.mark.parametrize(
    ("part", "name"),
    [("measurement", "current"), ("sent", "position"), ("reference", "load_torque")],
)
def test_ticks_of_another_robot_are_refused(mode: str, size: int, part: str, name: str) -> None:
    one = tick(0)
    other = replace(one, **{part: replace(getattr(one, part), **{name: np.zeros(size)})})
    with pytest.raises(ArgumentError, match=f"{size}.* not of .*{JOINTS}"):
        MODES[mode]().step(other)


@pytest.mark.parametrize("name", ["acceleration", "angular_velocity"])
def test_an_inertial_unit_of_two_axes_is_refused(name: str) -> None:
    one = tick(0)
    imu = replace(one.measurement.imu, **{name: np.zeros(2)})
    other = replace(one, measurement=replace(one.measurement, imu=imu))
    with pytest.raises(ArgumentError, match="arrays of"):
        MODES["fusion"]().step(other)


@pytest.mark.parametrize("mode", ["paper", "momentum"])
@pytest.mark.parametrize("age", [0.031, 5.0, math.nan, math.inf])
def test_a_stale_sample_makes_all_joints_blind(age: float, mode: str) -> None:
    stale = tick(30, 0.5, age=age)
    observations, events = run(MODES[mode](), [stale if k == 30 else tick(k) for k in range(60)])
    assert events == []
    for k, observation in enumerate(observations):
        blind = 30 <= k < 30 + WINDOW
        assert (observation.state == (JointState.BLIND if blind else JointState.FREE)).all()


@pytest.mark.parametrize("mode", ["paper", "momentum"])
def test_a_sample_of_the_usual_age_is_none_of_that(mode: str) -> None:
    observations, _ = run(MODES[mode](), [tick(k, age=0.029) for k in range(5)])
    assert (observations[-1].state == JointState.FREE).all()


def test_a_joint_the_gate_keeps_altering_never_detects_a_contact() -> None:
    ticks = [
        tick(k, error_of(ELBOW, 0.5), limited=[ELBOW] if k % 7 == 0 else []) for k in range(90)
    ]
    observations, events = run(observer(), ticks)
    assert events == []
    assert all(one.state[ELBOW] == JointState.BLIND for one in observations)


def test_a_contact_ends_when_its_joint_goes_blind() -> None:
    pushed = error_of(ELBOW, 0.1)
    ticks = [tick(k, pushed, limited=[ELBOW] if k == 40 else []) for k in range(60)]
    observations, events = run(observer(), ticks)
    first = [event for event in events if event.id == 1]
    assert first[-1].phase == "end"
    assert first[-1].time == pytest.approx(40 * CYCLE)
    # A contact when the joint is judged again is a contact, not a rebound.
    [begin] = [event for event in events if event.phase == "begin" and event.id == 2]
    assert begin.kind == "contact"
    assert begin.time == pytest.approx((40 + WINDOW) * CYCLE)
    assert begin.onset_time == pytest.approx(41 * CYCLE)
    assert observations[45].state[ELBOW] == JointState.BLIND


@pytest.mark.parametrize("time", [math.nan, -5.0, 0.1, math.inf])
def test_a_clock_that_fails_turns_no_event_around(time: float) -> None:
    ticks = [
        tick(k, error_of(ELBOW, 0.1 if 50 <= k < 90 else 0.0), time=time if 90 <= k < 115 else None)
        for k in range(200)
    ]
    _, events = run(observer(), ticks)
    check_life(events)
    assert [event.phase for event in events][0 :: len(events) - 1] == ["begin", "end"]
    assert events[-1].time == pytest.approx(89 * CYCLE)


def test_models_of_another_robot_are_refused() -> None:
    with pytest.raises(ModelFileError, match="robot 'nao'"):
        ContactObserver(ROBOT, models(robot="nao"), SETTINGS)
    with pytest.raises(ModelFileError, match="order"):
        ContactObserver(ROBOT, models(joint_names=ROBOT.joint_names[::-1]), SETTINGS)


def test_describe_names_models_and_threshold_in_one_line() -> None:
    text = ContactObserver(ROBOT, models({"HeadYaw": SILENT}), SETTINGS).describe()
    assert "\n" not in text
    for part in ("paper", "cart trees of 1 joints", "plant-0123", "median of 11", "2.29 deg"):
        assert part in text


def test_the_observer_takes_the_models_thresholds_unless_one_is_set() -> None:
    own = {name: math.radians(0.5 + 0.1 * i) for i, name in enumerate(ROBOT.joint_names)}
    set_of_models = replace(models(), threshold=own)
    observer = ContactObserver(ROBOT, set_of_models, replace(SETTINGS, threshold=None))
    assert "0.50 to 2.10 deg" in observer.describe()
    fixed = ContactObserver(ROBOT, set_of_models, replace(SETTINGS, threshold=math.radians(2.5)))
    assert "2.50 to 2.50 deg" in fixed.describe()


def test_after_a_reset_everything_is_as_at_first() -> None:
    rng = np.random.default_rng(3)
    errors = np.cumsum(0.01 * rng.standard_normal((300, JOINTS)), axis=0)
    ticks = [tick(k, errors[k], limited=[3] if k % 50 == 9 else []) for k in range(300)]
    target = observer()
    first, events = run(target, ticks)
    assert len(events) > 20
    target.reset()
    again, _ = run(target, ticks)
    fresh, _ = run(observer(), ticks)
    assert all(map(same, first, again))
    assert all(map(same, first, fresh))


def test_observations_are_not_written_to_later() -> None:
    target = observer()
    first = target.step(tick(0, 0.01))
    kept = [first.residual.copy(), first.expected.copy(), first.state.copy(), first.torque.copy()]
    run(target, [tick(k, 0.5) for k in range(1, 30)])
    for array, copy in zip(
        (first.residual, first.expected, first.state, first.torque), kept, strict=True
    ):
        np.testing.assert_array_equal(array, copy)


@examples(40)
@given(
    st.lists(
        st.tuples(
            st.integers(1, 25),
            st.sampled_from([0.0, 0.03, 0.06, -0.06, 0.3, -0.3, math.nan]),
            st.sampled_from([0.0, -0.06, 0.3]),
            st.sampled_from([(), (), (ELBOW,), (ELBOW, ELBOW - 2)]),
            st.sampled_from([0.0, 0.0, 0.0, 0.04]),
        ),
        max_size=20,
    )
)
def test_events_make_sense_for_any_signal(
    parts: list[tuple[int, float, float, tuple[int, ...], float]],
) -> None:
    target = observer()
    events: list[Contact] = []
    k = 0
    for ticks, outer, inner, limited, age in parts:
        error = error_of(ELBOW, outer) + error_of(ELBOW - 2, inner)
        for _ in range(ticks):
            observation = target.step(tick(k, error, limited=limited, age=age))
            k += 1
            for event in observation.contacts:
                assert event.joint is not None
                joint = ROBOT.joint_index(event.joint)
                if event.phase == "begin":
                    assert event.direction == -np.sign(observation.residual[joint])
                    assert abs(observation.residual[joint]) > THRESHOLD
                if event.phase != "end":
                    assert observation.state[joint] != JointState.BLIND
            blind = observation.state == JointState.BLIND
            np.testing.assert_array_equal(np.isnan(observation.residual), blind)
            np.testing.assert_array_equal(np.isnan(observation.threshold), blind)
            events += observation.contacts
    check_life(events)


def test_detects_light_touches_and_nothing_else_in_fast_motion() -> None:
    """Identification as in Sec. IV, then pushes of 4 deg in a motion faster than any it was identified on."""
    estimation = [free_run(k, seed) for seed, k in enumerate((2.0, 3.0, 4.0, 5.0))]
    model = fit_joint("LElbowRoll", estimation, "affine")
    target = ContactObserver(ROBOT, models({"LElbowRoll": model}, kind="affine"), SETTINGS)
    features = motion(8.0, 77, 60.0)
    error = free_error(features, 78)
    onsets = [6.0, 15.0, 24.0, 33.0, 42.0, 51.0]
    signs = [1, -1, -1, 1, 1, -1]
    time = np.arange(len(error)) * CYCLE
    for onset, sign in zip(onsets, signs, strict=True):
        rise = np.clip((time - onset) / 0.1, 0, 1) * np.clip((onset + 0.8 - time) / 0.1, 0, 1)
        error += sign * np.radians(4.0) * rise
    ticks = [
        tick(k, error_of(ELBOW, error[k]), features=tuple(features[k])) for k in range(len(error))
    ]
    _, events = run(target, ticks)
    begins = [event for event in events if event.phase == "begin"]
    assert [event.direction for event in begins] == [-sign for sign in signs]
    for onset, begin in zip(onsets, begins, strict=True):
        assert 0.0 < begin.detection_time - onset < 0.2
        assert abs(begin.onset_time - onset) < 0.06
    ends = [event for event in events if event.phase == "end"]
    assert [event.intensity_deg for event in ends] == pytest.approx([4.0] * 6, abs=1.0)
