"""Times at which samples are requested, and at which the DCM follows a command computed from one: in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, reject
from hypothesis import strategies as st

from pepper_driver.backends.naoqi.dcm_channel import MAX_REQUEST_LEAD, SAMPLE_PHASE, TICK_PHASE
from pepper_driver.backends.naoqi.timing import SlowLinkError
from support.examples import examples
from support.virtual_robot import (
    CYCLE,
    ROBOT,
    SETTINGS,
    Network,
    VirtualLoop,
    VirtualRobot,
    link_with,
    wifi,
    wire,
)

STAND = ROBOT.posture("Stand")
ONES, STILL = np.ones(17), np.zeros(3)
STEP = 1e-5  # [rad] by which each command differs from the one before

SAMPLE_QUESTIONS = ("getListData", "getTime")


@dataclass
class Reaction:
    """Times of a run without its first second.

    Attributes:
        cycles: From the cycle of each sample to the cycle in which the DCM followed the command computed from it.
        late: Fraction of ticks whose sample was late.
        crowded: Fraction of ticks with more than one question under way.
    """

    cycles: list[float]
    late: float
    crowded: float

    @property
    def median(self) -> float:
        return float(np.median(self.cycles))


def react(
    network: Network, *, step_order: bool = False, ticks: int = 800, phase: float = 3.0
) -> Reaction:
    """Run ticks and look in the DCM's book for the command of each.

    Args:
        network: Between the two.
        step_order: As with ``step``: the command of the tick before goes out first, no sample is requested, and ticks
            begin at the same phase on any network.
        ticks: Number.
        phase: Of the robot's cycles [ms].
    """
    robot = VirtualRobot(network, phase=phase)
    loop = VirtualLoop(robot, request=not step_order, compute=0.0 if step_order else 1.5)
    link = loop.link
    if step_order:
        link._tick_phase = TICK_PHASE * ROBOT.cycle
    link.start()
    samples, ages, crowded, last = [], [], [], STAND
    for tick in range(ticks):
        loop.wait()
        if step_order:
            loop.write(last, ONES, STILL)
        measurement = loop.read()
        crowded.append(sum(robot.unanswered[question] for question in SAMPLE_QUESTIONS) > 1)
        last = STAND + STEP * (tick + 1)
        if not step_order:
            loop.write(last, ONES, STILL)
        samples.append(measurement.tick - round(measurement.age / ROBOT.cycle))
        ages.append(measurement.age)
    robot.pass_time(robot.time + 200.0)
    followed = {
        round((joints[0] - STAND[0]) / STEP): date for date, (joints, _) in robot.commanded.items()
    }
    exact = {
        number: date
        for number, date in followed.items()
        if abs(robot.commanded[date][0][0] - STAND[0] - STEP * number) < 1e-9
    }
    # The first sample of the link, of cycle 0, was of an earlier one than the ticks'.
    first = link._cycles.date(0)
    cycles = [
        (exact[tick + 1] - first) / CYCLE - sample
        for tick, sample in enumerate(samples)
        if tick >= 84 and tick + 1 in exact
    ]
    return Reaction(cycles, float(np.mean(np.array(ages[84:]) > 0.006)), float(np.mean(crowded)))


@pytest.mark.parametrize("phase", [0.0, 3.0, 6.0, 9.0, 11.9])
def test_on_a_quick_link_a_reaction_takes_two_cycles_less_than_with_step(phase: float) -> None:
    now = react(wire(1), phase=phase)
    before = react(wire(1), phase=phase, step_order=True)
    assert now.median == pytest.approx(3.0, abs=0.1)
    assert before.median - now.median == pytest.approx(2.0, abs=0.1)
    assert np.percentile(now.cycles, 99) <= np.percentile(before.cycles, 99) - 1.9
    assert now.late <= 0.002
    assert not now.crowded


@pytest.mark.parametrize("phase", [0.0, 3.0, 6.0, 9.0, 11.9])
@pytest.mark.parametrize(
    "network",
    [wifi, lambda seed: wifi(seed, stalls=False), lambda seed: wire(seed, jitter=1.5)],
    ids=["wifi", "wifi without stalls", "jitter"],
)
def test_under_jitter_and_latency_it_takes_at_least_one_cycle_less(
    network: Callable[[int], Network], phase: float
) -> None:
    now = react(network(2), phase=phase)
    before = react(network(2), phase=phase, step_order=True)
    assert before.median - now.median >= 0.9
    assert now.median < 4.1
    assert now.late <= before.late + 0.01
    assert not now.crowded


def test_wireless_samples_come_in_time() -> None:
    """Else half of them were late by a cycle, and the observed contact would tremble."""
    late = [react(wifi(seed, stalls=False)).late for seed in range(4)]
    assert np.mean(late) < 0.03


@pytest.mark.parametrize("publication", [0.0, 1.5, 2.3])
def test_values_that_the_robot_publishes_late_are_still_those_of_the_cycle(
    publication: float,
) -> None:
    robot = VirtualRobot(wire(3), publication=publication)
    loop = VirtualLoop(robot)
    ages = []
    for _ in range(500):
        loop.wait()
        ages.append(loop.read().age)
    assert not np.array(ages[50:]).any()


def test_a_sample_is_requested_as_long_before_its_tick_as_it_takes() -> None:
    quick, slow, hopeless = (
        link_with(VirtualRobot(network))
        for network in (lambda _: 0.5, lambda _: 3.0, lambda _: 6.5)
    )
    assert 1e3 * quick.request_lead == pytest.approx(1.0 + 1.5, abs=0.1)
    assert 1e3 * slow.request_lead == pytest.approx(6.0 + 1.5, abs=0.1)
    assert hopeless.request_lead == 0.0, "asked for in the tick before"
    assert slow.request_lead < MAX_REQUEST_LEAD * ROBOT.cycle


@pytest.mark.parametrize(
    ("way", "phase"),
    [
        (0.5, TICK_PHASE),
        (3.0, SAMPLE_PHASE + 7.5 / CYCLE),
        (5.0, SAMPLE_PHASE),
        (9.0, SAMPLE_PHASE),
    ],
)
def test_ticks_begin_when_their_sample_has_come_and_it_is_never_requested_too_early(
    way: float, phase: float
) -> None:
    robot = VirtualRobot(lambda _: way, phase=4.0)
    loop = VirtualLoop(robot)
    for _ in range(400):
        loop.wait()
        loop.read()

    def after(time: float) -> float:
        """[cycles] of the robot."""
        return (robot.dcm_time(time) - robot.first_cycle) % CYCLE / CYCLE

    assert (after(loop.began[-1]) - phase + 0.5) % 1.0 - 0.5 == pytest.approx(0.0, abs=0.05)
    last = loop.began[-100]
    requested = [time for time, what in robot.asked if what == "getListData" and time > last]
    assert min(after(time) for time in requested) >= SAMPLE_PHASE - 0.05
    assert len(requested) <= 100, "one for each tick"


@examples(25)
@given(
    delay=st.floats(0.1, 8.0),
    jitter=st.floats(0.0, 3.0),
    late=st.sets(st.integers(50, 290), max_size=20),
    seed=st.integers(0, 1000),
)
def test_one_question_at_most_is_under_way_and_samples_keep_coming(
    delay: float, jitter: float, late: set[int], seed: int
) -> None:
    """On any way that is not refused, and where ticks begin late too."""
    rng = np.random.default_rng(seed)
    robot = VirtualRobot(lambda _: delay + jitter * float(rng.exponential()))
    try:
        loop = VirtualLoop(robot)
    except SlowLinkError:
        reject()
    dates = []
    for tick in range(300):
        loop.wait(late=7.0 if tick in late else 0.0)
        loop.read()
        dates.append(loop.link._reader.date)
        assert sum(robot.unanswered[question] for question in SAMPLE_QUESTIONS) <= 1
    new = np.count_nonzero(np.diff(dates[50:]))
    # A cycle whose question is still under way goes without one.
    cycles = np.ceil(np.quantile(2 * delay + jitter * rng.gamma(2.0, size=10_000), 0.9) / CYCLE)
    assert new >= 0.85 * 249 / cycles - len(late)


def test_an_answer_that_is_late_costs_one_sample() -> None:
    """It is of the cycle in which it was asked for; the next request finds its way free."""
    robot = VirtualRobot(lambda _: 0.3)
    loop = VirtualLoop(robot)
    ages = []
    for tick in range(120):
        if tick == 100:
            robot._network = lambda _: 4.0
        loop.wait()
        ages.append(round(loop.read().age / ROBOT.cycle))
        robot._network = lambda _: 0.3
    assert ages[95:] == [0] * 5 + [1] + [0] * 19


def test_programs_that_never_request_get_the_sample_that_was_asked_for_a_tick_ago() -> None:
    robot = VirtualRobot(wire(4))
    loop = VirtualLoop(robot, request=False)
    ages, ticks, dates = [], [], []
    for _ in range(300):
        loop.wait()
        measurement = loop.read()
        ages.append(measurement.age)
        ticks.append(measurement.tick)
        dates.append(robot.dcm_time(robot.time) - loop.link._reader.date)
    assert not np.array(ages[50:]).any()
    assert set(np.diff(ticks[50:]).tolist()) == {1}
    assert np.median(dates) == pytest.approx(CYCLE * (1 + TICK_PHASE), abs=1.5)


def test_who_begins_to_request_in_the_middle_soon_has_the_sample_of_the_tick() -> None:
    """As where a loop of its own made the first ticks."""
    robot = VirtualRobot(wire(4))
    loop = VirtualLoop(robot, request=False)
    for _ in range(100):
        loop.wait()
        loop.read()
    loop.followed.request_lead = loop.link.request_lead
    late = []
    for _ in range(50):
        loop.wait()
        loop.read()
        late.append(robot.dcm_time(robot.time) - loop.link._reader.date > CYCLE)
    assert not any(late[2:])


@pytest.mark.parametrize("pause", [100.0, 1000.0, 5003.0])
def test_the_first_sample_after_a_pause_is_fresh(pause: float) -> None:
    """It is requested; without that it was the one asked for before the pause."""
    robot = VirtualRobot(wire(5))
    loop = VirtualLoop(robot)
    for _ in range(100):
        loop.wait()
        loop.read()
    robot.pass_time(robot.time + pause)
    loop.wait()
    loop.wait()  # the first may have begun before its sample had come
    measurement = loop.read()
    assert measurement.age <= ROBOT.cycle + 1e-9
    assert robot.dcm_time(robot.time) - loop.link._reader.date < 2 * CYCLE


def test_reads_without_writes_leave_joints_where_they_are_and_stop_the_wheels() -> None:
    """By the DCM's own dates: what reads does not write."""
    robot = VirtualRobot(wire(6))
    loop = VirtualLoop(robot)
    loop.link.start()
    for tick in range(100):
        loop.wait()
        loop.read()
        loop.write(STAND + 1e-3 * tick, ONES, np.array([1.0, -2.0, 3.0]))
    last, taken = robot.dcm_time(robot.time), robot.taken
    measured = []
    for _ in range(60):
        loop.wait()
        measured.append(loop.read())
    assert robot.taken - taken <= 2, "those under way"
    moving = [date for date, (_, wheels) in robot.commanded.items() if wheels.any()]
    assert moving[-1] - last < 1e3 * SETTINGS.timing.wheels.stop
    assert np.array_equal(robot.commanded[max(robot.commanded)][0], STAND + 1e-3 * 99)
    assert all(m.age == 0.0 for m in measured), "nothing is silent: it was sent nothing"
    assert measured[-1].response_delay == 0, "the last command written"
    loop.wait()
    loop.read()
    loop.write(STAND, ONES, STILL)
    robot.pass_time(robot.time + 100.0)
    assert np.array_equal(robot.commanded[max(robot.commanded)][0], STAND)
