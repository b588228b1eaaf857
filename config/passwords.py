"""No password in a URI: other users of the computer see it there, and logs and shells keep it."""

from __future__ import annotations

import re

from pepper_driver.config import ConfigError

PASSWORD_VARIABLE = "PEPPER_PASSWORD"
"""The environment variable for the password of a robot that asks for one."""

# Read from the raw text: a password may hold what a URI gives a meaning, such as / ? # and @.
_LOGIN = re.compile(r"\s*(naoqis?)://.*:.*@", re.DOTALL | re.IGNORECASE)
_KEY = re.compile(r"\s*(naoqis?)\b.*[?&][^=&]*(?:pass|pwd|secret|token)", re.DOTALL | re.IGNORECASE)

_USER = re.compile(r"//[^?#]*@")
_SECRET = re.compile(r"(?i)([?&][^=&]*(?:pass|pwd|secret|token|auth|key)[^=&]*=)[^&#]*")


def check_no_password(uri: str) -> None:
    """Refuse a robot's URI that holds a password, and say where to put it. The message does not repeat it.

    Raises:
        ConfigError: It does.
    """
    found = _LOGIN.match(uri) or _KEY.match(uri)
    if found:
        raise ConfigError(
            f"backend '{found[1]}://...': no password in a URI, where logs and other users see it; put it into the "
            f"environment variable {PASSWORD_VARIABLE} or into a keyring, or start in a terminal to be asked"
        )


def without_secrets(uri: str) -> str:
    """Return a URI without user, password and keys: ``naoqis://nao:pw@pepper.local`` is ``naoqis://pepper.local``."""
    return _SECRET.sub(r"\1...", _USER.sub("//", uri))
