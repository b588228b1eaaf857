"""Sensitivity of mode ``fusion``: each run-time constant at half and at twice its value, each part left out.

Robots of the development split are identified and touched once, as `pepper evaluate --split development` does; their
takes are kept. Each variant of the observer then gets the same takes. Printed are N90 of the hand of attentive robots,
the fraction of touches that are detected, false contacts, and the difference of this fraction from the shipped
observer: its mean over robots, and twice the standard error of this mean. Takes and variants that are over are kept:
the same command goes on after Ctrl-C.
Run: python benchmarks/sensitivity.py --draws 0-7 --folder runs/sensitivity --json sensitivity.json
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from rich.console import Console
from rich.table import Table

from pepper_driver import PepperError
from pepper_driver.config import load_experiment, load_observer_settings, load_robot
from pepper_driver.config.files import content_hash, make_folder, write_text
from pepper_driver.config.population import parse_draws
from pepper_driver.config.touch_suites import EVEN, load_touch_suites
from pepper_driver.config.workers import one_core
from pepper_driver.evaluation.touch.ledger import code_hash
from pepper_driver.evaluation.touch.observers import ABLATIONS, FUSION, ModelFiles, make, watch_all
from pepper_driver.evaluation.touch.records import RobotRecord, load_take, save_take
from pepper_driver.evaluation.touch.scoring import score_robot
from pepper_driver.evaluation.touch.split import CALIBRATION, EXPERIMENT, KNOWN_WEIGHT, board_law
from pepper_driver.evaluation.touch.summary import group_of, summarise_touch
from pepper_driver.evaluation.touch.takes import TakeSpec, perform, plan_takes
from pepper_driver.identification import identify_population
from pepper_driver.observer import ContactObserver, ModelSet, Observer, Recording, constants

SETTINGS = "config"

SETTINGS_VARIED = ("fusion_window", "false_contacts", "merge_gap", "rebound_window")
"""Of ``observer.yaml``: the others say how contacts are reported."""

CONSTANTS = {
    SETTINGS: SETTINGS_VARIED,
    "constants": tuple(name for name in vars(constants) if name.isupper()),
}
"""By their place, constants that decide if, when and on which limb a contact is reported."""

FACTORS = (0.5, 2.0)

GROUPS = ("standing", "attentive", "in motion")

VariantResult = dict[str, Any]
"""Of one variant: ``detected`` touches, by robot and group, (count, of); ``false`` by robot, alone and
touched; hours; N90 [N]."""


def variants(only: Sequence[str]) -> list[str]:
    """Return their names: the shipped observer, parts left out, and constants as ``PLACE:NAME*FACTOR``."""
    changed = [
        f"{place}:{name}*{factor:g}"
        for place, names in CONSTANTS.items()
        for name in names
        for factor in FACTORS
    ]
    return [
        variant
        for variant in (FUSION, *ABLATIONS, *changed)
        if not only or variant == FUSION or any(text in variant for text in only)
    ]


# -- takes ------------------------------------------------------------------------------------------------------------


def specs_of(draw: int) -> tuple[TakeSpec, ...]:
    """Return the takes of a development robot."""
    suites = load_touch_suites(load_robot())
    return plan_takes(suites, draw, suites.splits["development"].free)


def take_file(folder: Path, spec: TakeSpec) -> Path:
    """Return where the record of a take is kept; its ticks and true torques are next to it."""
    return folder / "takes" / f"{spec.draw}-{spec.name}.json.gz"


def ticks_file(take: Path) -> Path:
    """Return where the ticks of a take are kept."""
    return take.with_name(take.name.replace(".json.gz", ".npz"))


def torque_file(take: Path) -> Path:
    """Return where the true torques of a take are kept."""
    return take.with_name(take.name.replace(".json.gz", ".npy"))


def keep_take(spec: TakeSpec, models: Path, path: Path) -> None:
    """Perform a take, unless it was performed before."""
    if path.exists():
        return
    with one_core(1):
        done = perform(spec, models)
    if done.recording is not None:
        done.recording.save(ticks_file(path))
        np.save(torque_file(path), done.true_torque)
    save_take(done.take, path)


def perform_takes(draws: Sequence[int], folder: Path, workers: int) -> dict[int, Path]:
    """Identify and touch robots; return their models by their draw, without robots that could not be identified."""
    robot = load_robot()
    experiment = load_experiment(EXPERIMENT, robot)
    owners = identify_population(
        f"mujoco://?plant={load_touch_suites(robot).population}",
        draws,
        experiment,
        "fusion",
        folder / "models",
        calibration=load_experiment(CALIBRATION, robot),
        weight=KNOWN_WEIGHT,
        seed=experiment.seed,
        keep_recordings=True,
        workers=workers,
    )
    models = {owner.draw: owner.file for owner in owners if owner.file is not None}
    make_folder(folder / "takes")
    jobs = [(s, models[draw]) for draw in models for s in specs_of(draw)]
    Parallel(n_jobs=workers)(delayed(keep_take)(s, m, take_file(folder, s)) for s, m in jobs)
    return models


# -- one variant, in a process of its own -----------------------------------------------------------------------------


def change(constant: str, factor: float) -> None:
    """Change a constant wherever the observer has it; its kernels are not loaded yet."""
    place, name = constant.split(":")
    original = getattr(importlib.import_module(f"pepper_driver.observer.{place}"), name)
    value = type(original)(
        round(original * factor) if isinstance(original, int) else original * factor
    )
    for module in [m for n, m in sys.modules.items() if n.startswith("pepper_driver.")]:
        if module.__dict__.get(name) is original:
            setattr(module, name, value)


def observer_of(variant: str, models: Path) -> Observer:
    """Make the observer of a variant."""
    robot = load_robot()
    constant, _, factor = variant.partition("*")
    place, _, name = constant.partition(":")
    if place != SETTINGS:
        observer = constant if not factor else FUSION
        return make(observer, robot, ModelFiles(fusion=models))
    settings = load_observer_settings()
    value = getattr(settings, name)
    value = (
        max(round(value * float(factor)), 1) if isinstance(value, int) else value * float(factor)
    )
    changed: dict[str, Any] = {name: value}
    return ContactObserver(robot, ModelSet.load(models, robot), replace(settings, **changed))


def judge_robot(variant: str, draw: int, models: Path, folder: Path) -> RobotRecord:
    """Show the takes of a robot to a variant."""
    robot, takes = load_robot(), []
    law = board_law(load_touch_suites(robot).population, draw, robot)
    for spec in specs_of(draw):
        path = take_file(folder, spec)
        take = load_take(path)
        if take.failure:
            continue
        torque = np.load(torque_file(path))
        observed = watch_all(
            {FUSION: observer_of(variant, models)},
            Recording.load(ticks_file(path), robot),
            take.touches,
            robot,
            true_torque=torque if len(torque) else None,
        )
        takes.append(replace(take, hearings=observed))
    name = f"random {draw}"
    return RobotRecord(
        key="",
        robot=name,
        draw=draw,
        law=law,
        identity=name,
        failure="",
        fit={},
        warnings=(),
        takes=tuple(takes),
    )


def judge(variant: str, models: dict[int, Path], folder: Path) -> VariantResult:
    """Show all takes to a variant, and score it."""
    if ":" in variant and not variant.startswith(SETTINGS):
        constant, _, factor = variant.partition("*")
        change(constant, float(factor))
    robot = load_robot()
    records = [judge_robot(variant, draw, file, folder) for draw, file in models.items()]
    detected: dict[str, dict[str, list[int]]] = {}
    false: dict[str, list[int]] = {}
    hours = [0.0, 0.0]
    for record in records:
        groups = detected[record.robot] = {group: [0, 0] for group in GROUPS}
        counts = false[record.robot] = [0, 0]
        for take in score_robot(record, FUSION, tuple(robot.limbs)).takes:
            counts[take.suite == "touch"] += len(take.false)
            hours[take.suite == "touch"] += take.hours
            for score in take.touches:
                if score.touch.row == EVEN and (group := group_of(take.state)) in groups:
                    groups[group][0] += score.detected
                    groups[group][1] += 1
    ours = summarise_touch(records, (FUSION,), robot, by_state=()).observer(FUSION)
    assert ours is not None
    cells = {f"{cell.law}, {cell.place}, {cell.state}": cell.n90 for cell in ours.groups}
    return {
        "detected": detected,
        "false": false,
        "hours": hours,
        "n90": {name: None if n is None else n.newtons for name, n in cells.items()},
        "delay": ours.delays[0].fast.median,
        "first_limb": ours.located[0].first_limb.count / max(ours.located[0].first_limb.of, 1),
    }


def judge_apart(variant: str, models: dict[int, Path], folder: Path) -> VariantResult:
    """Judge a variant in a process of its own, or read what an earlier call found."""
    key = content_hash([variant, {d: str(m) for d, m in models.items()}, code_hash()])
    kept = folder / "variants" / f"{key}.json"
    if not kept.exists():
        request = json.dumps([variant, {d: str(m) for d, m in models.items()}, str(folder)])
        command = [sys.executable, __file__, "--judge", request]
        one = {**os.environ, "OMP_NUM_THREADS": "1"}
        done = subprocess.run(command, capture_output=True, text=True, env=one)
        if done.returncode:
            raise PepperError(f"{variant}: {done.stderr.strip()[-600:]}")
        write_text(kept, done.stdout)
    result: VariantResult = json.loads(kept.read_text())
    return result


# -- all of them ------------------------------------------------------------------------------------------------------


def detected_fraction(result: VariantResult, group: str) -> float:
    """Return the fraction of touches of a group that were detected."""
    parts = [robot[group] for robot in result["detected"].values()]
    detected, of = (sum(column) for column in zip(*parts, strict=True))
    return float(detected / max(of, 1))


def difference(result: VariantResult, shipped: VariantResult) -> str:
    """Return the difference of the fractions of all touches, mean over robots, and twice its standard error."""
    found = []
    for robot, groups in result["detected"].items():
        of = sum(part[1] for part in groups.values())
        before = sum(part[0] for part in shipped["detected"][robot].values())
        found.append((sum(part[0] for part in groups.values()) - before) / max(of, 1))
    spread = 2.0 * np.std(found, ddof=1) / math.sqrt(len(found)) if len(found) > 1 else math.nan
    return f"{np.mean(found):+.3f} +- {spread:.3f}"


def hand(result: VariantResult) -> str:
    """Return N90 of the hand of attentive robots, by law."""
    found = [result["n90"].get(f"{law}, hand, attentive") for law in ("nominal", "integral")]
    return " / ".join("-" if n is None else "> 30" if math.isinf(n) else f"{n:.1f}" for n in found)


def show(results: dict[str, VariantResult], console: Console) -> None:
    """Print a table."""
    shipped = results[FUSION]
    alone, touched = shipped["hours"]
    table = Table(
        title=f"Simulated, development robots: {len(shipped['detected'])}, {alone:.1f} h alone, {touched:.1f} h touched"
    )
    columns = (
        "N90 hand [N]",
        *GROUPS,
        "difference",
        "false, alone",
        "touched",
        "delay [ms]",
        "limb",
    )
    for name in ("variant", *columns):
        table.add_column(name)
    for variant, result in results.items():
        false = np.array(list(result["false"].values())).sum(axis=0)
        delay = result["delay"]
        table.add_row(
            variant,
            hand(result),
            *(f"{detected_fraction(result, group):.2f}" for group in GROUPS),
            difference(result, shipped),
            *(str(count) for count in false),
            "-" if delay is None else f"{1e3 * delay:.0f}",
            f"{result['first_limb']:.2f}",
        )
    console.print(table)


def main() -> int:
    """Perform takes, judge variants, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--draws", default="0-7", help="robots of the development split")
    parser.add_argument("--folder", type=Path, default=Path("runs/sensitivity"))
    parser.add_argument("--only", default="", help="parts of names of variants, by commas")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path, help="file for the results")
    parser.add_argument("--judge", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.judge:
        variant, files, folder = json.loads(options.judge)
        models = {int(draw): Path(file) for draw, file in files.items()}
        print(json.dumps(judge(variant, models, Path(folder))))
        return 0
    make_folder(options.folder / "variants")
    models = perform_takes(parse_draws(options.draws), options.folder, options.workers)
    names = variants([text for text in options.only.split(",") if text])
    found = Parallel(n_jobs=options.workers, prefer="threads")(
        delayed(partial(judge_apart, models=models, folder=options.folder))(name) for name in names
    )
    results = dict(zip(names, found, strict=True))
    show(results, Console())
    if options.json is not None:
        write_text(options.json, json.dumps(results, indent=1))
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except PepperError as error:
        sys.exit(f"sensitivity: {error}")
