"""A small free motion of arms and head, to see whether the joints follow and their models fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pepper_driver.config import (
    DoctorSettings,
    Experiment,
    PepperError,
    RobotConfig,
    load_doctor_settings,
    load_observer_settings,
)
from pepper_driver.config.steps import Step
from pepper_driver.controller import Tick
from pepper_driver.doctor.body import named
from pepper_driver.doctor.goals import moving_joints, plan_goals
from pepper_driver.doctor.model_fit import FitWatch, JointFit, Verdict
from pepper_driver.doctor.result import Result, failed, rated
from pepper_driver.observer import Contact, ContactObserver, ModelSet, Observation
from pepper_driver.robot import Pepper

REST = 0.25
"""[s] at each goal."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """How the small motion went.

    Attributes:
        results: Of its checks.
        fits: By joint that moved; empty where the motion was broken off.
    """

    results: tuple[Result, ...]
    fits: tuple[JointFit, ...]

    @property
    def passed(self) -> bool:
        """Whether no check failed."""
        return not failed(self.results)


def make_pepper(uri: str, models: ModelSet, robot: RobotConfig) -> Pepper:
    """The robot for a trial, with the observer that everybody uses."""
    observer = ContactObserver(robot, models, load_observer_settings())
    return Pepper(uri, observer=observer, robot=robot)


def try_motion(
    pepper: Pepper, models: ModelSet, *, on_progress: Callable[[float], None] | None = None
) -> Trial:
    """Move each joint of arms and head by a few degrees, and compare with its model. Whatever fails is in the results.

    Args:
        pepper: Of :func:`make_pepper`, not active; it is closed afterwards.
        models: To judge.
        on_progress: Told the share of the time that is over, 0..1.
    """
    robot, settings = pepper.config, load_doctor_settings()
    watch = FitWatch(robot, models, load_observer_settings(), moving_joints(robot))
    contacts: list[Contact] = []

    def on_tick(tick: Tick, observation: Observation | None) -> None:
        watch.step(tick, observation)
        if observation is not None:
            contacts.extend(c for c in observation.contacts if c.phase == "begin")

    try:
        with pepper:
            goals = plan_goals(pepper.target, robot, settings)
            steps = [
                Step(
                    joints=dict(zip(robot.joint_names, goal.tolist(), strict=True)),
                    duration=settings.stretch - REST,
                    hold=REST,
                )
                for goal in goals
            ]
            motion = Experiment(schema=2, name="small motion", steps=tuple(steps))
            pepper.play(motion, on_tick=on_tick, on_progress=on_progress)
            statistics = pepper.statistics
    except PepperError as error:
        result = rated(
            "motion",
            f"broken off: {error}",
            failure=True,
            cure="find what stopped the robot, cure it, and examine the robot again",
        )
        return Trial(results=(result,), fits=())
    share = statistics.missed / (statistics.ticks + statistics.missed)
    ticks = rated(
        "motion",
        statistics.summary,
        warning=share > settings.late_share,
        cure="end other programs on this computer, and permit real-time priority (docs/realtime.md)",
    )
    fits = watch.fits(settings)
    results = (
        ticks,
        _judge_following(fits),
        _judge_models(fits, settings),
        _judge_touch(contacts),
    )
    return Trial(results=results, fits=fits)


def _judge_following(fits: tuple[JointFit, ...]) -> Result:
    stuck = [fit.verdict is Verdict.STUCK for fit in fits]
    least = min(fits, key=lambda fit: fit.follows)
    return rated(
        "joints follow",
        f"{least.joint} least, {least.follows:.0%} of its way",
        failure=any(stuck),
        cure=f"{named((fit.joint for fit in fits), stuck)}: blocked, without power or broken; move it by hand with "
        "the robot at rest, then start the robot again",
    )


def _judge_models(fits: tuple[JointFit, ...], settings: DoctorSettings) -> Result:
    """On all joints together, and on the worst ones."""
    names = [fit.joint for fit in fits]
    known = [fit for fit in fits if np.isfinite(fit.rms)]
    if not known:
        return rated(
            "models fit", "no joint has a model", failure=True, cure="identify: 'pepper identify'"
        )
    worst = max(known, key=lambda fit: fit.rms)
    median = float(np.median([fit.rms for fit in known]))
    found = (
        f"residual over threshold, rms: {median:.2f} as a rule, {worst.rms:.2f} at {worst.joint}"
    )
    identify = "identify it with 'pepper identify'"
    if median > settings.misfit_median:
        return rated(
            "models fit",
            f"{found}: these models are not of this robot as it is",
            failure=True,
            cure=f"{identify}, or give the models of this robot with --models",
        )
    misfit = [fit.verdict is Verdict.MISFIT for fit in fits]
    worn = [fit.verdict is Verdict.WORN for fit in fits]
    parts, cures = [found], []
    if any(misfit):
        parts.append(f"do not fit: {named(names, misfit)}")
        cures.append(f"see that nothing touches the robot; if nothing does, {identify}")
    if any(worn):
        parts.append(f"worn or carrying: {named(names, worn)}")
        cures.append(
            f"empty the hands (a load looks the same) and try again; if it stays, {identify}: until then "
            "light touches of these joints are not felt"
        )
    return rated(
        "models fit",
        "; ".join(parts),
        failure=any(misfit),
        warning=any(worn),
        cure="; ".join(cures),
    )


def _judge_touch(contacts: list[Contact]) -> Result:
    felt = list(dict.fromkeys(contact.link for contact in contacts))
    number = "1 contact" if len(contacts) == 1 else f"{len(contacts)} contacts"
    return rated(
        "untouched",
        f"{number} felt: {named(felt, [True] * len(felt))}" if felt else "no contact felt",
        failure=bool(felt),
        cure="something touches the robot, or the model does not fit: clear the space around it and try again; "
        "if nothing was there, identify it with 'pepper identify'",
    )
