"""Steps of a first hour one after the other: what ends one early, and what is kept."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from math import ceil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends import Backend
from pepper_driver.backends.interface import Capability
from pepper_driver.cli.app import run
from pepper_driver.config import ConfigError, PepperError, RobotConfig
from pepper_driver.config.file_lock import InUseError, lock_folder
from pepper_driver.config.files import set_aside
from pepper_driver.config.first_hour import load_first_hour
from pepper_driver.config.touch_prompts import load_touch_prompts
from pepper_driver.first_hour.hour import run_hour
from pepper_driver.first_hour.operator import OperatorLeftError, TerminalOperator
from pepper_driver.first_hour.plan import HourPlan, PlannedStep, plan_hour
from pepper_driver.first_hour.state import (
    STATE,
    STEPS,
    FirstHour,
    FirstHourError,
    ResultValue,
    StepName,
    load_state,
    new_hour,
    save_state,
)
from pepper_driver.first_hour.steps import check_readiness
from pepper_driver.identification.measurements.program import held_weight
from pepper_driver.testing.faults import drained, heated
from support.doctor import Patient
from support.examples import examples
from support.first_hour import INFO, ROBOT, open_hour

PAGE = Path(__file__).parents[3] / "docs" / "first_robot.md"


@pytest.fixture(scope="module")
def plan() -> HourPlan:
    """The shipped plan, with a weight."""
    weight = held_weight(0.5, "left")
    return plan_hour(ROBOT, load_first_hour(), label="key", weight=weight)


class Robot:
    """Steps without a robot: each writes a file of its own attempt, and may end early at four places.

    Args:
        folder: Of the hour.
        ends: By call of a step, in their order: where it ends; ``done`` when there are no more.
    """

    def __init__(self, folder: Path, ends: list[str]) -> None:
        self._folder, self._ends = folder, ends
        self._now, self._answered = "done", False
        self.written: list[str] = []
        self.made: list[StepName] = []
        self.lines: list[str] = []

    def introduce(self, step: PlannedStep) -> None:
        self._now = self._ends.pop(0) if self._ends else "done"
        self._answered = False

    def check(self) -> None:
        if self._now == ("unfit later" if self._answered else "unfit"):
            raise FirstHourError("battery: 15%")

    def confirm(self, question: str) -> None:
        if self._now == "leaves":
            raise OperatorLeftError("no answer for 600 s")
        self._answered = True

    def offer(self, question: str) -> bool:
        return False

    def actions(self) -> dict[StepName, Callable[[], Mapping[str, ResultValue]]]:
        return {name: self._action(name) for name in STEPS}

    def _action(self, name: StepName) -> Callable[[], Mapping[str, ResultValue]]:
        def act() -> Mapping[str, ResultValue]:
            path = self._folder / f"{name}.mcap"
            set_aside(path)
            text = f"{name}, attempt {len(self.written)}"
            path.write_text(text)
            self.written.append(text)
            if self._now == "stopped":
                raise PepperError("the button on the chest was pressed")
            if self._now == "interrupted":
                raise KeyboardInterrupt
            self.made.append(name)
            return {"attempt": text}

        return act

    def run(
        self, plan: HourPlan, asked: FirstHour | None = None, *, again: StepName | None = None
    ) -> FirstHour:
        return run_hour(
            self._folder,
            asked or open_hour(),
            plan,
            self.actions(),
            self,
            introduce=self.introduce,
            check=self.check,
            show=self.lines.append,
            again=again,
        )


@examples(60)
@given(
    ends=st.lists(
        st.sampled_from(["unfit", "leaves", "unfit later", "stopped", "interrupted", "done"]),
        max_size=12,
    )
)
def test_whatever_ends_it_early_the_same_command_comes_to_the_same_end(
    plan: HourPlan, tmp_path_factory: pytest.TempPathFactory, ends: list[str]
) -> None:
    folder = tmp_path_factory.mktemp("hour")
    robot = Robot(folder, list(ends))
    for _ in range(len(ends) + 1):
        done = (
            [s.name for s in load_state(folder / STATE).steps if s.progress == "done"]
            if (folder / STATE).exists()
            else []
        )
        try:
            hour = robot.run(plan)
            break
        except (PepperError, KeyboardInterrupt):
            assert "the same command goes on" in robot.lines[-1]
            after = load_state(folder / STATE)
            assert [s.name for s in after.steps if s.progress == "done"][: len(done)] == done
    assert robot.made == list(STEPS)  # each step once
    assert sum(1 + len(step.earlier) for step in hour.steps) == len(robot.written)
    assert hour == load_state(folder / STATE)
    assert hour.next_step is None
    # Every attempt is there, under one name or another, and the last one under its own.
    files = {path.read_text() for path in folder.iterdir() if ".mcap" in path.name}
    assert files == set(robot.written)
    for step in hour.steps:
        assert (folder / f"{step.name}.mcap").read_text() == step.figures["attempt"]


def test_codes_say_whether_it_had_begun(plan: HourPlan, tmp_path: Path) -> None:
    with pytest.raises(OperatorLeftError) as raised:
        Robot(tmp_path, ["leaves"]).run(plan)
    assert not raised.value.while_active
    with pytest.raises(OperatorLeftError) as raised:
        Robot(tmp_path, ["done", "leaves"]).run(plan)
    assert raised.value.while_active
    assert load_state(tmp_path / STATE).next_step == "measure"


@pytest.mark.parametrize(
    ("again", "made"),
    [
        ("free", ["free", "pack"]),
        ("doctor", ["doctor", "pack"]),
        ("identify", ["identify", "rest", "free", "touches", "pack"]),
    ],
)
def test_a_step_is_made_again_with_those_that_build_on_it(
    plan: HourPlan, tmp_path: Path, again: StepName, made: list[StepName]
) -> None:
    first = Robot(tmp_path, ["done", "done", "done", "stopped"])
    with pytest.raises(PepperError, match="button"):
        first.run(plan)
    before = first.run(plan)
    assert [len(step.earlier) for step in before.steps] == [0, 0, 0, 1, 0, 0, 0]
    robot = Robot(tmp_path, ["leaves"])
    with pytest.raises(OperatorLeftError):
        robot.run(plan, again=again)
    assert load_state(tmp_path / STATE) == before, "nothing is given up before something begins"
    assert "the same command goes on" in robot.lines[-1]
    robot = Robot(tmp_path, ["stopped"])
    with pytest.raises(PepperError, match="button"):
        robot.run(plan, again=again)
    assert "the same command without --again goes on" in robot.lines[-1]
    hour = robot.run(plan, again=again)  # the step is not done: it goes on
    assert robot.made == made
    assert hour.next_step is None
    for old, new in zip(before.steps, hour.steps, strict=True):
        if new.name == again:
            assert new.earlier == (*old.earlier, old.figures, {})
        elif new.name in made:
            assert new.earlier == (*old.earlier, old.figures)
        else:
            assert new == old
    files = {path.read_text() for path in tmp_path.iterdir() if ".mcap" in path.name}
    assert files == {*first.written, *robot.written}


def test_where_nothing_was_done_nothing_is_made_again(plan: HourPlan, tmp_path: Path) -> None:
    with pytest.raises(FirstHourError, match="no hour of which a step could be made again"):
        Robot(tmp_path, []).run(plan, again="free")
    assert not (tmp_path / STATE).exists()


def test_a_robot_that_is_unfit_by_the_time_of_the_answer_does_not_move(
    plan: HourPlan, tmp_path: Path
) -> None:
    robot = Robot(tmp_path, ["unfit later"])
    with pytest.raises(FirstHourError, match="battery"):
        robot.run(plan)
    assert not robot.written
    assert load_state(tmp_path / STATE).step("doctor").progress == "open"


def test_another_robot_and_a_second_command_are_refused(plan: HourPlan, tmp_path: Path) -> None:
    with pytest.raises(PepperError, match="button"):
        Robot(tmp_path, ["done", "stopped"]).run(plan)
    before = (tmp_path / STATE).read_text()
    with pytest.raises(FirstHourError, match="of the robot"):
        Robot(tmp_path, []).run(plan, replace(open_hour(), identity="another"))
    with lock_folder(tmp_path), pytest.raises(InUseError):
        Robot(tmp_path, []).run(plan)
    assert (tmp_path / STATE).read_text() == before


def test_the_hour_is_an_hour_and_the_page_says_so(plan: HourPlan) -> None:
    assert plan.robot < 60 * 60.0
    assert plan.hands < 15 * 60.0
    rows = re.findall(
        r"^\| \d \| `(\w+)` \| .* \| (\d+) min \| (\d+) min \|$", PAGE.read_text(), re.MULTILINE
    )
    printed = {name: (int(robot), int(hands)) for name, robot, hands in rows}
    assert printed == {
        step.name: (ceil(step.robot / 60.0), ceil(step.hands / 60.0)) for step in plan.steps
    }
    assert tuple(printed) == STEPS
    found = re.search(
        r"^\| \| all \| \| (\d+) min \| (\d+) min \|$", PAGE.read_text(), re.MULTILINE
    )
    assert found is not None
    sums = tuple(map(sum, zip(*printed.values(), strict=True)))
    assert (int(found[1]), int(found[2])) == sums
    assert sums[0] <= 60
    assert sums[1] <= 15


def test_the_page_says_how_long_touches_with_a_spring_scale_take() -> None:
    plan = plan_hour(ROBOT, load_first_hour(), label="key", prompts="scale")
    found = re.search(
        r"`--prompts scale` the touches take (\d+) min of the robot and (\d+) min of your hands",
        PAGE.read_text(),
    )
    assert found is not None
    step = plan.step("touches")
    assert tuple(map(int, found.groups())) == (ceil(step.robot / 60.0), ceil(step.hands / 60.0))


def test_the_page_has_the_words_of_the_command(plan: HourPlan) -> None:
    text = PAGE.read_text(encoding="utf-8")
    titles = re.findall(r"^\| \d \| `(\w+)` \| (.*?) \|", text, re.MULTILINE)
    assert dict(titles) == {step.name: step.title for step in plan.steps}
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \| (.*?) \| (.*?) \| .* \|$", text, re.MULTILINE)
    printed, before = {}, ""
    for name, do, stop, normal in rows:
        before = before if stop == "the same" else stop
        printed[name] = (do, before, normal)
    assert printed == {step.name: (step.do, step.stop, step.normal) for step in plan.steps}


def test_the_weight_is_taken_out_before_models_are_identified(plan: HourPlan) -> None:
    assert "take the weight out of the hand" in plan.step("identify").do


def test_nothing_in_the_plan_moves_legs_or_base(plan: HourPlan) -> None:
    legs = set(ROBOT.chains["legs"])
    for runs in plan.runs.values():
        assert not any(run.moves_legs for run in runs)
        assert not legs & {run.joint for run in runs}
    (goals,) = (step.goals for step in plan.free.steps if hasattr(step, "goals"))
    assert not legs & set(goals.joints)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> Callable[[Patient], None]:
    def use(backend: Patient) -> None:
        def make(uri: str, robot: RobotConfig | None = None) -> Backend:
            return backend

        monkeypatch.setattr("pepper_driver.first_hour.steps.make_backend", make)

    return use


def test_a_robot_is_looked_at_before_each_step(patient: Callable[[Patient], None]) -> None:
    patient(Patient())
    check_readiness("mock", ROBOT, INFO.identity)
    with pytest.raises(FirstHourError, match="another robot"):
        check_readiness("mock", ROBOT, "another")
    patient(Patient(drained(0.19)))
    with pytest.raises(FirstHourError, match=r"battery: 19%.*charge it"):
        check_readiness("mock", ROBOT, INFO.identity)
    patient(Patient(drained(0.21)))
    check_readiness("mock", ROBOT, INFO.identity)
    hot = Patient(heated("LElbowRoll", 70.0))
    patient(hot)
    with pytest.raises(FirstHourError, match=r"LElbowRoll is warmest with 70 deg C.*cool"):
        check_readiness("mock", ROBOT, INFO.identity)
    assert not hot.moved


def test_a_question_without_a_terminal_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ConfigError, match="--yes"):
        TerminalOperator(print, 1.0)
    arguments = ["first-hour", "--backend", "mock", "--out", str(tmp_path / "hour")]
    assert run(arguments) == 2
    assert "--yes" in capsys.readouterr().err
    assert run([*arguments, "--yes"]) == 2  # labels by key
    assert "--label" in capsys.readouterr().err
    assert run([*arguments, "--yes", "--label", "head", "--pack", str(tmp_path / "x.tar")]) == 2
    assert ".zip" in capsys.readouterr().err
    wake = ["--backend", "naoqi://127.0.0.1:1?wake=1", "--yes", "--label", "head"]
    assert run(["first-hour", "--out", str(tmp_path / "hour"), *wake]) == 2
    assert "chest twice" in capsys.readouterr().err
    assert not (tmp_path / "hour").exists()


def test_a_dry_run_prints_both_sums_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["first-hour", "--out", str(tmp_path / "hour"), "--dry-run"]) == 0
    shown = capsys.readouterr().out
    assert "robot time" in shown
    assert "your hands are needed for" in shown
    assert not (tmp_path / "hour").exists()


def test_a_state_of_another_plan_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_state(tmp_path / STATE, open_hour())
    arguments = ["first-hour", "--backend", "mock", "--out", str(tmp_path), "--label", "head"]
    assert run([*arguments, "--yes"]) == 2
    assert "by the plan" in capsys.readouterr().err
    assert json.loads((tmp_path / STATE).read_text())["plan"] == "p"


@pytest.mark.parametrize(
    ("abilities", "simulated"),
    [(frozenset({"push", "grab"}), True), (frozenset({"speech"}), False)],
)
def test_an_hour_at_the_stand_in_is_not_taken_for_one_of_a_real_robot(
    abilities: frozenset[Capability], simulated: bool
) -> None:
    info = replace(INFO, capabilities=abilities)
    hour = new_hour(
        ROBOT, info, plan="p", prompts=load_touch_prompts(ROBOT), label="key", weight=None
    )
    assert hour.simulated == simulated
