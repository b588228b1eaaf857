"""Steps as text, for what commands print before they move anything."""

from __future__ import annotations

from collections.abc import Iterator

from pepper_driver.callbacks.events import CueEvent
from pepper_driver.config import RobotConfig
from pepper_driver.config.steps import Step
from pepper_driver.config.task_specs import BaseSpec, LookAtSpec, OrientationSpec, PoseSpec


def step_times(step: Step) -> str:
    """Time that a step takes."""
    if step.wait is not None:
        return f"at most {step.wait.timeout:.2f} s"
    if not step.max_duration:
        return "no time"
    parts = [] if step.duration is None else [f"{step.duration:.2f} s"]
    if step.until is not None:
        parts.append(f"until reached, {step.timeout:.2f} s at most")
    if step.hold:
        parts.append(f"hold {step.hold:.2f} s")
    return ", ".join(parts)


def step_parts(step: Step, robot: RobotConfig) -> Iterator[str]:
    """Describe a step, part by part."""
    yield from map(str, CueEvent.of(step, 0.0))
    if (wait := step.wait) is not None:
        yield f"wait for a {wait}, or {'stop' if wait.on_timeout == 'stop' else 'go on'}"
    if step.posture is not None:
        yield f"posture {step.posture}"
    for joint, angle in step.joints.items():
        yield f"{joint} to {angle:g}{'' if joint in robot.hands.joints else ' rad'}"
    yield from (f"{hand} to {aperture:g}" for hand, aperture in step.hands.items())
    if step.stiffness is not None:
        yield f"posture stiffness {step.stiffness:g} 1/s2"
    if step.attentive is not None:
        yield "attentive" if step.attentive else "no longer attentive"
    for _, task in step.tasks():
        kept = ", kept" if task.keep else ""
        if isinstance(task, BaseSpec):
            parts = (("x", task.x, "m"), ("y", task.y, "m"), ("heading", task.heading, "rad"))
            goal = ", ".join(
                f"{key} {value:g} {unit}" for key, value, unit in parts if value is not None
            )
            yield f"base to {goal}{kept}"
            continue
        if isinstance(task, LookAtSpec):
            goal = task.link or f"{_numbers(task.point or ())} m"
            yield f"look at {goal}{kept}"
            continue
        base = ", with the base" if task.base else ""
        if isinstance(task, OrientationSpec):
            goal = f"quaternion {_numbers(task.quaternion)}"
        elif isinstance(task, PoseSpec):
            goal = f"{_numbers(task.position)} m, quaternion {_numbers(task.quaternion)}"
        else:
            goal = f"{_numbers(task.target)} m"
        where = "" if task.root is None else f" from {task.root}"
        yield f"{task.label} to {goal}{where}{base}{kept}"
    if (twist := step.base_velocity) is not None:
        yield f"base at {twist.vx:g} {twist.vy:g} m/s, {twist.wz:g} rad/s"


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:g}" for value in values)
