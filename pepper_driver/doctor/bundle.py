"""One file with all that the doctor saw, to be sent to others: without names, addresses, serial numbers and secrets."""

from __future__ import annotations

import getpass
import hashlib
import json
import platform
import re
import socket
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from io import BytesIO
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

import numpy as np
import psutil

from pepper_driver.backends import BackendInfo
from pepper_driver.backends.selection import parse_uri
from pepper_driver.config.files import write_bytes
from pepper_driver.doctor.checks import Inspection
from pepper_driver.doctor.examination import Examination
from pepper_driver.doctor.motion_test import MotionTest
from pepper_driver.log.summary import versions
from pepper_driver.observer import ModelSet
from pepper_driver.observer.recording import arrays_as_bytes

FORMAT = 1

MIN_NAME = 3
"""Letters of a name that is taken out: shorter ones are in many words."""

DISCARD = 9
"""Port of no service."""

DATE = (1980, 1, 1, 0, 0, 0)
"""Of the files inside: equal content gives equal bytes."""

CONTENT = """Report of 'pepper doctor', to be sent to those who can help.

report.json       versions of the program and of the robot, kind of computer, network, checks, joints, measured facts
inspection.npz    sensors of the robot at rest, for some seconds
small-*.npz       commands and sensors of its small motion (numpy.load)

Host names, user names, network addresses, folders and the serial number of the robot were replaced by <...> or a hash.
Look through report.json before you send it.
"""

Way = Literal["same computer", "wired", "wireless", "unknown"]

_INSPECTED = ("time", "age", "position", "current", "wheel_speed", "temperature", "battery")
_ADDRESSES = (
    re.compile(r"\b(?:\d{1,3}\.){3}\d{1,3}\b"),
    re.compile(r"(?i)\b(?:[0-9a-f]{2}[:-]){5}[0-9a-f]{2}\b"),
    re.compile(r"(?i)(?<![\w:])(?:[0-9a-f]{0,4}:){3,7}[0-9a-f]{1,4}(?!\w|:\w)"),
    re.compile(r"(?i)(?<![\w:])[0-9a-f]{0,4}::[0-9a-f]{1,4}(?!\w|:\w)"),
)
_FOLDER = re.compile(r"(?<![\w/.>])(?:/[^\s/'\":;,<>()]+)+/(?=[^\s/'\":;,<>()])")
"""Folders of an absolute path: its file keeps its name."""


def robot_hash(identity: str) -> str:
    """Return what stands for a robot's identity in files that are sent: the same in all of them."""
    return hashlib.sha256(_serial(identity).encode()).hexdigest()[:12]


def _serial(identity: str) -> str:
    """Return the body id of a robot, however it is driven."""
    return identity.removesuffix("/angles")


class Scrubber:
    """Takes names and addresses out of texts, and puts a hash in place of a robot's serial number.

    Args:
        uris: Of the robot, by all its addresses.
        info: Of its backend.
    """

    def __init__(self, uris: Sequence[str], info: BackendInfo) -> None:
        self._uris, self._info = tuple(uris), info
        hosts = [parse_uri(uri).host.rpartition("@") for uri in uris]
        names = {
            robot_hash(info.identity): (_serial(info.identity),),
            "<robot>": tuple(address.split(":")[0] for _, _, address in hosts),
            "<user>": (*(user.split(":")[0] for user, _, _ in hosts), _user(), Path.home().name),
            "<computer>": (platform.node(), platform.node().split(".")[0]),
        }
        # A simulated robot has a hash for its identity, and no address.
        self._names = [
            (re.compile(rf"(?<!\w){re.escape(name)}(?!\w)", re.IGNORECASE), what)
            for what, given in names.items()
            for name in sorted(set(given), key=len, reverse=True)
            if len(name) >= MIN_NAME
        ]
        self._home = str(Path.home())

    def also_of(self, uri: str) -> Scrubber:
        """Return one that takes out the names in one more address of the robot as well; empty for none."""
        return Scrubber((*self._uris, uri), self._info) if uri else self

    def text(self, text: str) -> str:
        """Return a text without them."""
        text = text.replace("%2F", "/")  # a path in the query of a URI
        if len(self._home) > 1:
            text = text.replace(self._home, "<home>")
        text = _FOLDER.sub("<folder>/", text)
        for pattern in _ADDRESSES:
            text = pattern.sub(self._hidden, text)
        for pattern, what in self._names:
            text = pattern.sub(what, text)
        return text

    def _hidden(self, address: re.Match[str]) -> str:
        """Return what stands for an address; a version of NAOqi has four numbers as well."""
        return address[0] if address[0] == self._info.system_version else "<address>"

    def tree(self, value: Any) -> Any:  # noqa: ANN401 any JSON
        """Return JSON values with all their texts scrubbed, also those that are keys."""
        if isinstance(value, str):
            return self.text(value)
        if isinstance(value, Mapping):
            return {self.text(str(key)): self.tree(one) for key, one in value.items()}
        if isinstance(value, list | tuple):
            return [self.tree(one) for one in value]
        return value


def _user() -> str:
    """Return the name of the user; a system without one must stop no report."""
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return ""


def write_bundle(path: Path, uri: str, examination: Examination, motion_test: MotionTest) -> None:
    """Write all that an examination and a motion test saw.

    Args:
        path: Of the file, a ZIP archive.
        uri: Of the robot.
        examination: At rest.
        motion_test: In motion; may have none.

    Raises:
        OutputError: The file cannot be written.
    """
    scrubber, info = Scrubber((uri,), examination.info), examination.info
    robot = {
        "id": robot_hash(info.identity),
        "scheme": parse_uri(uri).scheme,
        "type": info.robot_type or None,
        "system_version": info.system_version or None,
        "simulated": info.simulated,
        "response_delay": info.response_delay,
        "capabilities": sorted(info.capabilities),
    }
    report = {
        "format": FORMAT,
        "versions": versions(),
        "network": _network(uri, examination.inspection),
        "passed": examination.passed and motion_test.passed,
        "results": [result.as_json() for result in (*examination.results, *motion_test.results)],
        "joints": [fit.as_json() for fit in motion_test.fits],
        "models": _models(examination.models),
    }
    files = {
        "README.txt": CONTENT.encode(),
        # The robot is described by words of its own and of the program, not by names of people and hosts.
        "report.json": json.dumps(
            {**scrubber.tree(report), "robot": robot}, indent=1, sort_keys=True
        ).encode(),
    }
    if examination.inspection is not None:
        files["inspection.npz"] = arrays_as_bytes(
            {name: examination.inspection.values(name) for name in _INSPECTED}
        )
    for name, recording in motion_test.recordings.items():
        files[f"{name.replace(' ', '-')}.npz"] = recording.as_bytes()
    write_bytes(path, _archive(files.items()))


def _network(uri: str, inspection: Inspection | None) -> dict[str, Any]:
    """Return what matters of the network: the way to the robot, and how its samples came."""
    host = urlsplit(f"//{parse_uri(uri).host}").hostname
    found: dict[str, Any] = {"way": None if host is None else way_to(host)}
    if inspection is not None:
        age = inspection.values("age")
        known = age[np.isfinite(age)]
        found |= {
            "age_median": float(np.median(known)) if len(known) else None,
            "age_max": float(np.max(known)) if len(known) else None,
            "without_sample": float(np.mean(np.diff(inspection.values("tick")) == 0)),
            "missed_ticks": inspection.missed,
        }
    return found


def way_to(host: str) -> Way:
    """Return by which kind of network this computer reaches a host. Nothing is sent to it."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, DISCARD, type=socket.SOCK_DGRAM)[0]
        with socket.socket(family, kind) as probe:
            probe.connect(address)  # chooses the way
            own = probe.getsockname()[0]
    except (OSError, UnicodeError):
        return "unknown"
    if ip_address(own).is_loopback:
        return "same computer"
    names = (
        name
        for name, addresses in psutil.net_if_addrs().items()
        if any(one.address == own for one in addresses)
    )
    return kind_of_interface(Path("/sys/class/net", next(names, "unknown")))


def kind_of_interface(device: Path) -> Way:
    """Return the kind of a network interface from the folder in which Linux describes it; elsewhere there is none."""
    if (device / "wireless").exists():
        return "wireless"
    return "wired" if (device / "device").exists() else "unknown"


def _models(models: ModelSet | None) -> dict[str, Any] | None:
    """Return what matters of the models; the models themselves stay at home."""
    if models is None:
        return None
    return {
        "kind": models.kind,
        "version": models.version,
        "test_fit": dict(models.test_fit),
        "threshold": dict(models.threshold),
        "measured": None if models.measured is None else asdict(models.measured),
    }


def _archive(files: Iterable[tuple[str, bytes]]) -> bytes:
    content = BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files:
            archive.writestr(zipfile.ZipInfo(name, DATE), data, zipfile.ZIP_DEFLATED)
    return content.getvalue()
