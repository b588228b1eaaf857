"""Addresses of robots, by URI, and sources of their passwords, which a URI never is."""

import getpass
import io
import os
import sys
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends.naoqi import qi_library
from pepper_driver.backends.naoqi.address import (
    Address,
    Secret,
    SecretError,
    find_secret,
    naoqi_address,
)
from pepper_driver.backends.selection import parse_uri
from pepper_driver.config import ConfigError, MissingExtraError, PepperError


def address(uri: str) -> Address:
    return naoqi_address(parse_uri(uri), {"mode"})


@pytest.mark.parametrize(
    ("uri", "url", "user"),
    [
        ("naoqi://pepper.local", "tcp://pepper.local:9559", None),
        ("naoqi://192.168.1.7:10000", "tcp://192.168.1.7:10000", None),
        ("naoqi://[fe80::1]:9559", "tcp://[fe80::1]:9559", None),
        ("naoqis://pepper.local", "tcps://pepper.local:9503", "nao"),
        ("naoqis://me@pepper.local:9504?mode=angles", "tcps://pepper.local:9504", "me"),
    ],
)
def test_addresses(uri: str, url: str, user: str | None) -> None:
    found = address(uri)
    assert (found.url, found.user, found.uri) == (url, user, uri)
    assert found.options == ({"mode": "angles"} if "mode" in uri else {})


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("naoqi", "names no robot"),
        ("naoqi://", "names no robot"),
        ("naoqi://:9559", "names no robot"),
        ("naoqi://pepper.local:port", "1 to 65535, got 'port'"),
        ("naoqi://pepper.local:99999", "1 to 65535, got '99999'"),
        ("naoqi://pepper.local:0", "port 0"),
        ("naoqi://pepper.local/x", "path"),
        ("naoqi://pepper.local?moed=angles", "did you mean mode"),
        ("naoqi://nao@pepper.local", "naoqis://nao@pepper.local"),
    ],
)
def test_a_wrong_address_is_one_line(uri: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        address(uri)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@given(
    password=st.text(st.characters(codec="ascii", categories=("L", "N", "P", "S"))).map(
        "7!{}".format
    ),
    form=st.sampled_from(
        [
            "naoqis://nao:{}@pepper.local",
            "NAOQIS://nao:{}@pepper.local:9503?mode=angles",
            "naoqi://nao:{}@pepper.local",
            "naoqis://pepper.local?password={}",
            "naoqis://pepper.local?mode=angles&api_token={}",
        ]
    ),
)
def test_a_password_in_the_uri_is_refused_and_not_repeated(password: str, form: str) -> None:
    with pytest.raises(ConfigError, match="PEPPER_PASSWORD") as caught:
        address(form.format(password))
    assert password not in str(caught.value)


@given(st.text())
def test_any_text_is_an_address_or_one_error(text: str) -> None:
    for scheme in ("naoqi", "naoqis"):
        with suppress(PepperError):
            assert address(f"{scheme}://{text}").host


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """No password in the environment, no keyring, no terminal."""
    monkeypatch.delenv("PEPPER_PASSWORD", raising=False)
    monkeypatch.setitem(sys.modules, "keyring", None)
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    return monkeypatch


SECURE = address("naoqis://nao@pepper.local")


def keyring(found: object) -> SimpleNamespace:
    def get_password(service: str, account: str) -> object:
        if isinstance(found, Exception):
            raise found
        return found if (service, account) == ("pepper-driver", "nao@pepper.local") else None

    return SimpleNamespace(get_password=get_password)


def test_the_password_comes_from_the_environment_first(alone: pytest.MonkeyPatch) -> None:
    alone.setitem(sys.modules, "keyring", keyring("of the keyring"))
    alone.setenv("PEPPER_PASSWORD", "of the environment")
    assert find_secret(SECURE) == Secret("of the environment")
    alone.setenv("PEPPER_PASSWORD", "")
    assert find_secret(SECURE) == Secret("of the keyring")


@pytest.mark.parametrize("found", [None, RuntimeError("locked"), b"odd"])
def test_a_keyring_that_is_no_help_is_passed_over(alone: pytest.MonkeyPatch, found: object) -> None:
    alone.setitem(sys.modules, "keyring", keyring(found))
    terminal = io.StringIO()
    alone.setattr(terminal, "isatty", lambda: True)
    alone.setattr(sys, "stdin", terminal)
    alone.setattr(getpass, "getpass", lambda prompt: f"typed at {prompt}")
    assert find_secret(SECURE) == Secret("typed at Password of nao@pepper.local: ")


def test_no_server_to_ask(alone: pytest.MonkeyPatch) -> None:
    with pytest.raises(SecretError, match="keyring set pepper-driver nao@pepper"):
        find_secret(SECURE)


def test_nothing_typed(alone: pytest.MonkeyPatch) -> None:
    def ends(prompt: str) -> str:
        raise EOFError

    terminal = io.StringIO()
    alone.setattr(terminal, "isatty", lambda: True)
    alone.setattr(sys, "stdin", terminal)
    for typed in (ends, lambda prompt: ""):
        alone.setattr(getpass, "getpass", typed)
        with pytest.raises(SecretError):
            find_secret(SECURE)


def test_without_tls_no_password_is_asked_for(alone: pytest.MonkeyPatch) -> None:
    assert find_secret(address("naoqi://pepper.local")) is None


def test_a_secret_does_not_show() -> None:
    secret = Secret("xyzzy")
    assert "xyzzy" not in f"{secret} {secret!r} {[secret]}"


def computer(system: str, machine: str, version: tuple[int, int]) -> dict[str, Any]:
    """A computer as the loader sees it: without the library, and the controller has loaded pinocchio."""

    def import_module(name: str) -> object:
        raise ImportError(name)

    return {
        "importlib": SimpleNamespace(import_module=import_module),
        "find_spec": lambda name: None,
        "sys": SimpleNamespace(version_info=version, modules={"pinocchio": SimpleNamespace()}),
        "platform": SimpleNamespace(
            system=lambda: system,
            machine=lambda: machine,
            python_version=lambda: ".".join(map(str, version)),
        ),
    }


def test_a_computer_without_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, seen in computer("Linux", "x86_64", (3, 12)).items():
        monkeypatch.setattr(qi_library, name, seen)
    with pytest.raises(MissingExtraError, match=r'pip install "pepper-driver\[naoqi\]"'):
        qi_library.load_qi()


@pytest.mark.parametrize(
    ("system", "machine", "version"),
    [
        ("Darwin", "arm64", (3, 12)),
        ("Linux", "aarch64", (3, 12)),
        ("Linux", "x86_64", (3, 13)),
        ("Windows", "AMD64", (3, 12)),
    ],
)
def test_a_computer_that_cannot_have_the_library(
    monkeypatch: pytest.MonkeyPatch, system: str, machine: str, version: tuple[int, int]
) -> None:
    for name, seen in computer(system, machine, version).items():
        monkeypatch.setattr(qi_library, name, seen)
    with pytest.raises(
        qi_library.NoQiError, match=r"Linux on x86-64 with Python 3\.11 or"
    ) as caught:
        qi_library.load_qi()
    assert f"{system} on {machine} with Python 3.{version[1]}" in str(caught.value)
    assert "pip install" not in str(caught.value), "it would install nothing"
    assert caught.value.extra == "naoqi"


def test_pinocchio_first(monkeypatch: pytest.MonkeyPatch) -> None:
    modules: dict[str, Any] = {"pinocchio": SimpleNamespace()}
    monkeypatch.setattr(qi_library, "sys", SimpleNamespace(modules=modules))
    monkeypatch.setattr(qi_library, "find_spec", lambda name: SimpleNamespace(name=name))
    with pytest.raises(qi_library.ImportOrderError, match="before pinocchio"):
        qi_library.load_qi()
    monkeypatch.setitem(modules, "qi", SimpleNamespace())
    monkeypatch.setattr(qi_library, "importlib", SimpleNamespace(import_module=modules.get))
    assert qi_library.load_qi() is modules["qi"]


def test_the_library_is_configured_before_it_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    found: dict[str, str] = {}
    monkeypatch.delenv("QI_LOG_LEVEL", raising=False)
    monkeypatch.setenv("QI_TCP_PING_TIMEOUT", "20")

    def start(name: str) -> object:
        found.update(os.environ)
        return SimpleNamespace(name=name)

    monkeypatch.setattr(qi_library, "importlib", SimpleNamespace(import_module=start))
    qi_library.load_qi()
    assert (found["QI_LOG_LEVEL"], found["QI_TCP_PING_TIMEOUT"]) == ("0", "20")
