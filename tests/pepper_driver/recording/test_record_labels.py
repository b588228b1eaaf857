"""Labels from edges, and labelled logs as recordings and pushes."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pepper_driver.backends import Measurement
from pepper_driver.config import UnknownNameError
from pepper_driver.controller import Tick
from pepper_driver.log import Label, LogWriter, RunLog, read_log
from pepper_driver.log.topics import LabelPhase
from pepper_driver.loop import TickRecord
from pepper_driver.observer import RecordingBuilder, RecordingError
from pepper_driver.recording.labels import (
    LabelError,
    Labeller,
    make_labeller,
    pushes_of,
    recording_of,
)
from pepper_driver.recording.terminal_keys import SpaceBar
from pepper_driver.testing import standing_measurement
from support.log_samples import ROBOT, Samples

TOUCH = list(ROBOT.sensors.touch)


def sample(time: float, *touched: str) -> Measurement:
    """A measurement in which these sensors are touched or pressed."""
    bumpers = np.array([float(name in touched) for name in ROBOT.sensors.bumpers])
    touch = np.array([float(name in touched) for name in TOUCH])
    return replace(standing_measurement(), time=time, touch=touch, bumpers=bumpers)


def phases(labeller: Labeller, *ticks: tuple[str, ...]) -> list[tuple[float, str]]:
    """Time and phase of the labels of a run, a tick each second."""
    labels = [label for k, names in enumerate(ticks) for label in labeller.step(sample(k, *names))]
    return [(label.time, label.phase) for label in labels]


def labeller(source: str, link: str | None = None, joint: str | None = None) -> Labeller:
    return make_labeller(source, ROBOT, SpaceBar(stop=print), link=link, joint=joint)


FRONT, REAR = "Head/Touch/Front", "Head/Touch/Rear"


def test_labels_are_the_edges_of_any_sensor_of_the_group() -> None:
    ticks = [(), (FRONT,), (FRONT, REAR), (REAR,), (), (), (REAR,), ()]
    expected = [(1.0, "onset"), (4.0, "release"), (6.0, "onset"), (7.0, "release")]
    assert phases(labeller("head"), *ticks) == expected
    assert phases(labeller("hand-left"), *ticks) == []
    assert phases(labeller("bumper"), *ticks) == []


@pytest.mark.parametrize(
    ("source", "sensor", "link", "joint"),
    [
        ("head", "Head/Touch/Middle", "Head", "HeadPitch"),
        ("hand-left", "LHand/Touch/Back", "l_wrist", "LWristYaw"),
        ("hand-right", "RHand/Touch/Back", "r_wrist", "RWristYaw"),
        ("bumper", "Back", "Tibia", None),
    ],
)
def test_a_sensor_says_what_is_touched(
    source: str, sensor: str, link: str, joint: str | None
) -> None:
    maker = labeller(source)
    assert maker.step(sample(0.0)) == ()
    assert not maker.touched
    expected = Label(time=0.5, phase="onset", source=source, link=link, joint=joint)
    assert maker.step(sample(0.5, sensor)) == (expected,)
    assert maker.touched


def test_what_is_touched_at_the_start_is_left_out_until_it_is_let_go() -> None:
    ticks = [(FRONT,), (FRONT,), (), (FRONT,), ()]
    assert phases(labeller("head"), *ticks) == [(3.0, "onset"), (4.0, "release")]


def test_a_key_counts_from_the_first_tick_on() -> None:
    bar = SpaceBar(stop=print)
    maker = make_labeller("key", ROBOT, bar)
    bar._presses += 1
    assert [label.phase for label in maker.step(sample(0.0))] == ["onset"]


@pytest.mark.parametrize(
    ("link", "joint", "expected"),
    [
        (None, None, (None, None)),
        ("LForeArm", None, ("LForeArm", "LElbowRoll")),
        (None, "LElbowRoll", ("LForeArm", "LElbowRoll")),
        ("l_gripper", "LElbowYaw", ("l_gripper", "LElbowYaw")),
        ("torso", None, ("torso", None)),
        ("base_link", None, ("base_link", None)),
        (None, "HipPitch", ("Hip", None)),
    ],
)
def test_a_key_touches_the_given_place(
    link: str | None, joint: str | None, expected: tuple[str | None, str | None]
) -> None:
    bar = SpaceBar(stop=print)
    maker = make_labeller("key", ROBOT, bar, link=link, joint=joint)
    assert maker.step(sample(0.0)) == ()
    bar._presses += 1
    (label,) = maker.step(sample(1.0))
    assert (label.link, label.joint) == expected
    assert (label.phase, label.source, label.time) == ("onset", "key", 1.0)
    assert maker.step(sample(2.0)) == ()
    bar._presses += 1
    assert [label.phase for label in maker.step(sample(3.0))] == ["release"]


def test_unknown_names_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean hand-left"):
        labeller("hand-lef")
    with pytest.raises(UnknownNameError, match="unknown link"):
        labeller("key", link="LForearm")
    with pytest.raises(UnknownNameError, match="unknown joint"):
        labeller("key", joint="LElbow")
    blind = replace(ROBOT, sensors=replace(ROBOT.sensors, touch={}))
    with pytest.raises(LabelError, match="no sensor for the label 'head'"):
        make_labeller("head", blind, SpaceBar(stop=print))


# -- back from the log ------------------------------------------------------------------------------------------


def written(path: Path, *labels: Label, ticks: int = 5) -> tuple[RunLog, list[Tick]]:
    """A log of some ticks, all labels in the first."""
    samples = Samples(0)
    made = [samples.tick(k) for k in range(ticks)]
    with LogWriter(path, ROBOT, {}, lossless=True) as log:
        for k, tick in enumerate(made):
            log.append(TickRecord(tick=tick, labels=labels if k == 0 else ()))
    return read_log(path), made


def end(time: float, phase: LabelPhase, link: str | None = "Head") -> Label:
    return Label(time=time, phase=phase, source="key", link=link, joint="HeadPitch")


def test_labels_come_back_as_they_were(tmp_path: Path) -> None:
    labels = [end(0.1 + 1e-15, "onset"), end(0.2, "release"), end(0.3, "onset", None)]
    log, _ = written(tmp_path / "a.mcap", *labels)
    assert log.labels == labels
    assert written(tmp_path / "b.mcap")[0].labels == []


def test_a_recording_comes_back_from_a_log(tmp_path: Path) -> None:
    samples = Samples(1)
    builder, path = RecordingBuilder(ROBOT), tmp_path / "a.mcap"
    with LogWriter(path, ROBOT, {}, lossless=True) as log:
        for k in range(20):
            tick = finite(samples.tick(k), k)
            builder.append(tick)
            log.append(TickRecord(tick=tick))
    expected, found = builder.finish(), recording_of(read_log(path), ROBOT)
    assert found.joint_names == ROBOT.joint_names
    for name, array in expected._arrays():
        np.testing.assert_array_equal(getattr(found, name), array)
        assert getattr(found, name).dtype == array.dtype


def finite(tick: Tick, number: int) -> Tick:
    """Made-up numbers, each another one, none of them wild."""
    rng = np.random.default_rng(number)
    imu = replace(
        tick.measurement.imu,
        acceleration=rng.normal(size=3),
        angular_velocity=rng.normal(size=3),
        attitude=rng.normal(size=3),
    )
    measurement = replace(
        standing_measurement(),
        time=0.012 * number,
        age=float(rng.uniform()),
        position=rng.normal(size=17),
        current=rng.normal(size=17),
        wheel_speed=rng.normal(size=3),
        imu=imu,
    )
    reference = replace(
        tick.reference,
        position=rng.normal(size=17),
        velocity=rng.normal(size=17),
        acceleration=rng.normal(size=17),
        load_torque=rng.normal(size=17),
        base_twist=rng.normal(size=3),
    )
    sent = replace(
        tick.sent,
        position=rng.normal(size=17),
        stiffness=rng.uniform(size=17),
        wheel_speed=rng.normal(size=3),
    )
    return replace(tick, measurement=measurement, reference=reference, sent=sent)


def test_a_tick_that_repeats_a_cycle_is_left_out_of_the_recording(tmp_path: Path) -> None:
    samples, path = Samples(1), tmp_path / "a.mcap"
    with LogWriter(path, ROBOT, {}, lossless=True) as log:
        for k in (0, 1, 2, 2, 3, 3, 4):
            log.append(TickRecord(tick=finite(samples.tick(k), k)))
    assert len(read_log(path)["time"]) == 7
    assert len(recording_of(read_log(path), ROBOT)) == 5


def test_a_recording_of_another_robot_or_of_nothing_is_refused(tmp_path: Path) -> None:
    log, _ = written(tmp_path / "a.mcap")
    other = replace(log, joint_names=log.joint_names[::-1])
    with pytest.raises(RecordingError, match="other joints"):
        recording_of(other, ROBOT)
    with pytest.raises(RecordingError, match="two samples"):
        recording_of(written(tmp_path / "b.mcap", ticks=1)[0], ROBOT)


def test_labels_are_pushes_of_unknown_size(tmp_path: Path) -> None:
    labels = [end(0.1, "onset"), end(0.4, "release"), end(1.0, "onset"), end(1.5, "release")]
    first, second = pushes_of(written(tmp_path / "a.mcap", *labels)[0])
    assert (first.onset, first.release, second.onset, second.release) == (0.1, 0.4, 1.0, 1.5)
    assert (first.link, first.joint, first.direction) == ("Head", "HeadPitch", 0)
    assert all(math.isnan(x) for x in (first.force, first.torque, first.degrees))
    assert not any((first.moving, first.saturating, first.saturated))


def test_a_touch_that_was_not_released_lasts_until_the_end_of_the_log(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    log, made = written(tmp_path / "a.mcap", end(0.01, "onset"))
    with caplog.at_level(logging.WARNING):
        (push,) = pushes_of(log)
    assert push.release == made[-1].measurement.time
    assert "0.010 s: the touch was not released" in caplog.text


def test_labels_out_of_order_are_left_out_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    labels = [end(0.1, "release"), end(0.2, "onset"), end(0.3, "onset"), end(0.4, "release")]
    with caplog.at_level(logging.WARNING):
        (push,) = pushes_of(written(tmp_path / "a.mcap", *labels)[0])
    assert (push.onset, push.release) == (0.2, 0.4)
    assert "0.100 s: release without an onset" in caplog.text
    assert "0.300 s: onset inside a touch" in caplog.text


def test_a_log_without_touches_or_places_is_refused(tmp_path: Path) -> None:
    for labels in ((), (end(0.1, "release"),)):
        log, _ = written(tmp_path / "a.mcap", *labels)
        with pytest.raises(LabelError, match="no labelled touch"):
            pushes_of(log)
    log, _ = written(tmp_path / "b.mcap", end(0.1, "onset", None), end(0.2, "release", None))
    with pytest.raises(LabelError, match=r"0\.100 s does not say what was touched"):
        pushes_of(log)
    (push,) = pushes_of(log, link="LForeArm", joint="LElbowRoll")
    assert (push.link, push.joint) == ("LForeArm", "LElbowRoll")
