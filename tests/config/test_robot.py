"""The robot description against the documented numbers, through two independent kinematics libraries."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio
import pytest
import yaml
from scipy.spatial.transform import Rotation

from pepper_driver.config import (
    ConfigError,
    RobotConfig,
    UnknownNameError,
    load_plant,
    load_robot,
    plant_hash,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.loading import package_file
from support import ROOT

FACTS: dict[str, Any] = yaml.safe_load((ROOT / "tests" / "facts" / "pepper.yaml").read_text())


@pytest.fixture(scope="module")
def robot() -> RobotConfig:
    return load_robot()


def transforms(angles: dict[str, float]) -> dict[str, FloatArray]:
    """Link poses in base_link, (4, 4) each, by the documented joint origins and axes alone."""
    poses = {"base_link": np.eye(4)}
    for name, joint in FACTS["joints"].items():  # listed from the base outwards
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("xyz", joint["rpy"]).as_matrix()
        pose[:3, 3] = joint["xyz"]
        if "axis" in joint:
            turn = np.eye(4)
            vector = np.array(joint["axis"]) * angles.get(name, 0.0)
            turn[:3, :3] = Rotation.from_rotvec(vector).as_matrix()
            pose = pose @ turn
        poses[joint["child"]] = poses[joint["parent"]] @ pose
    return poses


def random_angles(robot: RobotConfig, seed: int) -> dict[str, float]:
    values = np.random.default_rng(seed).uniform(robot.lower, robot.upper)
    return dict(zip(robot.joint_names, map(float, values), strict=True))


def test_joint_order_and_limits(robot: RobotConfig) -> None:
    assert list(robot.joint_names) == FACTS["joint_order"]
    for joint in robot.joints:
        assert [joint.lower, joint.upper] == FACTS["joints"][joint.name]["limits"]


def test_there_are_22_links_and_3_wheels(robot: RobotConfig) -> None:
    assert len(robot.links) == 22
    assert set(FACTS["links"]) | {"base_link"} == set(robot.links)
    assert robot.wheels.names == ("WheelFL", "WheelFR", "WheelB")


def test_masses_and_inertias(robot: RobotConfig) -> None:
    spec = mujoco.MjSpec.from_file(str(robot.urdf))
    spec.compiler.fusestatic = False
    spec.compiler.boundmass = 0
    spec.compiler.boundinertia = 0
    model = spec.compile()
    for link, (mass, x, y, z, ixx, ixy, ixz, iyy, iyz, izz) in FACTS["links"].items():
        body = model.body(link).id
        assert model.body_mass[body] == pytest.approx(mass, rel=1e-12)
        np.testing.assert_allclose(model.body_ipos[body], [x, y, z], atol=1e-12)
        rotation = Rotation.from_quat(model.body_iquat[body], scalar_first=True).as_matrix()
        tensor = rotation @ np.diag(model.body_inertia[body]) @ rotation.T
        documented = [[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]
        np.testing.assert_allclose(tensor, documented, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_forward_kinematics_and_centre_of_mass(robot: RobotConfig, seed: int) -> None:
    angles = random_angles(robot, seed)
    poses = transforms(angles)
    weighted = sum(
        values[0] * (poses[link] @ [*values[1:4], 1.0])[:3]
        for link, values in FACTS["links"].items()
    )
    mass = sum(values[0] for values in FACTS["links"].values())
    com = weighted / mass
    # The documented total counts 28 finger links of 2 mg, which the URDF leaves out.
    assert mass == pytest.approx(FACTS["total_mass"] - 28 * 2e-6, abs=1e-9)

    # A free root: Pinocchio leaves what is welded to the world out of the centre of mass.
    root = pinocchio.JointModelFreeFlyer()
    pin_model = pinocchio.buildModelFromUrdf(str(robot.urdf), root)
    pin_data = pin_model.createData()
    q = pinocchio.neutral(pin_model)
    for name, angle in angles.items():
        q[pin_model.joints[pin_model.getJointId(name)].idx_q] = angle
    pinocchio.framesForwardKinematics(pin_model, pin_data, q)
    for link, pose in poses.items():
        found = pin_data.oMf[pin_model.getFrameId(link)].homogeneous
        np.testing.assert_allclose(found, pose, atol=1e-9)
    np.testing.assert_allclose(pinocchio.centerOfMass(pin_model, pin_data, q), com, atol=1e-6)
    assert pinocchio.computeTotalMass(pin_model) == pytest.approx(mass, abs=1e-9)

    mj_model = mujoco.MjModel.from_xml_path(str(robot.urdf))
    mj_data = mujoco.MjData(mj_model)
    for name, angle in angles.items():
        mj_data.qpos[mj_model.joint(name).qposadr[0]] = angle
    mujoco.mj_kinematics(mj_model, mj_data)
    for link in ("Head", "l_wrist", "r_gripper", "torso"):
        np.testing.assert_allclose(mj_data.body(link).xpos, poses[link][:3, 3], atol=1e-9)


def test_touch_sensors_bumpers_and_button_sit_where_documented(robot: RobotConfig) -> None:
    sensors = robot.sensors
    found = {**sensors.touch, **sensors.bumpers, **sensors.buttons}
    assert (len(sensors.touch), len(sensors.bumpers), len(sensors.buttons)) == (5, 3, 1)
    assert set(found) == set(FACTS["sensors"])
    for name, frame in FACTS["sensors"].items():
        assert found[name].parent == frame["parent"]
        assert list(found[name].xyz) == frame["xyz"]
        assert list(found[name].rpy) == frame["rpy"]
        assert {found[name].parent, *found[name].covers} <= set(robot.links)
    (button,) = sensors.buttons
    key = robot.naoqi.prefix + robot.naoqi.button.format(button=button)
    assert key == "Device/SubDeviceList/ChestBoard/Button/Sensor/Value"


def test_centre_of_mass_of_the_independent_urdf() -> None:
    poses = transforms({})
    height = sum(v[0] * (poses[k] @ [*v[1:4], 1.0])[2] for k, v in FACTS["links"].items())
    assert height / FACTS["total_mass"] == pytest.approx(FACTS["com_height_at_zero"], abs=5e-5)


def test_recorded_postures_lie_inside_the_limits(robot: RobotConfig) -> None:
    assert {"Stand", "StandInit", "StandZero", "Crouch", "HalfSitting"} <= set(robot.postures)
    for posture in robot.postures.values():
        assert (posture >= robot.lower).all()
        assert (posture <= robot.upper).all()
    assert robot.posture("Stand")[robot.joint_index("LShoulderPitch")] == pytest.approx(
        1.58, abs=1e-6
    )


def test_a_posture_is_a_copy(robot: RobotConfig) -> None:
    robot.posture("Stand")[:] = 0.0
    assert np.abs(robot.posture("Stand")).max() > 1.0


def test_wheel_matrix_rolls_without_slip(robot: RobotConfig) -> None:
    """Each row from the geometry: -1/r [t, x t_y - y t_x] for a wheel that rolls along t = (-sin yaw, cos yaw)."""
    for row, name in enumerate(robot.wheels.names):
        joint = FACTS["joints"][name]
        yaw, (x, y, _) = joint["rpy"][2], joint["xyz"]
        t = np.array([-np.sin(yaw), np.cos(yaw)])
        expected = -np.array([t[0], t[1], x * t[1] - y * t[0]]) / robot.wheels.radius
        np.testing.assert_allclose(robot.wheels.matrix[row], expected, atol=2e-4)


def test_five_motor_types_on_seventeen_joints(robot: RobotConfig) -> None:
    assert len(robot.motors.types) == 5
    assert {drive.type for drive in robot.motors.joints.values()} == set(robot.motors.types)
    for motor in robot.motors.types.values():
        # The computed resistance follows from the documented no-load speed and stall torque.
        voltage = motor.torque_constant * motor.no_load_speed
        assert motor.resistance == pytest.approx(
            motor.torque_constant * voltage / motor.stall_torque, rel=2e-3
        )


def test_chains_run_from_the_trunk_outwards(robot: RobotConfig) -> None:
    for chain in robot.chains.values():
        for inner, outer in pairwise(chain):
            assert (
                robot.joints[robot.joint_index(inner)].child
                == robot.joints[robot.joint_index(outer)].parent
            )
    assert robot.chain_of("LElbowRoll")[0] == "LShoulderPitch"


def test_unknown_names_suggest_close_ones(robot: RobotConfig) -> None:
    with pytest.raises(UnknownNameError, match="LShoulderRoll"):
        robot.joint_index("LShoulderRol")
    with pytest.raises(UnknownNameError, match="StandInit"):
        robot.posture("StandInt")


def broken_copy(tmp_path: Path, file: str, old: str, new: str) -> Path:
    """The shipped description with one change in one file; returns its top file."""
    for name in (
        "pepper.urdf",
        *(
            f"{n}.yaml"
            for n in ("pepper", "postures", "motors", "sensors", "limits", "wheels", "naoqi")
        ),
    ):
        text = package_file(name).read_text()
        if name == file:
            assert old in text
            text = text.replace(old, new, 1)
        (tmp_path / name).write_text(text)
    return tmp_path / "pepper.yaml"


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("postures.yaml", "LShoulderRoll: 0.1", "LShoulderRoll: 9.1", "outside"),
        ("postures.yaml", "LShoulderRoll: 0.1", "LSholderRoll: 0.1", "did you mean LShoulderRoll"),
        ("postures.yaml", "KneePitch: 0.0, ", "", "no entry for joint KneePitch"),
        ("motors.yaml", "resistance: 3.683", "resistance: -3.683", "must be above 0"),
        ("motors.yaml", "resistance: 3.683", "resistence: 3.683", "did you mean resistance"),
        ("motors.yaml", 'HipRoll: {type: "4"', 'HipRoll: {type: "9"', "unknown motor type '9'"),
        ("sensors.yaml", "bits: 12", "bits: 12.5", "encoder.bits"),
        ("pepper.yaml", "cycle: 0.012", "cycle: fast", "key 'cycle'"),
        ("pepper.yaml", "name: pepper", "name: pepper\nname: salt", "given twice"),
        ("pepper.yaml", "legs: [KneePitch, ", "legs: [", "no entry for joint KneePitch"),
        ("wheels.yaml", "radius: 0.07", "radius: [0.07]", "key 'radius'"),
        ("pepper.urdf", "</robot>", "", "not a usable URDF"),
        ("naoqi.yaml", "time: DCM/Time", "", "key 'time' is missing"),
        ("limits.yaml", "driver: HeadYaw", "driver: HeadYam", "did you mean HeadYaw"),
    ],
)
def test_a_wrong_file_is_named_with_its_key(
    tmp_path: Path, file: str, old: str, new: str, message: str
) -> None:
    top = broken_copy(tmp_path, file, old, new)
    with pytest.raises(ConfigError) as caught:
        load_robot(top)
    text = str(caught.value)
    assert file in text
    assert message in text
    assert "\n" not in text


def test_the_identity_of_a_plant_follows_its_motors(tmp_path: Path) -> None:
    shipped = load_robot()
    other = load_robot(broken_copy(tmp_path, "motors.yaml", "resistance: 3.683", "resistance: 3.7"))
    plant = load_plant("nominal", shipped)
    assert plant_hash(plant, other) != plant_hash(plant, shipped)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yaml"):
        load_robot(tmp_path / "nowhere.yaml")


def test_a_mirror_shows_the_other_hand(robot: RobotConfig) -> None:
    """The right hand does in the mirrored posture as the left one does, seen through the xz-plane."""
    reflection = np.diag([1.0, -1.0, 1.0, 1.0])
    index = [index for index, _ in robot.mirror]
    sign = np.array([sign for _, sign in robot.mirror])
    fingers = [robot.joint_index(name) for name in robot.hands.joints]
    model = pinocchio.buildModelFromUrdf(str(robot.urdf))
    data = model.createData()

    def poses(posture: FloatArray) -> list[FloatArray]:
        q = pinocchio.neutral(model)
        for name, angle in zip(robot.joint_names, posture, strict=True):
            q[model.joints[model.getJointId(name)].idx_q] = angle
        pinocchio.framesForwardKinematics(model, data, q)
        names = ("l_wrist", "r_wrist", "Head", "LForeArm", "RForeArm")
        return [data.oMf[model.getFrameId(name)].homogeneous.copy() for name in names]

    for seed in range(5):
        posture = np.random.default_rng(seed).uniform(robot.lower, robot.upper)
        left, right, head, left_arm, right_arm = poses(posture)
        seen = poses(sign * posture[index])
        expected = (right, left, head, right_arm, left_arm)
        for pose, other in zip(seen, expected, strict=True):
            np.testing.assert_allclose(reflection @ pose @ reflection, other, atol=1e-12)
    assert [robot.joint_names[index[k]] for k in fingers] == ["RHand", "LHand"]
    np.testing.assert_array_equal(sign[fingers], 1.0)


def test_the_mirror_of_the_mirror_is_the_robot(robot: RobotConfig) -> None:
    for here, (there, sign) in enumerate(robot.mirror):
        assert robot.mirror[there] == (here, sign)
    names = robot.joint_names
    partner = {name: names[robot.mirror[k][0]] for k, name in enumerate(names)}
    assert all(partner[name] == name for name in ("KneePitch", "HipRoll", "HeadYaw", "HeadPitch"))
    assert all(partner[f"L{name[1:]}"] == name for name in names if name.startswith("R"))
    # Limits of the arms mirror each other too.
    for here, (there, sign) in enumerate(robot.mirror):
        lower, upper = sorted((sign * robot.lower[here], sign * robot.upper[here]))
        assert robot.lower[there] == pytest.approx(lower)
        assert robot.upper[there] == pytest.approx(upper)
