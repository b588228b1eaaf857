"""Files play the steps of other files, which end, and lie where they are looked for."""

from pathlib import Path
from typing import Any

import pytest

from pepper_driver.config import (
    ConfigError,
    load_experiment,
)
from pepper_driver.config.experiment import ObserverChoice
from pepper_driver.config.loading import read_yaml
from pepper_driver.config.steps import PlayStep, Step
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
from support.yaml_values import dump


def test_a_file_plays_the_steps_of_others_in_its_folder(tmp_path: Path) -> None:
    """Names of files count from the one that names them, wherever the first one lies."""
    write(
        tmp_path / "parts", "twice.yaml", {"repeat": {"times": 2, "steps": [{"play": "turn.yaml"}]}}
    )
    write(tmp_path / "parts", "turn.yaml", TURN)
    loaded = load_data(
        tmp_path, experiment({"play": "parts/twice.yaml"}, {"play": "wave"}, {"play": "wave"})
    )
    wave = load_experiment("wave", ROBOT)
    turns = "steps.0.play.0.repeat.steps.0.play.0"
    steps = dict(loaded.walk())
    turn = steps[turns]
    assert isinstance(turn, Step)
    assert turn.joints == {"HeadYaw": 0.2}
    assert [key for key in steps if key.startswith("steps.1")] == [
        "steps.1",
        *(f"steps.1.play.{number}" for number in range(len(wave.steps))),
    ]
    assert isinstance(steps["steps.2"], PlayStep)
    assert steps["steps.2"].steps == wave.steps
    assert loaded.max_length == pytest.approx(2 * 0.75 + 2 * wave.max_length)
    assert loaded.is_open  # the wave ends where it is reached
    assert loaded.observer is None


def test_a_played_file_gets_the_observer_of_what_plays_it(tmp_path: Path) -> None:
    write(tmp_path, "listen.yaml", LISTEN)
    play = {"play": "listen.yaml"}
    assert load_data(tmp_path, experiment(play)).observer == ObserverChoice()
    said = refusal(tmp_path, experiment(STAND, play, observer=None))
    assert said.startswith(" line 8: key 'steps.1.play.0.wait': no touch can be detected")


@pytest.mark.parametrize(
    ("files", "where"),
    [
        ({"mine": ["mine"]}, "steps.0.play"),
        ({"mine": ["a"], "a": ["mine"]}, "steps.0.play"),
        ({"mine": ["a"], "a": ["b"], "b": ["a"]}, "steps.0.play"),
    ],
)
def test_no_file_is_played_in_itself(
    tmp_path: Path, files: dict[str, list[str]], where: str
) -> None:
    for name, played in files.items():
        write(tmp_path, f"{name}.yaml", *({"play": f"{other}.yaml"} for other in played))
    with pytest.raises(ConfigError) as caught:
        load_experiment(tmp_path / "mine.yaml", ROBOT)
    said = str(caught.value)
    last = list(files)[-1]
    assert said.startswith(f"{tmp_path / last}.yaml line 4: key '{where}': ")
    assert said.endswith(f"'{files[last][0]}.yaml' would be played in itself without end")


@pytest.mark.parametrize("name", ["mine.yaml", "./mine.yaml", "../{folder}/mine.yaml"])
def test_another_name_of_a_file_is_the_same_file(tmp_path: Path, name: str) -> None:
    play = {"play": name.format(folder=tmp_path.name)}
    for data in (
        experiment(STAND, play),
        experiment({"repeat": {"times": 2, "steps": [play]}}),
        changed(experiment(BRANCH), "steps.0.branch.otherwise", [play]),
        experiment(STAND, reactions=[play]),
    ):
        assert "would be played in itself without end" in refusal(tmp_path, data)


def test_a_file_that_is_played_twice_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each plays the next one twice; else the last would be read 4096 times."""
    read: list[str] = []

    def counted(path: Path) -> dict[str, Any]:
        read.append(path.name)
        return read_yaml(path)

    monkeypatch.setattr("pepper_driver.config.experiment.read_yaml", counted)
    for number in range(12):
        write(tmp_path, f"{number}.yaml", *[{"play": f"{number + 1}.yaml"}] * 2)
    write(tmp_path, "12.yaml", {"hold": 0.01})
    assert load_experiment(tmp_path / "0.yaml", ROBOT).max_length == pytest.approx(0.01 * 2**12)
    assert read == [f"{number}.yaml" for number in range(13)]


@pytest.mark.parametrize(
    "more",
    [{"contacts": [PUSH]}, {"reactions": [{"say": "Ouch"}]}, {"reactions": [{"do": "hold"}]}],
)
def test_steps_alone_are_played(tmp_path: Path, more: dict[str, Any]) -> None:
    write(tmp_path, "other.yaml", STAND, **more)
    for data, key in (
        (experiment(TURN, {"play": "other.yaml"}), "steps.1.play"),
        (experiment(TURN, reactions=[{"play": "other.yaml"}]), "reactions.0.play"),
    ):
        said = refusal(tmp_path, data)
        assert (
            f"key '{key}': 'other.yaml' has reactions or contacts; steps alone are played" in said
        )


def test_what_is_wrong_with_a_played_file_is_said_of_that_file(tmp_path: Path) -> None:
    write(tmp_path, "other.yaml", TURN, {"posture": "Stnd", "hold": 1.0})
    (tmp_path / "mine.yaml").write_text(dump(experiment({"play": "other.yaml"})))
    with pytest.raises(ConfigError) as caught:
        load_experiment(tmp_path / "mine.yaml", ROBOT)
    assert str(caught.value).startswith(f"{tmp_path / 'other.yaml'} line 8: key 'steps.1.posture'")


def test_the_steps_of_another_file_stand_in_that_file(tmp_path: Path) -> None:
    said = refusal(tmp_path, experiment({"play": "wave", "steps": [STAND]}))
    assert "unknown key 'steps.0.steps' (possible: name, play)" in said


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("wav", "unknown experiment 'wav' (did you mean wave"),
        ("gone.yaml", "there is no file "),
        ("folder.yaml", "there is no file "),
        (3, "must be a text, got 3"),
        ("", "must not be empty"),
        ("x" * 81, "at most 80 letters"),
    ],
)
def test_a_file_to_play_must_be_there(tmp_path: Path, name: object, reason: str) -> None:
    (tmp_path / "folder.yaml").mkdir()
    said = refusal(tmp_path, experiment(STAND, {"play": name}))
    assert "key 'steps.1.play': " in said
    assert reason in said
