"""Postures that the robot cannot take are refused before it moves, wherever a file may lead it."""

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given

from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import ConfigError, PepperError
from pepper_driver.config.loading import read_yaml
from pepper_driver.experiments.experiment import ExperimentRun
from pepper_driver.experiments.feasibility import PostureCheck
from pepper_driver.experiments.plan import plan_experiment
from support.examples import examples
from support.experiments import EXAMPLES, ROBOT, STAND, fake, make_experiment, with_played
from support.yaml_values import damaged, dump

BENT_ARM = {
    "LShoulderPitch": 0.9,
    "LShoulderRoll": 0.01,
    "LElbowYaw": -0.3,
    "LElbowRoll": -1.5,
    "LHand": 0.5,
}
BENT: dict[str, Any] = {"joints": BENT_ARM, "hold": 1.0}
"""Leads the hand of a standing robot into its trunk."""
PART = {key: BENT_ARM[key] for key in ("LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LHand")}
ELBOW = {"joints": {"LElbowRoll": -1.2}, "hold": 1.0}
COUPLED = {"joints": {"HeadYaw": 1.5, "HeadPitch": 0.4}, "hold": 1.0}
TOUCHED: dict[str, Any] = {"limb": "left_arm"}


def plan(
    *steps: dict[str, Any], parts: dict[str, Any] | None = None, start: Any = None, **more: Any
) -> None:
    experiment = with_played(make_experiment(*steps, **more), **(parts or {}))
    plan_experiment(experiment, ROBOT, MockBackend(ROBOT), start=start)


# -- in time ----------------------------------------------------------------------------------------------------------

FAST: dict[str, Any] = {"joints": {"HeadYaw": 2.0}, "duration": 0.1}
HOLDS: dict[str, Any] = {"joints": ["HeadYaw"], "range": 0.9, "move": 0.02, "hold": 1.0, "count": 9}


@pytest.mark.parametrize(
    ("steps", "key"),
    [
        ([STAND, FAST], "steps.1.duration"),
        ([STAND, {"repeat": {"times": 2, "steps": [FAST]}}], "steps.1.repeat.steps.0.duration"),
        ([STAND, {"joints": {"HeadYaw": -1.0}, "hold": 4.0}, FAST], "steps.2.duration"),
        ([STAND, {"hands": {"LHand": 0.0}, "duration": 0.01}], "steps.1.duration"),
        ([{"holds": HOLDS}], "steps.0.holds.move"),
    ],
)
def test_a_way_that_no_motor_makes_in_time(steps: list[dict[str, Any]], key: str) -> None:
    with pytest.raises(
        ConfigError, match=rf"key '{key}': \w+ would go .* at most; give .* or more"
    ):
        plan(*steps)


def test_the_time_that_it_says_is_enough() -> None:
    with pytest.raises(
        ConfigError, match=r"HeadYaw would go 2.01 rad in 0.1 s, and makes 7\.\d+ rad/s"
    ):
        plan(STAND, FAST)
    plan(STAND, FAST | {"duration": 0.28})


def test_where_the_distance_is_unknown_nothing_is_refused() -> None:
    aside = {"joints": {"HeadYaw": 1.9}, "hold": 0.2}
    plan(FAST)
    plan(STAND, aside, {"joints": {"HeadYaw": -0.1}, "duration": 0.1})  # it never was so far aside
    plan(FAST, start=posture(HeadYaw=1.9))
    with pytest.raises(ConfigError, match=r"steps\.0\.duration"):
        plan(FAST, start=posture())


# -- one posture ------------------------------------------------------------------------------------------------------


def posture(**joints: float) -> Any:
    angles = ROBOT.posture("Stand")
    for name, angle in joints.items():
        angles[ROBOT.joint_index(name)] = angle
    return angles


def test_a_posture_in_which_links_would_touch() -> None:
    check = PostureCheck(ROBOT)
    assert check.problem(posture()) == ""
    assert "l_wrist and torso would run into one another" in check.problem(posture(**BENT_ARM))
    near = check.problem(posture(**(BENT_ARM | {"LShoulderRoll": 0.56})))
    assert near.startswith("l_wrist and torso would come within 4 mm of one another")
    assert near.endswith("must stay 10 mm apart")
    assert check.problem(posture(**(BENT_ARM | {"LShoulderRoll": 0.7}))) == ""


def test_limits_that_depend_on_another_joint() -> None:
    check = PostureCheck(ROBOT)
    assert check.problem(posture(HeadYaw=0.0, HeadPitch=0.4)) == ""
    text = check.problem(posture(HeadYaw=1.5, HeadPitch=0.4))
    assert text.startswith("HeadPitch at 0.4 rad lies outside -")
    assert text.endswith("while HeadYaw is at 1.5 rad")


def test_what_is_not_known_is_no_problem() -> None:
    check = PostureCheck(ROBOT)
    angles = posture(**BENT_ARM)
    angles[ROBOT.joint_index("HipPitch")] = np.nan
    assert check.problem(angles) == ""
    angles = posture(HeadYaw=1.5, HeadPitch=0.4)
    angles[ROBOT.joint_index("LElbowRoll")] = np.nan
    assert "HeadPitch" in check.problem(angles), "of these two all is known"
    angles[ROBOT.joint_index("HeadYaw")] = np.nan
    assert check.problem(angles) == ""


# -- in a file --------------------------------------------------------------------------------------------------------


LOOP = {"repeat": {"times": 2, "steps": [BENT]}}
WRONG: list[tuple[list[Any], str, str]] = [
    ([{"posture": "Crouch", "hold": 1.0}], "steps.0.posture", "limits while HeadYaw is at 0"),
    ([STAND, COUPLED], "steps.1.joints", "HeadPitch at 0.4 rad lies outside"),
    ([COUPLED], "steps.0.joints", "HeadPitch at 0.4 rad lies outside"),
    ([STAND, BENT], "steps.1.joints", "l_wrist and torso would run into"),
    ([STAND, {"joints": PART, "hold": 1.0}, ELBOW], "steps.2.joints", "torso"),
    ([STAND, LOOP], "steps.1.repeat.steps.0.joints", "torso"),
    # Its first round is harmless: the arm comes to where it is bad in the second.
    (
        [
            STAND,
            {
                "repeat": {
                    "times": 2,
                    "steps": [
                        {"joints": {"LElbowRoll": -0.6}, "hold": 1.0},
                        {"joints": PART, "hold": 1.0},
                        ELBOW,
                    ],
                }
            },
        ],
        "steps.1.repeat.steps.2.joints",
        "torso",
    ),
    (
        [
            STAND,
            {
                "repeat": {
                    "times": 2,
                    "steps": [
                        ELBOW | {"name": "a"},
                        {"joints": {"LElbowRoll": -0.6}, "hold": 1.0},
                        {"joints": PART, "hold": 1.0},
                    ],
                }
            },
        ],
        "steps.1.repeat.steps.0.joints",
        "torso",
    ),
    (
        [STAND, {"branch": {"timeout": 1.0, "cases": [{"on": TOUCHED, "steps": [BENT]}]}}],
        "steps.1.branch.cases.0.steps.0.joints",
        "torso",
    ),
    (
        [
            STAND,
            {
                "branch": {
                    "timeout": 1.0,
                    "cases": [{"on": TOUCHED, "steps": []}],
                    "otherwise": [BENT],
                }
            },
        ],
        "steps.1.branch.otherwise.0.joints",
        "torso",
    ),
]


@pytest.mark.parametrize(("steps", "key", "reason"), WRONG)
def test_a_step_is_refused_with_its_key(steps: list[Any], key: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=f"^mine: key '{key}'") as caught:
        plan(*steps)
    assert reason in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_where_the_robot_stands_counts_too() -> None:
    """The steps alone are fine; from where this robot stands they would lead the arm into the trunk."""
    plan(ELBOW)
    with pytest.raises(ConfigError, match=r"'steps\.0\.joints': .*torso"):
        plan(ELBOW, start=posture(**PART))
    plan(STAND | {"duration": 1.0}, ELBOW, start=posture(**PART))


def test_joints_that_a_task_moves_are_not_known() -> None:
    arm = ROBOT.chains["left_arm"]
    reach = {"link": "l_wrist", "root": "base_link", "target": [0.3, 0.2, 0.8]}
    moved = {"position": {**reach, "joints": list(arm)}, "duration": 1.0}
    with pytest.raises(ConfigError, match="torso"):
        plan(STAND, BENT)
    plan(STAND, moved, BENT)  # the wrist may be anywhere
    wrist = {**BENT_ARM, "LWristYaw": 0.0}
    with pytest.raises(ConfigError, match="torso"):
        plan(STAND, moved, {"joints": wrist, "hold": 1.0})
    with pytest.raises(ConfigError, match="torso"):
        plan(STAND, moved, STAND, BENT)


def test_after_a_branch_only_what_is_the_same_is_known() -> None:
    branch = {"timeout": 1.0, "cases": [{"on": TOUCHED, "steps": [{"joints": PART, "hold": 1.0}]}]}
    plan(STAND, {"branch": branch}, ELBOW)
    both = branch | {"otherwise": [{"joints": PART, "hold": 2.0}]}
    with pytest.raises(ConfigError, match=r"'steps\.2\.joints': .*torso"):
        plan(STAND, {"branch": both}, ELBOW)


def test_steps_of_a_reaction_come_from_anywhere() -> None:
    part = make_experiment({"posture": "Stand", "hold": 1.0}, BENT)
    reactions = [{"play": "p"}]
    with pytest.raises(ConfigError, match=r"'reactions\.0\.play\.1\.joints': .*torso"):
        plan(STAND, parts={"p": part}, reactions=reactions)
    plan(
        STAND,
        {"joints": PART, "hold": 1.0},
        parts={"p": make_experiment(ELBOW)},
        reactions=reactions,
    )


def test_random_goals_are_left_to_the_controller() -> None:
    goals = {"joints": ["LShoulderPitch", "LShoulderRoll", "LElbowRoll"], "range": 1.0, "count": 60}
    plan({"setpoints": {**goals, "period": 1.2}})


# -- whatever is in a file --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_a_damaged_experiment_begins_nothing(
    example: Any, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is planned, or one line says what is wrong."""
    backend, _ = fake(monkeypatch)
    path = tmp_path_factory.mktemp("fuzz") / "mine.yaml"

    @examples(
        40,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )
    @given(damaged(read_yaml(example)))
    def damage(data: Any) -> None:
        path.write_text(dump(data), encoding="utf-8")
        try:
            run = ExperimentRun(path, contacts=False)
        except PepperError as error:
            assert len(str(error).splitlines()) == 1
        else:
            assert 0.0 < run.experiment.max_length <= run.experiment.max_duration
        assert backend.calls == []

    damage()
