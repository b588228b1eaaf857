"""Yielding, swinging back and retreat of an arm that is pushed: plant by plant.

The left arm stands in POSTURE, where it has arrived moving as it is then pushed ("arrived the other way": moving
against it, so that the friction of its gears holds twice over; "attentive": arms and head are kept just moving, after
both arrivals). The observer, with models of the nominal (or integral) plant, has seen half a minute of free motion. All
forces act at POINT, sideways and square to the forearm. Comply: 10 N for 1.5 s; measured is the way of that point, from
the true joint angles, and how often the velocity of a joint that gave way turns round after the release, in runs of
several seeds, for it hangs on where the joint happens to stand then. Retract: a springy hand takes hold and pulls;
measured is its force.
Run: python benchmarks/reflexes.py --json reflexes.json
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from pepper_driver import Comply, Pepper, Reflex, Retract
from pepper_driver.backends import Truth
from pepper_driver.config import load_observer_settings, load_robot
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.workers import run_jobs
from pepper_driver.controller import RobotModel, Tick
from pepper_driver.observer import ContactObserver, ModelSet
from pepper_driver.observer.models.model_file import shipped
from pepper_driver.reflexes.reflex import Then

PLANTS = ("nominal", "integral", "worn", "cold", "payload", "soft-hip", "jitter")
POSTURE = {"LShoulderPitch": 0.6, "LShoulderRoll": 0.3, "LElbowYaw": -1.0, "LElbowRoll": -0.2}
LINK, POINT = "LForeArm", np.array([0.14, 0.0, 0.0])  # [m] in the link
PUSHED = "LShoulderRoll"  # the joint that gives way most
FORCE, PUSH_TIME = 10.0, 1.5  # [N], [s]
FREE_TIME = 30.0  # [s] of motion in which the observer learns the robot
SWING = 0.15  # [rad] of that motion
GAVE_WAY = 0.02  # [rad] by which a joint has been led
TURNING = 0.03  # [rad/s] below which a velocity has no sign: the raw encoder, 14 bits, sees no less in a tick
HAND_STIFFNESS, PULL, RISE = 1000.0, 0.04, 0.1  # [N/m], [m], [s]
AWAY = 0.5  # [s] after detection
SEEDS = (3, 1, 2, 4, 5, 6)  # all for the reversals, the first for everything else
TURNS: dict[str, tuple[float | None, Then]] = {
    "without": (None, "resume"),
    "returns": (1.0, "resume"),
    "stays": (1.0, "stay"),
}
ALLOWED = {"without": 1, "returns": 1, "stays": 0}  # reversals after the release


def observer(plant: str) -> ContactObserver:
    """With the models that ship for the plant it is a variant of."""
    kind = "integral" if plant == "integral" else "nominal"
    return ContactObserver(
        load_robot(), ModelSet.load(shipped("fusion")[kind]), load_observer_settings()
    )


@contextmanager
def ready(
    plant: str,
    reflexes: list[Reflex],
    seed: int,
    *,
    against: bool = False,
    attentive: bool = False,
) -> Iterator[Pepper]:
    """A robot in POSTURE, whose observer has its models."""
    uri = f"mujoco://?plant={plant}&seed={seed}"
    with Pepper(uri, observer=observer(plant), reflexes=reflexes) as pepper:
        pepper.set_posture(POSTURE, duration=2.0)
        pepper.run(2.5)
        home, rng, config = pepper.target, np.random.default_rng(seed), pepper.config
        lower, upper = config.lower + 0.02, config.upper - 0.02
        upper_body = slice(config.joint_index("HeadYaw"), None)
        while pepper.time < FREE_TIME:
            posture = home.copy()
            posture[upper_body] += rng.uniform(-SWING, SWING, len(home[upper_body]))
            pepper.set_posture(np.clip(posture, lower, upper), duration=1.5)
            pepper.run(1.8)
        arrival = home.copy()
        arrival[config.joint_index(PUSHED)] += SWING if against else -SWING
        for posture in (arrival, home):
            pepper.set_posture(posture, duration=1.5)
            pepper.run(3.0)
        pepper.attentive = attentive
        pepper.run(3.0)
        yield pepper


def reversals(time: FloatArray, joints: FloatArray, release: float, led: BoolArray) -> int:
    """Count sign changes of the velocity of a joint that gave way, after the release: the worst joint."""
    speed = np.gradient(joints, time, axis=0)[time >= release]
    counts = [0]
    for joint in np.flatnonzero(led):
        signs = np.sign(speed[np.abs(speed[:, joint]) > TURNING, joint])
        counts.append(int(np.count_nonzero(np.diff(signs))))
    return max(counts)


def sideways(truth: Truth) -> FloatArray:
    """(3,) in the world: to the left of the robot, square to the forearm."""
    arm = truth.link_pose(LINK)[:3, 0]
    left = np.array([0.0, 1.0, 0.0]) - arm[1] * arm
    unit: FloatArray = left / np.linalg.norm(left)
    return unit


def comply(
    plant: str,
    gain: float | None,
    then: Then,
    seed: int,
    *,
    against: bool = False,
    attentive: bool = False,
) -> dict[str, Any]:
    """One push: way after a second and at most [m], reversals after it."""
    reflexes: list[Reflex] = [] if gain is None else [Comply(gain=gain, then=then)]
    rows: list[FloatArray] = []
    with ready(plant, reflexes, seed, against=against, attentive=attentive) as pepper:
        start, truth = pepper.time, pepper.backend.truth
        pepper.push(LINK, FORCE * sideways(truth), POINT, PUSH_TIME, rise=0.05)
        pepper.run(
            PUSH_TIME + 3.0,
            on_tick=lambda tick, _: rows.append(
                np.append(tick.measurement.time - start, truth.position)
            ),
        )
        detected = any(contact.time > start for contact in pepper.contact_history)
    table = np.array(rows)
    time, joints = table[:, 0], table[:, 1:]
    model = RobotModel(load_robot())
    way = [model.link_pose(LINK, q) @ np.append(POINT, 1.0) for q in joints]
    distance = np.linalg.norm(np.array(way)[:, :3] - way[0][:3], axis=1)
    pushed = time <= PUSH_TIME
    led = np.abs(joints[pushed] - joints[0]).max(axis=0) > GAVE_WAY
    return {
        "detected": detected,
        "way_1s": float(distance[np.searchsorted(time, 1.0)]),
        "way": float(distance[pushed].max()),
        "reversals": reversals(time, joints, PUSH_TIME, led),
    }


def retract(plant: str, seed: int) -> dict[str, Any]:
    """One pull: force when it is detected, and AWAY later [N]."""
    rows: list[tuple[float, float]] = []
    with ready(plant, [Retract()], seed) as pepper:
        start, truth = pepper.time, pepper.backend.truth

        def note(tick: Tick, _: object) -> None:
            force = sum(float(np.linalg.norm(contact.force)) for contact in truth.contacts)
            rows.append((tick.measurement.time - start, force))

        pull = PULL * sideways(truth)
        pepper.backend.grab(LINK, pull, POINT, stiffness=HAND_STIFFNESS, rise=RISE, hold=2.0)
        pepper.run(2.2, on_tick=note)
        begun = [c.time - start for c in pepper.contact_history if c.time > start]
    if not begun:
        return {"detected": False, "at_detection": float("nan"), "later": float("nan")}
    time, force = np.array(rows).T
    at, later = (force[np.searchsorted(time, begun[0] + wait)] for wait in (0.0, AWAY))
    return {"detected": True, "at_detection": float(at), "later": float(later)}


def measure(plant: str, seeds: Sequence[int]) -> dict[str, Any]:
    """All results of one plant."""
    seed, *others = seeds
    once = {
        "without": comply(plant, None, "resume", seed),
        "stiff": comply(plant, 0.0, "resume", seed),
        "half": comply(plant, 0.5, "resume", seed),
        "returns": comply(plant, 1.0, "resume", seed),
        "stays": comply(plant, 1.0, "stay", seed),
    }
    return {
        **once,
        "against": comply(plant, 1.0, "resume", seed, against=True),
        "attentive": [
            comply(plant, 1.0, "resume", seed, against=against, attentive=True)
            for against in (False, True)
        ],
        "retract": retract(plant, seed),
        "reversals": {
            case: [once[case]["reversals"]]
            + [comply(plant, gain, then, other)["reversals"] for other in others]
            for case, (gain, then) in TURNS.items()
        },
    }


def millimetres(values: dict[str, Any]) -> str:
    """Way of one push after a second, for the table."""
    return f"{values['way_1s'] * 1e3:.0f}{'' if values['detected'] else ' (not detected)'}"


def main() -> None:
    """Measure all plants, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", nargs="+", default=PLANTS, choices=PLANTS)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    console = Console()
    results = run_jobs(partial(measure, plant, options.seeds) for plant in options.plants)
    plants = dict(
        zip(
            options.plants,
            track(results, total=len(options.plants), console=Console(stderr=True)),
            strict=True,
        )
    )
    table = Table(title="Simulated: 10 N at the forearm, and a hand that pulls at it")
    for column in (
        "plant",
        "without, mm",
        "stiff, ratio",
        "half, mm",
        "free 1 s, mm",
        "arrived the other way, mm",
        "attentive: so / the other way, mm",
        f"too many reversals in {len(options.seeds)} runs: without / returns / stays",
        "retract, N at detection / 0.5 s later",
    ):
        table.add_column(column)
    for plant, values in plants.items():
        passive = values["without"]["way"]
        table.add_row(
            plant,
            f"{passive * 1e3:.1f}",
            f"{values['stiff']['way'] / passive:.2f}",
            f"{values['half']['way'] * 1e3:.1f}",
            millimetres(values["returns"]),
            millimetres(values["against"]),
            " / ".join(map(millimetres, values["attentive"])),
            " / ".join(
                str(sum(count > ALLOWED[case] for count in counts))
                for case, counts in values["reversals"].items()
            ),
            f"{values['retract']['at_detection']:.1f} / {values['retract']['later']:.1f}",
        )
    console.print(table)
    if options.json:
        options.json.write_text(json.dumps({"simulated": True, "plants": plants}, indent=1))


if __name__ == "__main__":
    main()
