"""Accuracy of the stand-in's ALMotion over qi, and its conflict with another user of the DCM.

Joints by setAngles and the base by moveTo: how far the true robot is from where it was sent. The fight: a client sends
a joint a sine by the DCM every 12 ms, while ALMotion does what its switches let it do; measured is what the DCM sends
to the joint and what the joint does, in the last 3 s. Run: python benchmarks/stand_in_motion.py --json motion.json
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from math import pi
from pathlib import Path
from typing import Any

os.environ.setdefault("QI_LOG_LEVEL", "0")  # before the import

import numpy as np
import qi
from rich.console import Console
from rich.table import Table

from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import load_robot

ROBOT = load_robot()
CYCLE = ROBOT.cycle
ANGLES = ((0.6, -0.3, 0.8), (-0.4, 0.1, 1.4), (0.0, -0.2, 1.0))  # [rad] of JOINTS
JOINTS = ["HeadYaw", "HeadPitch", "LShoulderPitch"]
WAYS = (
    (0.3, 0.0, 0.0),
    (0.0, 0.0, pi / 2),
    (0.3, -0.2, 0.0),
    (-0.3, 0.0, -pi / 2),
    (1.0, 0.0, 0.0),
)
SINES = {"LShoulderPitch": 0.3, "HeadYaw": 0.3, "HipPitch": 0.15}  # [rad]
FREQUENCY, LEAD = 0.5, 36  # [Hz], [ms]
DRIVEN, LOOKED = 4.5, 3.0  # [s]


def joints(stand_in: StandIn, motion: qi.Object) -> list[dict[str, Any]]:
    """Errors of joints after setAngles at half speed and 2 s of rest."""
    places = [ROBOT.joint_index(name) for name in JOINTS]
    errors = []
    for goal in ANGLES:
        motion.setAngles(JOINTS, list(goal), 0.5)
        time.sleep(2.5)
        errors.append(stand_in.black_box(1).position[0, places] - goal)
    rows = np.abs(errors)
    return [
        {
            "joint": name,
            "median_deg": float(np.degrees(np.median(column))),
            "max_deg": float(np.degrees(column.max())),
        }
        for name, column in zip(JOINTS, rows.T, strict=True)
    ]


def moves(stand_in: StandIn, motion: qi.Object) -> list[dict[str, Any]]:
    """Errors of moveTo in the world, its time, and how long other calls took meanwhile."""
    found = []
    for way in WAYS:
        start = stand_in.black_box(1).base[0]
        begin, waits = time.monotonic(), []
        moving = motion.moveTo(*way, _async=True)
        while moving.isRunning():
            asked = time.perf_counter()
            motion.getAngles("Body", True)
            waits.append(time.perf_counter() - asked)
            time.sleep(0.02)
        took = time.monotonic() - begin
        time.sleep(0.3)
        end = stand_in.black_box(1).base[0]
        c, s = np.cos(start[2]), np.sin(start[2])
        error = end - start - [c * way[0] - s * way[1], s * way[0] + c * way[1], way[2]]
        found.append(
            {
                "way": list(way),
                "seconds": took,
                "error_mm": float(1000 * np.hypot(error[0], error[1])),
                "error_deg": float(np.degrees(abs((error[2] + pi) % (2 * pi) - pi))),
                "get_angles_ms_max": 1000 * max(waits),
            }
        )
    return found


def swing(session: qi.Session, joint: str, amplitude: float) -> None:
    """Send a sine to a joint by the DCM."""
    dcm, memory = session.service("DCM"), session.service("ALMemory")
    dcm.createAlias(["swing", [f"{joint}/Position/Actuator/Value"]])
    angle = memory.getData(f"Device/SubDeviceList/{joint}/Position/Sensor/Value")
    begin, due = dcm.getTime(0), time.monotonic()
    while (passed := (dcm.getTime(0) - begin) / 1000) < DRIVEN:
        then = passed + LEAD / 1000
        value = angle + min(then, 1.0) * amplitude * float(np.sin(2 * pi * FREQUENCY * then))
        date = begin + round(1000 * then)
        dcm.setAlias(["swing", "ClearAfter", "time-separate", 0, [date], [[value]]], _async=True)
        due += CYCLE
        time.sleep(max(0.0, due - time.monotonic()))


def fights(stand_in: StandIn, session: qi.Session, motion: qi.Object) -> list[dict[str, Any]]:
    """Measure a sine motion while ALMotion writes too."""
    life = session.service("ALAutonomousLife")

    def protect(on: bool) -> None:
        motion.setCollisionProtectionEnabled("Arms", on)
        motion.setExternalCollisionProtectionEnabled("Arms", on)

    def diagnose(on: bool) -> None:
        motion.setDiagnosisEffectEnabled(on)
        motion.setSmartStiffnessEnabled(on)

    def guard(on: bool) -> None:
        motion.setExternalCollisionProtectionEnabled("Move", on)
        motion.setFallManagerEnabled(on)
        motion.setPushRecoveryEnabled(on)

    def everything(on: bool) -> None:
        protect(on)
        diagnose(on)
        guard(on)

    def live() -> None:
        life.setState("solitary")
        everything(False)

    cases: dict[str, Callable[[], None]] = {
        "all on": lambda: everything(True),
        "arms' protection off": lambda: protect(False),
        "and diagnosis, smart stiffness off": lambda: diagnose(False),
        "and Move, fall manager, push recovery off": lambda: guard(False),
        "all off, life solitary": live,
    }
    found = []
    for joint, amplitude in SINES.items():
        for case, prepare in cases.items():
            prepare()
            swing(session, joint, amplitude)
            box = stand_in.black_box(round(LOOKED / CYCLE))
            place = ROBOT.joint_index(joint)
            sent, true = box.position_command[:, place], box.position[:, place]
            found.append(
                {
                    "joint": joint,
                    "case": case,
                    "largest_step_rad": float(np.abs(np.diff(sent)).max()),
                    "rms_acceleration": float(np.std(np.diff(true, 2) / CYCLE**2)),
                }
            )
        life.setState("disabled")
    return found


def shown(title: str, rows: list[dict[str, Any]]) -> Table:
    """A table of them."""
    table = Table(title=title)
    for column in rows[0]:
        table.add_column(column)
    for row in rows:
        table.add_row(*(f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()))
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plant", default="nominal")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    console = Console()
    with StandIn(f"mujoco://?plant={given.plant}", consent=True) as stand_in:
        session = qi.Session()
        session.connect(stand_in.url)
        motion = session.service("ALMotion")
        motion.wakeUp()
        results = {"joints": joints(stand_in, motion), "moves": moves(stand_in, motion)}
        results["fights"] = fights(stand_in, session, motion)
    for name, rows in results.items():
        console.print(shown(name, rows))
    if given.json:
        given.json.write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
