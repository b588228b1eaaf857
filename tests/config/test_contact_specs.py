"""Contacts of a simulated robot: what is read of them, how strong they are, and which make no sense."""

from pathlib import Path
from typing import Any

import pytest

from pepper_driver.config.contact_specs import (
    AnyContact,
    GrabSpec,
    JointPushSpec,
    PushSpec,
    RandomForces,
    RandomPushes,
)
from support.experiment_files import (
    PUSH,
    RANDOM,
    SETPOINTS,
    STAND,
    TURN,
    changed,
    experiment,
    load_data,
    refusal,
)

PLACE = {key: PUSH[key] for key in ("joint", "link", "xyz")}
JOINT_PUSH: dict[str, Any] = {
    **PLACE,
    "kind": "joint_push",
    "degrees": 2.8,
    "direction": -1,
    "start": 0.5,
    "duration": 0.5,
}
GRAB: dict[str, Any] = {**PLACE, "kind": "grab", "pull": [0.0, 0.02, 0.0], "start": 0.5}
FORCES: dict[str, Any] = {
    "kind": "random_forces",
    "times": [0.5],
    "newtons": [5.0, 20.0],
    "duration": [0.3, 1.0],
    "points": [
        {"link": "torso", "xyz": [0.0, 0.0, 0.2]},
        {"link": "Tibia", "xyz": [0.0, 0.1, 0.0]},
    ],
}
PUSHES: dict[str, Any] = changed(
    RANDOM, "points.LElbowRoll", {"link": "LForeArm", "xyz": [0.1, 0, 0]}
)


def touched(*contacts: dict[str, Any]) -> dict[str, Any]:
    """A robot that stands, turns its head and goes to random goals, with contacts."""
    return experiment(
        STAND, TURN | {"hold": 5.0}, {"setpoints": SETPOINTS}, contacts=list(contacts)
    )


def contact_of(folder: Path, contact: dict[str, Any]) -> AnyContact:
    (read,) = load_data(folder, touched(contact)).contacts
    return read


def test_each_kind_is_read(tmp_path: Path) -> None:
    push = contact_of(tmp_path, PUSH | {"step": "stand", "frame": "link"})
    assert isinstance(push, PushSpec)
    assert (push.joint, push.link, push.step, push.frame) == (
        "LShoulderRoll",
        "LBicep",
        "stand",
        "link",
    )
    assert (push.start, push.duration, push.saturating) == (0.5, 0.5, False)
    assert push.largest == push.force == (0.0, 10.0, 0.0)
    joint_push = contact_of(tmp_path, JOINT_PUSH | {"saturating": True})
    assert isinstance(joint_push, JointPushSpec)
    assert (joint_push.degrees, joint_push.direction, joint_push.saturating) == (2.8, -1, True)
    assert joint_push.step is None
    grab = contact_of(tmp_path, GRAB | {"rise": 0.6, "hold": 2.0, "release": 0.2})
    assert isinstance(grab, GrabSpec)
    assert grab.duration == pytest.approx(0.6 + 2.0 + 0.2)
    assert isinstance(contact_of(tmp_path, PUSHES), RandomPushes)
    assert isinstance(contact_of(tmp_path, FORCES), RandomForces)


@pytest.mark.parametrize("way", [0.001, 0.05, 0.5])
def test_a_grab_pulls_with_its_spring_and_no_more_than_its_strength(way: float) -> None:
    grab = GrabSpec(**(GRAB | {"xyz": (0.0, 0.0, 0.0), "pull": (0.6 * way, 0.0, -0.8 * way)}))
    size = min(1000.0 * way, 100.0)
    assert grab.largest == pytest.approx((0.6 * size, 0.0, -0.8 * size))
    assert grab.duration == pytest.approx(1.6)


def test_random_contacts_are_over_when_the_last_may_be(tmp_path: Path) -> None:
    """The last comes at 3 s, half of 0.4 s later at most, and takes 1 s at most."""
    assert contact_of(tmp_path, PUSHES).latest == pytest.approx(3.0 + 0.2 + 1.0)  # type: ignore[union-attr]


def test_a_joint_may_be_pushed_in_several_places(tmp_path: Path) -> None:
    places = [{"link": link, "xyz": [0.1, 0.0, 0.0]} for link in ("LBicep", "LForeArm")]
    one = contact_of(tmp_path, PUSHES)
    several = contact_of(tmp_path, changed(PUSHES, "points.LShoulderRoll", places))
    assert isinstance(one, RandomPushes)
    assert isinstance(several, RandomPushes)
    assert [p.link for p in one.points["LShoulderRoll"]] == ["LBicep"]
    assert [p.link for p in several.points["LShoulderRoll"]] == ["LBicep", "LForeArm"]


def test_touched_joints_come_once_in_the_order_of_the_file(tmp_path: Path) -> None:
    elbow = JOINT_PUSH | {"joint": "RElbowRoll", "link": "RForeArm"}
    contacts = [elbow, PUSHES, PUSH | {"start": 1.2, "duration": 0.2}, FORCES]
    assert load_data(tmp_path, touched(*contacts)).touched_joints == ("RElbowRoll", "LShoulderRoll")
    assert load_data(tmp_path, touched(FORCES)).touched_joints == ()
    assert load_data(tmp_path, touched()).touched_joints == ()


@pytest.mark.parametrize(
    ("contact", "key", "value", "where", "reason"),
    [
        (PUSH, "kind", "pushes", "", "unknown kind 'pushes' (did you mean push"),
        (PUSH, "kind", KeyError, "", "no 'kind' (possible: grab, joint_push"),
        (PUSH, "kind", 3, "", "'kind' must be a text, got 3"),
        (PUSH, "link", "LBice", "link", "did you mean LBicep"),
        (PUSH, "joint", "LBicep", "joint", "unknown joint"),
        (PUSH, "start", -0.5, "start", "must be 0 or more"),
        (PUSH, "duration", 0.0, "duration", "must be above 0"),
        (PUSH, "xyz", [0.0, 0.0], "xyz", "needs at least 3 entries"),
        (PUSH, "xyz.1", "left", "xyz.1", "must be a number"),
        (PUSH, "force", [0.0, 0.0, 0.0], "", "'force' must be longer than 0, and 1000 N at most"),
        (PUSH, "force", [0.0, 1001.0, 0.0], "", "1000 N at most, not 1001"),
        (PUSH, "force", KeyError, "force", "is missing"),
        (PUSH, "frame", "torso", "frame", "must be 'world' or 'link', got \"torso\""),
        (PUSH, "saturating", "yes", "saturating", 'must be true or false, got "yes"'),
        (PUSH, "forces", [0.0, 1.0, 0.0], "forces", "did you mean force"),
        (PUSH, "degrees", 2.0, "degrees", "unknown key"),
        (JOINT_PUSH, "direction", 0, "direction", "must be -1 or 1, got 0"),
        (JOINT_PUSH, "degrees", 91.0, "degrees", "must be 90 or less"),
        (JOINT_PUSH, "force", [0.0, 1.0, 0.0], "force", "unknown key"),
        (GRAB, "pull", [0.0, 1.1, 0.0], "", "1 m at most"),
        (GRAB, "stiffness", 100.0, "stiffness", "must be 300 or more"),
        (GRAB, "max_force", 0.0, "max_force", "must be above 0"),
        (GRAB, "duration", 1.0, "duration", "unknown key"),
        (PUSHES, "times.0", -0.1, "times.0", "must be 0 or more"),
        (PUSHES, "times.0", 0.1, "", "'jitter' takes a push to before its goal"),
        (PUSHES, "times", [], "times", "needs at least one time"),
        (PUSHES, "times.1", 4.9, "times", "may last until 6.1 s, beyond the next goal after 6 s"),
        (PUSHES, "times.1", 4.8, None, None),
        (PUSHES, "degrees", [10.0, 3.0], "", "'degrees': the lower bound 10 is above the upper, 3"),
        (PUSHES, "degrees", [0.0, 3.0], "degrees.0", "must be above 0"),
        (PUSHES, "duration", [2.0, 1.0], "", "'duration': the lower bound"),
        (PUSHES, "duration", 1.0, "duration", "must be a list, got 1"),
        (PUSHES, "joints.0", "HeadYaw", "", "'points' has no entry for joint HeadYaw"),
        (PUSHES, "joints", ["HeadYa"], "", "no entry for joint HeadYa"),
        (PUSHES, "points.LShoulderRoll.link", "LBice", "points.LShoulderRoll.link", "LBicep"),
        (PUSHES, "points.LShoulderRol", {"link": "Head", "xyz": [0, 0, 0]}, "points", "did you mean LShoulderRoll"),
        (PUSHES, "points.LShoulderRoll", [], "points.LShoulderRoll", "needs at least one entry"),
        (PUSHES, "points.LShoulderRoll", 3, "points.LShoulderRoll", "a mapping of keys to values, got 3"),
        (PUSHES, "points.LShoulderRoll.lnk", "Head", "points.LShoulderRoll.lnk", "did you mean link"),
        (PUSHES, "rise", [0.04, 0.2], None, None),
        (PUSHES, "rise", [0.2, 0.04], "", "'rise': the lower bound"),
        (PUSHES, "max_distal_ratio", -0.1, "max_distal_ratio", "must be 0 or more"),
        (PUSHES, "max_force", 0.0, "max_force", "must be above 0"),
        (PUSHES, "evenly", True, "evenly", "unknown key"),
        (FORCES, "newtons", [20.0, 5.0], "", "'newtons': the lower bound"),
        (FORCES, "newtons", [5.0, 1001.0], "newtons.1", "must be 1000 or less"),
        (FORCES, "points.1.link", "LForeArm", "points", "LForeArm is carried by LElbowRoll; push it"),
        (FORCES, "points.1.link", "Head", "points", "Head is carried by HeadPitch"),
        (FORCES, "points.1.link", "torse", "points.1.link", "did you mean torso"),
        (FORCES, "points", {"link": "Hip", "xyz": [0, 0, 0]}, None, None),
    ],
)  # fmt: skip
def test_a_wrong_contact_is_one_line_with_key_and_reason(
    tmp_path: Path,
    contact: dict[str, Any],
    key: str,
    value: object,
    where: str | None,
    reason: str | None,
) -> None:
    data = touched(changed(contact, key, value))
    if where is None or reason is None:
        load_data(tmp_path, data)
        return
    said = refusal(tmp_path, data)
    assert said.startswith(" line ")
    assert f"key '{'.'.join(filter(None, ('contacts.0', where)))}'" in said
    assert reason in said


def test_a_contact_is_a_mapping(tmp_path: Path) -> None:
    data = changed(touched(PUSH), "contacts.0", "push")
    said = refusal(tmp_path, data)
    assert "key 'contacts.0': must be a mapping of keys to values, got \"push\"" in said


def test_random_contacts_need_one_step_with_random_goals(tmp_path: Path) -> None:
    goals = {"setpoints": SETPOINTS}
    without = experiment(STAND, contacts=[PUSHES])
    assert "key 'contacts.0': random contacts need a step with random goals" in refusal(
        tmp_path, without
    )
    two = experiment(goals | {"name": "first"}, goals | {"name": "second"}, contacts=[PUSHES])
    assert "give 'step', its name, where there are several" in refusal(tmp_path, two)
    load_data(tmp_path, changed(two, "contacts.0.step", "second"))
    assert "key 'contacts.0" in refusal(tmp_path, changed(two, "contacts.0.step", "secnd"))
    twice = changed(changed(two, "steps.1.name", "first"), "contacts.0.step", "first")
    assert "key 'contacts.0" in refusal(tmp_path, twice)
    block = {"repeat": {"times": 2, "steps": [goals]}}
    load_data(tmp_path, experiment(block, contacts=[PUSHES]))


def test_sweeps_are_free_motion(tmp_path: Path) -> None:
    sweeps = {
        "joints": ["HeadYaw"],
        "estimation_stiffness": [2.0],
        "sweeps": 1,
        "max_offset": 0.1,
        "setpoints": 1,
        "dwell": [9.0, 9.0],
        "neighbour_range": 0.4,
    }
    said = refusal(tmp_path, experiment({"sweeps": sweeps}, contacts=[PUSHES]))
    assert "key 'contacts.0': sweeps are free motion; leave contacts out" in said
    load_data(tmp_path, experiment({"sweeps": sweeps}))


def test_a_push_may_end_just_when_the_next_goal_is_set(tmp_path: Path) -> None:
    """0.1 + 0.2 is more than 0.3 for a computer."""
    exact = changed(RANDOM, "times", [0.1]) | {"jitter": 0.0, "duration": [0.2, 0.2]}
    goals = {"setpoints": SETPOINTS | {"period": 0.3}}
    load_data(tmp_path, experiment(goals, contacts=[exact]))
    later = changed(exact, "times", [0.101])
    assert "beyond the next goal after 0.3 s" in refusal(
        tmp_path, experiment(goals, contacts=[later])
    )
