"""Wrong files, motions and experiments left out: one line with file, line, key and what is possible."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver.config import (
    load_controller_settings,
    load_doctor_settings,
    load_network,
    load_observer_settings,
    load_plant,
    load_robot,
    load_safety_settings,
    load_world,
)
from pepper_driver.config.loading import package_file
from pepper_driver.log import read_log
from pepper_driver.observer import ModelSet, Recording
from pepper_driver.reflexes.declared import load_reflexes
from support.bad_input import check_refused

ROBOT = load_robot()

LOADERS: dict[str, Callable[[str], object]] = {
    "plant": lambda path: load_plant(path, ROBOT),
    "world": load_world,
    "network": load_network,
    "controller": lambda path: load_controller_settings(ROBOT, path),
    "observer": load_observer_settings,
    "safety": load_safety_settings,
    "doctor": load_doctor_settings,
    "robot": load_robot,
    "reflexes": lambda path: load_reflexes(Path(path), ROBOT),
}
"""By kind of file: what reads it. All are YAML."""

SHIPPED = {
    "world": ("worlds", "table.yaml"),
    "network": ("networks", "wifi.yaml"),
    "controller": ("controller.yaml",),
    "observer": ("observer.yaml",),
    "safety": ("safety.yaml",),
    "doctor": ("doctor.yaml",),
}
"""Files that are changed in one key."""

NO_YAML: dict[str, tuple[bytes | None, str]] = {
    "missing": (None, "cannot be read (there is no such file)"),
    "empty": (b"", "holds nothing, expected a mapping of keys to values"),
    "a number": (b"3\n", "holds a number, expected a mapping of keys to values"),
    "a list": (b"- 1\n- 2\n", "holds a list, expected a mapping of keys to values"),
    "Latin-1": (b"name: caf\xe9\n", "cannot be read (not UTF-8 text, at byte 9)"),
    "UTF-16": ("name: x\n".encode("utf-16"), "cannot be read (not UTF-8 text, at byte 0)"),
    "binary": (bytes(range(256)), "cannot be read (not UTF-8 text, at byte 128)"),
    "a control character": (b"name: x\nb: \x01\n", "line 2: holds a control character"),
    "a tab": (b"name: x\nb:\n\t- 1\n", "line 3: found character"),
    "deep": (b"a: " + b"[" * 20_000, "line 1: nested deeper than 100 levels"),
    "anchors": (
        b"a: &a [1, 1]\n"
        + b"".join(
            b"%c: &%c [*%c, *%c, *%c, *%c]\n" % (n, n, n - 1, n - 1, n - 1, n - 1)
            for n in range(ord("b"), ord("m"))
        ),
        "anchors stand for",
    ),
    "a key twice": (b"name: x\nname: y\n", "line 2: key 'name' is given twice"),
    "an object": (b"name: !!python/object:os.system {}\n", "line 1: could not determine"),
    "a date": (b"name: 2020-01-01\n", ""),
    "a list as key": (b"[1, 2]: x\n", "line 1: a key must be a word or a number"),
    "an open bracket": (b"name: [1, 2\n", "line 2: "),
    "an unknown key": (b"nonsense: 3\n", "nonsense"),
}
"""By what is wrong with them: content, None for no file, and what is said."""


@pytest.mark.parametrize("kind", LOADERS)
@pytest.mark.parametrize("wrong", NO_YAML)
def test_it_is_no_such_file(kind: str, wrong: str, tmp_path: Path) -> None:
    content, expected = NO_YAML[wrong]
    path = tmp_path / "mine.yaml"
    if content is not None:
        path.write_bytes(content)
    error = check_refused(lambda: LOADERS[kind](str(path)), expected)
    assert str(path) in str(error)


@pytest.mark.parametrize("kind", LOADERS)
def test_it_is_a_folder(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "folder.yaml"
    path.mkdir()
    check_refused(lambda: LOADERS[kind](str(path)), f"{path}: cannot be read (it is a folder)")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read anything")
@pytest.mark.parametrize("kind", LOADERS)
def test_it_may_not_be_read(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("name: x\n")
    path.chmod(0)
    check_refused(lambda: LOADERS[kind](str(path)), "cannot be read (no permission)")


PLANT = "name: mine\ndescription: ''\nextends: nominal\n"
WORLD = (
    "name: mine\ndescription: ''\nobjects:\n  a:\n    shape: box\n    size: [0.1, 0.1, 0.1]\n"
    "    mass: null\n    position: [1.0, 0.0, 0.5]\n"
)

CASES: list[tuple[str, str, str]] = [
    ("plant", PLANT + "extends2: x\n", "mine.yaml line 4: unknown key 'extends2'"),
    (
        "plant",
        PLANT.replace("nominal", "none"),
        "mine.yaml line 3: key 'extends': unknown plant 'none' (did you mean nominal or worn?",
    ),
    (
        "plant",
        PLANT.replace("nominal", "none.yaml"),
        "none.yaml: cannot be read (there is no such file)",
    ),
    (
        "plant",
        PLANT.replace("nominal", "mine.yaml"),
        "mine.yaml line 3: key 'extends': the plant extends itself",
    ),
    (
        "plant",
        PLANT.replace("nominal", "3"),
        "mine.yaml line 3: key 'extends': expected the name of a plant, or a list of names, got 3",
    ),
    (
        "plant",
        PLANT + "battery: {charge: 3}\n",
        "mine.yaml line 4: key 'battery.charge': must be 1 or less, got 3",
    ),
    (
        "plant",
        PLANT + "battery: {charge: full}\n",
        "mine.yaml line 4: key 'battery.charge': must be a number, got \"full\"",
    ),
    (
        "plant",
        PLANT + "battery: {charge: .nan}\n",
        "mine.yaml line 4: key 'battery.charge': must be a finite number, got nan",
    ),
    (
        "plant",
        PLANT + "battery: {charg: 0.5}\n",
        "mine.yaml line 4: unknown key 'battery.charg' (did you mean charge?",
    ),
    (
        "plant",
        PLANT + "battery: 0.5\n",
        "mine.yaml line 4: key 'battery': must be a mapping of keys to values, got 0.5",
    ),
    (
        "plant",
        PLANT + "base: floating\n",
        "mine.yaml line 4: key 'base': must be 'fixed' or 'rolling', got \"floating\"",
    ),
    (
        "plant",
        PLANT + "base: null\n",
        "mine.yaml line 4: key 'base': must be 'fixed' or 'rolling', got null",
    ),
    (
        "plant",
        PLANT + "factors: {half_gapp: 2}\n",
        "mine.yaml line 4: key 'factors.half_gapp': no number has this key (did you mean half_gap?",
    ),
    (
        "plant",
        PLANT + "factors: {half_gap: .inf}\n",
        "mine.yaml line 4: key 'factors.half_gap': expected a finite number, or numbers by joint,",
    ),
    (
        "plant",
        PLANT + "factors: {half_gap: wide}\n",
        "mine.yaml line 4: key 'factors.half_gap': expected a finite number, or numbers by joint,",
    ),
    (
        "plant",
        PLANT + "factors: 2\n",
        "mine.yaml line 4: key 'factors': expected a mapping of keys to values",
    ),
    (
        "plant",
        PLANT + "joints: {LShoulderRol: {half_gap: 0.01}}\n",
        "mine.yaml line 4: key 'joints.LShoulderRol': unknown joint 'LShoulderRol' (did you mean",
    ),
    (
        "plant",
        PLANT + "joints: {LShoulderRoll: 0.01}\n",
        "mine.yaml line 4: key 'joints.LShoulderRoll': expected a mapping of keys to values",
    ),
    (
        "plant",
        PLANT + "joints: {LShoulderRoll: {gap: 0.01}}\n",
        "mine.yaml line 4: unknown key 'joints.LShoulderRoll.gap' (did you mean half_gap?",
    ),
    (
        "plant",
        PLANT + "transport: {command_delay: 1.5}\n",
        "mine.yaml line 4: key 'transport.command_delay': must be a whole number, got 1.5",
    ),
    (
        "plant",
        PLANT + "transport: {command_delay: -1}\n",
        "mine.yaml line 4: key 'transport.command_delay': must be 0 or more, got -1",
    ),
    (
        "plant",
        PLANT + "transport: {command_delay: true}\n",
        "mine.yaml line 4: key 'transport.command_delay': must be a whole number, got true",
    ),
    (
        "plant",
        PLANT + "physics: {timestep: 1}\n",
        "mine.yaml line 4: key 'physics.timestep': must be 0.002 or less, got 1",
    ),
    (
        "plant",
        PLANT + "body: {masses: {Hed: 1.0}}\n",
        "mine.yaml line 4: key 'body.masses': unknown name 'Hed' (did you mean Head?",
    ),
    (
        "plant",
        PLANT + "randomise: 3\n",
        "mine.yaml line 4: key 'randomise': expected a mapping of keys to values",
    ),
    (
        "plant",
        PLANT + "randomise: {factors: {half_gap: [2, 1]}, values: {}, model_error: [0, 0]}\n",
        "mine.yaml line 4: key 'randomise.factors.half_gap': the lower bound 2 is above the upper, 1",
    ),
    (
        "plant",
        PLANT.replace("name: mine", "name: 3"),
        "mine.yaml line 1: key 'name': must be a text, got 3",
    ),
    ("plant", "name: mine\ndescription: ''\n", "mine.yaml: key 'base' is missing (and 10 more)"),
    (
        "world",
        WORLD.replace("box", "bx"),
        "mine.yaml line 5: key 'objects.a.shape': must be 'box', 'sphere' or 'capsule', got \"bx\"",
    ),
    (
        "world",
        WORLD.replace("[0.1, 0.1, 0.1]", "[0.1, 0.1]"),
        "mine.yaml line 4: key 'objects.a': size of a box is three whole lengths along x, y, z; 2",
    ),
    (
        "world",
        WORLD.replace("[0.1, 0.1, 0.1]", "[0.1, 0.1, -1]"),
        "mine.yaml line 6: key 'objects.a.size.2': must be above 0, got -1",
    ),
    (
        "world",
        WORLD.replace("[0.1, 0.1, 0.1]", "0.1"),
        "mine.yaml line 6: key 'objects.a.size': must be a list, got 0.1",
    ),
    (
        "world",
        WORLD.replace("[1.0, 0.0, 0.5]", "[1.0, 0.0]"),
        "mine.yaml line 8: key 'objects.a.position': needs at least 3 entries",
    ),
    (
        "world",
        WORLD.replace("[1.0, 0.0, 0.5]", "[1.0, .nan, 0.5]"),
        "mine.yaml line 8: key 'objects.a.position.1': must be a finite number, got nan",
    ),
    (
        "world",
        WORLD.replace("null", "-1"),
        "mine.yaml line 7: key 'objects.a.mass': must be above 0, got -1",
    ),
    (
        "world",
        WORLD.replace("null", "heavy"),
        "mine.yaml line 7: key 'objects.a.mass': must be a number, got \"heavy\"",
    ),
    (
        "world",
        WORLD.replace("shape: box", "shap: box"),
        "mine.yaml line 5: unknown key 'objects.a.shap' (did you mean shape?",
    ),
    (
        "world",
        WORLD.replace("    position: [1.0, 0.0, 0.5]\n", ""),
        "mine.yaml line 4: key 'objects.a.position' is missing",
    ),
    (
        "world",
        WORLD.replace("objects:", "object:"),
        "mine.yaml line 3: unknown key 'object' (did you mean objects?",
    ),
    ("network", "delay: -0.1", "mine.yaml line 4: key 'delay': must be 0 or more, got -0.1"),
    ("network", "delay: soon", "mine.yaml line 4: key 'delay': must be a number, got \"soon\""),
    (
        "network",
        "delay: 1e9",
        "mine.yaml line 4: key 'delay': must be 60 or less, got 1000000000.0",
    ),
    (
        "network",
        "stall_probability: 2",
        "mine.yaml line 6: key 'stall_probability': must be 1 or less, got 2",
    ),
    ("network", "dely: 0.1", "mine.yaml line 9: unknown key 'dely' (did you mean delay?"),
    (
        "safety",
        "speed_margin: 0.5",
        "mine.yaml line 4: key 'speed_margin': must be 1 or more, got 0.5",
    ),
    (
        "safety",
        "speed_margin: .nan",
        "mine.yaml line 4: key 'speed_margin': must be a finite number, got nan",
    ),
    (
        "safety",
        "speed_margin: '1.5'",
        "mine.yaml line 4: key 'speed_margin': must be a number, got \"1.5\"",
    ),
    (
        "safety",
        "speed_margin: true",
        "mine.yaml line 4: key 'speed_margin': must be a number, got true",
    ),
    (
        "safety",
        "following_error: -1",
        "mine.yaml line 6: key 'following_error': must be above 0, got -1",
    ),
    (
        "safety",
        "following_error: null",
        "mine.yaml line 6: key 'following_error': must be a number, got null",
    ),
    (
        "safety",
        "temperature_fault: 10",
        "mine.yaml: 'temperature_warning' must not be above 'temperature_fault'",
    ),
    (
        "safety",
        "battery_fault: 2",
        "mine.yaml line 20: key 'battery_fault': must be 1 or less, got 2",
    ),
    (
        "safety",
        "chest_button: maybe",
        "mine.yaml line 24: key 'chest_button': must be true or false, got \"maybe\"",
    ),
    (
        "safety",
        "following_eror: 0.6",
        "mine.yaml line 34: unknown key 'following_eror' (did you mean following_error or following_error_time?",
    ),
    (
        "observer",
        "tree: oak",
        "mine.yaml line 2: key 'tree': must be 'cart' or 'affine', got \"oak\"",
    ),
    ("observer", "threshold: -1", "mine.yaml line 4: key 'threshold': must be above 0, got -1"),
    (
        "observer",
        "median_window: 11.5",
        "mine.yaml line 3: key 'median_window': must be a whole number, got 11.5",
    ),
    (
        "observer",
        "median_window: 0",
        "mine.yaml line 3: key 'median_window': must be 1 or more, got 0",
    ),
    ("observer", "adapt: 1", "mine.yaml line 8: key 'adapt': must be true or false, got 1"),
    ("observer", "adap: true", "mine.yaml line 14: unknown key 'adap' (did you mean adapt?"),
    ("observer", "merge_gap: -1", "mine.yaml line 10: key 'merge_gap': must be 0 or more, got -1"),
    (
        "controller",
        "feedback: all",
        "mine.yaml line 6: key 'feedback': must be 'none' or 'joints', got \"all\"",
    ),
    (
        "controller",
        "feedback_time: 0",
        "mine.yaml line 7: key 'feedback_time': must be above 0, got 0",
    ),
    (
        "controller",
        "velocity: fast",
        "mine.yaml line 31: key 'velocity': must be 'safe' or 'robot', got \"fast\"",
    ),
    (
        "controller",
        "velocity_limit: {HeadYaw: 1.0}",
        "mine.yaml line 34: key 'velocity_limit': no entry for joint HeadPitch, HipPitch, HipRoll,",
    ),
    (
        "controller",
        "velocity_limit: 3",
        "mine.yaml line 34: key 'velocity_limit': must be a mapping of keys to values, got 3",
    ),
    (
        "controller",
        "jerk_limit: {HeadYow: 1.0}",
        "mine.yaml line 46: key 'jerk_limit': unknown joint 'HeadYow' (did you mean HeadYaw or RHand",
    ),
    (
        "controller",
        "posture: {stiffness: -1, weight: 1.0}",
        "mine.yaml line 8: key 'posture.stiffness': must be 0 or more, got -1",
    ),
    (
        "controller",
        "posture: {stiffness: 5.0}",
        "mine.yaml line 8: key 'posture.weight' is missing",
    ),
    (
        "controller",
        "position_margin: -0.1",
        "mine.yaml line 48: key 'position_margin': must be 0 or more, got -0.1",
    ),
    (
        "controller",
        "constraints: []",
        "mine.yaml line 49: key 'constraints': must be a mapping of keys to values",
    ),
    (
        "doctor",
        "inspection_time: -1",
        "mine.yaml line 2: key 'inspection_time': must be 0.5 or more, got -1",
    ),
    ("doctor", "gravity: [9.8]", "mine.yaml line 6: key 'gravity': needs at least 2 entries"),
    ("doctor", "gravity: 9.8", "mine.yaml line 6: key 'gravity': must be a list, got 9.8"),
    ("doctor", "motion: long", "mine.yaml line 11: key 'motion': must be a number, got \"long\""),
    (
        "doctor",
        "inspektion_time: 1",
        "mine.yaml line 24: unknown key 'inspektion_time' (did you mean inspection_time or segment_time?",
    ),
    ("robot", "name: 3", "robot/pepper.yaml line 2: key 'name': must be a text, got 3"),
    ("robot", "cycle: 0", "robot/pepper.yaml line 4: key 'cycle': must be above 0, got 0"),
    (
        "robot",
        "cycle: slow",
        "robot/pepper.yaml line 4: key 'cycle': must be a number, got \"slow\"",
    ),
    ("robot", "urdf: none.urdf", "robot/none.urdf: not a usable URDF (there is no such file)"),
    ("robot", "postures: none.yaml", "robot/none.yaml: cannot be read (there is no such file)"),
    (
        "robot",
        "joint_names: [HeadYaw]",
        "robot/pepper.yaml line 8: key 'joint_names': no entry for joint HeadPitch, HipPitch,",
    ),
    (
        "robot",
        "joint_names: HeadYaw",
        "robot/pepper.yaml line 8: key 'joint_names': must be a list, got \"HeadYaw\"",
    ),
    (
        "robot",
        "chains: {head: [HeadYow]}",
        "robot/pepper.yaml line 14: key 'chains': unknown joint 'HeadYow' (did you mean HeadYaw or",
    ),
    (
        "postures",
        "Stand: {HeadYaw: 0.0}",
        "robot/postures.yaml line 3: key 'Stand': no entry for joint HeadPitch, HipPitch, HipRoll,",
    ),
    (
        "postures",
        "Stand: 3",
        "robot/postures.yaml line 3: key 'Stand': expected joint names with angles [rad]",
    ),
    (
        "postures",
        "HeadYaw: 9.0",
        "robot/postures.yaml line 3: key 'Stand'.HeadYaw: 9.0 rad lies outside -2.08567 to 2.08567",
    ),
    (
        "postures",
        "HeadYaw: '0.1'",
        "robot/postures.yaml line 3: key 'Stand'.HeadYaw: expected an angle [rad], got \"0.1\"",
    ),
    (
        "postures",
        "HeadYaw: .nan",
        "robot/postures.yaml line 3: key 'Stand'.HeadYaw: nan rad lies outside -2.08567 to 2.08567",
    ),
    (
        "postures",
        "HeadYow: 0.1",
        "robot/postures.yaml line 3: key 'Stand': unknown joint 'HeadYow' (did you mean HeadYaw or",
    ),
    (
        "reflexes",
        "reflexes: hold\n",
        "mine.yaml line 1: key 'reflexes': a list such as [{do: hold}]",
    ),
    ("reflexes", "reflexes: []\nmore: 1\n", "mine.yaml line 2: unknown key 'more'"),
    (
        "reflexes",
        "reflexes: [hold]\n",
        "mine.yaml line 1: key 'reflexes': a list such as [{do: hold}]",
    ),
    (
        "reflexes",
        "reflexes: [{do: hld}]\n",
        "mine.yaml line 1: key 'reflexes.0.do': unknown reflex 'hld' (did you mean hold?",
    ),
    (
        "reflexes",
        "reflexes: [{on: {link: LForeArm}}]\n",
        "mine.yaml line 1: key 'reflexes.0.do' is missing:",
    ),
    (
        "reflexes",
        "reflexes: [{do: hold, on: LForeArm}]\n",
        "mine.yaml line 1: key 'reflexes.0.on': which contacts: a mapping with any of limb, link,",
    ),
    (
        "reflexes",
        "reflexes: [{do: hold, on: {link: LForearm}}]\n",
        "mine.yaml line 1: key 'reflexes.0.on.link': unknown link 'LForearm' (did you mean LForeArm",
    ),
    (
        "reflexes",
        "reflexes: [{do: hold, release_delay: -1}]\n",
        "mine.yaml line 1: key 'reflexes.0': hold: release_delay is a number from 0 to 3600, got -1",
    ),
    (
        "reflexes",
        "reflexes: [{do: hold, release_delay: true}]\n",
        "mine.yaml line 1: key 'reflexes.0': hold: release_delay is a number from 0 to 3600, got True",
    ),
    (
        "reflexes",
        "reflexes: [{do: hold, release_dely: 1}]\n",
        "mine.yaml line 1: unknown key 'reflexes.0.release_dely' (did you mean release_delay?",
    ),
    (
        "reflexes",
        "reflexes: [{do: hold, then: go}]\n",
        "mine.yaml line 1: key 'reflexes.0': hold: 'then' is 'resume' or 'stay', got 'go'",
    ),
    (
        "reflexes",
        "reflexes: [{do: hold}, {do: hold}]\n",
        "mine.yaml line 1: key 'reflexes.1': 'hold' and 'hold' of 'reflexes.0' answer the same",
    ),
]


def message_of(kind: str, content: str) -> object:
    """Read a file with this content; of a kind that is shipped, the shipped one with this key."""
    path = Path("mine.yaml")
    key = content.split(":")[0]
    if kind in SHIPPED:
        text = package_file(*SHIPPED[kind]).read_text()
        if "\n" not in content:
            text, count = re.subn(rf"^{key}:.*(\n .*)*", content, text, count=1, flags=re.MULTILINE)
            content = text if count else f"{text}\n{content}\n"
    if kind in ("robot", "postures"):
        shutil.copytree(package_file(), "robot", ignore=shutil.ignore_patterns("*.py", "__*"))
        name = {"robot": "pepper.yaml", "postures": "postures.yaml"}[kind]
        path = Path("robot", name)
        text = path.read_text()
        if key == "HeadYow":
            text = text.replace("HeadYaw:", "HeadYow:", 1)
        elif key == "HeadYaw":
            text = re.sub(r"HeadYaw: [-0-9.e]+", content, text, count=1)
        else:
            text = re.sub(rf"^{key}:.*(\n .*)*", content, text, count=1, flags=re.MULTILINE)
        path.write_text(text)
        return load_robot(Path("robot", "pepper.yaml").resolve())
    path.write_text(content)
    return LOADERS[kind]("mine.yaml")


@pytest.mark.parametrize(
    ("kind", "content", "expected"),
    CASES,
    ids=[
        f"{number} {kind} {text.splitlines()[-1][:40]}"
        for number, (kind, text, _) in enumerate(CASES)
    ],
)
def test_a_value_is_wrong(
    kind: str, content: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    check_refused(lambda: message_of(kind, content), expected)


def test_one_mistake_is_counted_as_one(tmp_path: Path) -> None:
    """pydantic also finds a list too short from which it has left out what is wrong."""
    path = tmp_path / "mine.yaml"
    path.write_text(WORLD.replace("[0.1, 0.1, 0.1]", "[0.1, 0.1, thick]"))
    assert " more)" not in str(check_refused(lambda: load_world(str(path)), "must be a number"))
    path.write_text(WORLD.replace("[0.1, 0.1, 0.1]", "[0.1, wide, thick]"))
    check_refused(lambda: load_world(str(path)), "(and 1 more)")


NO_MODELS: dict[str, tuple[bytes | None, str]] = {
    "missing": (None, "cannot be read (there is no such file)"),
    "empty": (b"", "not a model file"),
    "YAML": (b"tree: affine\n", "not a model file"),
    "binary": (bytes(range(256)), "not a model file"),
    "a list": (b"[1, 2]", "not a model file"),
    "other JSON": (b'{"a": 1}', "not a model file"),
    "cut": (b'{"format": 2, "robot": "pep', "damaged: "),
    "not UTF-8": (b'{"format": 2, "robot": "\xe9"}', "damaged: not UTF-8 text, at byte 24"),
    "NaN": (b'{"format": 2, "cycle": NaN}', "damaged: NaN is not finite"),
    "old": (b'{"format": 1}', "format 1 is not the format 2"),
    "a key twice": (b'{"format": 2, "format": 2}', "damaged: a key is given twice"),
    "no models": (b'{"format": 2}', "damaged: there are no models"),
    "deep": (b'{"format": ' + b"[" * 100_000, "damaged: "),
}


@pytest.mark.parametrize("wrong", NO_MODELS)
def test_it_holds_no_models(wrong: str, tmp_path: Path) -> None:
    content, expected = NO_MODELS[wrong]
    path = tmp_path / "models.json"
    if content is not None:
        path.write_bytes(content)
    error = check_refused(lambda: ModelSet.load(path), expected, "pepper identify")
    assert str(path) in str(error)


NO_LOGS: dict[str, tuple[bytes | None, str]] = {
    "missing": (None, "cannot be read (there is no such file)"),
    "empty": (b"", "is empty"),
    "text": (b"time,position\n0,1\n", "is not an MCAP file"),
    "binary": (bytes(range(256)), "is not an MCAP file"),
    "only the beginning": (
        b"\x89MCAP0\r\n",
        "not a log of this package, cut before its first row",
    ),
    "zeros": (b"\x89MCAP0\r\n" + bytes(100), "not a log of this package"),
}


@pytest.mark.parametrize("wrong", NO_LOGS)
def test_it_is_no_log(wrong: str, tmp_path: Path) -> None:
    content, expected = NO_LOGS[wrong]
    path = tmp_path / "run.mcap"
    if content is not None:
        path.write_bytes(content)
    assert str(path) in str(check_refused(lambda: read_log(path), expected))


@pytest.mark.parametrize("save", [np.save, np.savez])
def test_it_is_no_recording(save: Any, tmp_path: Path) -> None:
    check_refused(lambda: Recording.load(tmp_path / "none.npz"), "there is no such file")
    check_refused(lambda: Recording.load(tmp_path), "it is a folder")
    path = tmp_path / "run.npz"
    with path.open("wb") as file:
        save(file, np.zeros(3))
    check_refused(lambda: Recording.load(path), "is no recording")
    path.write_bytes(b"PK\x03\x04 nothing")
    check_refused(lambda: Recording.load(path), "damaged")
