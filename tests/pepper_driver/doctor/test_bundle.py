"""The doctor's archive: all that was seen, and nothing that says whose robot it is."""

import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.backends import BackendError, BackendInfo
from pepper_driver.backends.mock import MockBackend
from pepper_driver.cli.app import run
from pepper_driver.doctor import MotionTest, examine
from pepper_driver.doctor import bundle as bundle_module
from pepper_driver.doctor.bundle import (
    MIN_NAME,
    Scrubber,
    kind_of_interface,
    way_to,
    write_bundle,
)
from support.doctor import ROBOT, Patient, use
from support.examples import examples

SERIAL = "AP990438A03Y12300042"
VERSION = "2.5.10.7"
URI = "naoqis://anna@pepper-7.lab.example:9503?wake=1"


class Owned(Patient):
    """A robot with a serial number, whose diagnosis and errors name names."""

    @property
    def info(self) -> BackendInfo:
        return replace(
            super().info,
            identity=SERIAL,
            name="pepper-7.lab.example",
            robot_type="Juliette",
            system_version=VERSION,
        )


def content(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def test_all_that_was_seen_is_in_the_archive(tmp_path: Path) -> None:
    path = tmp_path / "report.zip"
    assert run(["doctor", "--yes", "--report", str(path)]) == 0
    files = content(path)
    assert set(files) == {
        "README.txt",
        "report.json",
        "inspection.npz",
        "small-motion.npz",
        "small-steps.npz",
    }
    report = json.loads(files["report.json"])
    assert report["passed"] is True
    assert report["robot"]["simulated"] is True
    assert {"pepper_driver", "python", "numpy", "machine"} <= report["versions"].keys()
    assert len(report["joints"]) == 14
    assert any(result["name"] == "delay" for result in report["results"])
    seen = np.load(io.BytesIO(files["inspection.npz"]))
    assert seen["position"].shape == (len(seen["time"]), 17)
    moved = np.load(io.BytesIO(files["small-steps.npz"]))
    assert np.ptp(moved["sent_position"][:, ROBOT.joint_index("HeadYaw")]) > 0.02
    assert path.stat().st_size < 3e6


def test_nothing_in_it_says_whose_robot_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bundle_module, "way_to", lambda host: "wireless")
    monkeypatch.setattr("platform.node", lambda: "annas-laptop.lab.example")
    monkeypatch.setattr("getpass.getuser", lambda: "anna.smith")
    use(monkeypatch, Owned())
    seen = examine(URI)
    reported = replace(
        seen.results[0],
        found=f"{SERIAL} (NAOqi {VERSION}) at pepper-7.lab.example (10.0.12.7, fe80::1ff:fe23:4567:890a) refuses anna, "
        f"from annas-laptop, {Path.home()}/models.json",
    )
    path = tmp_path / "report.zip"
    test = MotionTest(results=(reported,), fits=())
    write_bundle(path, URI, replace(seen, results=(reported, *seen.results)), test)
    text = b"\n".join(content(path).values()).decode("latin-1").lower()
    for secret in (
        SERIAL,
        "pepper-7",
        "lab.example",
        "10.0.12.7",
        "fe80",
        "anna",
        str(Path.home()) + "/",
    ):
        assert secret.lower() not in text, secret
    report = json.loads(content(path)["report.json"])
    assert f"(NAOqi {VERSION}) at <robot> (<address>, <address>)" in report["results"][0]["found"]
    assert report["robot"]["scheme"] == "naoqis"
    assert report["robot"]["type"] == "Juliette"
    assert report["robot"]["system_version"] == VERSION
    assert report["network"]["way"] == "wireless"
    assert report["network"]["age_max"] == 0.0
    assert report["network"]["without_sample"] == 0.0


def test_the_way_to_a_robot_is_known_where_the_system_says_it(tmp_path: Path) -> None:
    assert way_to("127.0.0.1") == "same computer"
    assert way_to("no..name") == "unknown"
    for name, part, kind in (("wlan0", "wireless", "wireless"), ("eth0", "device", "wired")):
        (tmp_path / name / part).mkdir(parents=True)
        assert kind_of_interface(tmp_path / name) == kind
    (tmp_path / "tun0").mkdir()
    assert kind_of_interface(tmp_path / "tun0") == "unknown"


def test_a_simulated_robot_has_no_way_and_no_version_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "report.zip"
    write_bundle(path, "mock", examine("mock"), MotionTest(results=(), fits=()))
    report = json.loads(content(path)["report.json"])
    assert (report["robot"]["type"], report["robot"]["system_version"]) == (None, None)
    assert report["network"]["way"] is None


NAME = st.text(st.characters(categories=["L", "Nd"], max_codepoint=0x24F), min_size=MIN_NAME)


@examples(100)
@given(user=NAME, host=NAME, before=st.text(max_size=8), after=st.text(max_size=8))
def test_user_and_host_are_taken_out_wherever_they_are(
    user: str, host: str, before: str, after: str
) -> None:
    scrubber = Scrubber((f"naoqis://{user}@{host}",), MockBackend(ROBOT).info)
    for name in (user, host):
        text = scrubber.text(f"{before} {name}: {after}")
        assert f" {name}:" not in text


def test_numbers_and_versions_stay() -> None:
    scrubber = Scrubber(("naoqi://robot-1",), MockBackend(ROBOT).info)
    text = (
        "steps of 12.00 ms at 03:04:05, version 4.0.0, LShoulderPitch 1.2 deg/s (docs/realtime.md)"
    )
    assert scrubber.text(text) == text
    assert scrubber.tree({"a": [1, 2.5, None, True], "b": ("x",)}) == {
        "a": [1, 2.5, None, True],
        "b": ["x"],
    }


@pytest.mark.parametrize(
    ("text", "scrubbed"),
    [
        ("fe80::1 refuses", "<address> refuses"),
        ("connect to fd00:1::7: refused", "connect to <address>: refused"),
        ("[fe80::1ff:fe23:4567:890a]:9559", "[<address>]:9559"),
        ("/mnt/annas-disk/pepper/models.json: damaged", "<folder>/models.json: damaged"),
        (
            "naoqi://<robot>/?settings=%2Fmnt%2Fanna%2Fx.yaml",
            "naoqi://<robot>/?settings=<folder>/x.yaml",
        ),
        ("naoqi://pepper-7:9559 is old-pepper", "naoqi://<robot>:9559 is <robot>"),
    ],
)
def test_addresses_and_folders_are_taken_out(text: str, scrubbed: str) -> None:
    scrubber = Scrubber(("naoqi://pepper-7",), MockBackend(ROBOT).info)
    assert scrubber.also_of("naoqi://old-pepper?delay=5").text(text) == scrubbed


def test_a_robot_that_does_not_answer_has_a_report_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> None:
        raise BackendError("no robot at 10.0.12.7")

    use(monkeypatch, Patient(opens=refuse))
    seen = examine("mock")
    assert seen.inspection is None
    path = tmp_path / "report.zip"
    write_bundle(path, "mock", seen, MotionTest(results=(), fits=()))
    files = content(path)
    assert "inspection.npz" not in files
    assert json.loads(files["report.json"])["results"][0]["found"] == "no robot at <address>"


def test_a_place_that_cannot_be_written_to_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["doctor", "--no-motion", "--report", str(tmp_path / "report.json")]) == 2
    assert "ends in .zip" in capsys.readouterr().err
    assert run(["doctor", "--no-motion", "--report", "/dev/null/x.zip"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "/dev/null/x.zip" in line
