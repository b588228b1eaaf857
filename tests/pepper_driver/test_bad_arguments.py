"""Wrong arguments of the public functions: refused in one line, by an error of the project, and nothing changes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver import (
    Comply,
    ExperimentRun,
    FollowHand,
    Hold,
    Ignore,
    Observer,
    Pepper,
    Retract,
    Soften,
    StopBase,
)
from pepper_driver.backends import Command, make_backend
from pepper_driver.backends.naoqi_server.faults import parse_fault
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import (
    load_controller_settings,
    load_network,
    load_observer_settings,
    load_plant,
    load_robot,
    load_safety_settings,
    load_world,
)
from pepper_driver.controller import (
    BasePoseTask,
    ComplianceTask,
    FrameTask,
    HandTask,
    LookAtTask,
    OrientationTask,
    PositionTask,
    PostureTask,
    RobotModel,
    WholeBodyController,
)
from pepper_driver.controller.constraints import (
    Balance,
    CoupledLimits,
    SelfCollision,
    TorqueLimit,
)
from pepper_driver.log import read_log
from pepper_driver.log.export import export_log
from pepper_driver.log.plots import plot_contacts
from pepper_driver.observer import ModelSet
from pepper_driver.recording.record import record_labelled
from pepper_driver.reflexes import prepare_reflexes
from pepper_driver.replay import load_run
from support.bad_input import check_refused

ROBOT = load_robot()
Case = tuple[Callable[[Any], object], str]


def untyped(value: object) -> Any:
    """Arguments as a program without type checks hands them over."""
    return value


class Odd:
    """An object whose text has two lines."""

    def __repr__(self) -> str:
        return "line one\nline two"


def make(**arguments: Any) -> Callable[[Any], object]:
    """A robot with these arguments."""
    return lambda _: Pepper(**{"uri": "mock", "observer": None, **arguments})


CONSTRUCTOR: list[Case] = [
    (
        lambda _: Pepper(untyped(3)),
        "a backend is named by a URI, such as 'mujoco' or 'naoqi://pepper.local', got 3",
    ),
    (
        lambda _: Pepper(untyped(None)),
        "a backend is named by a URI, such as 'mujoco' or 'naoqi://pepper.local', got None",
    ),
    (
        lambda _: Pepper(untyped(Path("mujoco"))),
        "a backend is named by a URI, such as 'mujoco' or 'naoqi://pepper.local', got",
    ),
    (
        lambda _: Pepper(untyped(b"mujoco")),
        "a backend is named by a URI, such as 'mujoco' or 'naoqi://pepper.local', got b'mujoco'",
    ),
    (
        lambda _: Pepper(untyped(["mujoco"])),
        "a backend is named by a URI, such as 'mujoco' or 'naoqi://pepper.local', got ['mujoco']",
    ),
    (
        lambda _: Pepper(untyped(make_backend("mock"))),
        "a backend is named by a URI, such as 'mujoco' or 'naoqi://pepper.local', got a MockBackend",
    ),
    (lambda _: Pepper(""), "backend URI is empty; for example: mujoco"),
    (make(observer=3), "Pepper: observer must be a text or an Observer, got 3"),
    (make(observer=True), "Pepper: observer must be a text or an Observer, got True"),
    (
        make(observer=Observer),
        "Pepper: observer must be a text or an Observer, got the class Observer",
    ),
    (make(observer=["fusion"]), "Pepper: observer must be a text or an Observer, got ['fusion']"),
    (make(observer=""), "unknown observer ''"),
    (make(observer="fussion"), "unknown observer 'fussion' (did you mean fusion?"),
    (make(observer="fu\nsion"), "unknown observer 'fu\\nsion' (did you mean fusion?"),
    (make(models=3, observer="fusion"), "Pepper: models must be a path or a text, got 3"),
    (make(models=b"x", observer="fusion"), "Pepper: models must be a path or a text, got b'x'"),
    (make(models="", observer="fusion"), "models must be the path of a file, got ''"),
    (make(models="a\0b", observer="fusion"), "models must be the path of a file, got 'a\\x00b'"),
    (
        make(models="none.json", observer="fusion"),
        "none.json: cannot be read (there is no such file)",
    ),
    (make(models="none.json"), "models are for an observer that is given by its name"),
    (make(log=3), "Pepper: log must be a path or a text, got 3"),
    (make(log=True), "Pepper: log must be a path or a text, got True"),
    (make(log=""), "log must be the path of a file, got ''"),
    (make(log="a\0b"), "log must be the path of a file, got 'a\\x00b'"),
    (make(log=Path(__file__).parent), "cannot be written (it is a folder)"),
    (make(reflexes=Hold()), "reflexes are given in a list: [Hold()]"),
    (make(reflexes=Hold), "reflexes are given in a list, such as [Hold()], got the class Hold"),
    (make(reflexes=None), "reflexes are given in a list, such as [Hold()], got None"),
    (make(reflexes=3), "reflexes are given in a list, such as [Hold()], got 3"),
    (make(reflexes="hold"), "reflexes are given in a list, such as [Hold()], got 'hold'"),
    (make(reflexes={"hold": Hold()}), "reflexes are given in a list, such as [Hold()], got a dict"),
    (make(real_time="no"), "Pepper: real_time must be True or False, got 'no'"),
    (make(real_time=1), "Pepper: real_time must be True or False, got 1"),
    (make(real_time=None), "Pepper: real_time must be True or False, got None"),
    (
        make(loop="x"),
        "loop is 'thread' or 'caller', got 'x'; a simulation that is not paced, without",
    ),
    (
        make(loop="thread"),
        "loop is 'thread' or 'caller', got 'thread'; a simulation that is not paced, without",
    ),
    (
        make(loop=[]),
        "loop is 'thread' or 'caller', got []; a simulation that is not paced, without",
    ),
    (make(robot=3), "Pepper: robot must be a RobotConfig, got 3"),
    (make(robot="pepper"), "Pepper: robot must be a RobotConfig, got 'pepper'"),
    (make(controller={}), "Pepper: controller must be a ControllerSettings, got {}"),
    (make(safety="safety.yaml"), "Pepper: safety must be a SafetySettings, got 'safety.yaml'"),
    (make(about=3), "Pepper: about must be a mapping, got 3"),
    (make(about=["x"]), "Pepper: about must be a mapping, got ['x']"),
    (make(about={"run": 3}), "about holds texts by name, got 3 for 'run'"),
    (
        make(reflex=[Hold()]),
        "Pepper: unknown argument 'reflex' (did you mean reflexes or real_time?",
    ),
    (lambda _: untyped(Pepper)("mock", "fusion"), "Pepper: too many arguments without a name"),
]

BEFORE: list[Case] = [
    (lambda p: p.run(1.0), "'mock' is not active; use it inside 'with Pepper(...) as pepper:'"),
    (lambda p: p.step(), "'mock' is not active; use it inside 'with Pepper(...) as pepper:'"),
    (
        lambda p: p.push("LForeArm", [0, 1, 0]),
        "'mock' is not active; use it inside 'with Pepper(...) as pepper:'",
    ),
    (
        lambda p: p.grab("LForeArm", [0, 0.1, 0]),
        "'mock' is not active; use it inside 'with Pepper(...) as pepper:'",
    ),
    (
        lambda p: p.set_posture("Stand"),
        "'mock' is not active; use it inside 'with Pepper(...) as pepper:'",
    ),
    (
        lambda p: p.drive(0.1, 0, 0),
        "'mock' is not active; use it inside 'with Pepper(...) as pepper:'",
    ),
    (lambda p: p.play("wave"), "'mock' is not active; use it inside 'with Pepper(...) as pepper:'"),
    (
        lambda p: p.wait_for_contact(),
        "'mock' is not active; use it inside 'with Pepper(...) as pepper:'",
    ),
    (lambda p: p.contacts(), "'mock' is not active; use it inside 'with Pepper(...) as pepper:'"),
    (
        lambda p: p.start_log("x.mcap"),
        "'mock' is not active; use it inside 'with Pepper(...) as pepper:'",
    ),
    (
        lambda p: p.clear_statistics(),
        "'mock' is not active; use it inside 'with Pepper(...) as pepper:'",
    ),
    (lambda p: p.measurement, "'mock' was never started"),
    (lambda p: p.position, "'mock' was never started"),
    (lambda p: p.target, "'mock' was never started"),
    (lambda p: p.time, "'mock' was never started"),
    (lambda p: p.base_pose, "'mock' was never started"),
    (lambda p: p.controller, "'mock' was never started"),
    (lambda p: p.statistics, "'mock' was never started"),
    (lambda p: p.link_pose("Head"), "'mock' was never started"),
]
"""Of a robot that was never started."""

MOTION: list[Case] = [
    (lambda p: p.run(True), "seconds must be a time from 0 to 1e+09 s, got True"),
    (lambda p: p.run("1"), "seconds must be a time from 0 to 1e+09 s, got '1'"),
    (lambda p: p.run(nan), "seconds must be a time from 0 to 1e+09 s, got nan"),
    (lambda p: p.run(inf), "seconds must be a time from 0 to 1e+09 s, got inf"),
    (lambda p: p.run(-1), "seconds must be a time from 0 to 1e+09 s, got -1"),
    (lambda p: p.run(None), "seconds must be a time from 0 to 1e+09 s, got None"),
    (lambda p: p.run(np.array([1.0])), "seconds must be a time from 0 to 1e+09 s, got array([1.])"),
    (lambda p: p.run(np.True_), "seconds must be a time from 0 to 1e+09 s, got np.True_"),
    (lambda p: p.run(1j), "seconds must be a time from 0 to 1e+09 s, got 1j"),
    (lambda p: p.run(1e12), "seconds must be a time from 0 to 1e+09 s, got 1000000000000.0"),
    (lambda p: p.run(), "run: missing a required argument: 'seconds'"),
    (lambda p: p.run(1.0, until=3), "run: until must be a function without arguments, got 3"),
    (lambda p: p.run(1.0, until=True), "run: until must be a function without arguments, got True"),
    (
        lambda p: p.run(1.0, until=lambda contact: True),
        "run: until must be a function without arguments, got the function <lambda>",
    ),
    (lambda p: p.run(1.0, on_tick=3), "run: on_tick must be a function of 2 arguments, got 3"),
    (
        lambda p: p.run(1.0, on_tick=lambda: None),
        "run: on_tick must be a function of 2 arguments, got the function <lambda>",
    ),
    (lambda p: p.run(1.0, speed=2), "run: unknown argument 'speed' (did you mean seconds?"),
    (lambda p: p.run(1.0, print), "run: too many arguments without a name"),
    (
        lambda p: p.set_posture({"HeadYaw": "0.1"}),
        "a posture takes numbers, got '0.1' for HeadYaw",
    ),
    (
        lambda p: p.set_posture({"HeadYaw": True}),
        "a posture takes numbers, got True for HeadYaw",
    ),
    (
        lambda p: p.set_posture({"HeadYaw": None}),
        "a posture takes numbers, got None for HeadYaw",
    ),
    (
        lambda p: p.set_posture({"HeadYaw": nan}),
        "a posture takes finite numbers, got nan for HeadYaw",
    ),
    (
        lambda p: p.set_posture({"HeadYaw": [0.1]}),
        "a posture takes numbers, got [0.1] for HeadYaw",
    ),
    (
        lambda p: p.set_posture({"HeadYaw": 9}),
        "HeadYaw cannot go to 9 rad: its limits are -2.086 to 2.086 rad",
    ),
    (
        lambda p: p.set_posture({"HeadYow": 0.1}),
        "unknown joint 'HeadYow' (did you mean HeadYaw or RHand or LHand?",
    ),
    (lambda p: p.set_posture({3: 0.1}), "unknown joint 3"),
    (
        lambda p: p.set_posture("Stnd"),
        "unknown posture 'Stnd' (did you mean Stand or StandZero or StandInit?",
    ),
    (lambda p: p.set_posture(""), "unknown posture ''"),
    (
        lambda p: p.set_posture(3),
        "a posture is its name, a mapping from joints to angles [rad], or all 17 angles, got 3",
    ),
    (
        lambda p: p.set_posture(None),
        "a posture is its name, a mapping from joints to angles [rad], or all 17 angles, got None",
    ),
    (lambda p: p.set_posture([0.0] * 16), "a posture takes 17 numbers, got shape (16,)"),
    (lambda p: p.set_posture(["0"] * 17), "a posture takes numbers, got '0' for KneePitch"),
    (
        lambda p: p.set_posture([True] + [0.0] * 16),
        "a posture takes numbers, got True for KneePitch",
    ),
    (lambda p: p.set_posture([inf] * 17), "a posture takes finite numbers, got inf for KneePitch"),
    (lambda p: p.set_posture(np.zeros((17, 1))), "a posture takes 17 numbers, got shape (17, 1)"),
    (
        lambda p: p.set_posture(np.zeros(17, dtype=object)),
        "a posture takes 17 numbers, got array([0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0],",
    ),
    (
        lambda p: p.set_posture(np.zeros(17, dtype=complex)),
        "a posture takes 17 numbers, got an array (17,) of complex128",
    ),
    (
        lambda p: p.set_posture([[0.0], [1.0, 2.0]]),
        "a posture takes 17 numbers, got [[0.0], [1.0, 2.0]]",
    ),
    (
        lambda p: p.set_posture(b"Stand"),
        "a posture is its name, a mapping from joints to angles [rad], or all 17 angles, got b'Stand'",
    ),
    (
        lambda p: p.set_posture("Stand", stiffness=True),
        "stiffness must be a number from 0 to 3000, got True",
    ),
    (
        lambda p: p.set_posture("Stand", stiffness=0),
        "stiffness must be above 0 for a posture, got 0",
    ),
    (
        lambda p: p.set_posture("Stand", stiffness="5"),
        "stiffness must be a number from 0 to 3000, got '5'",
    ),
    (
        lambda p: p.set_posture("Stand", stiffness=nan),
        "stiffness must be a number from 0 to 3000, got nan",
    ),
    (
        lambda p: p.set_posture("Stand", duration=0),
        "duration must be a time from 0.001 to 3600 s, got 0",
    ),
    (
        lambda p: p.set_posture("Stand", duration=True),
        "duration must be a time from 0.001 to 3600 s, got True",
    ),
    (
        lambda p: p.set_posture("Stand", duration="2"),
        "duration must be a time from 0.001 to 3600 s, got '2'",
    ),
    (
        lambda p: p.set_posture("Stand", duration=1e9),
        "duration must be a time from 0.001 to 3600 s, got 1000000000.0",
    ),
    (lambda p: p.set_posture("Stand", speed=2), "set_posture: unknown argument 'speed'"),
    (lambda p: p.drive("0.1", 0, 0), "drive takes numbers, got '0.1' for vx"),
    (lambda p: p.drive(True, 0, 0), "drive takes numbers, got True for vx"),
    (lambda p: p.drive(0, nan, 0), "drive takes finite numbers, got nan for vy"),
    (lambda p: p.drive(0, 0, 1e9), "drive: wz is 10 at most, got 1e+09"),
    (lambda p: p.drive([0.1], 0, 0), "drive takes numbers, got [0.1] for vx"),
    (lambda p: p.drive(0.1, 0), "drive: missing a required argument: 'wz'"),
    (lambda p: p.drive(0, 0, 0, hold="no"), "drive: hold must be True or False, got 'no'"),
    (
        lambda p: p.play(3),
        "play: experiment must be a Plan or an Experiment or a text or a path, got 3",
    ),
    (
        lambda p: p.play(None),
        "play: experiment must be a Plan or an Experiment or a text or a path, got None",
    ),
    (lambda p: p.play("wav"), "unknown experiment 'wav' (did you mean wave?"),
    (lambda p: p.play(""), "unknown experiment ''"),
    (lambda p: p.play("none.yaml"), "none.yaml: cannot be read (there is no such file)"),
    (
        lambda p: p.play("wave", on_step=3),
        "play: on_step must be a function of one argument, got 3",
    ),
    (
        lambda p: p.play("wave", on_tick="x"),
        "play: on_tick must be a function of 2 arguments, got 'x'",
    ),
    (lambda p: p.link_pose("Hed"), "unknown link 'Hed' (did you mean Head?"),
    (lambda p: p.link_pose(3), "unknown link 3"),
    (lambda p: p.link_pose("Head", of="sent"), "of is 'measured' or 'commanded', got 'sent'"),
    (lambda p: p.link_pose("Head", of=[]), "of is 'measured' or 'commanded', got []"),
    (
        lambda p: p.position["HeadYow"],
        "unknown joint 'HeadYow' (did you mean HeadYaw or RHand or LHand?",
    ),
    (lambda p: p.start_log(3), "start_log: path must be a path or a text, got 3"),
    (lambda p: p.start_log(""), "path must be the path of a file, got ''"),
    (lambda p: p.start_log(Path(__file__).parent), "cannot be written (it is a folder)"),
    (
        lambda p: p.start_log("/dev/null/run.mcap"),
        "/dev/null/run.mcap: its folder cannot be made (there is a file of this name)",
    ),
    (
        lambda p: p.start_log("run.mcap", label=3),
        "start_log: label must be a function of one argument, got 3",
    ),
    (lambda p: p.start(), "'mujoco' is already active"),
    (
        lambda p: p.publish(3),
        "publish: event must be a StepEvent or a CueEvent or a PushEvent, got 3",
    ),
    (lambda p: p.remove(3), "remove: part must be a Task or a Constraint, got 3"),
]

PUSHES: list[Case] = [
    (lambda p: p.push("LForeArm", [0, 1]), "push: force: expected 3 finite numbers, got [0, 1]"),
    (lambda p: p.push("LForeArm", 20), "push: force: expected 3 finite numbers, got 20"),
    (
        lambda p: p.push("LForeArm", [0, nan, 0]),
        "push: force: expected 3 finite numbers, got [0, nan, 0]",
    ),
    (lambda p: p.push("LForeArm", "0 1 0"), "push: force: expected 3 finite numbers, got '0 1 0'"),
    (
        lambda p: p.push("LForeArm", ["0", "1", "0"]),
        "push: force: expected 3 finite numbers, got ['0', '1', '0']",
    ),
    (
        lambda p: p.push("LForeArm", [True, False, False]),
        "push: force: expected 3 finite numbers, got [True, False, False]",
    ),
    (lambda p: p.push("LForeArm", None), "push: force: expected 3 finite numbers, got None"),
    (
        lambda p: p.push("LForeArm", [0, None, 1]),
        "push: force: expected 3 finite numbers, got [0, None, 1]",
    ),
    (
        lambda p: p.push("LForeArm", np.zeros((3, 1))),
        "push: force: expected 3 finite numbers, got an array (3, 1) of float64",
    ),
    (lambda p: p.push("LForeArm", [0, 1e9, 0]), "push: force: at most 10000 N, got 1e+09 N"),
    (
        lambda p: p.push("LForearm", [0, 1, 0]),
        "unknown link 'LForearm' (did you mean LForeArm or RForeArm?",
    ),
    (lambda p: p.push(3, [0, 1, 0]), "unknown link 3"),
    (
        lambda p: p.push(["LForeArm"], [0, 1, 0]),
        "unknown link ['LForeArm'] (did you mean LForeArm or RForeArm?",
    ),
    (
        lambda p: p.push("LForeArm", [0, 1, 0], [0, 1]),
        "push: point: expected 3 finite numbers, got [0, 1]",
    ),
    (
        lambda p: p.push("LForeArm", [0, 1, 0], "hand"),
        "push: point: expected 3 finite numbers, got 'hand'",
    ),
    (lambda p: p.push("LForeArm", [0, 1, 0], [1e9, 0, 0]), "push: point: at most 1 m, got 1e+09 m"),
    (
        lambda p: p.push("LForeArm", [0, 1, 0], duration=0),
        "push: duration must be a finite number above 0, got 0",
    ),
    (
        lambda p: p.push("LForeArm", [0, 1, 0], duration=-1),
        "push: duration must be a finite number above 0, got -1",
    ),
    (
        lambda p: p.push("LForeArm", [0, 1, 0], duration=nan),
        "push: duration must be a finite number above 0, got nan",
    ),
    (
        lambda p: p.push("LForeArm", [0, 1, 0], duration="1"),
        "push: duration must be a finite number above 0, got '1'",
    ),
    (
        lambda p: p.push("LForeArm", [0, 1, 0], duration=True),
        "push: duration must be a finite number above 0, got True",
    ),
    (
        lambda p: p.push("LForeArm", [0, 1, 0], delay=-1),
        "push: delay must be a finite number from 0 up, got -1",
    ),
    (
        lambda p: p.push("LForeArm", [0, 1, 0], delay=inf),
        "push: delay must be a finite number from 0 up, got inf",
    ),
    (
        lambda p: p.push("LForeArm", [0, 1, 0], rise=0),
        "push: rise must be a finite number above 0, got 0",
    ),
    (
        lambda p: p.push("LForeArm", [0, 1, 0], rise=[1]),
        "push: rise must be a finite number above 0, got [1]",
    ),
    (lambda p: p.push("LForeArm", [0, 1, 0], frame="base"), "unknown frame 'base'"),
    (lambda p: p.push("LForeArm", [0, 1, 0], frame=[]), "unknown frame []"),
    (lambda p: p.push("LForeArm"), "push: missing a required argument: 'force'"),
    (lambda p: p.push("LForeArm", [0, 1, 0], strength=3), "push: unknown argument 'strength'"),
    (lambda p: p.grab("LForeArm", [0, 1]), "grab: pull: expected 3 finite numbers, got [0, 1]"),
    (lambda p: p.grab("LForeArm", [0, 100, 0]), "grab: pull: at most 1 m, got 100 m"),
    (
        lambda p: p.grab("LForeArm", [0, 0.1, 0], stiffness=1),
        "grab: stiffness must be 300 to 3000 N/m, got 1",
    ),
    (
        lambda p: p.grab("LForeArm", [0, 0.1, 0], stiffness="1000"),
        "grab: stiffness must be a finite number from 0 up, got '1000'",
    ),
    (
        lambda p: p.grab("LForeArm", [0, 0.1, 0], rise=0),
        "grab: rise must be a finite number above 0, got 0",
    ),
    (
        lambda p: p.grab("LForeArm", [0, 0.1, 0], rise=True),
        "grab: rise must be a finite number above 0, got True",
    ),
    (
        lambda p: p.grab("LForeArm", [0, 0.1, 0], hold=-1),
        "grab: hold must be a finite number from 0 up, got -1",
    ),
    (
        lambda p: p.grab("LForeArm", [0, 0.1, 0], release=nan),
        "grab: release must be a finite number above 0, got nan",
    ),
    (
        lambda p: p.grab("LForeArm", [0, 0.1, 0], max_force=0),
        "grab: max_force must be a finite number above 0, got 0",
    ),
    (lambda p: p.grab("LHandd", [0, 0.1, 0]), "unknown link 'LHandd' (did you mean Head?"),
]

EVENTS: list[Case] = [
    (
        lambda p: p.wait_for_contact(timeout=-1),
        "timeout must be a time [s] from 0 up, or None, got -1",
    ),
    (
        lambda p: p.wait_for_contact(timeout=nan),
        "timeout must be a time [s] from 0 up, or None, got nan",
    ),
    (
        lambda p: p.wait_for_contact(timeout=inf),
        "timeout must be a time [s] from 0 up, or None, got inf",
    ),
    (
        lambda p: p.wait_for_contact(timeout=True),
        "timeout must be a time [s] from 0 up, or None, got True",
    ),
    (
        lambda p: p.wait_for_contact(timeout="1"),
        "timeout must be a time [s] from 0 up, or None, got '1'",
    ),
    (
        lambda p: p.wait_for_contact(link="LForearm", timeout=0.1),
        "unknown link 'LForearm' (did you mean LForeArm or RForeArm?",
    ),
    (lambda p: p.wait_for_contact(3), "wait_for_contact: too many arguments without a name"),
    (
        lambda p: p.wait_for_contact(timout=1),
        "wait_for_contact: unknown argument 'timout' (did you mean timeout?",
    ),
    (lambda p: p.contacts(kind="tapp"), "unknown kind 'tapp'"),
    (lambda p: p.contacts(where="x"), "contacts: unknown argument 'where'"),
    (lambda p: p.on_contact(3), "on_contact: too many arguments without a name"),
    (lambda p: p.on_contact("LForeArm"), "on_contact: too many arguments without a name"),
    (
        lambda p: p.on_contact(link="LForearm"),
        "unknown link 'LForearm' (did you mean LForeArm or RForeArm?",
    ),
    (lambda p: p.on_contact(link=3), "link: a name or a list of names is needed, got 3"),
    (
        lambda p: p.on_contact(joint="LElbow"),
        "unknown joint 'LElbow' (did you mean LElbowYaw or LElbowRoll or RElbowYaw?",
    ),
    (lambda p: p.on_contact(kind="poke"), "unknown kind 'poke'"),
    (lambda p: p.on_contact(phase="start"), "unknown phase of a contact 'start'"),
    (
        lambda p: p.on_contact(lnk="LForeArm"),
        "on_contact: unknown argument 'lnk' (did you mean link?",
    ),
    (
        lambda p: p.on_contact()(3),
        "a callback must be a function that takes the event, and not a coroutine, got 3; for asyncio",
    ),
    (
        lambda p: p.on_contact()(None),
        "a callback must be a function that takes the event, and not a coroutine, got None; for",
    ),
    (
        lambda p: p.on_contact()(asyncio.sleep),
        "a callback must be a function that takes the event, and not a coroutine, got the function",
    ),
    (
        lambda p: p.on_contact()(lambda: None),
        "a callback must be a function that takes the event, and not a coroutine, got the function",
    ),
    (
        lambda p: p.on_contact(lambda: None),
        "a callback must be a function that takes the event, and not a coroutine, got the function",
    ),
    (lambda p: p.on_tick(every=0), "every must be a whole number from 1 to 1000000, got 0"),
    (lambda p: p.on_tick(every=True), "every must be a whole number from 1 to 1000000, got True"),
    (lambda p: p.on_tick(every=1.5), "every must be a whole number from 1 to 1000000, got 1.5"),
    (lambda p: p.on_tick(every="2"), "every must be a whole number from 1 to 1000000, got '2'"),
    (lambda p: p.on_tick(queue=-1), "queue must be a whole number from 1 to 1000000, got -1"),
    (
        lambda p: p.on_tick(queue=10**12),
        "queue must be a whole number from 1 to 1000000, got 1000000000000",
    ),
    (lambda p: p.on_tick(evry=3), "on_tick: unknown argument 'evry' (did you mean every?"),
    (
        lambda p: p.on_tick(lambda a, b: None),
        "a callback must be a function that takes the event, and not a coroutine, got the function",
    ),
    (lambda p: p.on_touch(sensor="Head"), "unknown touch sensor 'Head'"),
    (lambda p: p.on_touch(sensor=3), "unknown touch sensor 3"),
    (
        lambda p: p.on_touch(sensor=["Head/Touch/Front"]),
        "unknown touch sensor ['Head/Touch/Front'] (did you mean Head/Touch/Front or Head/Touch/Rear",
    ),
    (lambda p: p.on_touch(pressed="yes"), "on_touch: pressed must be True or False, got 'yes'"),
    (lambda p: p.on_touch(pressed=1), "on_touch: pressed must be True or False, got 1"),
    (
        lambda p: p.on_touch(pressed=np.array([1, 0])),
        "on_touch: pressed must be True or False, got array([1, 0])",
    ),
    (
        lambda p: p.on_bumper(bumper="Front"),
        "unknown bumper 'Front' (did you mean FrontLeft or FrontRight?",
    ),
    (lambda p: p.on_button(button="x"), "unknown button 'x'"),
    (lambda p: p.on_button("x"), "on_button: too many arguments without a name"),
    (lambda p: p.on_reflex(name="hld"), "unknown reflex 'hld' (did you mean hold?"),
    (lambda p: p.on_reflex(phase="x"), "unknown phase of a reflex 'x'"),
    (lambda p: p.on_cue(kind="shout"), "unknown kind of cue 'shout'"),
    (
        lambda p: p.on_fault()(3),
        "a callback must be a function that takes the event, and not a coroutine, got 3; for asyncio",
    ),
    (lambda p: p.on_fault(x=1), "on_fault: unknown argument 'x'"),
]

SERVICES: list[Case] = [
    (lambda p: p.services.say(3), "say must be a text, got 3"),
    (lambda p: p.services.say(" "), "say must be a text, got ' '"),
    (lambda p: p.services.say(), "say: missing a required argument: 'text'"),
    (lambda p: p.services.leds(3, (1, 0, 0)), "group must be a text, got 3"),
    (
        lambda p: p.services.leds("FaceLeds", (1, 0)),
        "a colour is (r, g, b), each from 0 to 1, got (1, 0)",
    ),
    (lambda p: p.services.leds("FaceLeds", 3), "a colour is (r, g, b), each from 0 to 1, got 3"),
    (
        lambda p: p.services.leds("FaceLeds", None),
        "a colour is (r, g, b), each from 0 to 1, got None",
    ),
    (
        lambda p: p.services.leds("FaceLeds", "red"),
        "a colour is (r, g, b), each from 0 to 1, got 'red'",
    ),
    (
        lambda p: p.services.leds("FaceLeds", (255, 0, 0)),
        "a colour is (r, g, b), each from 0 to 1, got (255, 0, 0)",
    ),
    (
        lambda p: p.services.leds("FaceLeds", (True, 0, 0)),
        "a colour is (r, g, b), each from 0 to 1, got (True, 0, 0)",
    ),
    (
        lambda p: p.services.leds("FaceLeds", (nan, 0, 0)),
        "a colour is (r, g, b), each from 0 to 1, got (nan, 0, 0)",
    ),
    (
        lambda p: p.services.leds("FaceLeds", (1, 0, 0), -1),
        "lights fade within a time from 0 to 60 s, got -1",
    ),
    (
        lambda p: p.services.leds("FaceLeds", (1, 0, 0), True),
        "lights fade within a time from 0 to 60 s, got True",
    ),
    (
        lambda p: p.services.leds("FaceLeds", color=(1, 0, 0)),
        "leds: unknown argument 'color' (did you mean colour?",
    ),
    (lambda p: p.services.show_image(3), "url must be a text, got 3"),
    (
        lambda p: p.services.go_to_posture("Stand", 0),
        "a speed is a ratio to the full one, above 0 up to 1, got 0",
    ),
    (
        lambda p: p.services.go_to_posture("Stand", True),
        "a speed is a ratio to the full one, above 0 up to 1, got True",
    ),
    (
        lambda p: p.services.go_to_posture("Stand"),
        "'mujoco' cannot go to posture 'Stand' by its own program while the loop moves it:",
    ),
    (
        lambda p: p.services.wake_up(),
        "'mujoco' cannot wake up by its own program while the loop moves it: it is awake",
    ),
    (
        lambda p: p.services.rest(),
        "'mujoco' cannot rest by its own program while the loop moves it: leave the 'with' block",
    ),
]


def change(make: Callable[[], Any], name: str, value: object) -> Callable[[Any], object]:
    """Set an attribute of a new task."""
    return lambda _: setattr(make(), name, value)


def wrist() -> PositionTask:
    return PositionTask("l_wrist")


TASKS: list[Case] = [
    (lambda _: PositionTask("l_wirst"), "unknown link 'l_wirst' (did you mean l_wrist or r_wrist?"),
    (lambda _: PositionTask(untyped(3)), "a link is given by its name, got 3"),
    (lambda _: untyped(PositionTask)(), "PositionTask: missing a required argument: 'link'"),
    (
        lambda _: PositionTask("l_wrist", [0, 1]),
        "the point of position l_wrist takes 3 numbers, got shape (2,)",
    ),
    (lambda _: PositionTask("l_wrist", root=untyped(3)), "a link is given by its name, got 3"),
    (
        lambda _: PositionTask("l_wrist", joints="LElbowYaw"),
        "joints must be a list of names of joints, one at least, got 'LElbowYaw'",
    ),
    (
        lambda _: PositionTask("l_wrist", joints=["LElbowYaw", "LElbowYaw"]),
        "joints: LElbowYaw is given twice",
    ),
    (
        lambda _: PositionTask("l_wrist", base=untyped("no")),
        "PositionTask: base must be True or False, got 'no'",
    ),
    (lambda _: PositionTask("l_wrist", name=untyped(3)), "the name of a task is a text, got 3"),
    (
        lambda _: PositionTask("l_wrist", robot=untyped(3)),
        "PositionTask: robot must be a RobotConfig, got 3",
    ),
    (
        lambda _: PositionTask("l_wrist", stiffness=True),
        "stiffness must be a number from 0 to 3000, got True",
    ),
    (
        lambda _: PositionTask("l_wrist", stiffness=untyped("1")),
        "stiffness must be a number from 0 to 3000, got '1'",
    ),
    (
        lambda _: PositionTask("l_wrist", weight=-1),
        "weight must be a number from 0 to 1e+12, got -1",
    ),
    (
        lambda _: untyped(PositionTask)("l_wrist", roott="r_wrist"),
        "PositionTask: unknown argument 'roott' (did you mean root or robot?",
    ),
    (
        lambda _: untyped(OrientationTask)("l_wrist", [0, 0, 0]),
        "OrientationTask: too many arguments without a name",
    ),
    (
        change(wrist, "target", [0, 1]),
        "the target of position l_wrist takes 3 numbers, got shape (2,)",
    ),
    (
        change(wrist, "target", [True] * 3),
        "the target of position l_wrist takes numbers, got True for number 0",
    ),
    (
        change(wrist, "target", ["0"] * 3),
        "the target of position l_wrist takes numbers, got '0' for number 0",
    ),
    (change(wrist, "target", None), "the target of position l_wrist takes 3 numbers, got None"),
    (
        change(wrist, "target", [nan] * 3),
        "the target of position l_wrist takes finite numbers, got nan for number 0",
    ),
    (
        change(wrist, "target", {"x": 1}),
        "the target of position l_wrist takes 3 numbers, got {'x': 1}",
    ),
    (
        change(lambda: OrientationTask("l_wrist"), "target", "up"),
        "the target of orientation l_wrist takes a (3, 3) rotation matrix or a unit quaternion (x,",
    ),
    (
        change(lambda: OrientationTask("l_wrist"), "target", [0, 0, 0, 2]),
        "the target of orientation l_wrist takes a unit quaternion (x, y, z, w), got one of norm 2",
    ),
    (
        change(lambda: FrameTask("l_wrist"), "target", np.zeros((2, 2))),
        "the target of pose l_wrist takes a (4, 4) transform or (x, y, z, qx, qy, qz, qw), got shape",
    ),
    (
        change(lambda: FrameTask("l_wrist"), "target", [0, 0, 0, 0, 0, 0, True]),
        "the target of pose l_wrist takes a (4, 4) transform or (x, y, z, qx, qy, qz, qw), got [0,",
    ),
    (
        change(wrist, "stiffness", 1e9),
        "stiffness must be a number from 0 to 3000, got 1000000000.0",
    ),
    (change(wrist, "stiffness", None), "stiffness must be a number from 0 to 3000, got None"),
    (change(wrist, "damping", True), "damping must be a number from 0 to 120, got True"),
    (change(wrist, "damping", "1"), "damping must be a number from 0 to 120, got '1'"),
    (change(wrist, "weight", inf), "weight must be a number from 0 to 1e+12, got inf"),
    (
        change(wrist, "dim_weight", [1, 1]),
        "dim_weight must be 3 finite numbers that are not negative, got [1, 1]",
    ),
    (
        change(wrist, "dim_weight", [True, True, True]),
        "dim_weight must be 3 finite numbers that are not negative, got [True, True, True]",
    ),
    (
        change(wrist, "reference_velocity", "x"),
        "the reference velocity of position l_wrist takes 3 numbers, got 'x'",
    ),
    (
        lambda _: wrist().move_to([0, 0, 0], untyped("1")),
        "the durations of position l_wrist takes one number, got '1' for number 0",
    ),
    (
        lambda _: wrist().move_to([0, 0, 0], True),
        "the durations of position l_wrist takes one number, got True for number 0",
    ),
    (
        lambda _: wrist().move_to([0, 0, 0], -1),
        "position l_wrist takes durations from 0.001 s up, got [-1.0]",
    ),
    (
        lambda _: untyped(wrist()).move_to([0, 0, 0]),
        "move_to: missing a required argument: 'duration'",
    ),
    (
        lambda _: wrist().move_through([], []),
        "position l_wrist moves through one target or more, got []",
    ),
    (
        lambda _: wrist().reached(True),
        "position l_wrist takes one tolerance or 3, above 0, got True",
    ),
    (
        lambda _: wrist().reached(untyped("x")),
        "position l_wrist takes one tolerance or 3, above 0, got 'x'",
    ),
    (lambda _: wrist().reached(0), "position l_wrist takes one tolerance or 3, above 0, got 0"),
    (lambda _: untyped(wrist()).reached(), "reached: missing a required argument: 'tolerance'"),
    (
        change(lambda: PostureTask(["HeadYaw"]), "target", {"HeadYaw": "0.1"}),
        "a posture takes one number, got '0.1' for HeadYaw",
    ),
    (
        change(lambda: PostureTask(["HeadYaw"]), "target", {"HeadPitch": 0.1}),
        "unknown joint 'HeadPitch' (did you mean HeadYaw?",
    ),
    (
        change(lambda: HandTask("LHand"), "target", True),
        "the aperture of LHand takes one number, got True for number 0",
    ),
    (
        change(lambda: HandTask("LHand"), "target", 2),
        "LHand cannot open to 2: 0 is closed, 1 is open",
    ),
    (lambda _: HandTask("Lhand"), "unknown hand 'Lhand' (did you mean LHand or RHand?"),
    (
        lambda _: LookAtTask(axis=[0, 0, 0]),
        "the axis of look-at Head has no direction: [0.0, 0.0, 0.0]",
    ),
    (lambda _: LookAtTask(target_link="Head"), "Head cannot look at a point of its own"),
    (
        change(BasePoseTask, "target", [0, 0]),
        "a base pose (x, y, heading) takes 3 numbers, got shape (2,)",
    ),
    (
        lambda _: ComplianceTask(["HeadYaw"], inertia=0),
        "inertia must be one or 1 finite numbers above 0, got 0",
    ),
    (
        lambda _: ComplianceTask(["HeadYaw"], inertia=True),
        "inertia must be one or 1 finite numbers above 0, got True",
    ),
    (
        change(lambda: ComplianceTask(["HeadYaw"]), "torque", "x"),
        "an external torque takes one number, got 'x'",
    ),
    (lambda _: Balance(untyped(3)), "Balance: robot must be a RobotConfig, got 3"),
    (
        lambda _: Balance(ROBOT, True),
        "margin must be from 0 to 0.088 m, where the triangle of the wheels ends, got True",
    ),
    (
        lambda _: CoupledLimits(untyped(None)),
        "CoupledLimits: robot must be a RobotConfig, got None",
    ),
    (
        lambda _: SelfCollision(ROBOT, untyped("x")),
        "SelfCollision: settings must be a SelfCollisionSettings, got 'x'",
    ),
    (
        lambda _: TorqueLimit(ROBOT, fraction=True),
        "fraction must be a finite number above 0, got True",
    ),
    (
        lambda _: untyped(TorqueLimit)(ROBOT, fracton=0.5),
        "TorqueLimit: unknown argument 'fracton' (did you mean fraction?",
    ),
    (
        lambda _: RobotModel(untyped("pepper")),
        "RobotModel: robot must be a RobotConfig, got 'pepper'",
    ),
    (
        lambda _: RobotModel(ROBOT).link_pose("Head", untyped([1])),
        "link_pose takes 17 angles, got [1]",
    ),
    (
        lambda _: WholeBodyController(ROBOT, untyped({})),
        "WholeBodyController: settings must be a ControllerSettings, got {}",
    ),
    (
        lambda _: WholeBodyController(ROBOT, dt=True),
        "dt must be a cycle in seconds above 0, got True",
    ),
]

REFLEXES: list[Case] = [
    (
        lambda _: Hold(priority=untyped("1")),
        "hold: priority is a number from -1000 to 1000, got '1'",
    ),
    (lambda _: Hold(priority=True), "hold: priority is a number from -1000 to 1000, got True"),
    (lambda _: Hold(priority=untyped(1.5)), "hold: priority is a whole number, got 1.5"),
    (lambda _: Hold(release_delay=-1), "hold: release_delay is a number from 0 to 3600, got -1"),
    (lambda _: Hold(release_delay=nan), "hold: release_delay is a number from 0 to 3600, got nan"),
    (lambda _: Hold(max_duration=inf), "hold: max_duration is a number from 0 to 3600, got inf"),
    (lambda _: Hold(then=untyped("go")), "hold: 'then' is 'resume' or 'stay', got 'go'"),
    (lambda _: Hold(then=untyped([])), "hold: 'then' is 'resume' or 'stay', got []"),
    (lambda _: Hold(name=untyped(3)), "the name of a reflex is a text, got 3"),
    (lambda _: Hold(name="a\nb"), "the name of a reflex is a text, got 'a\\nb'"),
    (
        lambda _: untyped(Hold)(linkk="LForeArm"),
        "Hold: unknown argument 'linkk' (did you mean link?",
    ),
    (lambda _: untyped(Hold)("LForeArm"), "Hold: too many arguments without a name"),
    (lambda _: Comply(damping=-1), "comply: damping is a number from 0.05 to 12, got -1"),
    (lambda _: Comply(damping=True), "comply: damping is a number from 0.05 to 12, got True"),
    (
        lambda _: Retract(distance=untyped("far")),
        "retract: distance is a number from 0.01 to 1.5, got 'far'",
    ),
    (lambda _: Retract(distance=nan), "retract: distance is a number from 0.01 to 1.5, got nan"),
    (
        lambda _: Soften(stiffness=untyped(None)),
        "soften: stiffness is a number from 0 to 1, got None",
    ),
    (
        lambda _: FollowHand(follow_with=untyped("head")),
        "follow_hand: 'follow_with' is 'arm' or 'base', got 'head'",
    ),
    (lambda _: untyped(StopBase)(stiffness=1), "StopBase: unknown argument 'stiffness'"),
    (
        lambda _: prepare_reflexes([Hold(link="LForearm")], ROBOT),
        "unknown link 'LForearm' (did you mean LForeArm or RForeArm?",
    ),
    (lambda _: prepare_reflexes([Ignore(joint="x")], ROBOT), "unknown joint 'x'"),
    (
        lambda _: prepare_reflexes([Hold(kind=untyped("poke"))], ROBOT),
        "unknown kind 'poke'",
    ),
    (
        lambda _: prepare_reflexes([Hold()], untyped(3)),
        "prepare_reflexes: robot must be a RobotConfig, got 3",
    ),
]

STAND_IN: list[Case] = [
    (
        lambda _: StandIn(untyped(3)),
        "a backend is named by a URI, such as 'mujoco' or 'naoqi://pepper.local', got 3",
    ),
    (lambda _: StandIn("mock"), "'mock': behind the stand-in there must be a simulated robot"),
    (
        lambda _: StandIn("naoqi://x"),
        "'naoqi://x': behind the stand-in there must be a simulated robot",
    ),
    (
        lambda _: StandIn("mujoco://?plant=none"),
        "unknown plant 'none' (did you mean nominal or worn?",
    ),
    (lambda _: StandIn(port=-1), "port must be a whole number from 0 to 65535, got -1"),
    (lambda _: StandIn(port=99999), "port must be a whole number from 0 to 65535, got 99999"),
    (lambda _: StandIn(port=True), "port must be a whole number from 0 to 65535, got True"),
    (
        lambda _: StandIn(port=untyped("9559")),
        "port must be a whole number from 0 to 65535, got '9559'",
    ),
    (lambda _: StandIn(host=""), "host must be a text, got ''"),
    (lambda _: StandIn(host=untyped(3)), "host must be a text, got 3"),
    (
        lambda _: StandIn(clock=untyped(1.5)),
        "clock must be a whole number from -4294967296 to 4294967296, got 1.5",
    ),
    (lambda _: StandIn(consent=untyped("no")), "StandIn: consent must be True or False, got 'no'"),
    (lambda _: StandIn(outlive=-1), "outlive must be a time [s], 0 or more, got -1"),
    (lambda _: StandIn(outlive=nan), "outlive must be a time [s], 0 or more, got nan"),
    (lambda _: StandIn(network="none"), "unknown network 'none'"),
    (lambda _: StandIn(network=untyped(3)), "unknown network 3"),
    (lambda _: StandIn(login=untyped("nao")), "StandIn: login must be a Login, got 'nao'"),
    (
        lambda _: StandIn(faults=untyped("hang")),
        "faults must be a list: [parse_fault('hang')], got 'hang'",
    ),
    (
        lambda _: StandIn(faults=untyped(["hang"])),
        "each of faults comes from parse_fault('hang'), got 'hang'",
    ),
    (lambda _: StandIn(faults=untyped(3)), "faults must be a list: [parse_fault('hang')], got 3"),
    (
        lambda _: StandIn(faults=[parse_fault("hot:joint=Elbow")]),
        "unknown motor 'Elbow' (did you mean RElbowYaw or LElbowYaw or RElbowRoll?",
    ),
    (lambda _: StandIn().robot, "the stand-in is not started: use it in a 'with' block"),
    (lambda _: StandIn().black_box(), "the stand-in is not started: use it in a 'with' block"),
    (lambda _: StandIn().naoqi_process, "the stand-in is not started: use it in a 'with' block"),
    (lambda _: StandIn().wait(), "the stand-in is not started: use it in a 'with' block"),
    (lambda _: StandIn().start_naoqi(), "the stand-in is not started: use it in a 'with' block"),
    (
        lambda _: StandIn().set_fault("hang"),
        "the stand-in is not started: use it in a 'with' block",
    ),
    (
        lambda _: StandIn().set_fault(untyped(3)),
        "a fault is a text such as 'hang:seconds=2', got 3",
    ),
    (lambda _: StandIn().set_fault("hng"), "unknown fault 'hng' (did you mean hang?"),
]

OTHERS: list[Case] = [
    (
        lambda _: make_backend(untyped(3)),
        "a backend is named by a URI, such as 'mujoco' or 'naoqi://pepper.local', got 3",
    ),
    (
        lambda _: make_backend("mock", untyped("pepper")),
        "make_backend: robot must be a RobotConfig, got 'pepper'",
    ),
    (lambda p: p.backend.write(untyped(3)), "a command is expected, got 3"),
    (
        lambda p: p.backend.write(
            Command(position=np.zeros(3), stiffness=np.ones(17), wheel_speed=np.zeros(3))
        ),
        "command.position: expected 17 finite numbers, got array([0., 0., 0.])",
    ),
    (
        lambda p: p.backend.write(
            Command(
                position=np.zeros(17),
                stiffness=np.ones(17, dtype=bool),
                wheel_speed=np.zeros(3),
            )
        ),
        "command.stiffness: expected 17 finite numbers, got an array (17,) of bool",
    ),
    (
        lambda p: p.backend.write(
            Command(position=untyped(["0"] * 17), stiffness=np.ones(17), wheel_speed=np.zeros(3))
        ),
        "command.position: expected 17 finite numbers, got a list",
    ),
    (lambda _: make_backend("mujoco").push("Head", [0, 0, 1]), "'mujoco' is not open"),
    (lambda _: load_robot(untyped(3)), "load_robot: path must be a path or a text, got 3"),
    (lambda _: load_robot(""), "path must be the path of a file, got ''"),
    (lambda _: load_robot("none.yaml"), "none.yaml: cannot be read (there is no such file)"),
    (lambda _: load_robot(untyped([1])), "load_robot: path must be a path or a text, got [1]"),
    (lambda _: load_plant("none", ROBOT), "unknown plant 'none' (did you mean nominal or worn?"),
    (lambda _: load_plant("worn", untyped(3)), "load_plant: robot must be a RobotConfig, got 3"),
    (lambda _: load_plant(untyped(None), ROBOT), "unknown plant None (did you mean worn?"),
    (lambda _: load_world("none"), "unknown world 'none'"),
    (lambda _: load_network(untyped(3)), "unknown network 3"),
    (
        lambda _: load_controller_settings(ROBOT, "none.yaml"),
        "none.yaml: cannot be read (there is no such file)",
    ),
    (
        lambda _: load_controller_settings(untyped("controller.yaml")),
        "load_controller_settings: robot must be a RobotConfig, got 'controller.yaml'",
    ),
    (lambda _: load_observer_settings(untyped(3)), "path must be the path of a file, got 3"),
    (lambda _: load_safety_settings(""), "path must be the path of a file, got ''"),
    (lambda _: read_log(untyped(3)), "read_log: path must be a path or a text, got 3"),
    (lambda _: read_log("none.mcap"), "none.mcap: cannot be read (there is no such file)"),
    (lambda _: read_log("a\0b"), "path must be the path of a file, got 'a\\x00b'"),
    (
        lambda _: read_log(untyped(b"run.mcap")),
        "read_log: path must be a path or a text, got b'run.mcap'",
    ),
    (lambda _: load_run("none.mcap"), "none.mcap: cannot be read (there is no such file)"),
    (lambda _: load_run(untyped(None)), "load_run: path must be a path or a text, got None"),
    (
        lambda _: export_log(untyped("run.mcap"), "run.csv", "csv"),
        "export_log: log must be a RunLog, got 'run.mcap'",
    ),
    (
        lambda _: plot_contacts(untyped("run.mcap"), "run.png"),
        "plot_contacts: log must be a RunLog, got 'run.mcap'",
    ),
    (lambda _: ModelSet.load(untyped(3)), "models must be the path of a file, got 3"),
    (
        lambda _: ModelSet.load("none.json"),
        "none.json: cannot be read (there is no such file); 'pepper identify' writes model files",
    ),
    (lambda _: ModelSet.load(__file__), "not a model file; 'pepper identify' writes model files"),
    (
        lambda _: record_labelled("mock", untyped(3), "head", seconds=1.0),
        "record_labelled: out must be a path or a text, got 3",
    ),
    (
        lambda _: record_labelled("mock", "x.mcap", "head", seconds=True),
        "seconds must be a time above 0, got True",
    ),
    (
        lambda _: record_labelled("mock", "x.mcap", "head", seconds=untyped("1")),
        "seconds must be a time above 0, got '1'",
    ),
    (lambda _: record_labelled("mock", "x.mcap", "foot", seconds=1.0), "unknown label 'foot'"),
    (
        lambda _: record_labelled("mock", "x.mcap", "head"),
        "give seconds to hold the posture for, or an experiment",
    ),
    (
        lambda _: record_labelled("mock", "x.mcap", "head", seconds=1.0, seed=3),
        "a seed is for an experiment: leave it out",
    ),
    (
        lambda _: record_labelled("mock", "x.mcap", "head", seconds=1.0, link="Had"),
        "unknown link 'Had' (did you mean Head?",
    ),
    (
        lambda _: ExperimentRun(untyped(3)),
        "ExperimentRun: experiment must be an Experiment or a text or a path, got 3",
    ),
    (lambda _: ExperimentRun("none.yaml"), "none.yaml: cannot be read (there is no such file)"),
]


@pytest.fixture(scope="module")
def active(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pepper]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("input"))
        with Pepper("mujoco", reflexes=[Hold()]) as pepper:
            yield pepper


def numbered(cases: list[Case]) -> pytest.MarkDecorator:
    """Cases by their number and the first words of what is expected."""
    return pytest.mark.parametrize(
        ("call", "expected"), cases, ids=[f"{n} {case[1][:40]}" for n, case in enumerate(cases)]
    )


@numbered(CONSTRUCTOR)
def test_a_robot_is_not_made_of_it(call: Callable[[Any], object], expected: str) -> None:
    check_refused(lambda: call(None), expected)


@numbered(BEFORE)
def test_a_robot_that_was_not_started_says_so(call: Callable[[Any], object], expected: str) -> None:
    pepper = Pepper("mock", observer=None)
    check_refused(lambda: call(pepper), expected)


@numbered([*MOTION, *PUSHES, *EVENTS, *SERVICES, *OTHERS])
def test_an_active_robot_refuses_it_and_nothing_changes(
    active: Pepper, call: Callable[[Any], object], expected: str
) -> None:
    tick, target, logged = active.measurement.tick, active.target, list(Path().iterdir())
    callbacks = len(active.callback_statistics)
    check_refused(lambda: call(active), expected)
    active.step()
    assert active.measurement.tick == tick + 1, "time has passed"
    np.testing.assert_array_equal(active.target, target)
    assert active.controller.base_velocity.target.tolist() == [0.0, 0.0, 0.0]
    assert len(active.callback_statistics) == callbacks
    assert list(Path().iterdir()) == logged


@numbered([*TASKS, *REFLEXES])
def test_no_task_and_no_reflex_is_made_of_it(call: Callable[[Any], object], expected: str) -> None:
    check_refused(lambda: call(None), expected)


@numbered(STAND_IN)
@pytest.mark.usefixtures("qi")
def test_no_stand_in_is_made_of_it(call: Callable[[Any], object], expected: str) -> None:
    check_refused(lambda: call(None), expected)


@pytest.mark.parametrize("accepted", [0.012, np.float64(0.012), np.float32(0.012), 0])
def test_numbers_of_other_kinds_are_numbers(active: Pepper, accepted: Any) -> None:
    active.run(accepted)
    active.set_posture({"HeadYaw": accepted}, duration=untyped(np.float32(1.0)))
    active.drive(accepted, untyped(np.int64(0)), 0)
    active.drive(0, 0, 0)
    active.set_posture({"HeadYaw": 0.0})


def test_a_decorator_needs_no_brackets(active: Pepper) -> None:
    before = len(active.callback_statistics)
    reported: list[object] = []
    for register in (
        active.on_contact,
        active.on_tick,
        active.on_touch,
        active.on_bumper,
        active.on_button,
        active.on_fault,
        active.on_reflex,
        active.on_step,
        active.on_cue,
        active.on_push,
    ):

        def callback(event: object) -> None:
            reported.append(event)

        assert untyped(register)(callback) is callback
    assert len(active.callback_statistics) == before + 10
    active.run(0.024)
    assert len(reported) == 2, "two ticks"
