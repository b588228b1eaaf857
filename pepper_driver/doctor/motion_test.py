"""Motion test of ``pepper doctor``: small free motions, compared with the models."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import accumulate

import numpy as np

from pepper_driver.backends.readiness import CheckResult, failed, named, rated, unknown
from pepper_driver.config import (
    DoctorSettings,
    Experiment,
    PepperError,
    RobotConfig,
    load_doctor_settings,
    load_observer_settings,
    load_self_collision,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.steps import Step
from pepper_driver.controller import RobotModel, Tick
from pepper_driver.controller.collision import CapsuleDistances
from pepper_driver.doctor.checks import NETWORK
from pepper_driver.doctor.model_fit import JointFit, ModelFitMonitor, Verdict
from pepper_driver.identification.measurements.noise import late_fraction, measure_noise
from pepper_driver.identification.measurements.program import measured_joints
from pepper_driver.identification.measurements.response import ResponseError, measure_response
from pepper_driver.observer import (
    Contact,
    ContactObserver,
    ModelSet,
    Observation,
    Recording,
    RecordingBuilder,
)
from pepper_driver.observer.models.measured_robot import MeasuredRobot
from pepper_driver.observers import measured_robot, uri_with_measured_delay
from pepper_driver.robot import Pepper
from pepper_driver.session import OnTick

SEED = 1
"""Of the goals: each motion is the same, so that they can be compared over months."""

MIN_FOLLOWING_FRACTION = 0.4
"""Of the amplitude that each goal is away from the middle at least."""

STEPS = 6
"""Steps of the clearance motion that are tried, from none to all of it."""


class NoRoomError(PepperError, RuntimeError):
    """The arms are where they cannot move freely; nothing has moved."""


def moving_joints(robot: RobotConfig) -> tuple[str, ...]:
    """Return the joints of arms and head: those that cannot tip the robot over."""
    return tuple(name for name in robot.joint_names if name not in robot.chains["legs"])


def plan_goals(start: FloatArray, robot: RobotConfig, settings: DoctorSettings) -> list[FloatArray]:
    """(17,) goals [rad] from one side of a middle to the other, and back to the start at the end.

    The middle is the first posture, moved off limits and, as far as needed, with the arms aside: where links are near,
    the controller would move the legs for them.

    Args:
        start: (17,) the first posture [rad], within the limits.
        robot: Its description.
        settings: Amplitudes and distances.

    Raises:
        NoRoomError: Links are too near to one another all the same.
    """
    room = _Room(robot, settings.clearance)
    aside = np.zeros(len(start))
    for joint, angle in settings.clearance_motion.items():
        aside[robot.joint_index(joint)] = angle
    for fraction in np.linspace(0.0, 1.0, STEPS):
        goals = _goals_around(start + fraction * aside, robot, settings)
        if all(room.is_free(goal) for goal in goals):
            return [*goals, start]
    raise NoRoomError(
        "there is no room for a small motion around this posture: links are too near to one another; "
        "bring the arms away from the body by hand, robot at rest"
    )


def _goals_around(
    posture: FloatArray, robot: RobotConfig, settings: DoctorSettings
) -> list[FloatArray]:
    moving = np.array([name not in robot.chains["legs"] for name in robot.joint_names])
    is_hand = np.array([name in robot.hands.joints for name in robot.joint_names])
    amplitude = np.where(is_hand, settings.hand_amplitude, settings.amplitude) * moving
    edge = amplitude + settings.limit_distance * moving
    middle = np.where(moving, np.clip(posture, robot.lower + edge, robot.upper - edge), posture)
    rng = np.random.default_rng(SEED)
    side = rng.choice([-1.0, 1.0], len(posture))
    goals = [middle]
    for _ in range(round(settings.motion / settings.segment_time) - 2):
        side = -side
        goals.append(
            middle + side * amplitude * rng.uniform(MIN_FOLLOWING_FRACTION, 1.0, len(posture))
        )
    return goals


class _Room:
    """Says whether links keep a distance [m]."""

    def __init__(self, robot: RobotConfig, distance: float) -> None:
        self._model = RobotModel(robot)
        self._capsules = CapsuleDistances(self._model, load_self_collision(robot))
        self._distance = distance

    def is_free(self, posture: FloatArray) -> bool:
        self._capsules.place(self._model.configuration(posture))
        return not self._capsules.any_near(self._distance)


REST = 0.25
"""[s] at each goal."""

SMALL_MOTION, SMALL_STEPS = "small motion", "small steps"

RESPONSE_STEP = 0.035
"""[rad] of the steps that show when the currents answer."""

RESPONSE_PAIRS = 8
"""Steps to either side."""

RESPONSE_REST = 0.9
"""[s] after each."""

RESPONSE_STIFFNESS = 900.0
"""[1/s2] of the posture task: each step begins with the largest acceleration."""

NOISE_REST = 2.5
"""[s] before them, in which the noise of the sensors shows."""

RESPONSE_TIME = NOISE_REST + 2 * RESPONSE_PAIRS * RESPONSE_REST
"""[s] of all steps."""

MAX_NOISE_RATIO = 3.0
"""Noise of an encoder over that when the models were identified: thresholds have a margin for less."""

MAX_LATE_CHANGE = 0.05
"""Fraction of the samples that may come late beyond that when the models were identified."""

MAX_DELAY_CHANGE = 1
"""Ticks by which the delay may differ from that of the models: more, and their residuals are those of another robot."""


@dataclass(frozen=True, kw_only=True)
class MotionTest:
    """Results of the small motion.

    Attributes:
        results: Of its checks.
        fits: By joint that moved; empty where the motion was broken off.
        recordings: Of its motions by name, as far as they came.
    """

    results: tuple[CheckResult, ...]
    fits: tuple[JointFit, ...]
    recordings: Mapping[str, Recording] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """True if no check failed."""
        return not failed(self.results)


def make_pepper(uri: str, models: ModelSet | None, robot: RobotConfig) -> Pepper:
    """Return the robot for a motion test, with the observer that everybody uses, or without models with none."""
    if models is None:
        return Pepper(uri, observer=None, robot=robot)
    observer = ContactObserver(robot, models, load_observer_settings())
    measured = measured_robot(models)
    return Pepper(uri_with_measured_delay(uri, measured), observer=observer, robot=robot)


def try_motion(
    pepper: Pepper,
    models: ModelSet | None,
    *,
    on_progress: Callable[[float], None] | None = None,
) -> MotionTest:
    """Move each joint of arms and head by a few degrees, and compare with its model. Failures are in the results.

    Args:
        pepper: Of :func:`make_pepper`, not active; it is closed afterwards.
        models: To judge; None for a robot that is not identified yet: then its delay and its motion are judged.
        on_progress: Called with the fraction of the time that has passed, 0..1.
    """
    robot, settings = pepper.config, load_doctor_settings()
    watch = ModelFitMonitor(robot, models, load_observer_settings(), moving_joints(robot))
    contacts: list[Contact] = []
    builders = {name: RecordingBuilder(robot) for name in (SMALL_MOTION, SMALL_STEPS)}

    def listen(_: Tick, observation: Observation | None) -> None:
        if observation is not None:
            contacts.extend(c for c in observation.contacts if c.phase == "begin")

    def on_tick(tick: Tick, observation: Observation | None) -> None:
        builders[SMALL_MOTION].append(tick)
        watch.step(tick, observation)
        listen(tick, observation)

    def on_steps_tick(tick: Tick, _: Observation | None) -> None:
        builders[SMALL_STEPS].append(tick)

    try:
        with pepper:
            middle, *goals = plan_goals(pepper.target, robot, settings)
            moves = partial(_moves, robot=robot, seconds=settings.segment_time - REST)
            there = moves([middle, *goals[:-1], middle])
            _play(
                pepper,
                (
                    (Experiment(schema=2, name=SMALL_MOTION, steps=there), on_tick),
                    (_response_motion(middle, robot), on_steps_tick),
                    # Not compared: an observer that missed the small steps does not know where friction holds.
                    (Experiment(schema=2, name="back", steps=moves([goals[-1]])), listen),
                ),
                on_progress,
            )
            statistics = pepper.statistics
    except PepperError as error:
        result = rated(
            "motion",
            f"broken off: {error}",
            failure=True,
            remedy="find what stopped the robot, remove the cause, and examine the robot again",
        )
        return MotionTest(results=(result,), fits=(), recordings=_finished(builders))
    recordings = _finished(builders)
    fraction = statistics.missed / (statistics.ticks + statistics.missed)
    ticks = rated(
        "motion",
        statistics.summary,
        warning=fraction > settings.late_fraction,
        remedy="end other programs on this computer, and permit real-time priority (docs/realtime.md)",
    )
    fits = watch.fits(settings)
    delay = _judge_delay(recordings[SMALL_STEPS], models, pepper.backend.info.response_delay, robot)
    sensors = _judge_sensors(recordings[SMALL_STEPS], measured_robot(models), robot)
    results: tuple[CheckResult, ...] = (ticks, delay, sensors, _judge_following(fits))
    if models is not None:
        results += (_judge_models(fits, settings), _judge_touch(contacts))
    return MotionTest(results=results, fits=fits, recordings=recordings)


def _play(
    pepper: Pepper,
    parts: Sequence[tuple[Experiment, OnTick]],
    on_progress: Callable[[float], None] | None,
) -> None:
    """Play experiments one after the other; the progress is that of all of them."""
    ends = list(accumulate(experiment.max_length for experiment, _ in parts))
    for (experiment, on_tick), begin in zip(parts, (0.0, *ends), strict=False):

        def advance(fraction: float, begin: float = begin, part: Experiment = experiment) -> None:
            if on_progress is not None:
                on_progress((begin + fraction * part.max_length) / ends[-1])

        pepper.play(experiment, on_tick=on_tick, on_progress=advance)


def _finished(builders: Mapping[str, RecordingBuilder]) -> dict[str, Recording]:
    """Return the recordings that have samples."""
    return {name: builder.finish() for name, builder in builders.items() if len(builder) > 1}


def _moves(goals: Sequence[FloatArray], robot: RobotConfig, seconds: float) -> tuple[Step, ...]:
    """Return steps to goals (17,), one after the other."""
    return tuple(
        Step(
            joints=dict(zip(robot.joint_names, goal.tolist(), strict=True)),
            duration=seconds,
            hold=REST,
        )
        for goal in goals
    )


def _response_motion(middle: FloatArray, robot: RobotConfig) -> Experiment:
    """Return small steps of all moving joints at once to either side of a posture (17,), after a rest there."""
    stepped = middle.copy()
    for joint in measured_joints(robot):
        stepped[robot.joint_index(joint)] += RESPONSE_STEP
    rest, there, back = (
        Step(joints=dict(zip(robot.joint_names, goal.tolist(), strict=True)), hold=hold)
        for goal, hold in (
            (middle, NOISE_REST),
            (stepped, RESPONSE_REST),
            (middle, RESPONSE_REST),
        )
    )
    return Experiment(
        schema=2,
        name=SMALL_STEPS,
        stiffness=RESPONSE_STIFFNESS,
        steps=(rest, *RESPONSE_PAIRS * (there, back)),
    )


def _judge_delay(
    recording: Recording, models: ModelSet | None, reported: int, robot: RobotConfig
) -> CheckResult:
    """Compare the delay from a command to its current with that of the models."""
    try:
        measured = measure_response(recording, measured_joints(robot), robot)
    except ResponseError as error:
        return unknown("delay", str(error))
    delay = reported + measured.lead
    found = f"{delay} ticks from a command to its answer"
    if models is None:
        return rated("delay", f"{found}, {reported} reported; identification measures it")
    known = models.measured
    if known is None:
        return rated(
            "delay",
            f"{found}, {reported} reported; these models do not say with which they were identified",
            warning=measured.lead != 0,
            remedy="identify again with 'pepper identify', which measures it",
        )
    change = delay - known.response_delay
    return rated(
        "delay",
        f"{found}, {known.response_delay} when the models were identified",
        failure=abs(change) > MAX_DELAY_CHANGE,
        warning=change != 0,
        remedy="use the same network, a cable if possible; if it stays, identify again with 'pepper identify'",
    )


def _judge_sensors(
    recording: Recording, before: MeasuredRobot | None, robot: RobotConfig
) -> CheckResult:
    """Compare noise of the encoders at rest and late samples with those before, when models were identified."""
    noise = {}
    for joint in measured_joints(robot):
        at_rest = measure_noise(recording, joint)
        if at_rest is not None:
            noise[joint] = at_rest[0]
    if not noise:
        return unknown("sensors", "no joint rested")
    late, worst = late_fraction([recording]), max(noise, key=lambda joint: noise[joint])
    found = f"noise {np.degrees(noise[worst]):.3f} deg at {worst}, {late:.1%} of the samples late"
    if before is None:
        return rated("sensors", found)
    # A noise below a step of the encoder is that of the step.
    least = robot.sensors.encoder.step / 4
    rough = [
        joint in before.joints
        and size > MAX_NOISE_RATIO * max(before.joints[joint].encoder_noise or 0.0, least)
        for joint, size in noise.items()
    ]
    parts, remedies = [found], []
    if any(rough):
        parts.append(f"much more than when the models were identified: {named(noise, rough)}")
        remedies.append("let the robot rest and try again; an encoder that stays noisy is loose")
    if late > before.late + MAX_LATE_CHANGE:
        parts.append(f"{before.late:.1%} late when the models were identified")
        remedies.append(NETWORK)
    return rated("sensors", "; ".join(parts), warning=bool(remedies), remedy="; ".join(remedies))


def _judge_following(fits: tuple[JointFit, ...]) -> CheckResult:
    stuck = [fit.verdict is Verdict.STUCK for fit in fits]
    least = min(fits, key=lambda fit: fit.follows)
    return rated(
        "joints follow",
        f"{least.joint} least, {least.follows:.0%} of its distance",
        failure=any(stuck),
        remedy=f"{named((fit.joint for fit in fits), stuck)}: blocked, without power or broken; move it by hand with "
        "the robot at rest, then start the robot again",
    )


def _judge_models(fits: tuple[JointFit, ...], settings: DoctorSettings) -> CheckResult:
    """On all joints together, and on the worst ones."""
    names = [fit.joint for fit in fits]
    known = [fit for fit in fits if np.isfinite(fit.rms)]
    if not known:
        return rated(
            "models fit", "no joint has a model", failure=True, remedy="identify: 'pepper identify'"
        )
    worst = max(known, key=lambda fit: fit.rms)
    median = float(np.median([fit.rms for fit in known]))
    found = f"residual over threshold, rms: median {median:.2f}, {worst.rms:.2f} at {worst.joint}"
    identify = "identify it with 'pepper identify'"
    if median > settings.misfit_median:
        return rated(
            "models fit",
            f"{found}: these models are not of this robot as it is",
            failure=True,
            remedy=f"{identify}, or give the models of this robot with --models",
        )
    misfit = [fit.verdict is Verdict.MISFIT for fit in fits]
    worn = [fit.verdict is Verdict.WORN for fit in fits]
    parts, remedies = [found], []
    if any(misfit):
        parts.append(f"do not fit: {named(names, misfit)}")
        remedies.append(f"see that nothing touches the robot; if nothing does, {identify}")
    if any(worn):
        parts.append(f"worn or carrying: {named(names, worn)}")
        remedies.append(
            f"empty the hands (a load has the same effect) and try again; if it stays, {identify}: until then "
            "light touches of these joints are not detected"
        )
    return rated(
        "models fit",
        "; ".join(parts),
        failure=any(misfit),
        warning=any(worn),
        remedy="; ".join(remedies),
    )


def _judge_touch(contacts: list[Contact]) -> CheckResult:
    links = list(dict.fromkeys(contact.link for contact in contacts))
    number = "1 contact" if len(contacts) == 1 else f"{len(contacts)} contacts"
    return rated(
        "untouched",
        f"{number} detected: {named(links, [True] * len(links))}"
        if links
        else "no contact detected",
        failure=bool(links),
        remedy="something touches the robot, or the model does not fit: clear the space around it and try again; "
        "if nothing was there, identify it with 'pepper identify'",
    )
