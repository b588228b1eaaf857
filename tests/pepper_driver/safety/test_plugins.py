"""Plug-ins: a mistake in one is reported before the robot moves, and by name and line where it fails in a tick."""

from __future__ import annotations

import inspect
import logging
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from pepper_driver import Contact, FaultError, Hold, Observation, Observer, Pepper, Reflex
from pepper_driver.backends import Measurement, NotConnectedError
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import PepperError, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.plugins import PluginInterfaceError
from pepper_driver.controller import (
    BrakingLimits,
    Constraint,
    LinearInequality,
    PartError,
    PositionTask,
    RobotModel,
    Task,
    TaskRows,
    Tick,
)
from pepper_driver.reflexes import ReflexRequests
from pepper_driver.safety.plugins import (
    describe_failure,
    dry_run_observer,
    dry_run_part,
    dry_run_reflexes,
)
from support.events import contact
from support.robots import make_pepper

ROBOT = load_robot()


def line_of(function: Callable[..., object], words: str) -> str:
    """``file line N`` of a line of a function."""
    lines, first = inspect.getsourcelines(function)
    (number,) = (n for n, line in enumerate(lines, first) if words in line)
    return f"{__file__.rpartition('/')[2]} line {number}"


def refused(call: Callable[[], object], *words: str) -> PepperError:
    """The one line that says what is wrong."""
    with pytest.raises(PepperError) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text
    for word in words:
        assert word in text, text
    return caught.value


# -- tasks ------------------------------------------------------------------------------------------------------------


class Mine(Task):
    """A task of two rows that does what a test requests."""

    def __init__(self, write: Callable[[TaskRows], object]) -> None:
        super().__init__(2, stiffness=1.0, weight=1.0, name="mine")
        self.write = write

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        rows.error = np.zeros(2)
        rows.jacobian = np.ones((2, 20))
        self.write(rows)


class Silent(Task):
    def __init__(self, *names: str) -> None:
        super().__init__(1, stiffness=1.0, weight=1.0)
        self.names = names

    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        self._jacobian, self._error = np.ones((1, 20)), np.zeros(1)
        for name in self.names:
            setattr(rows, name, getattr(self, f"_{name}"))


class Narrow(Mine):
    """With a mask of the joints alone."""

    def joint_mask(self, model: RobotModel) -> FloatArray:
        return np.ones(17)


class Forgetful(Task):
    def __init__(self) -> None:
        self.goal = 1.0

    def compute(self, model: RobotModel, rows: TaskRows) -> None: ...


def assign(name: str, value: object) -> Callable[[TaskRows], object]:
    return lambda rows: setattr(rows, name, value)


def fill(rows: TaskRows) -> None:
    rows.jacobian[:] = np.ones((20, 2))  # filled


WRONG_TASKS: list[tuple[Callable[[], Task], tuple[str, ...]]] = [
    (
        lambda: Mine(assign("jacobian", np.ones((20, 2)))),
        ("task 'mine' (Mine.compute, ", "rows.jacobian", "(2, 20)", "(20, 2)"),
    ),
    (lambda: Mine(assign("error", np.zeros(3))), ("Mine.compute", "rows.error", "(2,)", "(3,)")),
    (lambda: Mine(assign("bias", "none")), ("rows.bias", "got str")),
    (lambda: Mine(assign("jacobain", 0.0)), ("no 'jacobain'", "did you mean jacobian")),
    (lambda: Mine(fill), (line_of(fill, "filled"), "(20,2)", "(2,20)")),
    (lambda: Mine(assign("error", np.array([0.0, np.nan]))), ("rows.error", "not finite")),
    (lambda: Mine(assign("bias", np.full(2, np.inf))), ("rows.bias", "not finite")),
    (lambda: Silent("error"), ("'Silent' (Silent.compute", "nothing to rows.jacobian", "(1, 20)")),
    (lambda: Silent("jacobian"), ("Silent.compute", "nothing to rows.error", "(1,)")),
    (Forgetful, ("Forgetful", "super().__init__(rows")),
    (lambda: Narrow(lambda rows: None), ("Narrow.joint_mask, ", "(20,)", "(17,)")),
]


@pytest.mark.parametrize("active", [False, True])
@pytest.mark.parametrize("number", range(len(WRONG_TASKS)))
def test_a_wrong_task_is_refused_when_it_is_added(number: int, active: bool) -> None:
    make, words = WRONG_TASKS[number]
    pepper = make_pepper()
    if active:
        pepper.start()
    refused(lambda: pepper.add(make()), *words)
    if active:
        assert pepper.controller.tasks == (
            pepper.controller.posture,
            pepper.controller.base_velocity,
        )
        pepper.run(0.12)
        pepper.stop()


def test_a_dry_run_changes_nothing_of_a_task() -> None:
    """A position task takes the place where it is first used as its target: that is not the dry run's."""

    class Own(PositionTask):
        pass

    task = Own("l_wrist")
    dry_run_part(task, ROBOT)
    assert np.isnan(task.target).all()
    assert np.isnan(task.error).all()
    assert task.owner is None
    with make_pepper() as pepper:
        pepper.run(0.12)
        pepper.add(task)
        pepper.run(0.012)
        place = pepper.link_pose("l_wrist", of="commanded")[:3, 3]
        assert task.target == pytest.approx(place, abs=1e-6)


@pytest.mark.parametrize("nothing", [3, None, "posture", PositionTask, Hold()])
def test_what_is_no_part_is_refused(nothing: Any) -> None:
    error = refused(lambda: make_pepper().add(nothing), "a task or a constraint, got ")
    assert isinstance(error, PartError)
    if nothing is PositionTask:
        assert "the class PositionTask, not an object of it" in str(error)


# -- constraints ------------------------------------------------------------------------------------------------------


class Wall(Constraint):
    name = "wall"

    def __init__(self, found: Any) -> None:
        self.found = found

    def compute_inequality(
        self, model: RobotModel, braking_limits: BrakingLimits
    ) -> LinearInequality | None:
        if isinstance(self.found, Exception):
            raise self.found
        return self.found  # type: ignore[no-any-return]


class LazyWall(Wall):
    """Fails where it is asked whether its rows are needed."""

    lazy = True

    def is_satisfied(
        self, model: RobotModel, braking_limits: BrakingLimits, acceleration: FloatArray
    ) -> bool:
        return bool(acceleration[model.nv] > 0.0)  # beyond the last one


def wall(matrix: Any, bound: Any, *names: str) -> Wall:
    return Wall(LinearInequality(matrix, bound, names))


WRONG_WALLS: list[tuple[Wall, tuple[str, ...]]] = [
    (
        wall(np.zeros((1, 17)), np.zeros(1), "a"),
        ("constraint 'wall' (Wall.compute_inequality, ", "matrix", "(1, 20)", "(1, 17)"),
    ),
    (wall(np.zeros((1, 20)), np.zeros(2), "a"), ("with 1 names bound is an array (1,)", "(2,)")),
    (wall(np.zeros((1, 20)), np.zeros(1)), ("with 0 names", "(0, 20)", "(1, 20)")),
    (wall(np.zeros((1, 20)), [0.0], "a"), ("bound", "(1,)", "got [0.0]")),
    (wall(np.full((1, 20), np.nan), np.zeros(1), "a"), ("no number",)),
    (Wall((np.zeros((1, 20)), np.zeros(1))), ("LinearInequality or None", "got a tuple")),
    (Wall(ZeroDivisionError("no width")), ("ZeroDivisionError: no width", "test_plugins.py")),
    (LazyWall(None), (line_of(LazyWall.is_satisfied, "the last one"), "IndexError")),
]


@pytest.mark.parametrize("number", range(len(WRONG_WALLS)))
def test_a_wrong_constraint_is_refused_when_it_is_added(number: int) -> None:
    constraint, words = WRONG_WALLS[number]
    refused(lambda: make_pepper().add(constraint), *words)


def test_a_constraint_without_rows_is_taken() -> None:
    make_pepper().add(Wall(None))


# -- observers --------------------------------------------------------------------------------------------------------


class Seeing(Observer):
    """Blind, but for what is changed."""

    def __init__(self, **changes: Any) -> None:
        self.changes, self.steps, self.resets = changes, 0, 0

    def step(self, tick: Tick) -> Any:
        self.steps += 1
        nan = np.full(17, np.nan)
        blind = Observation(
            contacts=(),
            expected=nan,
            residual=nan,
            threshold=nan,
            torque=nan,
            torque_std=nan,
            state=np.zeros(17, dtype=np.int8),
        )
        if "observation" in self.changes:
            return self.changes["observation"]
        return replace(blind, **self.changes)

    def reset(self) -> None:
        self.steps = 0
        self.resets += 1

    def describe(self) -> str:
        return "seeing"


class Misreading(Seeing):
    def step(self, tick: Any) -> Any:
        return tick.command.position  # no such field


class Wordless(Seeing):
    """Describes itself by what is no text."""

    def describe(self) -> Any:
        return ["seeing"]


class TouchShy(Seeing):
    """Fails only once something touches."""

    def step(self, tick: Tick) -> Any:
        if np.abs(tick.sent.position - tick.measurement.position).max() > 0.05:
            raise ZeroDivisionError("touched")  # at a touch
        return super().step(tick)


WRONG_OBSERVERS: list[tuple[Observer, tuple[str, ...]]] = [
    (
        Seeing(observation=np.zeros(17)),
        ("observer 'Seeing' (Seeing.step, ", "an Observation", "got array("),
    ),
    (Seeing(expected=np.zeros(20)), ("expected: expected an array (17,)", "an array (20,)")),
    (Seeing(residual=[0.0] * 17), ("residual", "(17,)", "got a list")),
    (Seeing(threshold=0.1), ("threshold", "(17,)", "0.1")),
    (Seeing(torque=np.zeros((17, 1))), ("torque", "(17, 1)")),
    (Seeing(torque_std=np.zeros(17, dtype=np.int64)), ("torque_std", "floats", "int64")),
    (Seeing(state=np.full(17, 9)), ("state", "JointState")),
    (Seeing(state=None), ("state", "(17,)", "None")),
    (Seeing(contacts=[]), ("contacts", "a tuple of Contact")),
    (Seeing(contacts=("LBicep",)), ("contacts", "a tuple of Contact")),
    (Misreading(), (line_of(Misreading.step, "no such field"), "Misreading.step", "'command'")),
    (Wordless(), ("(Wordless.describe, ", "a line of text, got ['seeing']")),
    (TouchShy(), (line_of(TouchShy.step, "at a touch"), "ZeroDivisionError: touched")),
]


@pytest.mark.parametrize("number", range(len(WRONG_OBSERVERS)))
def test_a_wrong_observer_is_refused_when_the_robot_is_made(number: int) -> None:
    observer, words = WRONG_OBSERVERS[number]
    refused(lambda: make_pepper(observer=observer), *words)


def test_a_good_observer_is_reset_after_its_dry_run() -> None:
    observer = Seeing()
    dry_run_observer(observer, ROBOT)
    assert observer.steps == 0
    assert observer.resets >= 1


@pytest.mark.parametrize("nothing", [3, Seeing, np.zeros(17)])
def test_what_is_no_observer_is_refused_and_not_left_out(nothing: Any) -> None:
    refused(
        lambda: make_pepper(observer=nothing), "Pepper: observer must be a text or an Observer, got"
    )


# -- reflexes ---------------------------------------------------------------------------------------------------------


@dataclass(kw_only=True, eq=False)
class Asking(Reflex):
    """Requests what a test gives it, while it is touched."""

    request: Callable[[ReflexRequests], object]
    acted: bool = False

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        self.acted = True
        self.request(requests)  # here


class Bent(Mine):
    """Right in a controller of its own, wrong in a reflex."""


WRONG_REQUESTS: list[tuple[Callable[[ReflexRequests], object], tuple[str, ...]]] = [
    (
        lambda requests: requests.claim("left_arn"),
        ("reflex 'asking' (Asking.act, ", "unknown joint or chain 'left_arn'", "left_arm"),
    ),
    (lambda requests: requests.claim(["LElbowRoll", "LElbow"]), ("'LElbow'", "LElbowYaw")),
    (lambda requests: requests.claim(np.zeros(20, dtype=bool)), ("(17,) of bool", "(20,)")),
    (lambda requests: requests.claim(np.ones(17)), ("(17,) of bool", "float64")),  # type: ignore[arg-type]
    (lambda requests: requests.claim([3, 4]), ("given by names", "[3, 4]")),  # type: ignore[list-item]
    (lambda requests: requests.claim(None), ("given by names", "None")),  # type: ignore[arg-type]
    (lambda requests: requests.lower_stiffness("rigth_arm", 0.3), ("'rigth_arm'", "right_arm")),
    (lambda requests: requests.release("arm", in_place=True), ("'arm'",)),
    (lambda requests: requests.add_task("reach"), ("add_task takes a task", "'reach'")),  # type: ignore[arg-type]
    (lambda requests: requests.hold_posture(np.zeros(20), 100.0), ("held posture", "(20,)")),
    (
        lambda requests: requests.add_task(Bent(assign("error", np.zeros(3)))),
        ("task 'mine' (Bent.compute", "rows.error", "(3,)"),
    ),
]


@pytest.mark.parametrize("number", range(len(WRONG_REQUESTS)))
def test_a_wrong_request_is_refused_when_the_robot_is_made(number: int) -> None:
    request, words = WRONG_REQUESTS[number]
    reflex = Asking(request=request)
    error = refused(lambda: make_pepper(observer=Seeing(), reflexes=[reflex]), *words)
    assert isinstance(error, PluginInterfaceError)
    assert not reflex.acted, "only copies are tried"


def test_a_request_for_one_limb_only_is_found_on_that_limb() -> None:
    """Each limb is tried: a name that only the right arm's branch has wrong."""

    @dataclass(kw_only=True, eq=False)
    class Sided(Reflex):
        def begin(self, contact: Contact, requests: ReflexRequests) -> None:
            requests.claim("left_arm" if contact.link.startswith(("L", "l_")) else "rigth_arm")

    refused(lambda: make_pepper(reflexes=[Sided()]), "rigth_arm")
    make_pepper(reflexes=[Sided(joint="LShoulderRoll")])


def test_what_a_program_lacks_at_that_time_is_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    def request(requests: ReflexRequests) -> None:
        requests.claim(missing.chain)  # not there yet

    with caplog.at_level(logging.WARNING, logger="pepper_driver"):
        dry_run_reflexes([Asking(request=request)], ROBOT)
    missing: Any = None
    (record,) = caplog.records
    text = record.getMessage()
    assert "reflex 'asking' (Asking.act, " in text
    assert line_of(request, "not there yet") in text
    assert "NameError" in text


@pytest.mark.parametrize("nothing", [3, Hold, Hold(), [Hold], ["hold"]])
def test_what_is_no_list_of_reflexes_is_refused(nothing: Any) -> None:
    refused(lambda: make_pepper(reflexes=nothing), "reflexes are ", "Hold()")


@pytest.mark.parametrize("selection", ["left_arm", ["LShoulderPitch", "LElbowRoll"], "HeadYaw"])
def test_joints_are_claimed_by_name(selection: Any) -> None:
    names = ROBOT.chains.get(selection, [selection]) if isinstance(selection, str) else selection

    def request(requests: ReflexRequests) -> None:
        before = requests.claimed.copy()
        if requests.claim(selection):
            assert sorted(np.flatnonzero(requests.claimed & ~before)) == sorted(
                ROBOT.joint_index(name) for name in names
            )
        assert not requests.claim(selection), "they are taken now"

    dry_run_reflexes([Asking(request=request)], ROBOT)


# -- in a tick --------------------------------------------------------------------------------------------------------


class Later(Seeing):
    """Fails in its third tick on a robot."""

    def step(self, tick: Tick) -> Any:
        if self.resets > 2 and self.steps == 2:
            return 1 / 0  # by zero
        return super().step(tick)


class Drifting(Mine):
    def compute(self, model: RobotModel, rows: TaskRows) -> None:
        super().compute(model, rows)
        if model.q[1] > 0.01:
            rows.error = np.zeros(9)  # too many


def _drive(pepper: Pepper) -> None:
    pepper.drive(0.0, 0.2, 0.0, hold=True)
    pepper.run(2.0)


def faulted(pepper: Pepper) -> str:
    with pepper, pytest.raises(FaultError) as caught:
        _drive(pepper)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_fault_names_the_observer_and_its_line() -> None:
    text = faulted(make_pepper(observer=Later()))
    where = line_of(Later.step, "by zero")
    assert f"observer 'Later' (Later.step, {where}): ZeroDivisionError: division by zero" in text


def test_the_fault_names_the_task_and_its_line() -> None:
    pepper = make_pepper()
    pepper.add(Drifting(lambda rows: None))
    text = faulted(pepper)
    where = line_of(Drifting.compute, "too many")
    assert f"task 'mine' (Drifting.compute, {where}): ShapeError: rows.error takes" in text


def test_the_fault_names_the_reflex_and_its_line() -> None:
    touch = contact(1)
    asked: list[bool] = []

    def request(requests: ReflexRequests) -> None:
        if len(asked) > 100:
            requests.claim("left_arn")
        asked.append(True)

    pepper = make_pepper(observer=Seeing(contacts=(touch,)), reflexes=[Asking(request=request)])
    text = faulted(pepper)
    where = line_of(Asking.act, "# here")
    package = re.escape("reflex 'asking' (Asking.act, ")
    assert re.search(package + r"test_plugins\.py line \d+\): UnknownNameError", text), where


class Breaking(MockBackend):
    def read(self) -> Measurement:
        if len(self.commands) > 20:
            raise ZeroDivisionError("no time left")  # lost
        return super().read()


def test_the_event_of_a_lost_robot_names_the_backend_and_its_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("pepper_driver.robot.make_backend", lambda *_: Breaking(ROBOT, uri="my://"))
    pepper, reported = make_pepper(), list[str]()
    pepper.on_fault()(lambda event: reported.append(event.fault.text))
    with pytest.raises(ZeroDivisionError), pepper:
        pepper.run(2.0)
    where = line_of(Breaking.read, "# lost")
    assert reported == [
        f"backend 'my://' (Breaking.read, {where}): ZeroDivisionError: no time left"
    ]


def test_an_error_of_this_package_names_no_plug_in() -> None:
    with pytest.raises(NotConnectedError) as caught:
        MockBackend(ROBOT).read()
    assert describe_failure(caught.value) == "NotConnectedError: 'mock' is not open"
