"""Where a robot is: ``naoqi://host[:9559]``, ``naoqis://user@host[:9503]``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from pepper_driver.backends.selection import BackendUri
from pepper_driver.config import ConfigError

PORTS = {"naoqi": 9559, "naoqis": 9503}
"""By scheme: where NAOqi listens by default. NAOqi 2.5 in clear, 2.9 over TLS with user and password."""

MAX_HOST_LENGTH = 253
"""[letters] Of a name, as DNS has it."""

USER = "nao"
"""Who logs in where the URI names nobody: the one user every Pepper has."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Address:
    """Of a NAOqi.

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
        """As ``qi`` wants it, such as ``tcp://pepper.local:9559``."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'tcps' if self.secure else 'tcp'}://{host}:{self.port}"


def naoqi_address(uri: BackendUri, options: set[str]) -> Address:
    """The address that a URI means.

    Args:
        uri: With the scheme ``naoqi`` or ``naoqis``.
        options: Keys it may have.

    Raises:
        ConfigError: It names no host, a port that is none, or an unknown key.
    """
    example = "naoqis://nao@pepper.local" if uri.scheme == "naoqis" else "naoqi://pepper.local"
    user, at, place = uri.host.rpartition("@")
    secure = uri.scheme == "naoqis"
    if at and not secure:
        raise ConfigError(
            f"backend '{uri.text}': without TLS nobody logs in; write naoqi://{place}, or naoqis://{uri.host}"
        )
    uri.check_keys(options, host=True)
    try:
        parts = urlsplit(f"//{place}")
        host, port = parts.hostname, parts.port
    except ValueError as error:
        port_text = place.rpartition(":")[2]
        raise ConfigError(
            f"backend '{uri.text}': a port is a whole number from 1 to 65535, got '{port_text}';"
            f" NAOqi listens at {PORTS[uri.scheme]}"
        ) from error
    if port == 0:
        raise ConfigError(
            f"backend '{uri.text}': port 0 is none; NAOqi listens at {PORTS[uri.scheme]}"
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
