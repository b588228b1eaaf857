"""Benefit and cost of the oscillation of an attentive robot, by wave form, slide and period.

Motion: robots of the development split stand with bent arms, and nothing touches them. The ground truth gives the
fraction of time in which joints slide, the longest time in which one does not, gear travel, and motion of the hand.
Currents are measured; what the motors warm by them in the end follows from the plant. Each joint is sized by
its true friction, as a perfect identification would give it. No observer takes part.

Joint, with --joint: each arm joint of these robots alone, in the stick-slip model of the observer, without noise. A
touch of 5 N on the hand begins at each phase of the oscillation, against and along it, on the day of the identification
and on days with less and more friction. It shows once both position and drive differ by 0.4 deg from those without it.

Touch, with --touch: N90 by place. Each robot is identified as by its owner, and people touch it as in the row `even` of
the judge, in the state `attentive`: `fusion`, and the momentum observer for comparison.

What is chosen is chosen on these robots. Each run that is over is in the JSON file: the same command goes on after
Ctrl-C.
Run: python benchmarks/attentive.py --draws 0-3 --json attentive.json
     python benchmarks/attentive.py --draws 0-7 --no-motion --touch --folder attentive-models --json attentive.json
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np
from rich.console import Console
from rich.table import Table
from seeded_runs import FILE_WIDTH, Parser, Result, perform, read_results

from pepper_driver import Pepper, PepperError
from pepper_driver.cli.evaluate_split import DEFAULT_FOLDER
from pepper_driver.config import (
    ControllerSettings,
    RobotConfig,
    load_controller_settings,
    load_robot,
)
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.experiment import load_experiment
from pepper_driver.config.population import parse_draws
from pepper_driver.config.settings import AttentiveSettings, Wave
from pepper_driver.config.touch_suites import load_touch_suites
from pepper_driver.controller import RobotModel, Tick
from pepper_driver.controller.dither import Dither
from pepper_driver.evaluation.touch.n90 import ForceTouch, n90
from pepper_driver.evaluation.touch.observers import FUSION, ModelFiles
from pepper_driver.evaluation.touch.scoring import score_take
from pepper_driver.evaluation.touch.split import CALIBRATION, EXPERIMENT, perform_and_observe
from pepper_driver.evaluation.touch.takes import TakeSpec, plan_takes
from pepper_driver.identification import identify_population
from pepper_driver.observer.models.stick_slip import StickSlipModel, StickSlipParameters

POPULATION = "random"
STATE, ROW = "attentive", "even"
OBSERVERS = (FUSION, "momentum")
POSTURE = {
    "LShoulderPitch": 0.9,
    "LShoulderRoll": 0.25,
    "LElbowYaw": -1.2,
    "LElbowRoll": -1.0,
    "RShoulderPitch": 0.9,
    "RShoulderRoll": -0.25,
    "RElbowYaw": 1.2,
    "RElbowRoll": 1.0,
}
HAND, HAND_POINT, HAND_ROOT = "l_wrist", (0.07, 0.0, 0.0), "torso"
NOISE = 5  # seed of sensors and transport
SLIDES, PERIODS = (0.6, 1.0, 1.3), (2.5,)  # [deg], [s]
OVER, MIN_SPEED = (
    5,
    0.006,
)  # cycles over which a speed is taken, and the one above which a joint slides [rad/s]
LEVERS = {
    "LShoulderPitch": 0.4,
    "LShoulderRoll": 0.4,
    "LElbowYaw": 0.15,
    "LElbowRoll": 0.22,
}  # [m] of the hand
TOUCH, TOUCH_TIME, RISE, VISIBLE = 5.0, 1.0, 0.1, 0.4  # [N], [s], [s], [deg]
DAYS = (0.8, 1.0, 1.25)  # friction of a day over that of the identification
PHASES = 16
MAX_SECONDS, MAX_DEGREES, MAX_PERIOD = 3600.0, 5.0, 60.0
OFF = "off"


@dataclass(frozen=True)
class Case:
    """An oscillation: wave form, slide [deg], period [s]."""

    wave: Wave
    slide: float
    period: float

    @property
    def name(self) -> str:
        """As ``glide 1 deg 2.5 s``."""
        return f"{self.wave} {self.slide:g} deg {self.period:g} s"

    def settings(self, shipped: AttentiveSettings) -> AttentiveSettings:
        """Return the shipped settings with this oscillation."""
        turn = min(shipped.turn_time, 0.4 * self.period)
        return replace(
            shipped,
            wave=self.wave,
            slide_deg=self.slide,
            period=self.period,
            turn_time=turn,
        )


# -- motion -----------------------------------------------------------------------------------------------------------


def sized(pepper: Pepper, case: Case | None, settings: ControllerSettings) -> ControllerSettings:
    """Return the settings of a case for a robot whose friction is known exactly."""
    plant = pepper.backend.plant
    assert plant.config is not None
    breakaway = plant.config.per_joint("friction.breakaway", pepper.config)
    # One way in motion, the other way at rest: half of both.
    half = plant.friction * (1.0 + breakaway) / 2.0 / plant.stiffness
    attentive = settings.attentive if case is None else case.settings(settings.attentive)
    return replace(settings, attentive=attentive).with_friction(
        dict(zip(pepper.config.joint_names, half.tolist(), strict=True))
    )


def move(draw: int, case: Case | None, seconds: float) -> Result:
    """One robot that stands attentive, or just stands: results of its joints."""
    robot, uri = load_robot(), f"mujoco://?plant={POPULATION}&draw={draw}&seed={NOISE}"
    settings = load_controller_settings(robot)
    controller = sized(Pepper(uri, observer=None, robot=robot), case, settings)
    joints = [robot.joint_index(name) for name in settings.attentive.joints]
    true, commanded, current, temperature = [], [], [], []
    with Pepper(uri, observer=None, robot=robot, controller=controller) as pepper:
        truth = pepper.backend.truth

        def note(tick: Tick, _: object) -> None:
            true.append(truth.position)
            commanded.append(tick.reference.position)
            current.append(tick.measurement.current)
            temperature.append(tick.measurement.temperature)

        pepper.set_posture(POSTURE, duration=2.0)
        pepper.attentive = case is not None
        pepper.run(2.0 + 2.0 * settings.attentive.fade_time)
        pepper.run(seconds, on_tick=note)
    plant = pepper.backend.plant.config
    assert plant is not None
    position = np.array(true)
    slides = sliding(position[:, joints], robot.cycle)
    names = [robot.joint_names[joint] for joint in joints]
    rise = np.array([plant.heat.rise[robot.motors.joints[name].type] for name in names])
    resistance = np.array([robot.motors.of(name).resistance for name in names])
    squared = (np.array(current)[:, joints] ** 2).mean(axis=0)
    moved = np.ptp(position[:, joints], axis=0)
    lost = np.ptp(np.array(commanded)[:, joints], axis=0) - moved
    hours = len(position) * robot.cycle / 3600.0
    return {
        "law": "integral" if any(drive.ki for drive in plant.actuators) else "nominal",
        "joints": names,
        "friction_deg": [controller.attentive.friction_deg[name] for name in names],
        "half_gap_deg": np.degrees(plant.per_joint("half_gap", robot)[joints]).tolist(),
        "sliding": slides.mean(axis=0).tolist(),
        "pause": longest_pause(slides, robot.cycle).tolist(),
        "moved_deg": np.degrees(moved).tolist(),
        "lost_deg": np.degrees(lost).tolist(),
        "travel": (np.abs(np.diff(position[:, joints], axis=0)).sum(axis=0) / hours).tolist(),
        "current": np.array(current)[:, joints].mean(axis=0).tolist(),
        "heat": (rise * resistance * squared).tolist(),
        "temperature": temperature[-1][joints].tolist(),
        "hand": hand_motion(robot, position),
    }


def sliding(position: FloatArray, cycle: float) -> BoolArray:
    """Return (n - 2 OVER, joints) where joints slide, from their true positions (n, joints) [rad]."""
    speed = np.abs(position[2 * OVER :] - position[: -2 * OVER]) / (2 * OVER * cycle)
    slides: BoolArray = speed > MIN_SPEED
    return slides


def longest_pause(slides: BoolArray, cycle: float) -> FloatArray:
    """Return the longest time in which each joint does not slide [s]."""
    max_pause, run = np.zeros((2, slides.shape[1]))
    for row in slides:
        run = np.where(row, 0.0, run + cycle)
        max_pause = np.maximum(max_pause, run)
    return max_pause


def hand_motion(robot: RobotConfig, position: FloatArray) -> float:
    """Return the largest distance of the hand from the middle of its motion, seen from the torso [m]."""
    model = RobotModel(robot)
    hand, root = model.body_frame(HAND, HAND_POINT), model.body_frame(HAND_ROOT)
    places = []
    for row in position[::OVER]:
        model.set_state(model.configuration(row), np.zeros(model.nv))
        model.update_kinematics()
        places.append(model.pose(root).actInv(model.pose(hand)).translation)
    away = np.array(places) - np.mean(places, axis=0)
    return float(np.linalg.norm(away, axis=1).max())


# -- one joint --------------------------------------------------------------------------------------------------------


def show(draw: int, case: Case) -> Result:
    """Joints of one robot alone, touched: delays after which the touch shows [s], sliding and travel."""
    robot = load_robot()
    pepper = Pepper(f"mujoco://?plant={POPULATION}&draw={draw}", observer=None, robot=robot)
    settings = sized(pepper, case, load_controller_settings(robot)).attentive
    plant = pepper.backend.plant
    config = plant.config
    assert config is not None
    proportional, integral = config.per_joint("kp", robot), config.per_joint("ki", robot)
    breakaway = config.per_joint("friction.breakaway", robot)
    periods = np.arange(0.0, 3.0 * case.period + TOUCH_TIME + 1.0, robot.cycle)
    delays: list[float | None] = []
    slides, travel = [], []
    for (name, lever), day in itertools.product(LEVERS.items(), DAYS):
        j, motor, drive = robot.joint_index(name), robot.motors.of(name), robot.motors.joints[name]
        stiffness = float(plant.stiffness[j])
        parameters = StickSlipParameters(
            inertia=motor.rotor_inertia * drive.ratio**2 / stiffness,
            lag=motor.torque_constant * drive.ratio / float(proportional[j]),
            friction=day * float(plant.friction[j]) / stiffness,
            load_friction=0.0,
            breakaway=float(breakaway[j]),
            load_gain=1.0 / stiffness,
            offset=0.0,
            dead_band=0.0,
            integral_rate=float(integral[j] / proportional[j]),
            transport=0.0,
        )
        command = oscillation(robot, settings, name, len(periods))
        model = StickSlipModel.from_parameters([parameters], robot.cycle)
        free = model.play(0, command[0], command, np.zeros_like(command)).copy()
        late = free["position"][round(case.period / robot.cycle) :]
        slides.append(float(sliding(late[:, None], robot.cycle).mean()))
        travel.append(float(np.abs(np.diff(late)).sum() / (len(late) - 1) / robot.cycle * 3600.0))
        for onset, sign in itertools.product(np.arange(PHASES) / PHASES, (1.0, -1.0)):
            time = periods - (1.0 + onset) * case.period
            acts = (time >= 0.0) & (time < TOUCH_TIME)
            load = sign * TOUCH * lever * np.minimum(time / RISE, 1.0) * acts
            touched = model.play(0, command[0], command, load)
            moved = touched["position"] - free["position"]
            driven = touched["integral"] - free["integral"] - moved
            shows = np.minimum(np.abs(moved), np.abs(driven)) > np.radians(VISIBLE)
            first = np.flatnonzero(shows & acts)
            delays.append(float(time[first[0]]) if len(first) else None)
    return {"delays": delays, "sliding": slides, "travel": travel}


def oscillation(
    robot: RobotConfig, settings: AttentiveSettings, joint: str, ticks: int
) -> FloatArray:
    """Return the (ticks,) oscillation of a joint at its full size [rad]."""
    dither, j = Dither(robot, settings, robot.cycle), robot.joint_index(joint)
    dither.enabled = True
    middle = (robot.lower + robot.upper) / 2.0
    command = np.empty(ticks)
    for _ in range(round(settings.fade_time / robot.cycle) + 1):
        dither.step(middle)
    for tick in range(ticks):
        dither.step(middle)
        command[tick] = dither.position[j]
    return command


# -- touch ------------------------------------------------------------------------------------------------------------


def touch_specs(robot: RobotConfig, draw: int, touches: int | None) -> list[TakeSpec]:
    """Return the takes of a robot with the touches of N90 alone, so many of each take; None for all."""
    suites = load_touch_suites(robot)
    takes = [take for take in plan_takes(suites, draw, 0.0) if take.state == STATE]
    return [
        replace(take, acts=tuple(act for act in take.acts if act.row.name == ROW)[:touches])
        for take in takes
    ]


def identify(draws: Sequence[int], folder: Path, jobs: int, console: Console) -> dict[int, Path]:
    """Return the model file of each robot, by the identification of its owner; one without models is left out."""
    robot = load_robot()
    experiment = load_experiment(EXPERIMENT, robot)
    robots = identify_population(
        f"mujoco://?plant={POPULATION}",
        draws,
        experiment,
        "fusion",
        folder,
        calibration=load_experiment(CALIBRATION, robot),
        seed=experiment.seed,
        workers=jobs,
        progress=lambda one, done, all_: console.print(f"{one.name}: identified", highlight=False),
    )
    for one in robots:
        if one.file is None:
            console.print(f"{one.name}: left out, {one.reason}", highlight=False)
    return {one.draw: one.file for one in robots if one.file is not None}


def touch(draw: int, case: Case, models: Path, touches: int | None) -> Result:
    """One robot, touched in this oscillation: by observer, place, force and True if it was detected; false contacts."""
    robot = load_robot()
    shipped = load_controller_settings(robot).attentive
    found: Result = {name: {"touches": [], "false": 0, "hours": 0.0} for name in OBSERVERS}
    for spec in touch_specs(robot, draw, touches):
        take = perform_and_observe(
            spec, ModelFiles(fusion=models), OBSERVERS, attentive=case.settings(shipped)
        )
        if take.failure:
            continue
        for name in OBSERVERS:
            score = score_take(take, name, robot.limbs)
            found[name]["touches"] += [
                [one.touch.place, one.touch.force, one.detected] for one in score.touches
            ]
            found[name]["false"] += len(score.false)
            found[name]["hours"] += score.hours
    return found


# -- tables -----------------------------------------------------------------------------------------------------------


def of_group(names: Sequence[str], group: str) -> list[int]:
    """Return the places of the joints of a group."""
    return [place for place, name in enumerate(names) if ("Head" in name) is (group == "head")]


def motion_table(results: dict[str, Result], cases: Sequence[Case | None]) -> Table:
    """Return a row for each case, board law and group of joints."""
    columns = ["oscillation", "boards", "joints", "slides", "minimum", "longest pause, s"]
    columns += ["swing, deg", "travel, rad/h", "current, A", "heat, K", "hottest, K", "hand, mm"]
    table = Table(*columns, title="Simulated: nothing touches the standing robot")
    for case, law, group in itertools.product(cases, ("nominal", "integral"), ("arms", "head")):
        ending = f" {OFF}" if case is None else f" {case.name}"
        runs = {n: r for n, r in results.items() if n.endswith(ending) and r.get("law") == law}
        if not runs:
            continue
        joints = of_group(next(iter(runs.values()))["joints"], group)

        def values(key: str, of: dict[str, Result] = runs, at: list[int] = joints) -> FloatArray:
            return np.array([np.array(run[key])[at] for run in of.values()])

        hand = max(run["hand"] for run in runs.values())
        table.add_row(
            "none" if case is None else case.name,
            law,
            group,
            f"{values('sliding').mean():.2f}",
            f"{values('sliding').min():.2f}",
            f"{values('pause').max():.2f}",
            f"{values('moved_deg').mean():.1f}",
            f"{values('travel').mean():.0f}",
            f"{values('current').mean():.2f}",
            f"{values('heat').mean():.0f}",
            f"{values('heat').max():.0f}",
            f"{1e3 * hand:.1f}" if group == "arms" else "",
        )
    return table


def size_table(results: dict[str, Result]) -> Table:
    """Return a row for each joint: what friction and gap take away from a swing, and what is allowed for."""
    table = Table(
        "robot", "joint", "allowed for, deg", "lost, deg", "half of the gap, deg",
        title="Simulated: half of what is lost of a swing, from peak to peak",
    )  # fmt: skip
    for name, run in results.items():
        if " motion " not in f" {name} " or f" {OFF}" in name:
            continue
        rows = zip(
            run["joints"], run["friction_deg"], run["lost_deg"], run["half_gap_deg"], strict=True
        )
        for joint, friction, lost, gap in rows:
            cells = (f"{value:.2f}" for value in (friction, lost / 2.0, gap))
            table.add_row(name, joint, *cells)
    return table


def joint_table(results: dict[str, Result], cases: Sequence[Case]) -> Table:
    """Return a row for each case."""
    table = Table(
        "oscillation", "slides", "travel, rad/h", "touches that show", "after (median), ms", "after (p90), ms",
        title=f"Stick-slip model of one joint: touches of {TOUCH:g} N on the hand",
    )  # fmt: skip
    for case in cases:
        runs = [run for name, run in results.items() if name.endswith(f"joint {case.name}")]
        delays = [delay for run in runs for delay in run["delays"]]
        # A touch that does not show is later than any that does.
        ranked = np.sort([np.inf if delay is None else delay for delay in delays])
        table.add_row(
            case.name,
            f"{np.mean([run['sliding'] for run in runs]):.2f}",
            f"{np.mean([run['travel'] for run in runs]):.0f}",
            f"{np.isfinite(ranked).mean():.3f}",
            *(f"{1e3 * ranked[int(part * (len(ranked) - 1))]:.0f}" for part in (0.5, 0.9)),
        )
    return table


def touch_table(results: dict[str, Result], cases: Sequence[Case]) -> Table:
    """Return a row for each case, observer and place."""
    table = Table(
        "oscillation", "observer", "place", "N90, N", "detected", "false, in touched hours",
        title="Simulated: touches of 1 s on attentive robots",
    )  # fmt: skip
    for case, observer in itertools.product(cases, OBSERVERS):
        runs = {n: r[observer] for n, r in results.items() if n.endswith(f"touch {case.name}")}
        places = dict.fromkeys(place for run in runs.values() for place, _, _ in run["touches"])
        false = sum(run["false"] for run in runs.values())
        hours = sum(run["hours"] for run in runs.values())
        for place in places:
            touches = [
                ForceTouch(force, detected, name)
                for name, run in runs.items()
                for where, force, detected in run["touches"]
                if where == place
            ]
            detected = sum(one.detected for one in touches)
            table.add_row(
                case.name,
                observer,
                place,
                n90(touches).text,
                f"{detected} of {len(touches)}",
                f"{false} in {hours:.2f} h",
            )
    return table


# -- command ----------------------------------------------------------------------------------------------------------


def arguments() -> argparse.Namespace:
    """Return the options, checked."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    waves = get_args(Wave)
    parser.add_argument("--draws", default="0-3", help="robots of the development split")
    parser.add_argument("--waves", nargs="+", default=waves, choices=waves)
    parser.add_argument("--slides", nargs="+", type=float, default=SLIDES, help="[deg]")
    parser.add_argument("--periods", nargs="+", type=float, default=PERIODS, help="[s]")
    parser.add_argument("--seconds", type=float, default=60.0, help="of motion of each robot")
    parser.add_argument("--no-motion", action="store_true", help="leave the motion out")
    parser.add_argument("--joint", action="store_true", help="when a touch shows on one joint")
    parser.add_argument("--touch", action="store_true", help="measure N90")
    parser.add_argument("--touches", type=int, help="of each take; by default all")
    parser.add_argument(
        "--folder", type=Path, default=DEFAULT_FOLDER / "attentive", help="keeps models"
    )
    parser.add_argument("--sizes", action="store_true", help="what each joint loses of its swing")
    parser.add_argument("--jobs", type=int, default=1, help="processes; -1 for one per core")
    parser.add_argument("--json", type=Path, help="results, and where it goes on")
    given = parser.parse_args()
    for name, values, maximum in (
        ("slides", given.slides, MAX_DEGREES),
        ("periods", given.periods, MAX_PERIOD),
        ("seconds", [given.seconds], MAX_SECONDS),
    ):
        if not all(0.0 < value <= maximum for value in values):
            parser.error(f"--{name}: above 0, and {maximum:g} at most")
    if given.touches is not None and given.touches < 1:
        parser.error("--touches must be 1 or more")
    if given.jobs < 1 and given.jobs != -1:
        parser.error(f"--jobs must be 1 or more, or -1, got {given.jobs}")
    return given


def main() -> int:
    """Measure, print tables, and return the exit code."""
    given = arguments()
    progress = Console(stderr=True)
    try:
        if given.json is not None and given.json.is_file():
            read_results(given.json)  # before anything is measured
        draws = parse_draws(given.draws)
        cases = [
            Case(*case) for case in itertools.product(given.waves, given.slides, given.periods)
        ]
        runs: dict[str, Callable[[], Result]] = {}
        if not given.no_motion:
            for draw, case in itertools.product(draws, (None, *cases)):
                name = f"{POPULATION} {draw} motion {OFF if case is None else case.name}"
                runs[name] = partial(move, draw, case, given.seconds)
        if given.joint:
            for draw, case in itertools.product(draws, cases):
                runs[f"{POPULATION} {draw} joint {case.name}"] = partial(show, draw, case)
        if given.touch:
            models = identify(draws, given.folder, given.jobs, progress)
            for draw, case in itertools.product(models, cases):
                name = f"{POPULATION} {draw} touch {case.name}"
                runs[name] = partial(touch, draw, case, models[draw], given.touches)
        results = perform(runs, given.json, given.jobs, progress)
    except PepperError as error:
        print(f"attentive.py: {error}", file=sys.stderr)
        return 2
    # A file has no width that cells would have to be folded for.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else FILE_WIDTH)
    if not given.no_motion:
        motion = {name: run for name, run in results.items() if " motion " in name}
        console.print(motion_table(motion, (None, *cases)))
        if given.sizes:
            console.print(size_table(motion))
    if given.joint:
        console.print(joint_table(results, cases))
    if given.touch:
        console.print(touch_table(results, cases))
    return 0


if __name__ == "__main__":
    sys.exit(main())
