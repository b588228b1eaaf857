"""Steps are read to the last key; how long they take is the sum of what is written."""

import math
from pathlib import Path
from typing import Any

import pytest

from pepper_driver.config import ConfigError, Experiment
from pepper_driver.config.experiment import check_experiment
from pepper_driver.config.steps import (
    AnyStep,
    BranchStep,
    Holds,
    Leds,
    PlayStep,
    RandomStep,
    RepeatStep,
    Setpoints,
    Step,
    Sweeps,
    changed_steps,
)
from pepper_driver.config.task_specs import LookAtSpec, PositionSpec
from support.experiment_files import (
    HOLDS,
    ROBOT,
    SETPOINTS,
    STAND,
    changed,
    experiment,
    load_data,
    refusal,
    shipped,
)

REACH: dict[str, Any] = {"link": "l_wrist", "target": [0.3, 0.2, 0.8]}
TURN: dict[str, Any] = {"link": "r_wrist", "quaternion": [0.0, 0.0, 0.6, 0.8]}
MINE = experiment(
    {"duration": 1.0, "posture": "Stand", "joints": {"HeadYaw": 0.2}, "hands": {"LHand": 0.5}},
    {
        "duration": 2.0,
        "until": "reached",
        "tolerance": 0.02,
        "timeout": 4.0,
        "hold": 0.5,
        "stiffness": 8.0,
        "position": [REACH, REACH | {"link": "r_wrist", "root": "torso", "keep": True}],
        "orientation": TURN | {"joints": ["right_arm", "HipRoll"]},
        "pose": {
            "link": "Hip",
            "point": [0.0, 0.0, 0.1],
            "position": [0.0, 0.0, 0.5],
            "quaternion": [0.0, 0.0, 0.0, 1.0],
            "weight": 10.0,
        },
        "look_at": {"link": "l_wrist"},
        "com": {"target": [0.0, 0.0, 0.6], "root": "base_link"},
        "base": {"x": 0.1, "heading": 1.0},
    },
    {"hold": 1.0, "base_velocity": {"vx": 0.2}, "look_at": {"point": [1.0, 0.0, 1.0]}},
)


def step_of(folder: Path, step: dict[str, Any]) -> Any:
    return load_data(folder, experiment(step)).steps[0]


def test_every_part_of_a_step_is_read(tmp_path: Path) -> None:
    first, second, third = load_data(tmp_path, MINE).steps
    assert isinstance(first, Step)
    assert isinstance(second, Step)
    assert isinstance(third, Step)
    assert first.posture == "Stand"
    assert first.joints == {"HeadYaw": 0.2}
    assert first.hands == {"LHand": 0.5}
    assert [(key, task.label) for key, task in second.tasks()] == [
        ("position.0", "position l_wrist"),
        ("position.1", "position r_wrist"),
        ("orientation", "orientation r_wrist"),
        ("pose", "pose Hip"),
        ("look_at", "look at"),
        ("com", "com"),
        ("base", "base"),
    ]
    assert [task.keep for _, task in second.tasks()] == [False, True] + 5 * [False]
    assert second.position[0] == PositionSpec(link="l_wrist", target=(0.3, 0.2, 0.8))
    assert second.orientation[0].joints == ("right_arm", "HipRoll")
    assert (second.tolerance, second.stiffness) == (0.02, 8.0)
    assert third.look_at == LookAtSpec(point=(1.0, 0.0, 1.0))
    assert third.base_velocity is not None
    assert (third.base_velocity.vx, third.base_velocity.wz) == (0.2, 0.0)
    assert [step.moves_joints for step in (first, second, third)] == [True, False, False]
    # 1 s; a timeout of 4 s and a hold of 0.5 s; a hold of 1 s.
    assert [step.max_duration for step in (first, second, third)] == [1.0, 4.5, 1.0]
    assert [step.is_open for step in (first, second, third)] == [False, True, False]


def test_words_lights_and_cues_take_no_time(tmp_path: Path) -> None:
    step = step_of(tmp_path, {"say": "Ouch", "leds": {"colour": [1, 0.5, 0]}, "cue": "begun"})
    assert step.has_cues
    assert step.max_duration == 0.0
    assert step.leds == Leds(group="FaceLeds", colour=(1.0, 0.5, 0.0), duration=0.2)
    assert (step.say, step.cue) == ("Ouch", "begun")
    moving = step_of(tmp_path, STAND | {"say": "I stand"})
    assert moving.has_cues
    assert moving.max_duration == 1.0
    assert not step_of(tmp_path, STAND).has_cues


def test_a_hold_alone_is_a_pause(tmp_path: Path) -> None:
    step = step_of(tmp_path, {"hold": 2.5})
    assert step.max_duration == 2.5
    assert not step.is_open
    assert not step.moves_joints


def test_a_wait_takes_as_long_as_its_timeout_at_most(tmp_path: Path) -> None:
    wait = {"limb": "left_arm", "min_torque": 2.0, "lasting": 0.5, "timeout": 10.0}
    step = step_of(tmp_path, {"name": "listen", "wait": wait, "say": "Touch me"})
    assert step.is_open
    assert step.max_duration == 10.0
    assert (step.wait.limb, step.wait.lasting) == (("left_arm",), 0.5)
    assert step.wait.on_timeout == "continue"
    assert list(step.triggers()) == [("wait", step.wait)]


@pytest.mark.parametrize(
    ("kind", "cls"),
    [
        ({"setpoints": SETPOINTS}, RandomStep),
        ({"holds": HOLDS}, RandomStep),
        ({"repeat": {"times": 2, "steps": [STAND]}}, RepeatStep),
        ({"branch": {"timeout": 1.0, "cases": [{"on": {}, "steps": []}]}}, BranchStep),
        ({"play": "wave"}, PlayStep),
        ({"posture": "Stand", "hold": 1.0, "joints": {"HeadYaw": 0.1}}, Step),
    ],
)
def test_a_key_says_of_what_kind_a_step_is(
    tmp_path: Path, kind: dict[str, Any], cls: type[AnyStep]
) -> None:
    step = step_of(tmp_path, {"name": "mine", **kind})
    assert isinstance(step, cls)
    assert step.name == "mine"
    if cls is not Step:
        moving = experiment(kind | {"joints": {"HeadYaw": 0.1}})
        assert "unknown key 'steps.0.joints'" in refusal(tmp_path, moving)


def test_a_step_has_random_goals_of_one_kind(tmp_path: Path) -> None:
    said = refusal(tmp_path, experiment({"holds": HOLDS, "setpoints": SETPOINTS}))
    assert "key 'steps.0': a step gives one of 'setpoints', 'holds' and 'sweeps'" in said


def test_random_goals_begin_standing_unless_the_file_says_otherwise(tmp_path: Path) -> None:
    goals = step_of(tmp_path, {"holds": HOLDS}).goals
    assert (goals.posture, goals.settle) == ("Stand", 2.0)
    goals = step_of(tmp_path, {"holds": HOLDS | {"posture": "StandZero", "settle": 3}}).goals
    assert (goals.posture, goals.settle) == ("StandZero", 3.0)


def test_how_long_random_goals_take(tmp_path: Path) -> None:
    holds = step_of(tmp_path, {"holds": HOLDS}).goals
    assert isinstance(holds, Holds)
    assert holds.period == pytest.approx(2.0 + 1.0)
    assert holds.max_duration == pytest.approx(2.0 + 4 * 3.0)
    assert holds.number == 4
    setpoints = step_of(tmp_path, {"setpoints": SETPOINTS | {"settle": 1.0}}).goals
    assert isinstance(setpoints, Setpoints)
    assert setpoints.max_duration == pytest.approx(1.0 + 4 * 6.0)
    assert setpoints.number == 4


def test_how_long_sweeps_take_at_most(tmp_path: Path) -> None:
    """Twice the sequence of each joint: two moves for each sweep, and the set-points; each dwells 3 s at most."""
    sweeps = {
        "joints": ["HeadYaw", "LElbowRoll", "KneePitch"],
        "settle": 2.0,
        "estimation_stiffness": [2.0, 5.0],
        "sweeps": 4,
        "max_offset": 0.35,
        "setpoints": 8,
        "dwell": [1.0, 3.0],
        "neighbour_range": 0.4,
        "ranges": {"KneePitch": 0.25},
    }
    goals = step_of(tmp_path, {"sweeps": sweeps}).goals
    assert isinstance(goals, Sweeps)
    assert goals.number == 3 * 2 * (2 * 4 + 8)
    assert goals.max_duration == pytest.approx(3 * 2.0 + 3 * 2 * 16 * 3.0)
    assert goals.ranges == {"KneePitch": 0.25}


def test_the_estimation_runs_are_those_of_the_paper(tmp_path: Path) -> None:
    identify = load_data(tmp_path, shipped("experiments", "identify"))
    (step,) = identify.steps
    assert isinstance(step, RandomStep)
    assert isinstance(step.goals, Sweeps)
    stiffness = step.goals.estimation_stiffness
    assert len(stiffness) == 7
    assert (min(stiffness), max(stiffness)) == (2.0, 5.0)
    assert identify.stiffness == 9.0


def test_a_step_can_be_made_in_python() -> None:
    step = Step(duration=1.0, position=(PositionSpec(link="l_wrist", target=(0.3, 0.2, 1)),))
    check_experiment(Experiment(schema=2, name="mine", steps=(step,)), ROBOT)
    lost = Step(duration=1.0, position=(PositionSpec(link="wrist", target=(0.3, 0.2, 1)),))
    with pytest.raises(ConfigError, match=r"^mine: key 'steps\.1\.position\.link': unknown link"):
        check_experiment(Experiment(schema=2, name="mine", steps=(step, lost)), ROBOT)
    far = Step(duration=1.0, joints={"HeadYaw": 3.0})
    with pytest.raises(ConfigError, match=r"^mine: key 'steps\.0\.joints\.HeadYaw': 3 rad lies"):
        check_experiment(Experiment(schema=2, name="mine", steps=(far,)), ROBOT)


def test_what_a_step_made_in_python_plays_must_be_loaded() -> None:
    made = Experiment(schema=2, name="mine", steps=(PlayStep(play="wave"),))
    with pytest.raises(ConfigError, match=r"^mine: key 'steps\.0\.play': the steps of 'wave' were"):
        check_experiment(made, ROBOT)


def test_steps_change_from_the_inside_out(tmp_path: Path) -> None:
    """Each step once, with its key, and a block after what it holds."""
    turn = {"hold": 1.0}
    loaded = load_data(
        tmp_path,
        experiment(
            turn,
            {"repeat": {"times": 2, "steps": [turn, {"play": "wave"}]}},
            {
                "branch": {
                    "timeout": 1.0,
                    "cases": [{"on": {"limb": "head"}, "steps": [turn]}],
                    "otherwise": [turn],
                }
            },
        ),
    )
    keys: list[str] = []

    def change(key: str, step: Any) -> Any:
        keys.append(key)
        return Step(hold=step.hold + 1.0) if isinstance(step, Step) else step

    steps = changed_steps(loaded.steps, change, "steps")
    assert sorted(keys) == sorted(key for key, _ in loaded.walk())
    assert len(keys) == len(set(keys))
    assert keys.index("steps.1.repeat.steps.1.play.0") < keys.index("steps.1.repeat.steps.1")
    assert keys.index("steps.2.branch.otherwise.0") < keys.index("steps.2")
    other = Experiment(schema=2, name="other", steps=steps)
    longer = [step for _, step in other.walk() if isinstance(step, Step)]
    before = [step for _, step in loaded.walk() if isinstance(step, Step)]
    assert [step.hold for step in longer] == [step.hold + 1.0 for step in before]


WORDS = "must be a mapping of keys to values"


@pytest.mark.parametrize(
    ("key", "value", "where", "reason"),
    [
        ("steps", [], "steps", "needs at least one step"),
        ("steps.0.duration", -1.0, "steps.0.duration", "must be 0.001 or more, got -1"),
        ("steps.0.duration", 0.0, "steps.0.duration", "0.001"),
        ("steps.0.duration", 0.9e-3, "steps.0.duration", "0.001"),
        ("steps.0.duration", math.nan, "steps.0.duration", "must be a finite number, got nan"),
        ("steps.0.duration", 1e6, "steps.0.duration", "must be 3600 or less"),
        ("steps.0.duration", "1 s", "steps.0.duration", 'must be a number, got "1 s"'),
        ("steps.0.duration", KeyError, "steps.0", "give 'duration', 'until: reached' or 'hold'"),
        ("steps.0.posture", "Stnd", "steps.0.posture", "did you mean Stand"),
        ("steps.0.joints", {"HeadYa": 0.1}, "steps.0.joints.HeadYa", "did you mean HeadYaw"),
        ("steps.0.joints.HeadYaw", 3.0, "steps.0.joints.HeadYaw", "3 rad lies outside -2.08567"),
        ("steps.0.joints.LHand", 1.2, "steps.0.joints.LHand", ": 1.2 lies outside 0 to 1"),
        ("steps.0.joints.HeadYaw", math.inf, "steps.0.joints.HeadYaw", "finite"),
        ("steps.0.hands", {"LHnd": 0.1}, "steps.0.hands.LHnd", "did you mean LHand"),
        ("steps.0.hands.LHand", 1.2, "steps.0.hands.LHand", "1.2 lies outside 0 to 1"),
        ("steps.0.timeout", 2.0, "steps.0", "belong to 'until: reached'"),
        ("steps.0.speed", 2.0, "steps.0.speed", "unknown key"),
        ("steps.0.durations", 2.0, "steps.0.durations", "did you mean duration"),
        ("steps.0.repaet", {"times": 2}, "steps.0.repaet", "did you mean repeat"),
        ("steps.0.wait", {"timeout": 1.0}, "steps.0", "does not move: give it a step of its own"),
        ("steps.1.until", "arrived", "steps.1.until", "must be 'reached', got"),
        ("steps.1.timeout", KeyError, "steps.1", "needs a 'timeout'"),
        ("steps.1.timeout", 1.0, "steps.1", "'timeout' 1 s ends before 'duration', 2 s"),
        ("steps.1.tolerance", 0.0, "steps.1.tolerance", "must be above 0"),
        ("steps.1.stiffness", 0.0, "steps.1.stiffness", "must be above 0"),
        ("steps.2.until", "reached", "steps.2", "needs a 'timeout'"),
        ("steps.1.position.0.target", [0.1, 0.2], "steps.1.position.0.target", "needs at least 3 entries"),
        ("steps.1.position.0.target", [1, 1, 1, 1], "steps.1.position.0.target", "takes at most 3, has 4"),
        ("steps.1.position.0.target.1", math.nan, "steps.1.position.0.target.1", "finite"),
        ("steps.1.position.0.target.1", 101.0, "steps.1.position.0.target.1", "100"),
        ("steps.1.position.1.link", "r_wris", "steps.1.position.1.link", "did you mean r_wrist"),
        ("steps.1.position.1.link", "l_wrist", "steps.1", "two tasks are called 'position l_wrist'"),
        ("steps.1.position.0.targt", [0, 0, 0], "steps.1.position.0.targt", "unknown key"),
        ("steps.1.position", REACH | {"link": "l"}, "steps.1.position.link", "unknown link 'l'"),
        ("steps.1.position", REACH | {"target": 1.0}, "steps.1.position.target", "must be a list, got 1"),
        ("steps.1.position", None, "steps.1.position", f"{WORDS}, got null"),
        ("steps.1.position", [], "steps.1.position", "needs at least one entry"),
        ("steps.1.position.1.root", "world", "steps.1.position.1.root", "unknown link"),
        ("steps.1.position.1.root", "r_wrist", "steps.1.position.1", "root of its own target"),
        ("steps.1.pose.root", "Hip", "steps.1.pose", "root of its own target"),
        ("steps.1.com.name", "posture", "steps.1", "cannot be called 'posture'"),
        ("steps.1.com.name", "", "steps.1.com.name", "must not be empty"),
        ("steps.0.name", "a\nb", "steps.0.name", "one line without control characters"),
        ("steps.0.name", "a" * 81, "steps.0.name", "at most 80 letters"),
        ("steps.1.position.0.joints", ["left"], "steps.1.position.0.joints", "left_arm"),
        ("steps.1.position.0.joints", [], "steps.1.position.0.joints", "needs at least one joint"),
        ("steps.1.position.0.weight", 0.0, "steps.1.position.0.weight", "must be above 0"),
        ("steps.1.orientation.quaternion", [0, 0, 1, 1], "steps.1.orientation", "length 1, got 1.414"),
        ("steps.1.orientation.quaternion", [0, 0, 0, 0], "steps.1.orientation", "length 1, got 0"),
        ("steps.1.pose.quaternion", [1.0, 0, 0, 1.0], "steps.1.pose", "length 1"),
        ("steps.1.pose.quaternion", KeyError, "steps.1.pose.quaternion", "missing"),
        ("steps.1.look_at.point", [1.0, 0.0, 1.0], "steps.1.look_at", "either 'point' or 'link'"),
        ("steps.1.look_at.link", "Head", "steps.1.look_at", "cannot look at itself"),
        ("steps.1.look_at.link", "hand", "steps.1.look_at.link", "unknown link"),
        ("steps.1.com.root", "torso", "steps.1.com.root", "base_link"),
        ("steps.1.base", {}, "steps.1.base", "'x', 'y' or 'heading'"),
        ("steps.1.base.heading", 7.0, "steps.1.base.heading", "6.28"),
        ("steps.1.base_velocity", {"vx": 0.1}, "steps.1", "not both"),
        ("steps.2.base_velocity.vx", 0.4, "steps.2.base_velocity.vx", "0.4 m/s lies outside -0.35"),
        ("steps.2.base_velocity.wz", -1.1, "steps.2.base_velocity.wz", "rad/s lies outside -1 to 1"),
        ("steps.2.base_velocity.vz", 0.1, "steps.2.base_velocity.vz", "unknown key"),
    ],
)  # fmt: skip
def test_a_wrong_step_is_one_line_with_key_and_reason(
    tmp_path: Path, key: str, value: object, where: str, reason: str
) -> None:
    said = refusal(tmp_path, changed(MINE, key, value))
    assert said.startswith(" line ")
    assert f"key '{where}'" in said
    assert reason in said


SETTINGS: dict[str, Any] = SETPOINTS | {"secondary_joints": ["LElbowRoll"]}


@pytest.mark.parametrize(
    ("key", "value", "where", "reason"),
    [
        ("posture", "Stnd", "posture", "did you mean Stand"),
        ("settle", -1.0, "settle", "must be 0.001 or more"),
        ("speed", 1.0, "speed", "unknown key"),
        ("joints", [], "joints", "needs at least one joint"),
        ("joints.0", "LShoulderRol", "joints", "did you mean LShoulderRoll"),
        ("secondary_joints.0", "x", "secondary_joints", "unknown joint"),
        ("period", 0.0, "period", "must be above 0"),
        ("period", KeyError, "period", "is missing"),
        ("count", 0, "count", "must be 1 or more"),
        ("count", 2.5, "count", "must be a whole number, got 2.5"),
        ("range", 1.1, "range", "must be 1 or less"),
        ("base", {"linear": 0.1, "angular": 0.4, "share": 0.5}, None, None),
        ("base", {"linear": 0.5, "angular": 0.4, "share": 0.5}, "base.linear", "0.35 m/s"),
        ("base", {"linear": 0.1, "angular": 1.4, "share": 0.5}, "base.angular", "1 rad/s"),
        ("base", {"linear": 0.1, "angular": 0.4}, "base.share", "missing"),
        ("ranges", {"LElbowRoll": 0.1}, None, None),
        ("ranges", {"KneePitch": 0.1}, "", "KneePitch is not among the joints"),
        ("ranges", {"LElbowRol": 0.1}, "", "LElbowRol is not among the joints"),
    ],
)
def test_wrong_set_points(
    tmp_path: Path, key: str, value: object, where: str | None, reason: str | None
) -> None:
    data = experiment({"setpoints": changed(SETTINGS, key, value)})
    if where is None or reason is None:
        load_data(tmp_path, data)
        return
    said = refusal(tmp_path, data)
    assert f"key '{'.'.join(filter(None, ('steps.0.setpoints', where)))}'" in said
    assert reason in said


@pytest.mark.parametrize(
    ("key", "value", "where", "reason"),
    [
        ("dwell", [3.0, 1.0], "", "'dwell': the lower bound 3 is above the upper, 1"),
        ("joints.1", "LShoulder", "joints", "unknown joint"),
        ("max_offset", 0.5, "max_offset", "must be below 0.5"),
        ("estimation_stiffness", [], "estimation_stiffness", "needs at least one entry"),
        ("ranges", {"KneePitc": 0.2}, "ranges", "did you mean KneePitch"),
        ("ranges.KneePitch", 0.0, "ranges.KneePitch", "must be above 0"),
    ],
)
def test_wrong_sweeps(tmp_path: Path, key: str, value: object, where: str, reason: str) -> None:
    said = refusal(
        tmp_path, changed(shipped("experiments", "identify"), f"steps.0.sweeps.{key}", value)
    )
    assert f"key '{'.'.join(filter(None, ('steps.0.sweeps', where)))}'" in said
    assert reason in said


def test_nothing_to_reach_is_refused(tmp_path: Path) -> None:
    step = {"until": "reached", "timeout": 1.0}
    assert "needs a task or a posture" in refusal(tmp_path, experiment(step))
    load_data(tmp_path, experiment(step | {"hands": {"LHand": 0.0}}))
