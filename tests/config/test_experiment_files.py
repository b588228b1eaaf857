"""An experiment file is one that can be performed, or one line says what is wrong with it, and where."""

from pathlib import Path
from typing import Any

import pytest

from pepper_driver.config import (
    ConfigError,
    UnknownNameError,
    load_experiment,
)
from pepper_driver.config.contact_selector import TouchTrigger
from pepper_driver.config.experiment import ObserverChoice
from pepper_driver.config.loading import shipped_names
from support.experiment_files import (
    BRANCH,
    LISTEN,
    PUSH,
    ROBOT,
    STAND,
    TURN,
    changed,
    experiment,
    load_data,
    refusal,
    write,
)

SHIPPED = [
    (folder, name) for folder in ("motions", "experiments") for name in shipped_names(folder)
]


# -- files --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("folder", "name"), SHIPPED)
def test_the_shipped_files_load_and_are_called_like_their_files(folder: str, name: str) -> None:
    loaded = load_experiment(name, ROBOT)
    assert loaded.name == name
    assert loaded.description
    assert Path(loaded.source).name == f"{name}.yaml"
    assert Path(loaded.source).parent.name == folder
    if folder == "motions":
        assert loaded.max_length < 20.0
        assert loaded.observer is None
        assert not loaded.reactions
        assert not loaded.contacts


def test_there_are_files_to_learn_from() -> None:
    assert {"reach", "stretch", "wave"} <= set(shipped_names("motions"))
    assert {"demo", "identify", "reach_and_push"} <= set(shipped_names("experiments"))


def test_no_two_shipped_files_have_one_name() -> None:
    names = [name for _, name in SHIPPED]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(("name", "close"), [("wav", "wave"), ("dmo", "demo")])
def test_an_unknown_name_lists_those_there_are(name: str, close: str) -> None:
    with pytest.raises(
        UnknownNameError, match=f"unknown experiment '{name}' .did you mean {close}"
    ):
        load_experiment(name, ROBOT)


@pytest.mark.parametrize("old", [{"version": 1}, {"schema": 1}, {"version": 1, "schema": 2}])
def test_an_old_form_is_reported_in_one_line(tmp_path: Path, old: dict[str, int]) -> None:
    data = {**experiment(STAND), **old}
    key = next(iter(old))
    # Whatever else is old in it is not the first thing to say.
    for more in ({}, {"motion": {}, "pushes": [], "steps": 3}):
        said = refusal(tmp_path, {**data, **more})
        assert said.startswith(" line ")
        assert f"key '{key}': a file of an old form, '{key}: 1'" in said
        assert "'schema: 2'" in said


def test_a_form_to_come_is_not_taken_for_an_old_one(tmp_path: Path) -> None:
    assert "key 'schema': must be 2, got 3" in refusal(tmp_path, experiment(STAND) | {"schema": 3})
    assert "key 'schema' is missing" in refusal(
        tmp_path, changed(experiment(STAND), "schema", KeyError)
    )
    assert "unknown key 'version'" in refusal(tmp_path, experiment(STAND, version=2))


@pytest.mark.parametrize("key", ["source", "parts", "foo"])
def test_a_key_that_no_file_has_is_unknown(tmp_path: Path, key: str) -> None:
    said = refusal(tmp_path, experiment(STAND, **{key: "x"}))
    assert said.startswith(" line 3: unknown key ")
    assert "source" not in said.split("possible: ")[1]


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"gone\.yaml: cannot be read"):
        load_experiment(tmp_path / "gone.yaml", ROBOT)


def test_a_file_that_holds_itself_is_refused(tmp_path: Path) -> None:
    text = "schema: 2\nname: x\nsteps: &a [{repeat: {times: 2, steps: *a}}]\n"
    assert "a list or mapping holds itself" in refusal(tmp_path, text)


def test_a_deep_file_is_refused_or_loaded(tmp_path: Path) -> None:
    for depth, fits in ((5, True), (30, True), (60, False), (400, False)):
        inner = "{say: deep, hold: 1}"
        for _ in range(depth):
            inner = f"{{repeat: {{times: 1, steps: [{inner}]}}}}"
        text = f"schema: 2\nname: x\nsteps: [{inner}]\n"
        if fits:
            assert load_data(tmp_path, text).max_length == 1.0
        else:
            assert " line 3: nested deeper than 100 levels" in refusal(tmp_path, text)


# -- observers ----------------------------------------------------------------------------------------------------


def test_steps_alone_have_no_observer(tmp_path: Path) -> None:
    assert load_data(tmp_path, experiment(STAND)).observer is None
    named = load_data(tmp_path, experiment(STAND, observer={"mode": "paper"}))
    assert named.observer == ObserverChoice(mode="paper")
    assert load_data(tmp_path, experiment(STAND, observer={})).observer == ObserverChoice()


@pytest.mark.parametrize(
    "data",
    [
        experiment(LISTEN),
        experiment(STAND, reactions=[{"say": "Ouch"}]),
        experiment(STAND, reactions=[{"do": "hold"}]),
        experiment(STAND, contacts=[PUSH]),
        experiment(BRANCH),
        experiment({"repeat": {"times": 2, "until": {}, "steps": [STAND]}}),
        experiment({"repeat": {"times": 2, "steps": [LISTEN]}}),
    ],
)
def test_what_has_to_do_with_touch_gets_an_observer(tmp_path: Path, data: dict[str, Any]) -> None:
    observer = load_data(tmp_path, data).observer
    assert observer == ObserverChoice(mode="fusion", models=None)


def test_without_an_observer_nothing_is_detected(tmp_path: Path) -> None:
    until = {"repeat": {"times": 2, "until": {}, "steps": [STAND]}}
    for step, where in (
        (LISTEN, "steps.0.wait"),
        (BRANCH, "steps.0.branch.cases.0.on"),
        (until, "steps.0.repeat.until"),
    ):
        said = refusal(tmp_path, experiment(step, observer=None))
        assert f"key '{where}': no touch can be detected: the experiment has no observer" in said
    reaction = experiment(STAND, observer=None, reactions=[{"do": "hold"}])
    assert "key 'reactions.0.on': no touch can be detected" in refusal(tmp_path, reaction)
    load_data(tmp_path, experiment(STAND, observer=None))


@pytest.mark.parametrize(
    ("on", "where", "reason"),
    [
        ({"limb": "lef_arm"}, ".limb", "unknown limb 'lef_arm' (did you mean left_arm"),
        ({"link": ["LBicep", "LBice"]}, ".link", "did you mean LBicep"),
        ({"joint": "LShoulder"}, ".joint", "unknown joint 'LShoulder'"),
        ({"limb": "head", "link": "LBicep"}, "", "no contact is on limb head and link LBicep"),
    ],
)
def test_names_in_triggers_are_those_of_the_robot(
    tmp_path: Path, on: dict[str, Any], where: str, reason: str
) -> None:
    for data, key in (
        (experiment({"wait": {"timeout": 1.0, **on}}), "steps.0.wait"),
        (experiment(STAND, reactions=[{"on": on, "say": "Ouch"}]), "reactions.0.on"),
        (
            experiment({"repeat": {"times": 2, "steps": [STAND], "until": on}}),
            "steps.0.repeat.until",
        ),
        (changed(experiment(BRANCH), "steps.0.branch.cases.1.on", on), "steps.0.branch.cases.1.on"),
    ):
        said = refusal(tmp_path, data)
        assert f"key '{key}{where}'" in said
        assert reason in said


# -- reactions ----------------------------------------------------------------------------------------------------


def test_a_reaction_has_words_motions_and_a_reflex(tmp_path: Path) -> None:
    write(tmp_path, "back.yaml", STAND)
    on = {"limb": "left_arm", "min_torque": 2.0}
    entry = {"on": on, "do": "retract", "distance": 0.3, "priority": 50}
    words = {"say": "Ouch", "leds": {"colour": [1, 0, 0]}, "cue": "touched"}
    loaded = load_data(
        tmp_path,
        experiment(
            TURN,
            reactions=[
                {**entry, **words},
                {
                    "on": {"lasting": 1.0, "touches": 2, "within": 5.0},
                    "play": "back.yaml",
                    "at_most": 3,
                },
                {"do": "hold"},
            ],
        ),
    )
    first, second, third = loaded.reactions
    assert first.on == TouchTrigger(limb=("left_arm",), min_torque=2.0)
    assert (first.say, first.cue, first.has_cues) == ("Ouch", "touched", True)
    assert first.reflex == {"do": "retract", "distance": 0.3, "priority": 50}
    assert first.reflex_entry == {
        "on": {"limb": ("left_arm",), "min_torque": 2.0},
        "do": "retract",
        "distance": 0.3,
        "priority": 50,
    }
    assert (first.at_most, first.play, first.steps) == (None, None, ())
    assert (second.play, second.at_most, second.reflex_entry) == ("back.yaml", 3, {})
    assert [step.name for step in second.steps] == ["stand"]
    assert not second.has_cues
    assert third.on == TouchTrigger()
    assert third.reflex_entry == {"do": "hold", "on": {}}


@pytest.mark.parametrize(
    ("reaction", "where", "reason"),
    [
        (3, "", "a reaction is a mapping of keys to values"),
        ({}, "", "a reaction gives 'do', 'say', 'leds', 'cue' or 'play'"),
        ({"on": {"limb": "head"}}, "", "a reaction gives 'do', 'say'"),
        ({"do": "hold", "on": {"lasting": 0.5}}, "", "a reflex answers at once"),
        ({"do": "hold", "on": {"touches": 2, "within": 1.0}}, "", "a reflex answers at once"),
        ({"on": {"kind": "rebound"}, "say": "Ouch"}, ".on", "a rebound is no touch"),
        ({"on": 3, "say": "Ouch"}, ".on", "must be a mapping of keys to values, got 3"),
        ({"on": {"limbs": "head"}, "say": "Ouch"}, ".on.limbs", "did you mean limb"),
        ({"say": "Ouch", "at_most": 0}, ".at_most", "must be 1 or more"),
        ({"sya": "Ouch"}, ".sya", "did you mean say"),
        ({"say": "Ouch", "distance": 0.3}, ".distance", "possible: at_most, cue, do, leds, on, play, say"),
        ({"reflex": {"do": "hold"}}, ".reflex", "unknown key"),
        ({"say": "Ouch", "steps": [STAND]}, ".steps", "unknown key"),
        ({"say": ""}, ".say", "must not be empty"),
        ({"leds": {"colour": "red"}}, ".leds.colour", 'must be a list, got "red"'),
        ({"play": "wav"}, ".play", "did you mean wave"),
    ],
)  # fmt: skip
def test_a_wrong_reaction(tmp_path: Path, reaction: object, where: str, reason: str) -> None:
    said = refusal(tmp_path, experiment(STAND, reactions=[reaction]))
    assert f"key 'reactions.0{where}'" in said
    assert reason in said


# -- what comes at the top ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("name", KeyError, "key 'name' is missing"),
        ("name", "", "key 'name': must not be empty"),
        ("seed", -1, "key 'seed': must be 0 or more"),
        ("stiffness", 0.0, "key 'stiffness': must be above 0"),
        ("stiffness", 1e9, "key 'stiffness': must be 3000 or less"),
        ("max_duration", 0, "key 'max_duration': must be above 0"),
        ("max_load", 1.1, "key 'max_load': must be 1 or less"),
        ("max_tipping", 0.0, "key 'max_tipping': must be above 0"),
        ("attentive", "yes", "key 'attentive': must be true or false"),
        ("observer", {"mod": "paper"}, "unknown key 'observer.mod' (did you mean mode or models"),
        ("observer", "paper", "key 'observer': must be a mapping of keys to values"),
        ("plant", 3, "key 'plant': must be a text, got 3"),
        ("reactions", {"say": "Ouch"}, "key 'reactions': must be a list, got a mapping"),
        ("reactions", [{"say": "Ouch"}] * 101, "key 'reactions': takes at most 100, has 101"),
        ("steps", KeyError, "key 'steps' is missing"),
        ("steps", None, "key 'steps': must be a list, got null"),
        ("step", [STAND], "unknown key 'step' (did you mean steps"),
    ],
)
def test_a_wrong_value_at_the_top(tmp_path: Path, key: str, value: object, reason: str) -> None:
    assert reason in refusal(tmp_path, changed(experiment(STAND), key, value))


def test_what_is_not_said_has_its_usual_value(tmp_path: Path) -> None:
    loaded = load_data(tmp_path, experiment(STAND))
    assert (loaded.seed, loaded.plant, loaded.world, loaded.stiffness) == (0, None, None, None)
    assert (loaded.max_duration, loaded.max_load, loaded.max_tipping) == (3600.0, 0.85, 0.8)
    assert (loaded.reactions, loaded.contacts, loaded.attentive) == ((), (), None)
