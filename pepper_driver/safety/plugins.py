"""Plug-ins: a dry run before the robot moves, and their name and line in the message when they fail.

Only parts that another package, or a program, defines are run dry; those of this package have tests of their own.
"""

from __future__ import annotations

import copy
import logging
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import get_args

import numpy as np

from pepper_driver.backends import Backend, Command, Measurement
from pepper_driver.backends.mock import MockBackend
from pepper_driver.config import PepperError, RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_selector import Kind
from pepper_driver.config.errors import shown
from pepper_driver.config.plugins import PluginInterfaceError
from pepper_driver.config.robot import LEGS
from pepper_driver.controller import (
    BrakingLimits,
    Constraint,
    LinearInequality,
    Reference,
    RobotModel,
    Task,
    TaskRows,
    Tick,
    WholeBodyController,
)
from pepper_driver.controller.constraints.constraint import RowCheck
from pepper_driver.controller.tasks.targets import finite_vector
from pepper_driver.observer import Contact, JointState, Observation, Observer
from pepper_driver.observer.detection.body_isolation import BASE_LINK, TRUNK_LINK
from pepper_driver.reflexes import Reflex, ReflexRequests

logger = logging.getLogger("pepper_driver")

Part = Backend | Constraint | Observer | Reflex | Task

DISPLACEMENT = 0.2
"""[rad] Between command and joints in the second half of an observer's dry run: more than any touch leaves."""

OBSERVER_TICKS = 50
"""Length of an observer's dry run."""

INTENSITY, TORQUE, FORCE = 30.0, 10.0, 20.0
"""[deg], [N m] Of the contacts that a reflex is run dry with: strong ones, which all are for."""

DECELERATION = 10.0
"""[m/s2], [rad/s2] Of all 20 degrees of freedom, where a constraint is run dry."""


def is_plugin(part: object) -> bool:
    """Return True for an object of a class that is not of this package."""
    return type(part).__module__.partition(".")[0] != __name__.partition(".")[0]


# -- names ------------------------------------------------------------------------------------------------------------


def describe_failure(error: BaseException) -> str:
    """Describe an error in one line: where a plug-in raised it, the plug-in and the line of its file first."""
    text = _one_line(error)
    part: Part | None = None
    for frame, _ in traceback.walk_tb(error.__traceback__):
        caller = frame.f_locals.get("self")
        if isinstance(caller, Part) and is_plugin(caller):
            part = caller
    return text if part is None else f"{_name(part, error)}: {text}"


def _one_line(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def _name(part: Part, error: BaseException | None = None, method: str = "") -> str:
    """Return kind, name and class of a plug-in, with the method and the line that an error comes from."""
    kind = next(base.__name__ for base in type(part).__mro__ if base in get_args(Part)).lower()
    cls = type(part)
    label = part.uri if isinstance(part, Backend) else getattr(part, "name", "") or cls.__name__
    found = "" if error is None else _place(part, error)
    if not found and method:
        code = getattr(getattr(cls, method, None), "__code__", None)
        where = (
            "" if code is None else f", {Path(code.co_filename).name} line {code.co_firstlineno}"
        )
        found = f"{cls.__name__}.{method}{where}"
    return f"{kind} '{label}' ({found or cls.__name__})"


def _place(part: Part, error: BaseException) -> str:
    """Return the method of a plug-in that raised an error, with the line in the plug-in's own files."""
    package = type(part).__module__.partition(".")[0]
    method, line = "", ""
    for frame, number in traceback.walk_tb(error.__traceback__):
        if frame.f_globals.get("__name__", "").partition(".")[0] != package:
            continue
        if frame.f_locals.get("self") is part and not method:
            method = f"{type(part).__name__}.{frame.f_code.co_name}, "
        line = f"{Path(frame.f_code.co_filename).name} line {number}"
    return method + line if line else ""


def _defect(part: Part, method: str, text: str) -> PluginInterfaceError:
    return PluginInterfaceError(f"{_name(part, method=method)}: {text}")


def _failed(part: Part, error: Exception, method: str) -> PluginInterfaceError:
    return PluginInterfaceError(f"{_name(part, error, method)}: {_one_line(error)}")


# -- tasks and constraints --------------------------------------------------------------------------------------------


def dry_run_part(part: Task | Constraint, robot: RobotConfig) -> None:
    """Evaluate a copy of a task or constraint once, at rest in the middle of all joints' ranges; nothing of it changes.

    Raises:
        PluginInterfaceError: It raises, or gives arrays of another shape or values that are not finite.
    """
    if is_plugin(part):
        model = RobotModel(robot)
        model.set_state(model.configuration((robot.lower + robot.upper) / 2), np.zeros(model.nv))
        model.update_kinematics()
        _dry_run(part, model)


def _dry_run(part: Task | Constraint, model: RobotModel) -> None:
    method = "compute" if isinstance(part, Task) else "compute_inequality"
    trial = part
    try:
        trial = copy.copy(part)
        if isinstance(trial, Task):
            _evaluate_task(trial, model)
        else:
            _evaluate_constraint(trial, model)
    except PluginInterfaceError:
        raise
    except Exception as error:
        raise _failed(trial, error, method) from error


def _evaluate_task(task: Task, model: RobotModel) -> None:
    if not hasattr(task, "rows"):
        raise _defect(
            task, "__init__", "does not call super().__init__(rows, stiffness=..., weight=...)"
        )
    task.owner = task.changes = None
    rows = TaskRows.empty(task.rows, model.nv)
    task.attach(model, rows)
    if not rows.jacobian.any():  # the rows may keep their last values otherwise
        rows.jacobian[:] = np.nan
    task.compute(model, rows)
    for name in ("error", "jacobian"):
        array: FloatArray = getattr(rows, name)
        if np.isnan(array).all():
            raise _defect(task, "compute", f"assigns nothing to rows.{name}, {_shape(array)}")
    rows.jacobian[np.isnan(rows.jacobian)] = 0.0  # entries that stay as they are
    for name in ("error", "jacobian", "bias"):
        if not np.isfinite(getattr(rows, name)).all():
            raise _defect(task, "compute", f"assigns values to rows.{name} that are not finite")
    mask = task.joint_mask(model)
    if np.shape(mask) != (model.nv,):
        raise _defect(task, "joint_mask", f"expected {_text((model.nv,))}, got {_shape(mask)}")


def _evaluate_constraint(constraint: Constraint, model: RobotModel) -> None:
    if not isinstance(getattr(constraint, "name", None), str):
        raise _defect(constraint, "__init__", "has no name: set the attribute 'name'")
    limits = BrakingLimits(np.full(model.nv, DECELERATION), model.robot.cycle)
    if constraint.lazy:
        constraint.is_satisfied(model, limits, np.zeros(model.nv))
    found = constraint.compute_inequality(model, limits)
    if found is None:
        return
    if not isinstance(found, LinearInequality):
        text = f"expected a LinearInequality or None, got {shown(found)}"
        raise _defect(constraint, "compute_inequality", text)
    count = len(found.names)
    for name, shape in (("matrix", (count, model.nv)), ("bound", (count,))):
        array = getattr(found, name)
        if np.shape(array) != shape or not isinstance(array, np.ndarray):
            text = f"with {count} names {name} is {_text(shape)}, got {_shape(array)}"
            raise _defect(constraint, "compute_inequality", text)
    if RowCheck(model.nv).plain(found) is None:
        raise _defect(constraint, "compute_inequality", "matrix or bound holds what is no number")


def _shape(value: object) -> str:
    return _text(value.shape) if isinstance(value, np.ndarray) else shown(value)


def _text(shape: tuple[int, ...]) -> str:
    return f"an array {shape}"


# -- observers --------------------------------------------------------------------------------------------------------


def still_tick(measurement: Measurement, command: FloatArray | None = None) -> Tick:
    """Return a tick of a robot whose command is to stand still.

    Args:
        measurement: What it measures.
        command: (17,) commanded positions [rad]; by default the measured ones.
    """
    position = measurement.position if command is None else command
    zero = np.zeros(len(position))
    return Tick(
        measurement=measurement,
        reference=Reference(
            position=position,
            velocity=zero,
            acceleration=zero,
            load_torque=zero,
            base_twist=np.zeros(3),
        ),
        sent=Command(position=position, stiffness=np.ones(len(position)), wheel_speed=np.zeros(3)),
        limited=np.zeros(len(position), dtype=np.bool_),
    )


def dry_run_observer(observer: Observer, robot: RobotConfig) -> None:
    """Run an observer on ticks of a robot that stands, half of the time with all joints pushed aside; then reset it.

    Raises:
        PluginInterfaceError: It raises, or an observation is not as :class:`Observation` says.
    """
    if not is_plugin(observer):
        return
    method = "reset"
    try:
        observer.reset()
        method = "step"
        backend = MockBackend(robot)
        standing = backend.open()
        for number in range(OBSERVER_TICKS):
            aside = DISPLACEMENT if number >= OBSERVER_TICKS // 2 else 0.0
            measurement = replace(backend.read(), position=standing.position + aside)
            tick = still_tick(measurement, standing.position)
            check_observation(observer, observer.step(tick), len(robot.joint_names))
        method = "describe"
        if not isinstance(text := observer.describe(), str):
            raise _defect(observer, method, f"expected a line of text, got {shown(text)}")
        method = "reset"
        observer.reset()
    except PluginInterfaceError:
        raise
    except Exception as error:
        raise _failed(observer, error, method) from error


def check_observation(observer: Observer, observation: object, joints: int) -> None:
    """Refuse what is no observation of a robot with so many joints.

    Raises:
        PluginInterfaceError: Another type, or a field of another type or shape.
    """
    if not isinstance(observation, Observation):
        raise _defect(observer, "step", f"expected an Observation, got {shown(observation)}")
    for field in fields(Observation):
        value = getattr(observation, field.name)
        if field.name == "contacts":
            if not isinstance(value, tuple) or not all(isinstance(c, Contact) for c in value):
                text = f"contacts: expected a tuple of Contact, got {shown(value)}"
                raise _defect(observer, "step", text)
        elif np.shape(value) != (joints,) or not isinstance(value, np.ndarray):
            text = f"{field.name}: expected {_text((joints,))}, got {_shape(value)}"
            raise _defect(observer, "step", text)
        elif field.name == "state":
            if not np.isin(value, list(JointState)).all():
                raise _defect(
                    observer, "step", f"state: expected values of JointState, got {value}"
                )
        elif value.dtype.kind != "f":
            raise _defect(observer, "step", f"{field.name}: expected floats, got {value.dtype}")


# -- reflexes ---------------------------------------------------------------------------------------------------------


def dry_run_reflexes(reflexes: Sequence[Reflex], robot: RobotConfig) -> None:
    """Run copies of reflexes on pretended contacts, one on each link that they are for; nothing moves.

    Only errors of this package are raised: they mean that a request is wrong. Others may come from the pretence, as of
    a variable of the program without a value yet: they are logged as warnings.

    Raises:
        PluginInterfaceError: A request names what the robot does not have, or has a wrong shape.
    """
    foreign = [reflex for reflex in reflexes if is_plugin(reflex)]
    if not foreign:
        return
    controller = WholeBodyController(robot)
    controller.model.update_kinematics()
    measurement = replace(MockBackend(robot).open(), position=controller.position)
    for reflex in foreign:
        try:
            trial = copy.copy(reflex)
            trial.setup(robot)
            for contact in _contacts(trial, robot):
                _dry_run_reflex(reflex, contact, controller, measurement, robot)
        except PepperError:
            raise
        except Exception as error:
            logger.warning("dry run with a pretended contact: %s", describe_failure(error))


def _contacts(reflex: Reflex, robot: RobotConfig) -> Iterator[Contact]:
    """Contacts that a reflex is for: on each joint's link, on trunk and base."""
    legs = robot.chains.get(LEGS, ())
    limbs = [(joint.name, joint.child) for joint in robot.joints if joint.name not in legs]
    places: list[tuple[str | None, str]] = [*limbs, (None, TRUNK_LINK), (None, BASE_LINK)]
    for joint, link in places:
        contact = pretend_contact(joint, link, robot, reflex.kind or "contact")
        contact = replace(
            contact,
            intensity_deg=max(contact.intensity_deg, reflex.min_intensity_deg),
            torque=max(TORQUE, reflex.min_torque),
            force=(max(FORCE, reflex.min_force), 0.0, 0.0),
        )
        if reflex.matches(contact):
            yield contact


def pretend_contact(
    joint: str | None, link: str, robot: RobotConfig, kind: Kind = "contact"
) -> Contact:
    """Return the begin of a strong contact."""
    return Contact(
        id=1,
        phase="begin",
        kind=kind,
        limb=robot.limb_of(joint),
        joint=joint,
        shown_by=joint,
        link=link,
        direction=1,
        intensity_deg=INTENSITY,
        torque=TORQUE,
        torque_std=0.1 * TORQUE,
        onset_time=0.0,
        detection_time=0.0,
        time=0.0,
    )


def _dry_run_reflex(
    reflex: Reflex,
    contact: Contact,
    controller: WholeBodyController,
    measurement: Measurement,
    robot: RobotConfig,
) -> None:
    """Contact, two ticks of it, its end, and the end of the reflex."""
    requests, trial = ReflexRequests(controller, robot), reflex
    try:
        trial = copy.copy(reflex)
        trial.setup(robot)
        later = trial.release_delay + robot.cycle
        end = replace(contact, phase="end")
        for time, contacts in ((0.0, [contact]), (1.0, []), (2.0, [end]), (2.0 + later, [])):
            requests.clear()
            observation = _observe(tuple(contacts), contact, robot)
            trial.step(observation, replace(measurement, time=time), requests)
            if requests.posture is not None:
                finite_vector("a held posture", requests.posture, len(robot.joint_names))
            for task in requests.tasks.values():
                if is_plugin(task):
                    _dry_run(task, controller.model)
    except PluginInterfaceError:
        raise
    except PepperError as error:
        raise _failed(trial, error, "act") from error


def _observe(contacts: tuple[Contact, ...], touching: Contact, robot: RobotConfig) -> Observation:
    """Observation of a robot at rest, with a torque on the joint that is touched."""
    count = len(robot.joint_names)
    torque, state = np.zeros(count), np.full(count, JointState.FREE, dtype=np.int8)
    if touching.joint is not None:
        index = robot.joint_index(touching.joint)
        torque[index], state[index] = touching.direction * TORQUE, JointState.CONTACT
    return Observation(
        contacts=contacts,
        expected=np.zeros(count),
        residual=np.zeros(count),
        threshold=np.full(count, 0.01),
        torque=torque,
        torque_std=np.full(count, 0.1 * TORQUE),
        state=state,
    )
