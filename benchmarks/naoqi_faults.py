"""Behaviour of a robot when its program, the connection or NAOqi fails: against the stand-in, from its black box.

A program in a process of its own moves both arms and drives. Then it is killed, the link is cut or blocked, NAOqi hangs
or is killed; the robot falls asleep, an arm is made soft, a joint is unplugged; another program commands the head or
the base; or Ctrl-C ends it, also while NAOqi hangs, is dead or out of reach. Results are of the simulated robot.
Run: python benchmarks/naoqi_faults.py --repeat 5 --speed 0.15 --json naoqi_faults.json
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from pepper_driver import Pepper
from pepper_driver.backends.naoqi.qi_library import Proxy, load_qi
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.backends.naoqi_server.shared_values import BlackBox
from pepper_driver.config import PepperError, load_doctor_settings, load_robot
from pepper_driver.config.arrays import FloatArray

LOSSES: Mapping[str, str | None] = {
    "program killed": None,
    "link cut": "cut",
    "link blocked": "blocked",
    "NAOqi killed": "kill",
    "NAOqi hangs": "hang",
}
"""What fails, and the fault of the stand-in that does it."""

LOST_MOTORS: Mapping[str, tuple[str | None, str]] = {
    "robot falls asleep": ("asleep", "RShoulderPitch"),
    "arm made soft by another program": (None, "RShoulderPitch"),
    "moving joint unplugged": ("disconnected:RShoulderPitch", "RShoulderPitch"),
    "joint without values": ("none:RShoulderPitch", ""),
}
"""Motors that stop: the fault of the stand-in, and the joint by which the black box dates it."""

FOREIGN = (
    "head by the DCM, 50 times a second",
    "head by ALMotion.setAngles",
    "base by ALMotion.move",
)
"""What another program commands."""

INTERRUPTED: Mapping[str, str | None] = {
    "all is well": None,
    "NAOqi hangs": "hang",
    "NAOqi is dead": "kill",
    "link blocked": "blocked",
}
"""What is wrong when Ctrl-C comes."""

MOVING = "moving"
ENOUGH = 0.8  # fraction of the speed that the wheels must have when it happens
START_TRIES = 10
PATIENCE = 30.0  # [s]
STANDS = load_doctor_settings().wheel_rest  # [rad/s]


# -- the program ------------------------------------------------------------------------------------------------


def move(uri: str, speed: float) -> None:
    """Move until something ends it, and say in a line of JSON what did."""
    ended: dict[str, Any] = {}
    try:
        with Pepper(uri, observer=None) as pepper:
            names = pepper.config.joint_names
            goal = pepper.controller.position.copy()
            pepper.controller.base_velocity.target = [speed, 0.0, 0.0]
            try:
                for number in range(1000):
                    for joint in ("LShoulderPitch", "RShoulderPitch"):
                        goal[names.index(joint)] = 1.0 + 0.5 * (-1) ** number
                    pepper.set_posture(goal, duration=2.0)
                    pepper.run(1.0)
                    if number == 0:
                        print(MOVING, flush=True)
                    pepper.run(1.0)
            except (PepperError, KeyboardInterrupt) as error:
                ended = {"at": time.monotonic(), "error": f"{type(error).__name__}: {error}"}
                raise
    except (PepperError, KeyboardInterrupt) as error:
        ended.setdefault("error", f"{type(error).__name__}: {error}")
    print(json.dumps(ended), flush=True)


class MovingProgram:
    """The program in its process, moving the robot."""

    def __init__(self, stand_in: StandIn, speed: float) -> None:
        uri = f"naoqi://127.0.0.1:{stand_in.port}"
        for _ in range(START_TRIES):
            self.process = subprocess.Popen(
                [sys.executable, __file__, "--program", uri, "--speed", str(speed)],
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
            assert self.process.stdout is not None
            first = self.process.stdout.readline().strip()
            time.sleep(0.5)
            if first == MOVING and self._drives(stand_in, speed):
                return
            self.process.kill()
            self.process.wait()
            if "at" not in first and first != MOVING:
                raise SystemExit(f"the program does not start: {first}")
        raise SystemExit("the program does not keep moving: this machine is too busy")

    def _drives(self, stand_in: StandIn, speed: float) -> bool:
        """Return true while the wheels turn and the program has not ended."""
        min_speed = ENOUGH * np.abs(load_robot().wheels.matrix @ [speed, 0.0, 0.0]).max()
        turning = np.abs(stand_in.black_box(3).wheel_speed).max(axis=1)
        return bool((turning > min_speed).all()) and self.process.poll() is None

    def end(self) -> dict[str, Any]:
        """Wait for its end, and return what it said."""
        out, _ = self.process.communicate(timeout=PATIENCE)
        line = out.strip().splitlines()[-1] if out.strip() else "{}"
        ended: dict[str, Any] = json.loads(line)
        return ended


# -- the robot ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Stop:
    """Times until the robot came to rest, from the last command for wheels that it took [ms].

    Attributes:
        commanded: Until the DCM commanded the wheels to stand.
        stood: Until the last wheel of the plant stood.
        fastest: Speed of the fastest wheel at that order [rad/s].
        sway: The same after they stood, when the robot rocks back.
        step: Largest change of a joint's command from a cycle to the next [mrad].
        drift: Largest change of a joint from a tenth of a second later on [mrad].
    """

    commanded: float
    stood: float
    fastest: float
    sway: float
    step: float
    drift: float

    @classmethod
    def of(cls, box: BlackBox, since: float) -> Stop:
        """From cycles before and after the event."""
        order = float(box.wheel_order[-1])
        time_after = 1e3 * (box.begin - order)
        commanded = np.abs(box.wheel_command).max(axis=1)
        speed = np.abs(box.wheel_speed).max(axis=1)
        stood = _first_below(time_after, speed, STANDS)
        held = box.begin > since + 0.1
        return cls(
            commanded=_first_below(time_after, commanded, 0.0),
            stood=stood,
            fastest=float(speed[time_after >= 0.0][0]),
            sway=float(speed[time_after > stood].max()),
            step=1e3 * float(np.abs(np.diff(box.position_command, axis=0)).max()),
            drift=1e3 * float(np.ptp(box.position[held], axis=0).max()),
        )


def _first_below(times: FloatArray, values: FloatArray, level: float) -> float:
    """Return the time at which values first fall to a level after time 0; linear between two cycles."""
    first = int(np.flatnonzero((times > 0.0) & (values <= level))[0])
    before, after = values[first - 1], values[first]
    fraction = (before - level) / (before - after) if before > after else 0.0
    return float(times[first - 1] + fraction * (times[first] - times[first - 1]))


def between(stand_in: StandIn, begin: float, end: float) -> BlackBox:
    """Cycles that were due between two moments."""
    box = stand_in.black_box()
    chosen = (box.begin > begin) & (box.begin <= end)
    return BlackBox(**{name: rows[chosen] for name, rows in vars(box).items()})


# -- what is measured --------------------------------------------------------------------------------------------


def lose(stand_in: StandIn, name: str, speed: float) -> dict[str, float | str]:
    """Let one thing fail while the robot moves."""
    program = MovingProgram(stand_in, speed)
    fault = LOSSES[name]
    begin = time.monotonic()
    if fault is None:
        program.process.kill()
    else:
        stand_in.set_fault(fault)
    time.sleep(1.0)
    box = between(stand_in, begin - 0.3, time.monotonic())
    found: dict[str, float | str] = vars(Stop.of(box, begin)).copy()
    ended = program.end()
    if "at" in ended:
        last_sample = box.end[box.end <= begin][-1]
        found["error"] = str(ended["error"])
        found["noticed"] = 1e3 * (ended["at"] - last_sample)
    continues = time.monotonic()
    stand_in.clear_faults()
    if fault in ("hang", "blocked"):
        time.sleep(0.5)
        late = between(stand_in, continues, time.monotonic())
        found["late orders"] = float(late.orders[-1] - box.orders[-1])
        found["late joints"] = 1e3 * float(
            np.abs(late.position_command - box.position_command[-1]).max()
        )
        found["late wheels"] = float(np.abs(late.wheel_speed).max())
    return found


@contextmanager
def service_of(stand_in: StandIn, name: str) -> Iterator[Proxy]:
    """Give a service over a connection of its own: some faults end all there are."""
    session = load_qi().Session()
    session.connect(stand_in.url)
    try:
        yield session.service(name)
    finally:
        session.close()


def go(stand_in: StandIn, name: str, speed: float) -> dict[str, float | str]:
    """Stop motors while the robot moves, until the program ends."""
    program = MovingProgram(stand_in, speed)
    fault, joint = LOST_MOTORS[name]
    begin = time.monotonic()
    if fault is None:
        with service_of(stand_in, "ALMotion") as motion:
            motion.setStiffnesses("RArm", 0.0)
    else:
        stand_in.set_fault(fault)
    ended = program.end()
    box = between(stand_in, begin - 0.1, time.monotonic())
    since = box.end[box.end <= begin][-1]
    found: dict[str, float | str] = {}
    if joint:
        place = load_robot().joint_index(joint)
        row = int(np.argmax(box.stiffness[:, place] < 0.5))
        held = box.end <= ended["at"]
        way = box.position_command[held, place] - box.position_command[row, place]
        since, found["command's way"] = box.end[row], 1e3 * float(np.abs(way[row:]).max())
    found |= {"noticed": 1e3 * (ended["at"] - since), "error": str(ended["error"])}
    stand_in.clear_faults()
    with service_of(stand_in, "ALMotion") as motion:
        motion.setStiffnesses("Body", 1.0)
    return found


def interfere(stand_in: StandIn, name: str, speed: float) -> dict[str, float | str]:
    """Let another program command joints or wheels, until the first one ends."""
    program = MovingProgram(stand_in, speed)
    with service_of(stand_in, "ALMotion") as motion, service_of(stand_in, "DCM") as dcm:
        goal = -0.5 if motion.getAngles("HeadYaw", True)[0] > 0.0 else 0.5  # not where it is
        begin = time.monotonic()
        if name == FOREIGN[1]:
            motion.setAngles("HeadYaw", goal, 0.2)
        elif name == FOREIGN[2]:
            motion.move(0.1, 0.0, 0.0)
        while program.process.poll() is None:
            if time.monotonic() > begin + PATIENCE:
                raise SystemExit(f"{name}: not noticed within {PATIENCE:g} s")
            if name == FOREIGN[0]:
                order = [[goal, dcm.getTime(20)]]
                dcm.set(["HeadYaw/Position/Actuator/Value", "ClearAll", order])
            time.sleep(0.02)
        motion.killAll()
    ended = program.end()
    return {"noticed": 1e3 * (ended["at"] - begin), "error": str(ended["error"])}


def interrupt(stand_in: StandIn, name: str, speed: float) -> dict[str, float | str]:
    """Press Ctrl-C, with something else wrong."""
    program = MovingProgram(stand_in, speed)
    fault = INTERRUPTED[name]
    if fault is not None:
        stand_in.set_fault(fault)
    begin = time.monotonic()
    program.process.send_signal(signal.SIGINT)
    program.process.wait(PATIENCE)
    found: dict[str, float | str] = {"exit": 1e3 * (time.monotonic() - begin)}
    program.end()
    stand_in.clear_faults()
    return found


def worst_of(runs: Sequence[Mapping[str, float | str]]) -> dict[str, Any]:
    """Maximum of each result, and all errors."""
    names = {name: None for run in runs for name in run if name != "error"}
    worst: dict[str, Any] = {
        name: max(float(run[name]) for run in runs if name in run) for name in names
    }
    worst["errors"] = sorted({str(run["error"]) for run in runs if "error" in run})
    return worst


def show(
    console: Console, results: Mapping[str, Mapping[str, Any]], columns: Sequence[str]
) -> None:
    """A table of the maximum results."""
    table = Table("", *columns)
    for name, found in results.items():
        cells = [f"{found[column]:.4g}" if column in found else "" for column in columns]
        table.add_row(name, *cells)
    console.print(table)
    for name, found in results.items():
        for error in found["errors"]:
            console.print(f"{name}: {error}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--speed", type=float, default=0.15, help="of the base [m/s]")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--program", metavar="URI", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.program is not None:
        move(given.program, given.speed)
        return
    console = Console(soft_wrap=True, width=140)
    with StandIn("mujoco://?seed=3", network="clear", consent=True) as stand_in:
        with service_of(stand_in, "ALMotion") as motion:
            motion.wakeUp()
        lost = {
            name: worst_of([lose(stand_in, name, given.speed) for _ in range(given.repeat)])
            for name in LOSSES
        }
        lost_motors = {
            name: worst_of([go(stand_in, name, given.speed) for _ in range(given.repeat)])
            for name in LOST_MOTORS
        }
        foreign = {
            name: worst_of([interfere(stand_in, name, given.speed) for _ in range(given.repeat)])
            for name in FOREIGN
        }
        stopped = {
            name: worst_of([interrupt(stand_in, name, given.speed) for _ in range(given.repeat)])
            for name in INTERRUPTED
        }
    console.print(
        f"largest of {given.repeat} runs at {given.speed:g} m/s; times in ms, joints in mrad"
    )
    show(
        console,
        lost,
        [
            "fastest",
            "commanded",
            "stood",
            "sway",
            "step",
            "drift",
            "noticed",
            "late orders",
            "late joints",
            "late wheels",
        ],
    )
    console.print("motors that stop: since the first cycle without them")
    show(console, lost_motors, ["command's way", "noticed"])
    console.print("another program commands: since its first order")
    show(console, foreign, ["noticed"])
    console.print("Ctrl-C: until the process has ended")
    show(console, stopped, ["exit"])
    if given.json is not None:
        given.json.write_text(
            json.dumps(
                {"lost": lost, "gone": lost_motors, "foreign": foreign, "interrupted": stopped},
                indent=1,
            )
        )


if __name__ == "__main__":
    main()
