"""Figure of the method on the page of the observer: ``python docs/observer_figure.py`` (extra ``plot``).

Writes ``docs/observer.png``: a hand pushes an attentive, simulated robot; both channels, and the residual.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pepper_driver import Pepper
from pepper_driver.config import (
    RobotIdentity,
    load_observer_settings,
    load_plant,
    load_robot,
    plant_hash,
)
from pepper_driver.controller import Tick
from pepper_driver.figure_style import (
    BLUE,
    COMMANDED,
    GREEN,
    MEASURED,
    ORANGE,
    PREDICTED,
    RESIDUAL,
    SHADE,
    THRESHOLD,
    Style,
    add_legend,
    dress,
    joint_title,
    new_figure,
    save_figure,
    styled,
)
from pepper_driver.observer import (
    ContactObserver,
    Observation,
    Observer,
    Recording,
    RecordingBuilder,
    load_shipped,
)
from pepper_driver.observer.contact_observer import ObserverParts
from pepper_driver.observer.residuals.fusion import FusionParts

FILE = Path(__file__).with_name("observer.png")
LINK, JOINT = "l_wrist", "LShoulderRoll"
FORCE, BEFORE, DURATION, AFTER = 6.0, 4.0, 1.0, 2.0
"""[N] outwards at the hand; [s] shown before it, of it, and after it."""
CHANNELS: dict[str, tuple[FusionParts, Style]] = {
    "model": (
        FusionParts(current=False, limbs=False),
        {"color": ORANGE, "linewidth": 1.2, "label": "by the stick-slip model (1)"},
    ),
    "current": (
        FusionParts(model=False, limbs=False),
        {"color": BLUE, "linewidth": 1.2, "label": "by the motor current (2)"},
    ),
    "both": (FusionParts(), {**RESIDUAL, "label": "residual r: both must agree (3)"}),
}


def record() -> tuple[Recording, float]:
    """Return a run of an attentive robot, and the time at which a hand pushes it [s]."""
    builder = RecordingBuilder(load_robot())

    def keep(tick: Tick, _: Observation | None) -> None:
        builder.append(tick)

    with Pepper("mujoco") as pepper:
        pepper.attentive = True
        pepper.set_posture({"LShoulderPitch": 0.9, "LElbowRoll": -1.0}, duration=2.0)
        pepper.run(10.0, on_tick=keep)
        begin = pepper.time
        pepper.push(LINK, [0.0, FORCE, 0.0], duration=DURATION)
        pepper.run(DURATION + AFTER, on_tick=keep)
    return builder.finish(), begin


def watch(observer: Observer, recording: Recording) -> list[Observation]:
    """Show a run to an observer."""
    return [observer.step(tick) for tick in recording.ticks()]


@styled
def draw(recording: Recording, begin: float) -> None:
    """Draw position, channels and residual of one joint."""
    robot, settings = load_robot(), load_observer_settings()
    plant = load_plant("nominal", robot)
    identity = RobotIdentity(name=plant.name, identity=plant_hash(plant, robot))
    models = load_shipped("fusion", [identity])
    j = robot.joint_index(JOINT)
    seen = {
        name: watch(
            ContactObserver(robot, models, settings, parts=ObserverParts(residual=parts)), recording
        )
        for name, (parts, _) in CHANNELS.items()
    }
    time = recording.time - begin
    figure = new_figure(9.0, 5.6)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
    target, measured = (
        np.degrees(recording.sent_position[:, j]),
        np.degrees(recording.position[:, j]),
    )
    both = seen["both"]
    expected = target - np.degrees([o.expected[j] for o in both])
    above.plot(time, target, **COMMANDED)
    above.plot(time, expected, **PREDICTED)
    above.plot(time, measured, **MEASURED)
    above.set_ylabel("position [deg]")
    above.set_title(f"{joint_title(JOINT)}, {FORCE:g} N at the hand for {DURATION:g} s; simulated")
    for name, (_, style) in CHANNELS.items():
        below.plot(time, np.degrees([o.residual[j] for o in seen[name]]), **style)
    # Without its limb: a joint that is judged together with others has a lower one.
    threshold = np.degrees([o.threshold[j] for o in seen["model"]])
    below.plot(time, threshold, **THRESHOLD)
    below.plot(time, -threshold, **{**THRESHOLD, "label": None})
    below.set_ylabel("residual [deg]")
    below.set_xlabel("time since the hand pushes [s]")
    (first, *_) = [c for o in both for c in o.contacts if c.time > begin and c.phase == "begin"]
    below.axvline(
        first.time - begin, color=GREEN, linewidth=1.5, label=f"contact reported: {first.joint}"
    )
    for axes in (above, below):
        axes.axvspan(0.0, DURATION, color=SHADE, zorder=0)
        dress(axes)
    below.set_xlim(-BEFORE, DURATION + AFTER)
    add_legend(figure)
    save_figure(figure, FILE)


if __name__ == "__main__":
    draw(*record())
