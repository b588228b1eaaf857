"""Any tree of steps with any touches: it ends, leaves the controller as it was, and the reference never jumps."""

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver import Hold, Pepper
from pepper_driver.config import load_controller_settings
from pepper_driver.observer import Contact
from support.events import contact
from support.examples import examples
from support.experiments import CYCLE, REACH, ROBOT, Played, make_experiment, with_played

SETTINGS = load_controller_settings(ROBOT)
SPEED, ACCELERATION = SETTINGS.joint_velocity(ROBOT), SETTINGS.joint_acceleration(ROBOT)
PLACES = [
    {"limb": "left_arm", "link": "LForeArm", "joint": "LElbowRoll"},
    {"limb": "head", "link": "Head", "joint": "HeadYaw"},
]
TOUCHED = 120
"""[ticks] from the beginning in which it is touched."""

duration = st.sampled_from([0.012, 0.06, 0.3])
triggers = st.fixed_dictionaries(
    {},
    optional={
        "limb": st.sampled_from(["left_arm", "head"]),
        "min_torque": st.just(2.0),
        "lasting": st.just(0.036),
    },
) | st.just({"touches": 2, "within": 0.5})
angles = st.dictionaries(st.sampled_from(["HeadYaw", "LShoulderRoll"]), st.sampled_from([0.1, 0.5]))
moves = st.builds(
    lambda joints, duration, hold: {"joints": joints, "duration": duration, "hold": hold},
    angles,
    st.sampled_from([0.24, 0.3]),  # in which every joint can get there
    duration,
)
leaves = st.one_of(
    moves,
    st.builds(
        lambda step, duration: step | {"hold": duration}, st.just({"posture": "Stand"}), duration
    ),
    st.builds(
        lambda duration, keep: {"duration": duration, "position": REACH | {"keep": keep}},
        duration,
        st.booleans(),
    ),
    st.just({"joints": {"HeadYaw": 0.3}, "until": "reached", "timeout": 0.6, "hold": 0.06}),
    st.just({"base_velocity": {"vx": 0.1}, "duration": 0.24, "stiffness": 20.0}),
    st.builds(lambda on: {"attentive": on, "hold": 0.12}, st.booleans()),
    st.just(
        {
            "setpoints": {
                "joints": ["HeadYaw"],
                "range": 0.5,
                "settle": 0.06,
                "count": 2,
                "period": 0.12,
            }
        }
    ),
    st.just({"cue": "word"}),
    st.builds(lambda on: {"wait": {**on, "timeout": 0.3}}, triggers),
)


def blocks(inner: Any) -> Any:
    steps = st.lists(inner, min_size=1, max_size=2)
    return st.builds(
        lambda times, steps, until: {"repeat": {"times": times, "steps": steps, **until}},
        st.integers(1, 3),
        steps,
        st.just({}) | st.builds(lambda on: {"until": on}, triggers),
    ) | st.builds(
        # The first case is the narrower one, else the other could never be taken.
        lambda first, second, otherwise, deciding: {
            "branch": {
                "timeout": 0.3,
                "deciding": deciding,
                "cases": [
                    {"on": {"limb": "left_arm", "min_torque": 2.0}, "steps": first},
                    {"on": {}, "steps": second},
                ],
                "otherwise": otherwise,
            }
        },
        st.lists(inner, max_size=1),
        steps,
        st.lists(inner, max_size=1),
        st.sampled_from([0.0, 0.06]),
    )


trees = st.lists(st.recursive(leaves, blocks, max_leaves=5), min_size=1, max_size=3)
reactions = st.lists(
    st.builds(
        lambda on, play, words, at_most: {"on": on, **play, **words, **at_most},
        triggers,
        st.just({"play": "p"}) | st.just({}),
        st.just({"cue": "touched"}),
        st.just({}) | st.just({"at_most": 1}),
    ),
    max_size=2,
)
touches = st.lists(
    st.tuples(
        st.integers(1, TOUCHED),
        st.integers(1, 40),
        st.sampled_from(PLACES),
        st.sampled_from([0.5, 3.0]),
    ),
    max_size=6,
)


def script(detected: list[Any]) -> dict[int, tuple[Contact, ...]]:
    events: dict[int, tuple[Contact, ...]] = {}
    for number, (begin, length, place, torque) in enumerate(detected):
        for tick, phase in ((begin, "begin"), (begin + 1, "update"), (begin + 1 + length, "end")):
            size = 0.5 if phase == "begin" else torque
            event = contact(number, phase=phase, torque=size, **place)
            events[tick] = (*events.get(tick, ()), event)
    return events


@examples(20)
@given(
    tree=trees,
    part=st.lists(leaves, min_size=1, max_size=2),
    answers=reactions,
    detected=touches,
    holds=st.booleans(),
)
def test_it_ends_leaves_nothing_behind_and_does_not_jump(
    tree: list[Any], part: list[Any], answers: list[Any], detected: list[Any], holds: bool
) -> None:
    played_part = make_experiment(*part)
    stand = {"posture": "Stand", "hold": 0.06}
    experiment = with_played(make_experiment(stand, *tree, reactions=answers), p=played_part)
    # Each touch may be answered by the steps of one reaction, the way back, and a reflex.
    longest = experiment.max_length + len(detected) * (played_part.max_length + 6.0) + 1.0
    most = round(longest / CYCLE)

    def stop_if_late(pepper: Pepper, tick: int) -> None:
        assert tick <= most, "it does not end"

    reflexes = (Hold(limb="head", release_delay=0.06),) if holds else ()
    played = Played(experiment, script(detected), reflexes=reflexes, on_tick=stop_if_late, rest=0.3)
    report = played.done
    assert played.after == played.before
    assert len(report.steps) == len(played.steps)
    for answer in answers:
        if answer.get("at_most") and len(answers) == 1:
            assert played.words.count("cue: touched") <= 1
    assert {event.id for event in report.contacts} <= set(range(len(detected)))
    speed = played.velocity
    assert (np.abs(speed) <= SPEED * (1 + 1e-6)).all()
    assert (np.abs(np.diff(speed, axis=0)) <= ACCELERATION * CYCLE * (1 + 1e-6)).all()
