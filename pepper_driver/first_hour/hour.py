"""Runs the steps of a first hour one after the other; what is done is not done again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from pepper_driver.config import PepperError
from pepper_driver.config.file_lock import lock_folder
from pepper_driver.first_hour.operator import Operator
from pepper_driver.first_hour.plan import HourPlan, PlannedStep
from pepper_driver.first_hour.state import (
    STATE,
    FirstHour,
    FirstHourError,
    ResultValue,
    StepName,
    check_same_hour,
    load_state,
    save_state,
)

Action = Callable[[], Mapping[str, ResultValue]]
"""Makes a step; returns its results. An error or an interrupt leaves the step to be made again."""


def run_hour(
    folder: Path,
    asked: FirstHour,
    plan: HourPlan,
    actions: Mapping[StepName, Action],
    operator: Operator,
    *,
    introduce: Callable[[PlannedStep], None],
    check: Callable[[], None],
    show: Callable[[str], None],
    again: StepName | None = None,
) -> FirstHour:
    """Make all steps that are not done.

    Args:
        folder: For all that is recorded; made if need be.
        asked: The hour as it would begin now; one in the folder must be the same.
        plan: What each step is.
        actions: By step.
        operator: Asked before each step in which the robot moves.
        introduce: Shows such a step.
        check: Called before the question and after the answer, which may come late; raises where the robot is not fit
            to move.
        show: Prints a line.
        again: Step to make once more although it is done, with those that build on it; None for none.

    Returns:
        The hour after its last step.

    Raises:
        FirstHourError: The folder has the hour of another robot, version or plan, its state is damaged, or it has no
            hour of which a step could be made again.
        InUseError: Another command works in the folder.
        OperatorLeftError: A step was not confirmed.
        PepperError: A step failed. ``while_active`` is True for all that comes after the begin.
    """
    path = folder / STATE
    with lock_folder(folder):
        hour = asked
        if path.exists():
            hour = load_state(path)
            check_same_hour(hour, asked, folder)
            if again is not None:
                hour = hour.reopened(again)
        elif again is not None:
            raise FirstHourError(f"{folder}: there is no hour of which a step could be made again")
        else:
            save_state(path, hour)
        begun = False
        while (name := hour.next_step) is not None:
            step = plan.step(name)
            try:
                if step.moves:
                    introduce(step)
                    check()
                    operator.confirm(f"Begin step '{name}'?")
                    check()
                begun = True
                hour = hour.begun(name)
                save_state(path, hour)
                figures = actions[name]()
                hour = hour.done(name, figures)
                save_state(path, hour)
            except (PepperError, KeyboardInterrupt) as error:
                if isinstance(error, PepperError):
                    error.while_active = error.while_active or begun or name != "doctor"
                # A terminal that was closed must not hide what ended the step.
                with suppress(OSError):
                    show(_how_to_go_on(hour, name, folder, again if begun else None))
                raise
    return hour


def _how_to_go_on(hour: FirstHour, name: StepName, folder: Path, again: StepName | None) -> str:
    done = [step.name for step in hour.steps if step.progress == "done"]
    kept = f"done: {', '.join(done)}" if done else "no step is done"
    command = "the same command" if again is None else "the same command without --again"
    return (
        f"the hour ended early, in step '{name}'; {kept}. All that was recorded is kept in {folder}. When the cause is "
        f"removed, {command} goes on from there"
    )
