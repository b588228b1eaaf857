"""Backends by URI, and those of other packages."""

from contextlib import suppress
from importlib.metadata import EntryPoint, EntryPoints

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends import make_backend, with_query
from pepper_driver.backends.mujoco_ import MujocoBackend
from pepper_driver.backends.selection import BackendUri, parse_uri
from pepper_driver.config import PepperError, RobotConfig, load_plant
from pepper_driver.config import plugins as plugins_module
from pepper_driver.config.plugins import PluginError


@pytest.mark.parametrize("uri", ["mujoco", "mujoco://", "mujoco?seed=3", "mujoco://?plant=nominal"])
def test_the_simulated_robot_has_several_spellings(uri: str) -> None:
    backend = make_backend(uri)
    assert isinstance(backend, MujocoBackend)
    assert backend.uri == uri


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("mujocco", "did you mean mujoco"),
        ("", "empty"),
        ("naoqo://pepper.local", "unknown backend"),
        ("mujoco://?plant=norminal", "did you mean nominal"),
        ("mujoco://?palnt=nominal", "did you mean plant"),
        ("mujoco://?seed=-1", "whole number"),
        ("mujoco://?seed=1&seed=2", "twice"),
        ("mujoco://?posture=Stnad", "Stand"),
        ("mujoco://?plant=nowhere.yaml", "nowhere.yaml"),
        ("mujoco://worn?seed=3", "'worn' says nothing here"),
        ("mujoco:///worn", "path"),
        ("mujoco://?seed=3#x", "fragment"),
        ("mujoco://?window=2", "window"),
    ],
)
def test_a_wrong_uri_is_one_line(uri: str, message: str) -> None:
    with pytest.raises(PepperError) as caught:
        make_backend(uri)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@given(st.text())
def test_any_text_is_a_uri_or_one_error(text: str) -> None:
    with suppress(PepperError):
        assert isinstance(parse_uri(text), BackendUri)


@pytest.mark.parametrize(
    ("uri", "expected"),
    [
        ("mujoco", "mujoco://?seed=5"),
        ("mujoco?seed=3&plant=worn", "mujoco://?seed=5&plant=worn"),
        ("mine://host/a%20b?x=1", "mine://host/a%20b?x=1&seed=5"),
    ],
)
def test_a_value_takes_its_place_in_a_uri(uri: str, expected: str) -> None:
    assert with_query(uri, seed=5) == expected


def test_a_key_is_taken_away() -> None:
    assert with_query("mujoco?plant=worn&draw=3", draw=None, day=None) == "mujoco://?plant=worn"


def third_party(uri: BackendUri, robot: RobotConfig) -> MujocoBackend:
    return MujocoBackend(robot, load_plant("nominal", robot), uri=uri.text)


def not_a_backend(uri: BackendUri, robot: RobotConfig) -> str:
    return "hello"


def in_need_of_more(uri: BackendUri) -> MujocoBackend:
    raise NotImplementedError


def out_of_luck(uri: BackendUri, robot: RobotConfig) -> MujocoBackend:
    raise ZeroDivisionError("no\nluck")


def test_another_package_registers_a_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    group = "pepper_driver.backends"
    points = EntryPoints(
        [
            EntryPoint(name="theirs", value=f"{__name__}:third_party", group=group),
            EntryPoint(name="broken", value="no_such_module:x", group=group),
            EntryPoint(name="odd", value=f"{__name__}:not_a_backend", group=group),
            EntryPoint(name="short", value=f"{__name__}:in_need_of_more", group=group),
            EntryPoint(name="luckless", value=f"{__name__}:out_of_luck", group=group),
            EntryPoint(name="text", value=f"{__name__}:__name__", group=group),
        ]
    )
    monkeypatch.setattr(plugins_module, "entry_points", lambda group: points.select(group=group))
    assert make_backend("theirs://here").uri == "theirs://here"
    with pytest.raises(PluginError, match="no_such_module"):
        make_backend("broken")
    with pytest.raises(PepperError, match="no Backend"):
        make_backend("odd")
    with pytest.raises(PluginError, match=r"backend 'short' fails .*TypeError.*takes 1 positional"):
        make_backend("short")
    with pytest.raises(
        PluginError, match=r"test_selection\.py line \d+\): ZeroDivisionError: no luck$"
    ):
        make_backend("luckless")
    with pytest.raises(PluginError, match="is str, no class or factory"):
        make_backend("text")
    with pytest.raises(PepperError, match="theirs"):
        make_backend("thiers")
