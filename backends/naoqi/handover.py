"""Handover: stiffness up at the begin; wheels, legs and joints given back in the end."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from itertools import count

import numpy as np

from pepper_driver.backends.fields import Measurement
from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.motion_profile import PEAK_SPEED_RATIO, minimum_jerk
from pepper_driver.backends.naoqi.dcm_channel import DcmChannel
from pepper_driver.backends.naoqi.memory_keys import Alias
from pepper_driver.config import NaoqiSettings, PepperError, RobotConfig, SafetySettings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.clock import SYSTEM_CLOCK, Clock
from pepper_driver.config.signals import check_signals

logger = logging.getLogger("pepper_driver")

MIN_STIFFNESS = 0.1
"""Stiffness below which a joint has none."""

WHEELS_AT_REST = np.zeros(3)


def ramp_up(
    link: DcmChannel,
    robot: RobotConfig,
    settings: NaoqiSettings,
    safety: SafetySettings,
    check: Callable[[], object],
) -> tuple[FloatArray, Measurement]:
    """Raise the stiffness to 1, of no joint from less than it has already, holding the posture measured.

    Args:
        link: With the robot.
        robot: Its limits, into which the posture is clipped.
        settings: How long it takes.
        safety: Age of samples at which it is not raised any further.
        check: Raises when the connection is lost.

    Returns:
        (17,) the posture held [rad], and what is measured then.

    Raises:
        BackendError: The robot stopped answering meanwhile.
    """
    paced_ticks, cycle = cycle_timer(robot.cycle, link=link), robot.cycle
    measurement = link.newest
    for _ in range(3):  # taking the robot over may have lasted: what was measured before is old
        next(paced_ticks)
        check()
        measurement = link.exchange(None, WHEELS_AT_REST, WHEELS_AT_REST)
    hold = np.clip(measurement.position, robot.lower, robot.upper)
    before = link.start()
    ticks, wheels_on = round(settings.timing.ramp_up / cycle), False
    for tick in range(1, ticks + 1):
        next(paced_ticks)
        check()
        check_signals()
        if not wheels_on and tick > ticks // 10:  # by now the wheels have a command to stand
            # Before the tick's own commands, which use up the limit of commands in flight.
            wheels_on = link.switch_wheels([((ticks - tick) * cycle, 1.0)])
        measurement = link.exchange(hold, np.maximum(before, tick / ticks), WHEELS_AT_REST)
        # Without samples the loop cannot see where the joints are: more stiffness would be a hazard.
        if not measurement.age <= safety.stale_fault:
            raise BackendError(
                f"the robot stopped answering while its stiffness was raised: the newest sample is "
                f"{1e3 * measurement.age:.0f} ms old; check the network, then start again"
            )
    if not wheels_on:
        raise BackendError(
            "the robot took no command to switch its wheels on; check the network, then start again"
        )
    return hold, measurement


def release_robot(
    link: DcmChannel,
    robot: RobotConfig,
    settings: NaoqiSettings,
    safety: SafetySettings,
    posture: FloatArray,
) -> bool:
    """Stop the wheels, lead the legs back, make all other joints soft.

    The legs keep their stiffness, unless the settings say otherwise: without brakes the robot would bow. No joint gets
    back the stiffness that another program lowered meanwhile; if it was the legs', as of a robot that goes to rest,
    they are not led back either.

    Args:
        link: With the robot.
        robot: Its description.
        settings: How fast.
        safety: Age of samples at which no leg is moved any further, and the loss of stiffness that counts as lowered by
            another program.
        posture: (17,) where ALMotion last sent the joints [rad]: legs that it finds elsewhere jerk. NaN where it does
            not say.

    Returns:
        Whether the robot took part; False as soon as it does not answer.
    """
    legs = np.array([name in robot.chains["legs"] for name in robot.joint_names])
    paced_ticks, begin = cycle_timer(robot.cycle, link=link), link.clock.seconds()

    def tick(position: FloatArray | None, stiffnesses: FloatArray) -> Measurement | None:
        """None where the robot does not answer."""
        next(paced_ticks)
        measurement = link.exchange(position, stiffnesses, WHEELS_AT_REST)
        patient = (
            min(link.unacknowledged_time, link.clock.seconds() - begin) <= settings.end_silence
        )
        return measurement if link.connected and patient else None

    for number in range(round(settings.wheel_stop_time / robot.cycle)):
        measurement = tick(None, link.stiffness)
        if measurement is None:
            return False
        at_rest = bool((np.abs(measurement.wheel_speed) < settings.wheel_stop_speed).all())
        # The first samples may be of cycles before the command to stand.
        if number >= 2 and at_rest and link.idle:
            break
    off = [(2 * robot.cycle, 0.0)]
    wheels_off = link.switch_wheels(off)

    stiffness = link.stiffness
    lowered = _shown(link, stiffness) < stiffness - safety.stiffness_loss
    legs_home = np.full(len(legs), np.nan)
    if (lowered & legs).any():
        logger.warning(
            "another program lowered the stiffness of the legs: they are not moved any more"
        )
    elif not _moved_by_others(link.newest, robot):
        legs_home = np.where(legs & np.isfinite(posture), posture, np.nan)
    stiffness = np.where(lowered, _shown(link, stiffness), stiffness)
    if not _return_legs(link, robot, legs_home, settings, stiffness, safety.stale_fault, tick):
        return False

    soft = np.zeros(len(legs)) if settings.release_legs else np.where(legs, stiffness, 0.0)
    ticks = round(settings.timing.ramp_down / robot.cycle)
    for number in range(1, ticks + 1):
        wheels_off = wheels_off or link.switch_wheels(off)
        # The program that lowers the stiffness may still be running.
        # fmin ignores NaN, a stiffness that is unknown.
        soft = np.where(lowered, np.fmin(soft, _shown(link, soft)), soft)
        stiffnesses = stiffness + (soft - stiffness) * number / ticks
        if tick(None, np.where(lowered, soft, stiffnesses)) is None:
            return False
    while not (wheels_off and link.idle and np.array_equal(link.stiffness, soft)):
        wheels_off = wheels_off or link.switch_wheels(off)
        if tick(None, soft) is None:
            return False
    return True


def _shown(link: DcmChannel, otherwise: FloatArray) -> FloatArray:
    """(17,) stiffness at the motor boards, as far as known; a very small one counts as 0."""
    shown = link.newest.stiffness
    return otherwise if shown is None else np.where(shown < MIN_STIFFNESS, 0.0, shown)


def _moved_by_others(measurement: Measurement, robot: RobotConfig) -> bool:
    """Return True, with a warning, where another program commands legs, as one that sends the robot to rest."""
    moved = not set(robot.chains["legs"]).isdisjoint(measurement.commanded_by_others)
    if moved:
        logger.warning("another program moves the legs: they are left to it")
    return moved


def _return_legs(
    link: DcmChannel,
    robot: RobotConfig,
    goal: FloatArray,
    settings: NaoqiSettings,
    stiffness: FloatArray,
    stale: float,
    tick: Callable[[FloatArray | None, FloatArray], Measurement | None],
) -> bool:
    """Lead joints to ``goal``, NaN where they stay; False where the robot does not answer.

    Broken off by the button on the chest, by another program that moves legs, and without fresh samples: no other
    program supervises the robot any more.
    """
    try:
        start = link.commanded(Alias.POSITION, settings.end_silence)
    except PepperError as error:
        logger.warning("%s", error)
        return False
    distance = np.where(np.isfinite(goal), goal - start, 0.0)
    farthest = float(np.abs(distance).max())
    if farthest <= settings.leg_tolerance:
        return True
    speed = settings.timing.leg_return_speed
    # leg_return_speed limits the peak of the minimum-jerk motion, not its mean.
    ticks = round(PEAK_SPEED_RATIO * farthest / speed / robot.cycle)
    for number in range(1, ticks + 1):
        measurement = tick(start + distance * minimum_jerk(number / ticks), stiffness)
        if measurement is None:
            return False
        if not measurement.age <= stale or measurement.buttons.any():
            logger.warning(
                "the legs do not return to where ALMotion left them: before it moves them, let the robot rest"
            )
            break
        if _moved_by_others(measurement, robot):
            break
    return True


def cycle_timer(
    cycle: float,
    ticks: int | None = None,
    *,
    link: DcmChannel | None = None,
    clock: Clock = SYSTEM_CLOCK,
) -> Iterator[int]:
    """Yield the number of each tick when it begins, ``cycle`` [s] apart, the first at once; wait after the last too.

    With a link they follow the robot's, by its clock, each with its sample requested in time. What was missed is not
    made up for.
    """
    clock = clock if link is None else link.clock
    due = clock.now()
    for tick in count() if ticks is None else range(ticks):
        yield tick
        shift = 0.0 if link is None else np.clip(link.phase_error(due), -0.001, 0.001)
        due += round(1e9 * (cycle + shift))
        if link is not None and link.request_lead:
            _sleep_until(clock, due - round(1e9 * link.request_lead))
            link.request()
        due = max(due, clock.now())
        _sleep_until(clock, due)


def _sleep_until(clock: Clock, moment: int) -> None:
    """Wait until a time of the clock [ns], which may be over."""
    rest = moment - clock.now()
    if rest > 0:
        clock.sleep(rest * 1e-9)
