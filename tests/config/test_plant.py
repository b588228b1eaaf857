"""Files of plants: mistakes are reported with file, key and reason, and a plant is known by all that it is."""

import math
import re
from pathlib import Path
from typing import Any

import pytest

from pepper_driver.config import ConfigError, PlantConfig, load_plant, load_robot, plant_hash
from pepper_driver.config.errors import UnknownNameError
from pepper_driver.config.loading import package_file, parse, read_yaml
from pepper_driver.config.plant import plant_names
from support.plant_files import (
    FLEXIBLE,
    ROBOT,
    Change,
    Tree,
    changed,
    drive_of,
    nominal,
    numbers,
    put,
    save,
    variant,
)


def take(joint: str) -> Change:
    def change(data: Tree) -> None:
        drive_of(data, joint)["joints"].remove(joint)

    return change


def give(joint: str, to: str) -> Change:
    return lambda data: drive_of(data, to)["joints"].append(joint)


WRONG: list[tuple[Change, str, str]] = [
    (put("physics", "timestep", value=0.0007), "physics.timestep", "does not divide the cycle"),
    (put("physics", "timestep", value=1e-320), "physics.timestep", "does not divide the cycle"),
    (put("physics", "timestep", value=0.003), "physics.timestep", "must be 0.002 or less"),
    (put("physics", "timestep", value=0.0), "physics.timestep", "must be above 0"),
    (give("HipRol", "HipRoll"), "joints", "did you mean HipRoll"),
    (give("KneePitch", "HipRoll"), "joints", "already has an actuator"),
    (take("HeadYaw"), "actuators", "no entry for joint HeadYaw"),
    (put("actuators", 0, "half_gap", value=0.6), "half_gap", "wider than the joint's range"),
    (put("actuators", 0, "half_gap", value=-0.1), "half_gap", "must be 0 or more"),
    (put("actuators", 0, "gear_stiffness", value=-2), "gear_stiffness", "must be above 0"),
    (put("actuators", 0, "friction", "breakaway", value=0.9), "breakaway", "must be 1 or more"),
    (put("actuators", 0, "friction", "load", value=1.0), "friction.load", "must be below 1"),
    (put("actuators", 0, "friction", "gap", "relatve", value=1.0), "relatve", "did you mean"),
    (put("board", "brakes", value=["KneePich"]), "board.brakes", "did you mean KneePitch"),
    (put("base", value="flying"), "base", "fixed"),
    (
        put("transport", "command_delay", value=1.5),
        "transport.command_delay",
        "must be a whole number",
    ),
    (put("transport", "late", value=1.0), "transport.late", "must be below 1"),
    (put("battery", "empty_voltage", value=40.0), "battery.empty_voltage", "not below"),
    (put("battery", "charge", value=0.0), "battery.charge", "must be above 0"),
    (put("heat", "rise", value={}), "heat.rise", "no entry for motor type"),
    (put("heat", "rise", "9", value=1.0), "heat.rise", "unknown name '9'"),
    (put("heat", "rise", "1", value=-1.0), "heat.rise.1", "must be 0 or more"),
    (put("heat", "start", value=math.nan), "heat.start", "finite"),
    (put("body", "masses", value={"Head": -1.0}), "body.masses.Head", "must be above 0"),
    (put("body", "masses", value={"Haed": 1.0}), "body.masses", "did you mean Head"),
    (put("body", "coms", value={"Head": [0, 0]}), "body.coms.Head", "needs at least 3 entries"),
    (
        put(
            "body", "payloads", value=[{"link": "hnd", "mass": 1, "radius": 0.1, "xyz": [0, 0, 0]}]
        ),
        "body.payloads",
        "unknown name 'hnd'",
    ),
]

for key, value, message in (
    ("joint", "Hip", "unknown name 'Hip'"),
    ("axis", [0, 0, 0], "the axis has no length"),
    ("stiffness", 0, "must be above 0"),
    ("inertia", -0.1, "must be 0 or more"),
):
    WRONG.append((put("flexibilities", value=[{**FLEXIBLE, key: value}]), "flexibilities", message))


@pytest.mark.parametrize(("change", "key", "message"), WRONG)
def test_a_wrong_plant_is_refused(tmp_path: Path, change: Change, key: str, message: str) -> None:
    with pytest.raises(ConfigError, match=r"mine\.yaml") as caught:
        load_plant(changed(tmp_path, change), ROBOT)
    text = str(caught.value)
    assert key in text
    assert message in text
    assert "\n" not in text


def test_an_unknown_plant_lists_those_there_are() -> None:
    with pytest.raises(UnknownNameError, match="nominal"):
        load_plant("nominl", ROBOT)
    assert "nominal" in plant_names()


def test_numbers_without_a_dot_are_numbers(tmp_path: Path) -> None:
    path = Path(save(tmp_path, nominal()))
    text = re.sub(r"timestep: \S+", "timestep: 1e-3", path.read_text())
    path.write_text(text)
    assert load_plant(str(path), ROBOT).physics.timestep == 0.001


def test_a_gap_is_compared_with_the_range_of_its_own_joint(tmp_path: Path) -> None:
    """The hand opens by 1, the knee turns by 1.03, the hip by 2.08."""
    for joint in ("KneePitch", "HipPitch"):
        bounds = ROBOT.joints[ROBOT.joint_index(joint)]
        half = (bounds.upper - bounds.lower) / 2
        for ratio, fits in ((0.99, True), (1.01, False)):
            path = variant(tmp_path, joints={joint: {"half_gap": ratio * half}})
            if fits:
                load_plant(path, ROBOT)
            else:
                with pytest.raises(ConfigError, match=f"gap of {joint} is wider"):
                    load_plant(path, ROBOT)


def test_a_negative_rotor_is_refused(tmp_path: Path) -> None:
    folder = package_file("pepper.yaml").parent
    for path in [*folder.glob("*.yaml"), *folder.glob("*.urdf")]:
        (tmp_path / path.name).write_text(path.read_text())
    motors = read_yaml(tmp_path / "motors.yaml")
    motors["types"]["4"]["rotor_inertia"] *= -1
    save(tmp_path, motors, "motors.yaml")
    with pytest.raises(
        ConfigError, match=r"motors\.yaml line \d+: key 'types\.4\.rotor_inertia'.*above 0"
    ):
        load_robot(tmp_path / "pepper.yaml")


def test_the_hash_follows_every_parameter() -> None:
    def identity(change: Change) -> str:
        data = nominal()
        change(data)
        return plant_hash(parse(PlantConfig, data, "plant.yaml"), ROBOT)

    seen = {identity(lambda data: None)}
    count = 1
    first = [p for p in numbers(nominal()) if p[0] != "actuators" or p[1] in (0, 7)]
    for path in first:
        value: Any = nominal()
        for part in path:
            value = value[part]
        # Halved, or moved off zero: that every bound takes.
        other: float = value + 1 if isinstance(value, int) else value / 2 if value else 0.125
        if path[-1] == "breakaway":
            other = value + 1.0
        seen.add(identity(put(*path, value=other)))
        count += 1
    for path, value in (
        (("base",), "fixed" if nominal()["base"] == "rolling" else "rolling"),
        (("targets", "speed_limit"), 1.25),
        (("board", "brakes"), []),
        (("body", "masses"), {"Head": 1.1}),
        (("body", "coms"), {"Head": [0.0, 0.0, 0.1]}),
        (("body", "payloads"), [{"link": "Head", "mass": 1.0, "radius": 0.1, "xyz": [0, 0, 0]}]),
        (("flexibilities",), [FLEXIBLE]),
    ):
        seen.add(identity(put(*path, value=value)))
        count += 1
    assert len(seen) == count > 70


def test_the_hash_does_not_follow_the_prose(tmp_path: Path) -> None:
    shipped = load_plant("nominal", ROBOT)
    renamed = changed(
        tmp_path,
        lambda data: (
            data.update(name="other", description="else"),
            [entry.update(origin={}) for entry in data["actuators"]],
        ),
    )
    plant = load_plant(renamed, ROBOT)
    assert plant.source != shipped.source
    assert plant_hash(plant, ROBOT) == plant_hash(shipped, ROBOT)
