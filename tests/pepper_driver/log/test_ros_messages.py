"""Topics under ROS 2 names: read by ROS's decoder, and compared with kinematics and parsers of other libraries."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from pepper_driver import Pepper
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import Tick
from pepper_driver.log import LogError, LogWriter, read_log
from pepper_driver.log.repair import repair_log
from pepper_driver.log.ros_messages import EVERY, ODOM, ROS_TOPICS, RosTopic
from pepper_driver.log.schema import layout_metadata
from pepper_driver.log.writer import McapFile
from pepper_driver.loop import TickRecord
from support.log_samples import ROBOT, Samples, Written, same_bits

decoder = pytest.importorskip("mcap_ros2.decoder")

NAMES = [topic.topic for topic in ROS_TOPICS]
RANDOM = np.random.default_rng(0)


def tick(number: int, position: FloatArray, time: float | None = None) -> Tick:
    """A tick with angles that a robot can have."""
    made = Samples(number).tick(number)
    time = made.measurement.time if time is None else time
    return replace(made, measurement=replace(made.measurement, position=position, time=time))


def angles() -> FloatArray:
    return RANDOM.uniform(ROBOT.lower, ROBOT.upper)


def write(path: Path, records: Iterable[TickRecord]) -> Path:
    with LogWriter(path, ROBOT, {}, lossless=True) as log:
        for record in records:
            log.append(record)
    return path


def messages(path: Path, topic: str) -> list[Any]:
    """All messages of a topic, as another library decodes them by the definitions in the file."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[decoder.DecoderFactory()])
        return [message for _, _, _, message in reader.iter_decoded_messages([topic])]


def placements(message: Any) -> dict[tuple[str, str], FloatArray]:
    """(4, 4) of each transform of a TFMessage, by parent and child."""
    found = {}
    for each in message.transforms:
        shift, turn = each.transform.translation, each.transform.rotation
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
        pose[:3, 3] = shift.x, shift.y, shift.z
        assert math.hypot(turn.x, turn.y, turn.z, turn.w) == pytest.approx(1.0, abs=1e-12)
        found[each.header.frame_id, each.child_frame_id] = pose
    return found


def in_odom(tree: dict[tuple[str, str], FloatArray]) -> dict[str, FloatArray]:
    """(4, 4) of each frame in the odometry frame, along the tree."""
    parents = {child: parent for parent, child in tree}
    assert len(parents) == len(tree), "a frame has one parent"
    poses = {}
    for link in parents:
        pose, at = np.eye(4), link
        while at != ODOM:
            pose, at = tree[parents[at], at] @ pose, parents[at]
        poses[link] = pose
    return poses


@pytest.mark.parametrize("number", range(5))
def test_transforms_are_the_kinematics_of_the_urdf(tmp_path: Path, number: int) -> None:
    position, base = angles(), RANDOM.uniform(-4, 4, 3)
    path = write(tmp_path / "a.mcap", [TickRecord(tick=tick(0, position), base_pose=base)])
    (fixed,), (moving,) = messages(path, "/tf_static"), messages(path, "/tf")
    poses = in_odom(placements(fixed) | placements(moving))

    model = pin.buildModelFromUrdf(str(ROBOT.urdf), pin.JointModelPlanar())
    q = pin.neutral(model)
    q[:4] = base[0], base[1], math.cos(base[2]), math.sin(base[2])
    for name, angle in zip(ROBOT.joint_names, position, strict=True):
        q[model.joints[model.getJointId(name)].idx_q] = angle
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    assert set(poses) == set(ROBOT.links)
    for link, pose in poses.items():
        expected = data.oMf[model.getFrameId(link)].homogeneous
        np.testing.assert_allclose(pose, expected, rtol=0, atol=1e-12, err_msg=link)


def test_links_may_stand_at_any_angle_on_their_parents_and_turn_about_any_axis(
    tmp_path: Path,
) -> None:
    frames = {
        link: replace(frame, xyz=tuple(RANDOM.normal(size=3)), rpy=tuple(RANDOM.uniform(-3, 3, 3)))
        for link, frame in ROBOT.link_frames.items()
    }
    joints = tuple(replace(joint, axis=tuple(RANDOM.normal(size=3))) for joint in ROBOT.joints)
    position, path = angles(), tmp_path / "a.mcap"
    with LogWriter(path, replace(ROBOT, link_frames=frames, joints=joints), {}) as log:
        log.append(TickRecord(tick=tick(0, position)))
    found = placements(messages(path, "/tf_static")[0]) | placements(messages(path, "/tf")[0])
    turns = {
        joint.child: Rotation.from_rotvec(np.array(joint.axis) / np.linalg.norm(joint.axis) * angle)
        for joint, angle in zip(joints, position, strict=True)
    }
    assert len(found) == len(frames) + 1
    for link, frame in frames.items():
        pose = found[frame.parent, link]
        turn = Rotation.from_euler("xyz", frame.rpy) * turns.get(link, Rotation.identity())
        np.testing.assert_allclose(pose[:3, :3], turn.as_matrix(), rtol=0, atol=1e-12)
        np.testing.assert_array_equal(pose[:3, 3], frame.xyz)


def test_a_joint_state_has_what_was_measured(tmp_path: Path) -> None:
    position = angles()
    path = write(tmp_path / "a.mcap", [TickRecord(tick=tick(0, position, time=12.25))])
    (state,) = messages(path, "/joint_states")
    assert state.name == list(ROBOT.joint_names)
    assert same_bits(np.array(state.position), position)
    assert (state.velocity, state.effort) == ([], []), "nothing measures them"
    (moving,), (fixed,) = messages(path, "/tf"), messages(path, "/tf_static")
    for header in [state.header, *(each.header for each in moving.transforms + fixed.transforms)]:
        assert (header.stamp.sec, header.stamp.nanosec) == (12, 250_000_000)


def test_the_description_is_the_urdf_and_others_read_it(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", (TickRecord(tick=tick(i, angles())) for i in range(12)))
    (description,) = messages(path, "/robot_description")
    assert description.data == ROBOT.urdf.read_text()
    assert pin.buildModelFromXML(description.data).nq >= len(ROBOT.joints)
    assert mujoco.MjModel.from_xml_string(description.data).njnt >= len(ROBOT.joints)
    links = {link.attrib["name"] for link in ElementTree.fromstring(description.data).iter("link")}
    frames = {each.child_frame_id for each in messages(path, "/tf")[0].transforms}
    assert frames < links


def test_what_never_changes_comes_once_and_first_the_rest_with_some_ticks(tmp_path: Path) -> None:
    count = 3 * EVERY + 1
    path = write(tmp_path / "a.mcap", (TickRecord(tick=tick(i, angles())) for i in range(count)))
    with path.open("rb") as stream:
        stamps: dict[str, list[int]] = {name: [] for name in NAMES}
        for _, channel, message in make_reader(stream).iter_messages(NAMES):
            stamps[channel.topic].append(message.log_time)
    cycle = 12_000_000
    sampled = [step * cycle for step in range(0, count, EVERY)]
    assert stamps == {
        "/robot_description": [0],
        "/tf_static": [0],
        "/tf": sampled,
        "/joint_states": sampled,
    }


def test_a_log_begun_in_a_run_starts_with_the_description(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [TickRecord(tick=tick(0, angles(), time=100.0))])
    with path.open("rb") as stream:
        assert {m.log_time for _, _, m in make_reader(stream).iter_messages()} == {100 * 10**9}


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("where", ["joint", "x", "heading"])
def test_a_number_that_is_not_finite_gives_no_transform(
    tmp_path: Path, value: float, where: str
) -> None:
    position, base = angles(), np.zeros(3)
    if where == "joint":
        position[7] = value
    else:
        base[0 if where == "x" else 2] = value
    good = angles()
    records = [TickRecord(tick=tick(0, position), base_pose=base)]
    records += [TickRecord(tick=tick(i, good)) for i in range(1, EVERY + 1)]
    path = write(tmp_path / "a.mcap", records)
    assert len(read_log(path)) == EVERY + 1
    (state,) = messages(path, "/joint_states")
    assert same_bits(np.array(state.position), good)
    for pose in placements(messages(path, "/tf")[0]).values():
        assert np.isfinite(pose).all()


def test_a_clock_beyond_the_stamps_of_ros_stands_at_the_last_one(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [TickRecord(tick=tick(0, angles(), time=2.0**32))])
    (state,) = messages(path, "/joint_states")
    assert (state.header.stamp.sec, state.header.stamp.nanosec) == (2**31 - 1, 10**9 - 1)


def test_arrays_of_backends_may_have_gaps_or_another_type(tmp_path: Path) -> None:
    position = angles().astype(np.float32)
    gaps = np.zeros(2 * len(position))
    gaps[::2] = position
    given: dict[int, Any] = {0: position, EVERY: gaps[::2]}
    ticks = (tick(i, given.get(i, gaps[::2])) for i in range(EVERY + 1))
    path = write(tmp_path / "a.mcap", (TickRecord(tick=each) for each in ticks))
    for state in messages(path, "/joint_states"):
        assert same_bits(np.array(state.position), position.astype(np.float64))


def test_the_base_goes_where_the_wheels_took_it(tmp_path: Path) -> None:
    path, poses = tmp_path / "a.mcap", {}
    with Pepper("mujoco", observer=None, log=path) as pepper:
        pepper.drive(0.2, 0.0, 0.5, hold=True)

        def keep(tick: Tick, _: object) -> None:
            poses[round(tick.measurement.time * 1e9)] = pepper.base_pose

        pepper.run(2.0, on_tick=keep)
    driven = 0.0
    for message in messages(path, "/tf"):
        base = message.transforms[0]
        assert (base.header.frame_id, base.child_frame_id) == ("odom", "base_link")
        stamp = base.header.stamp.sec * 10**9 + base.header.stamp.nanosec
        x, y, heading = poses[stamp]
        shift, turn = base.transform.translation, base.transform.rotation
        assert (shift.x, shift.y, shift.z) == (x, y, 0.0)
        assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(heading, abs=1e-12)
        driven = max(driven, math.hypot(x, y))
    assert driven > 0.1


@pytest.mark.parametrize("topic", ROS_TOPICS, ids=lambda topic: topic.topic)
def test_a_schema_defines_each_message_in_it_once(topic: RosTopic) -> None:
    first, *parts = topic.schema.split("=" * 80 + "\nMSG: ")
    defined = [part.partition("\n")[0] for part in parts]
    used = {
        line.split()[0].removesuffix("[]")
        for text in (first, *(part.partition("\n")[2] for part in parts))
        for line in text.splitlines()
    }
    assert len(set(defined)) == len(defined)
    assert {kind for kind in used if "/" in kind} == set(defined)


def test_repair_keeps_the_topics(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", (TickRecord(tick=tick(i, angles())) for i in range(120)))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    repair_log(path, tmp_path / "b.mcap")
    (description,) = messages(tmp_path / "b.mcap", "/robot_description")
    assert description.data == ROBOT.urdf.read_text()
    states = messages(tmp_path / "b.mcap", "/joint_states")
    read = read_log(tmp_path / "b.mcap")
    assert 0 < len(read) < 120
    sampled = read["position"][::EVERY]
    assert 0 <= len(sampled) - len(states) <= 1, "a chunk may end between a row and its state"
    for state, position in zip(states, sampled, strict=False):
        assert same_bits(np.array(state.position), position)


def test_a_log_from_before_these_topics_is_read_and_repaired(tmp_path: Path) -> None:
    written = Written(tmp_path / "a.mcap", 30)
    layout = layout_metadata(ROBOT)
    layout["topics"] = json.dumps([t for t in json.loads(layout["topics"]) if t not in NAMES])
    old = McapFile(tmp_path / "old.mcap", layout, {})
    with (tmp_path / "a.mcap").open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            if channel.topic not in NAMES:
                old.write_row(channel.topic, 1e-9 * message.log_time, message.data)
    old.finish()
    repair_log(tmp_path / "old.mcap", tmp_path / "repaired.mcap")
    for name in ("old.mcap", "repaired.mcap"):
        read = read_log(tmp_path / name)
        assert (read.complete, len(read)) == (True, 30)
        written.check(read)


def test_a_removed_urdf_is_one_line(tmp_path: Path) -> None:
    robot = replace(ROBOT, urdf=tmp_path / "gone.urdf")
    with pytest.raises(LogError, match=r"gone\.urdf: cannot be read for the log \(.*no such"):
        LogWriter(tmp_path / "a.mcap", robot, {})
    assert list(tmp_path.iterdir()) == []
