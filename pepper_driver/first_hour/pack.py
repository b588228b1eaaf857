"""Archive of a first hour that can be sent: without names, addresses and serial numbers."""

from __future__ import annotations

import json
import zipfile
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pepper_driver.backends import BackendInfo
from pepper_driver.backends.log_file import decode_log, read_bytes, topics_of
from pepper_driver.backends.log_records import find_chunks, messages_in
from pepper_driver.config.files import replacing
from pepper_driver.doctor.bundle import DATE, Scrubber, robot_hash
from pepper_driver.first_hour.bundle import PLACES, open_bundle
from pepper_driver.first_hour.state import STATE
from pepper_driver.identification.dataset import MANIFEST, read_manifest, recording_path
from pepper_driver.log.reader import usual_layout
from pepper_driver.log.topics import EVENTS
from pepper_driver.log.writer import McapFile
from pepper_driver.observer.models.model_file import ModelSet

README = "README.txt"

CONTENT = """First hour of a robot, made by 'pepper first-hour'.

first_hour.json   robot, version, steps and what they found
doctor.zip        report of 'pepper doctor'
identification/   free motion, from which models were identified (numpy.load), and its manifest
models.json       these models
rest.mcap         log: the robot stands, nothing touches it
free.mcap         log: free motion, nothing touches it
touches.mcap      log: touches that were asked for, with labels

Host names, user names, network addresses, folders and the serial number of the robot were replaced by <...> or a hash.
Look through first_hour.json, models.json and identification/manifest.json before you send it.

pepper evaluate --log first_hour.zip            makes a page of results
pepper calibrate --recordings first_hour.zip    makes a simulated robot that is like this one
"""

_SCRUBBED = ("backend", "parents", "observer", "observer_models")
"""Metadata of a log in which names may stand."""


def pack_bundle(folder: Path, path: Path, uri: str, info: BackendInfo) -> None:
    """Pack all parts of a finished hour; the robot's identity is the same hash in all of them.

    Args:
        folder: Of the hour.
        path: Of the archive; one that is there is replaced when this one is whole.
        uri: Of the robot, whose names are taken out.
        info: Of its backend.

    Raises:
        BundleError: A part is missing, damaged, or of another robot than the others.
        PepperError: The archive cannot be written.
    """
    with open_bundle(folder) as bundle:
        state = bundle.state
    manifest = read_manifest(folder / PLACES["identification"])
    # A robot may have had another address when it was recorded.
    scrubber = Scrubber((uri, manifest.backend), info)
    identity = robot_hash(info.identity)
    loaded = ModelSet.load(folder / PLACES["models"])
    models = replace(loaded, identity=identity, created_by=scrubber.text(loaded.created_by))
    described = asdict(manifest) | {
        "backend": scrubber.text(manifest.backend),
        "identity": identity,
    }
    # What steps found are numbers, and names of joints, links and checks.
    hour = replace(state.done("pack", {}), identity=identity)
    with replacing(path) as partial, TemporaryDirectory() as name:
        temporary = Path(name)
        models.save(temporary / PLACES["models"])
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
            _write(archive, README, CONTENT.encode())
            _write(archive, STATE, _json(asdict(hour)))
            _write(archive, PLACES["models"], (temporary / PLACES["models"]).read_bytes())
            _write(archive, PLACES["doctor"], (folder / PLACES["doctor"]).read_bytes())
            recordings = folder / PLACES["identification"]
            _write(archive, f"{recordings.name}/{MANIFEST}", _json(described))
            for run in manifest.runs:
                file = recording_path(recordings, run.name)
                _write(archive, f"{recordings.name}/{file.name}", file.read_bytes())
            for log in (PLACES["rest"], PLACES["free"], PLACES["touches"]):
                _copy_log(folder / log, temporary / log, scrubber, models)
                _write(archive, log, (temporary / log).read_bytes())


def _copy_log(path: Path, out: Path, scrubber: Scrubber, models: ModelSet) -> None:
    """Copy a log, without names in its metadata and events.

    Args:
        path: The log.
        out: The copy.
        scrubber: Takes names out; those of the log's own backend are added.
        models: As they are packed: the log says that it was made with these, on their robot.

    Raises:
        LogError: The log cannot be read, or the copy cannot be written.
    """
    data = read_bytes(path)
    file = decode_log(path, data, usual_layout())
    metadata = {**file.metadata, "identity": models.identity}
    scrubber = scrubber.also_of(metadata.get("backend", ""))
    for key in _SCRUBBED:
        if key in metadata:
            metadata[key] = scrubber.text(metadata[key])
    if "observer_models_sha256" in metadata:
        metadata["observer_models_sha256"] = models.sha256()
    events = 1 + topics_of(file.layout).index(EVENTS.topic)
    copy = McapFile(out, file.layout, metadata)
    try:
        for contents in find_chunks(data):
            for message in messages_in(contents or b""):
                if message.channel == events:
                    message = message._replace(data=_scrubbed(message.data, scrubber))
                copy.copy(message)
        copy.finish(complete=file.complete)
    finally:
        copy.abandon()


def _scrubbed(message: bytes, scrubber: Scrubber) -> bytes:
    """Return a JSON message with its text scrubbed; its kind and name are words of the program."""
    content = json.loads(message)
    return json.dumps(content | {"text": scrubber.text(content.get("text", ""))}).encode()


def _json(content: dict[str, Any]) -> bytes:
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def _write(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    # Recordings, logs and the report are compressed already.
    packed = name.endswith((".npz", ".mcap", ".zip"))
    method = zipfile.ZIP_STORED if packed else zipfile.ZIP_DEFLATED
    archive.writestr(zipfile.ZipInfo(name, DATE), content, method)
