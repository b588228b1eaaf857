"""A backend by URI: ``mujoco://?plant=nominal&seed=3``, ``replay://run.mcap``, or what other packages register."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import parse_qsl, urlencode, urlsplit

from pepper_driver.backends.interface import Backend
from pepper_driver.config import ConfigError, RobotConfig, load_robot, suggestion
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.errors import shown
from pepper_driver.config.passwords import check_no_password
from pepper_driver.config.plugins import load_plugin, make_part
from pepper_driver.config.signals import deferred_signals

GROUP = "pepper_driver.backends"
"""Entry-point group for backends of other packages: ``scheme = "module:factory"``."""

MAX_LENGTH = 1000
"""[letters] Of a URI."""

MAX_INTEGER = 10**18
"""In a URI."""

_BUILTIN = {
    "mock": "pepper_driver.backends.mock:from_uri",
    "mujoco": "pepper_driver.backends.mujoco_:from_uri",
    "naoqi": "pepper_driver.backends.naoqi.backend:from_uri",
    "naoqis": "pepper_driver.backends.naoqi.backend:from_uri",
    "replay": "pepper_driver.backends.replay:from_uri",
}


@dataclass(frozen=True, kw_only=True, slots=True)
class BackendUri:
    """A parsed backend URI; ``text`` is as the user wrote it.

    A relative path of a file is ``host`` and ``path`` together.
    """

    text: str
    scheme: str
    host: str
    path: str
    query: Mapping[str, str]

    def check_keys(self, known: set[str], *, host: bool, path: bool = False) -> None:
        """Raise a ConfigError for a query key that is not in ``known``, or an unexpected host or path."""
        if self.host and not host:
            raise ConfigError(
                f"backend '{self.text}': '{self.host}' says nothing here; "
                f"write {self.scheme}://?key=value with {', '.join(sorted(known))}"
            )
        if self.path.strip("/") and not path:
            raise ConfigError(f"backend '{self.text}': a path says nothing here")
        for key in self.query:
            if key not in known:
                possible = suggestion(key, known) or " (there are none)"
                raise ConfigError(f"backend '{self.text}': unknown key '{key}'{possible}")

    def integer(self, key: str, default: int, most: int | None = None) -> int:
        """Return a query value as a whole number from 0 to ``most``, where there is a most.

        Raises:
            ConfigError: It is invalid.
        """
        text = self.query.get(key)
        if text is None:
            return default
        most = MAX_INTEGER if most is None else most
        if not (text.isascii() and text.isdecimal() and len(text) < 20 and int(text) <= most):
            range_text = "0 or more" if most == MAX_INTEGER else f"from 0 to {most}"
            raise ConfigError(
                f"backend '{self.text}': {key} must be a whole number, {range_text}, got {shown(text)}"
            )
        return int(text)


def parse_uri(text: str) -> BackendUri:
    """Take a backend URI apart.

    Raises:
        ConfigError: It is no text, empty, gives a key twice, or holds a robot's password.
    """
    if not isinstance(text, str):
        raise ConfigError(
            f"a backend is named by a URI, such as 'mujoco' or 'naoqi://pepper.local', got {shown(text)}"
        )
    check_no_password(text)
    if not text.strip():
        raise ConfigError("backend URI is empty; for example: mujoco")
    if len(text) > MAX_LENGTH:
        raise ConfigError(f"backend {shown(text)}: {len(text)} letters, {MAX_LENGTH} at most")
    if not text.isprintable():  # some of these are cut out of a URI without a word
        raise ConfigError(f"backend {text!r}: a URI holds no control characters")
    try:
        parts = urlsplit(text if "://" in text else text.replace("?", "://?", 1))
        scheme = parts.scheme or text
    except ValueError as error:
        raise ConfigError(f"backend '{text}': not a URI ({error})") from error
    try:
        pairs = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
    except ValueError as error:
        raise ConfigError(
            f"backend '{text}': after '?' come key=value, with & between them"
        ) from error
    query = dict(pairs)
    if len(query) != len(pairs):
        raise ConfigError(f"backend '{text}': a key is given twice")
    if parts.fragment:
        raise ConfigError(f"backend '{text}': a fragment says nothing here")
    path = "" if parts.path == text else parts.path  # a scheme alone
    return BackendUri(text=text, scheme=scheme, host=parts.netloc, path=path, query=query)


def with_query(uri: str, **values: str | int | None) -> str:
    """Return a backend URI with values of query keys, in place of those that it has; None takes a key away."""
    parsed = parse_uri(uri)
    changed = {**parsed.query, **values}
    query = urlencode({key: value for key, value in changed.items() if value is not None})
    return f"{parsed.scheme}://{parsed.host}{parsed.path}?{query}"


def takes_delay(uri: str) -> bool:
    """Return true for a robot whose response delay is an option of the URI; a simulation has its own."""
    parsed = parse_uri(uri)
    return parsed.scheme in ("naoqi", "naoqis") and parsed.query.get("mode") != "angles"


def with_delay(uri: str, ticks: int) -> str:
    """Return the URI of a robot whose response delay was measured; where it knows its own, the same URI."""
    return with_query(uri, delay=ticks) if takes_delay(uri) else uri


@checked_arguments
def make_backend(uri: str, robot: RobotConfig | None = None) -> Backend:
    """Return the backend that ``uri`` names, not yet opened.

    Args:
        uri: ``scheme`` or ``scheme://host?key=value&...``.
        robot: Description of the robot, by default the shipped Pepper.

    Raises:
        UnknownNameError: No backend of this scheme.
        ConfigError: A part of the URI is wrong.
        MissingExtraError: The backend needs an optional part of the package.
        PluginError: That of another package cannot be loaded, or fails.
    """
    parsed = parse_uri(uri)
    if "." in parsed.scheme:
        raise ConfigError(f"backend '{uri}': for a robot at an address, write naoqi://{uri}")
    with deferred_signals():  # MuJoCo takes one for a defect of its own while it is imported
        factory = load_plugin("backend", GROUP, parsed.scheme, _BUILTIN)
    backend = make_part("backend", parsed.scheme, factory, parsed, robot or load_robot())
    if not isinstance(backend, Backend):
        raise ConfigError(
            f"backend '{uri}': its factory returned {type(backend).__name__}, no Backend"
        )
    return backend
