"""Address of a robot, and the password for it."""

from __future__ import annotations

import getpass
import importlib
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.selection import BackendUri
from pepper_driver.config import ConfigError
from pepper_driver.config.passwords import PASSWORD_VARIABLE

KEYRING = "pepper-driver"
"""Name of the service under which a keyring holds passwords, by ``user@host``."""


class SecretError(BackendError):
    """There is no password for a robot that asks for one."""


@dataclass(frozen=True, slots=True, repr=False)
class Secret:
    """A password that no log shows by accident."""

    value: str

    def __repr__(self) -> str:
        return "Secret(...)"


def find_secret(address: Address) -> Secret | None:
    """Return the password for a robot with TLS: of the environment, else the keyring, else from a terminal.

    None for a robot that asks for none.

    Raises:
        SecretError: No password is stored, and no terminal is there to ask for it.
    """
    if not address.secure:
        return None
    account = f"{address.user}@{address.host}"
    text = os.environ.get(PASSWORD_VARIABLE) or _from_keyring(account) or _asked(account)
    if not text:
        raise SecretError(
            f"'{address.uri}' asks for the password of {account}: set the environment variable {PASSWORD_VARIABLE}, "
            f"store it once by 'keyring set {KEYRING} {account}', or start in a terminal to be asked"
        )
    return Secret(text)


def _from_keyring(account: str) -> str | None:
    """None without the package keyring, and where it finds no keyring, or nothing in it."""
    try:
        keyring = importlib.import_module("keyring")
        found = keyring.get_password(KEYRING, account)
    except (
        Exception
    ):  # backends of keyring raise errors of many kinds; without one the terminal is asked
        return None
    return found if isinstance(found, str) else None


def _asked(account: str) -> str | None:
    if not sys.stdin or not sys.stdin.isatty():
        return None
    try:
        return getpass.getpass(f"Password of {account}: ")
    except EOFError:
        return None


PORTS = {"naoqi": 9559, "naoqis": 9503}
"""By scheme: where NAOqi listens by default. NAOqi 2.5 in clear, 2.9 over TLS with user and password."""

MAX_HOST_LENGTH = 253
"""[letters] Of a name, as DNS has it."""

USER = "nao"
"""Default user of a URI: the one user every Pepper has."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Address:
    """Address of a NAOqi.

    Attributes:
        uri: As the user wrote it; holds no secret.
        host: Name or IP address.
        port: TCP port.
        secure: Whether it speaks TLS and asks for user and password.
        user: Who logs in; None without TLS.
        options: The keys of the URI.
    """

    uri: str
    host: str
    port: int
    secure: bool
    user: str | None
    options: Mapping[str, str] = field(default_factory=dict)

    @property
    def url(self) -> str:
        """As ``qi`` expects it, such as ``tcp://pepper.local:9559``."""
        # An IPv6 address without brackets would look like host and port.
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'tcps' if self.secure else 'tcp'}://{host}:{self.port}"


def naoqi_address(uri: BackendUri, options: set[str]) -> Address:
    """Return the address that a URI means.

    Args:
        uri: With the scheme ``naoqi`` or ``naoqis``.
        options: Keys it may have.

    Raises:
        ConfigError: It names no host, an invalid port, or an unknown key.
    """
    example = "naoqis://nao@pepper.local" if uri.scheme == "naoqis" else "naoqi://pepper.local"
    user, at, place = uri.host.rpartition("@")
    secure = uri.scheme == "naoqis"
    if at and not secure:
        raise ConfigError(
            f"backend '{uri.text}': without TLS there is no login; write naoqi://{place}, or naoqis://{uri.host}"
        )
    uri.check_keys(options, host=True)
    try:
        parts = urlsplit(f"//{place}")
        # .port raises ValueError for letters and beyond 65535.
        host, port = parts.hostname, parts.port
    except ValueError as error:
        port_text = place.rpartition(":")[2]
        raise ConfigError(
            f"backend '{uri.text}': a port is a whole number from 1 to 65535, got '{port_text}';"
            f" NAOqi listens at {PORTS[uri.scheme]}"
        ) from error
    if port == 0:
        raise ConfigError(
            f"backend '{uri.text}': port 0 is invalid; NAOqi listens at {PORTS[uri.scheme]}"
        )
    if not host:
        raise ConfigError(f"backend '{uri.text}': names no robot; for example: {example}")
    if len(host) > MAX_HOST_LENGTH or any(letter.isspace() for letter in host):
        raise ConfigError(
            f"backend '{uri.text}': no host can have this name; for example: {example}"
        )
    return Address(
        uri=uri.text,
        host=host,
        port=PORTS[uri.scheme] if port is None else port,
        secure=secure,
        user=(user or USER) if secure else None,
        options=uri.query,
    )
