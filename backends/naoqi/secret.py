"""Passwords: from the environment, a keyring or a prompt, and out again only to the robot."""

from __future__ import annotations

import getpass
import importlib
import os
import sys
from dataclasses import dataclass

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi.address import Address
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
    """The password for a robot with TLS: that of the environment, else of the keyring, else asked for on a terminal.

    None for a robot that asks for none.

    Raises:
        SecretError: There is none, and nobody to ask.
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
    except Exception:  # of many kinds, by keyring and desktop; whoever has none is asked
        return None
    return found if isinstance(found, str) else None


def _asked(account: str) -> str | None:
    if not sys.stdin or not sys.stdin.isatty():
        return None
    try:
        return getpass.getpass(f"Password of {account}: ")
    except EOFError:
        return None
