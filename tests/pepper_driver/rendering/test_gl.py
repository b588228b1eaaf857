"""OpenGL without a display, and the message where there is none."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

from pepper_driver.config import ConfigError
from pepper_driver.rendering import gl as module
from pepper_driver.rendering.gl import RenderError, check_gl, make_context

linux = pytest.mark.skipif(sys.platform != "linux", reason="others draw by their own libraries")


@pytest.fixture(autouse=True)
def no_variable(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    module._off_screen.cache_clear()
    yield
    module._off_screen.cache_clear()


def drawing(*names: str) -> Any:
    """In place of ``subprocess.run``: these libraries draw."""

    def run(command: list[str], **_: Any) -> subprocess.CompletedProcess[bytes]:
        draws = any(f"mujoco.{name}" in command[-1] for name in names)
        return subprocess.CompletedProcess(command, 0 if draws else 1)

    return run


def test_software_draws_where_no_graphics_processor_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "run", drawing("osmesa"))
    assert module._off_screen() == "osmesa"


def test_a_graphics_processor_goes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "run", drawing("osmesa", "egl"))
    assert module._off_screen() == "egl"


@linux
def test_where_nothing_draws_the_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "run", drawing())
    with pytest.raises(RenderError) as error:
        make_context(8, 8)
    text = str(error.value)
    for name in ("tried egl, osmesa", "libegl1", "libgl1-mesa-dri", "libosmesa6"):
        assert name in text
    assert "\n" not in text


def test_a_library_that_never_answers_does_not_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(command: list[str], **_: Any) -> None:
        raise subprocess.TimeoutExpired(command, 60.0)

    monkeypatch.setattr(subprocess, "run", hang)
    with pytest.raises(RenderError, match="nothing draws"):
        module._off_screen()


@pytest.mark.parametrize("value", ["off", "sometimes"])
def test_a_variable_that_names_nothing_is_refused(
    value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", value)
    with pytest.raises(ConfigError, match=f"MUJOCO_GL: '{value}' does not draw; use egl or osmesa"):
        check_gl()


def test_a_library_that_cannot_be_loaded_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """PyOpenGL raises what it likes when MuJoCo is imported."""

    def load(name: str) -> Any:
        raise AttributeError("'NoneType' object has no attribute 'glGetError'")

    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr(module, "import_module", load)
    with pytest.raises(RenderError, match=r"nothing draws .* \(MUJOCO_GL is osmesa\)"):
        check_gl()
