"""Wrong URIs of robots: refused in one line that says what is possible, before anything is connected."""

from __future__ import annotations

import pytest

from pepper_driver import Pepper
from pepper_driver.backends import make_backend
from support.bad_input import check_refused

LONG_HOST = "a" * 300

CASES = [
    ("", "backend URI is empty; for example: mujoco"),
    ("  ", "backend URI is empty; for example: mujoco"),
    ("?", "unknown backend '?'"),
    ("//", "unknown backend '//'"),
    ("://", "unknown backend '://'"),
    ("mujocco", "unknown backend 'mujocco' (did you mean mujoco or mock?"),
    ("ros://x", "unknown backend 'ros'"),
    ("http://pepper.local", "unknown backend 'http'"),
    ("10.0.0.3", "backend '10.0.0.3': for a robot at an address, write naoqi://10.0.0.3"),
    (
        "pepper.local",
        "backend 'pepper.local': for a robot at an address, write naoqi://pepper.local",
    ),
    ("mujoco\n", "backend 'mujoco\\n': a URI holds no control characters"),
    ("mujoco\x1b[31m", "backend 'mujoco\\x1b[31m': a URI holds no control characters"),
    ("mujoco\0", "backend 'mujoco\\x00': a URI holds no control characters"),
    ("mujoco://?plant=a\nb", "backend 'mujoco://?plant=a\\nb': a URI holds no control characters"),
    ("mujoco://[::1", "backend 'mujoco://[::1': not a URI (Invalid IPv6 URL)"),
    ("mujoco://#x", "backend 'mujoco://#x': a fragment says nothing here"),
    ("mujoco:///x", "backend 'mujoco:///x': a path says nothing here"),
    ("mujoco:plant=worn", "backend 'mujoco:plant=worn': a path says nothing here"),
    (
        "mujoco://worn",
        "backend 'mujoco://worn': 'worn' says nothing here; write mujoco://?key=value with day, draw,",
    ),
    ("mujoco://?plant", "backend 'mujoco://?plant': after '?' come key=value, with & between them"),
    ("mujoco://?&", "backend 'mujoco://?&': after '?' come key=value, with & between them"),
    ("mujoco://?=3", "backend 'mujoco://?=3': unknown key ''"),
    ("mujoco://?sed=3", "backend 'mujoco://?sed=3': unknown key 'sed' (did you mean seed?"),
    ("mujoco://?seed=1&seed=2", "backend 'mujoco://?seed=1&seed=2': a key is given twice"),
    (
        "mujoco://?seed=-1",
        "backend 'mujoco://?seed=-1': seed must be a whole number, 0 or more, got '-1'",
    ),
    (
        "mujoco://?seed=1.5",
        "backend 'mujoco://?seed=1.5': seed must be a whole number, 0 or more, got '1.5'",
    ),
    (
        "mujoco://?seed=x",
        "backend 'mujoco://?seed=x': seed must be a whole number, 0 or more, got 'x'",
    ),
    (
        "mujoco://?seed=",
        "backend 'mujoco://?seed=': seed must be a whole number, 0 or more, got ''",
    ),
    (
        "mujoco://?seed=%C2%B2",
        "backend 'mujoco://?seed=%C2%B2': seed must be a whole number, 0 or more, got '²'",
    ),
    (
        "mujoco://?seed=" + "9" * 30,
        "backend 'mujoco://?seed=999999999999999999999999999999': seed must be a whole number, 0 or",
    ),
    ("mujoco://?seed=" + "9" * 5000, "5015 letters, 1000 at most"),
    (
        "mujoco://?seed=True",
        "backend 'mujoco://?seed=True': seed must be a whole number, 0 or more, got 'True'",
    ),
    ("mujoco://?plant=", "unknown plant ''"),
    ("mujoco://?plant=none", "unknown plant 'none' (did you mean nominal or worn?"),
    ("mujoco://?plant=wron", "unknown plant 'wron' (did you mean worn?"),
    ("mujoco://?plant=none.yaml", "none.yaml: cannot be read (there is no such file)"),
    ("mujoco://?plant=../x", "unknown plant '../x'"),
    (
        "mujoco://?draw=1",
        "config/plants/nominal.yaml: draws nothing (no key 'randomise'), so draw=1 says nothing",
    ),
    (
        "mujoco://?plant=random&draw=-1",
        "backend 'mujoco://?plant=random&draw=-1': draw must be a whole number, 0 or more, got '-1'",
    ),
    (
        "mujoco://?plant=random&draw=100",
        "random.yaml: draw 100 is held out for the test split of the evaluation, as all from 100 on",
    ),
    (
        "mujoco://?plant=nominal&day=1",
        "nominal.yaml: all days of its robots are alike (no key 'randomise.days'), so day=1 says nothing",
    ),
    (
        "mujoco://?plant=random&day=-1",
        "backend 'mujoco://?plant=random&day=-1': day must be a whole number, 0 or more, got '-1'",
    ),
    (
        "mujoco://?plant=random&draw=x",
        "backend 'mujoco://?plant=random&draw=x': draw must be a whole number, 0 or more, got 'x'",
    ),
    ("mujoco://?world=none", "unknown world 'none'"),
    ("mujoco://?world=.", "unknown world '.'"),
    (
        "mujoco://?posture=stand",
        "unknown posture 'stand' (did you mean Stand or StandZero or StandInit?",
    ),
    ("mujoco://?posture=", "unknown posture ''"),
    ("mujoco://?window=yes", "backend 'mujoco://?window=yes': window takes 0 or 1"),
    ("mujoco://?window=2", "backend 'mujoco://?window=2': window takes 0 or 1"),
    (
        "mock://x",
        "backend 'mock://x': 'x' says nothing here; write mock://?key=value with delay, posture",
    ),
    (
        "mock://?delay=x",
        "backend 'mock://?delay=x': delay must be a whole number, from 0 to 50, got 'x'",
    ),
    (
        "mock://?delay=1000000",
        "backend 'mock://?delay=1000000': delay must be a whole number, from 0 to 50, got '1000000'",
    ),
    ("mock://?posture=x", "unknown posture 'x'"),
    ("mock://?seed=3", "backend 'mock://?seed=3': unknown key 'seed'"),
    ("replay", "backend 'replay': name the log, as in replay://path/to/run.mcap"),
    ("replay://", "backend 'replay://': name the log, as in replay://path/to/run.mcap"),
    ("replay://none.mcap", "none.mcap: cannot be read (there is no such file)"),
    ("replay:///", "/: cannot be read (it is a folder)"),
    ("replay://x?y=1", "backend 'replay://x?y=1': unknown key 'y' (there are none)"),
    ("naoqi", "backend 'naoqi': names no robot; for example: naoqi://pepper.local"),
    ("naoqi://", "backend 'naoqi://': names no robot; for example: naoqi://pepper.local"),
    ("naoqi://:9559", "backend 'naoqi://:9559': names no robot; for example: naoqi://pepper.local"),
    (
        "naoqi://x:99999",
        "backend 'naoqi://x:99999': a port is a whole number from 1 to 65535, got '99999'; NAOqi",
    ),
    ("naoqi://x:0", "backend 'naoqi://x:0': port 0 is invalid; NAOqi listens at 9559"),
    (
        "naoqi://x:y",
        "backend 'naoqi://x:y': a port is a whole number from 1 to 65535, got 'y'; NAOqi listens at",
    ),
    (
        "naoqi://x:-1",
        "backend 'naoqi://x:-1': a port is a whole number from 1 to 65535, got '-1'; NAOqi listens",
    ),
    (
        "naoqi://a b",
        "backend 'naoqi://a b': no host can have this name; for example: naoqi://pepper.local",
    ),
    (f"naoqi://{LONG_HOST}", "no host can have this name"),
    ("naoqi://[::1", "backend 'naoqi://[::1': not a URI (Invalid IPv6 URL)"),
    ("naoqi://x/path", "backend 'naoqi://x/path': a path says nothing here"),
    ("naoqi://x?mode=foo", "backend 'naoqi://x?mode=foo': unknown mode 'foo'"),
    (
        "naoqi://x?modee=angles",
        "backend 'naoqi://x?modee=angles': unknown key 'modee' (did you mean mode?",
    ),
    (
        "naoqi://nao@x",
        "backend 'naoqi://nao@x': without TLS there is no login; write naoqi://x, or naoqis://nao@x",
    ),
    (
        "naoqi://nao:secret@x",
        "backend 'naoqi://...': no password in a URI, where logs and other users see it; put it into",
    ),
    (
        "naoqis://nao:secret@x",
        "backend 'naoqis://...': no password in a URI, where logs and other users see it; put it",
    ),
    (
        "naoqi://x?password=y",
        "backend 'naoqi://...': no password in a URI, where logs and other users see it; put it into",
    ),
    ("naoqis://", "backend 'naoqis://': names no robot; for example: naoqis://nao@pepper.local"),
]


@pytest.mark.parametrize(("uri", "expected"), CASES, ids=[repr(uri)[:40] for uri, _ in CASES])
def test_it_is_no_robot(uri: str, expected: str) -> None:
    check_refused(lambda: make_backend(uri), expected)
    error = check_refused(lambda: Pepper(uri, observer=None), expected)
    assert "secret" not in str(error)
