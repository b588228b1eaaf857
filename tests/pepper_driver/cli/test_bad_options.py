"""Wrong options and arguments of every command: one line on stderr, exit code 2, nothing on stdout, nothing written."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from pepper_driver.cli.app import COMMANDS, load_command, run
from pepper_driver.config import load_robot
from pepper_driver.log import LogWriter
from support import ROOT
from support.bad_input import check_line

OLD = "schema: 1\nname: m\nsteps: [{posture: Stand, duration: 1.0}]\n"


def prepare(folder: Path) -> None:
    """Make the files that commands are given."""
    (folder / "folder").mkdir()
    (folder / "folder.yaml").mkdir()
    (folder / "pictures.png").mkdir()
    (folder / "text").write_text("time,position\n0,1\n")
    (folder / "binary").write_bytes(bytes(range(256)))
    (folder / "empty").write_bytes(b"")
    (folder / "empty.yaml").write_bytes(b"")
    (folder / "old.yaml").write_text(OLD)
    (folder / "latin.yaml").write_bytes(b"name: caf\xe9\n")
    (folder / "good.yaml").write_text(OLD.replace("schema: 1", "schema: 2"))
    (folder / "list.yaml").write_text("- 1\n")
    with LogWriter(folder / "run.mcap", load_robot(), {}):
        pass


def message_of(words: str) -> str:
    """Run a command; return what it says."""
    import contextlib
    import io

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run(shlex.split(words))
    assert code == 2, (words, code, out.getvalue())
    return err.getvalue().strip().removeprefix("pepper: ")


CASES: list[tuple[str, str]] = [
    ("dmo", "unknown command 'dmo' (did you mean demo?; --help lists all)"),
    ("--hlp", "unknown option '--hlp' (did you mean --help?; --help lists all)"),
    ("-v", "unknown option '-v' (--help lists all)"),
    ("help", "unknown command 'help' (--help lists all)"),
    ("''", "an argument: must not be empty"),
    ("log inf run.mcap", "unknown command 'inf' (did you mean info?"),
    ("demo demo", "Got unexpected extra argument(s) (demo)"),
    ("demo --sed 3", "unknown option '--sed' (did you mean --seed?"),
    ("log info run.mcap --jsno x", "unknown option '--jsno' (did you mean --json?; --help lists"),
    ("identify --no-miror", "unknown option '--no-miror' (did you mean --no-mirror?; --help lists"),
    (
        "identify --out x --model-type fusoin",
        "cart, affine or fusion, got 'fusoin' (did you mean fusion?)",
    ),
    ("record --out x --label keys", "hand-right or bumper, got 'keys' (did you mean key?)"),
    ("log export run.mcap --format parqet", "npz, got 'parqet' (did you mean parquet?)"),
    ("run good", "unknown experiment 'good' (did you mean good.yaml?"),
    ("demo --seed", "Option '--seed' requires an argument."),
    ("demo --seed x", "option '--seed': must be a whole number, got 'x'"),
    ("demo --seed -1", "option '--seed': must be 0 or more, got '-1'"),
    ("demo --seed 1.5", "option '--seed': must be a whole number, got '1.5'"),
    ("demo --seed ''", "option '--seed': must not be empty"),
    ("demo --seconds soon", "option '--seconds': must be a number, got 'soon'"),
    ("demo --seconds nan", "option '--seconds': must be a finite number, got 'nan'"),
    ("demo --seconds inf", "option '--seconds': must be a finite number, got 'inf'"),
    ("demo --seconds -inf", "option '--seconds': must be a finite number, got '-inf'"),
    ("demo --seconds 1", "option '--seconds': must be 8 or more, got '1'"),
    ("demo --seconds 1e9", "option '--seconds': must be 3600 or less, got '1e9'"),
    ("demo --show=3", "Option '--show' does not take a value."),
    ("demo --out ''", "option '--out': must not be empty"),
    ("demo --out=", "option '--out': must not be empty"),
    ("demo --out text", "text: cannot be made (there is a file of this name)"),
    ("demo --out /dev/null/x", "/dev/null/x: cannot be made (a part of its path is no folder)"),
    ("demo --json folder", "folder: cannot be written (it is a folder)"),
    (
        "demo --json /dev/null/x.json",
        "/dev/null/x.json: cannot be written (a part of its path is no folder)",
    ),
    ("demo --json ' '", "option '--json': must not be empty"),
    ("demo --experiment dmo", "unknown experiment 'dmo' (did you mean demo?"),
    ("demo --experiment wave", "key 'contacts': a demonstration needs some"),
    ("demo --experiment none.yaml", "none.yaml: cannot be read (there is no such file)"),
    ("demo --experiment folder.yaml", "folder.yaml: cannot be read (it is a folder)"),
    ("demo --experiment latin.yaml", "latin.yaml: cannot be read (not UTF-8 text, at byte 9)"),
    ("demo --models none.json", "none.json: cannot be read (there is no such file)"),
    ("demo --models folder", "folder: cannot be read (it is a folder)"),
    ("demo --models text", "text: not a model file; 'pepper identify' writes model files"),
    ("demo --models empty", "empty: not a model file; 'pepper identify' writes model files"),
    ("demo --models binary", "binary: not a model file; 'pepper identify' writes model files"),
    ("run", "Missing argument 'NAME_OR_FILE'."),
    ("run none.yaml", "none.yaml: cannot be read (there is no such file)"),
    ("run folder", "unknown experiment 'folder' (possible: FILE.yaml, "),
    ("run folder.yaml", "folder.yaml: cannot be read (it is a folder)"),
    ("run latin.yaml", "latin.yaml: cannot be read (not UTF-8 text, at byte 9)"),
    ("run empty.yaml", "empty.yaml: holds nothing, expected a mapping of keys to values"),
    ("run list.yaml", "list.yaml: holds a list, expected a mapping of keys to values"),
    ("run ''", "an argument: must not be empty"),
    (
        "run old.yaml",
        "old.yaml line 1: key 'schema': a file of an old form, 'schema: 1'; the form is",
    ),
    ("run wave --seed -1", "option '--seed': must be 0 or more, got '-1'"),
    ("run wave --seed x", "option '--seed': must be a whole number, got 'x'"),
    ("run wave --models none.json", "none.json: cannot be read (there is no such file)"),
    ("run wave --models text", "text: not a model file; 'pepper identify' writes model files"),
    ("run wave --no-contacts=1", "Option '--no-contacts' does not take a value."),
    ("run wave --attentive=1", "Option '--attentive' does not take a value."),
    ("run a b", "Got unexpected extra argument(s) (b)"),
    ("move", "Missing argument 'NAME_OR_FILE'."),
    ("move wav", "unknown experiment 'wav' (did you mean wave?"),
    ("move none.yaml", "none.yaml: cannot be read (there is no such file)"),
    ("move folder.yaml", "folder.yaml: cannot be read (it is a folder)"),
    ("move latin.yaml", "latin.yaml: cannot be read (not UTF-8 text, at byte 9)"),
    ("move wave --backend muoco", "unknown backend 'muoco' (did you mean mujoco or mock?"),
    (
        "move wave --backend 'mujoco://?seed=-1'",
        "backend 'mujoco://?seed=-1': seed must be a whole number, 0 or more, got '-1'",
    ),
    ("move wave --log folder", "folder: cannot be written (it is a folder)"),
    (
        "move wave --log /dev/null/run.mcap",
        "/dev/null/run.mcap: its folder cannot be made (there is a file of this name)",
    ),
    ("move wave --json folder", "folder: cannot be written (it is a folder)"),
    ("move wave --real-time=yes", "Option '--real-time' does not take a value."),
    ("identify", "Missing option '--out'."),
    ("identify --out", "Option '--out' requires an argument."),
    ("identify --out folder", "folder: cannot be written (it is a folder)"),
    (
        "identify --out x.json --backend mujocco",
        "unknown backend 'mujocco' (did you mean mujoco or mock?",
    ),
    (
        "identify --out x.json --backend 'mujoco://?plant=worm'",
        "unknown plant 'worm' (did you mean worn?",
    ),
    (
        "identify --out x.json --joints LShoulderRol",
        "unknown joint 'LShoulderRol' (did you mean LShoulderRoll or RShoulderRoll or LShoulderPitch?",
    ),
    ("identify --out x.json --joints ,", "unknown joint ''"),
    ("identify --out x.json --joints HeadYaw,HeadYaw", "a joint is given twice: HeadYaw, HeadYaw"),
    (
        "identify --out x.json --model-type oak",
        "option '--model-type': must be cart, affine or fusion, got 'oak'",
    ),
    ("identify --out x.json --model-type ''", "option '--model-type': must not be empty"),
    ("identify --out x.json --workers 0", "option '--workers': must be 1 or more, got '0'"),
    ("identify --out x.json --workers -1", "option '--workers': must be 1 or more, got '-1'"),
    ("identify --out x.json --workers x", "option '--workers': must be a whole number, got 'x'"),
    (
        "identify --out x.json --workers 1000000",
        "option '--workers': must be 1000 or less, got '1000000'",
    ),
    ("identify --out x.json --seed -1", "option '--seed': must be 0 or more, got '-1'"),
    ("identify --out x.json --experiment none", "unknown experiment 'none'"),
    ("identify --out x.json --calibration dmo", "unknown experiment 'dmo' (did you mean demo?"),
    (
        "identify --out x.json --calibration none.yaml",
        "none.yaml: cannot be read (there is no such file)",
    ),
    (
        "identify --out x.json --recordings text",
        "text: cannot be made (there is a file of this name)",
    ),
    (
        "identify --out x.json --fit-only",
        "x-recordings: no recordings there (no manifest.json); record with 'pepper identify",
    ),
    (
        "identify --out x.json --fit-only --seed 3",
        "option '--seed': with '--fit-only' all is as it was recorded; leave it out",
    ),
    (
        "identify --out x.json --fit-only --recordings folder",
        "folder: no recordings there (no manifest.json); record with 'pepper identify --recordings",
    ),
    (
        "identify --out folder --draws 0-3 --backend mujoco://?plant=random&draw=1",
        "backend 'mujoco://?plant=random&draw=1': its draw has no meaning next to a list of draws",
    ),
    (
        "identify --out folder --draws 100-119 --backend mujoco://?plant=random",
        "random.yaml: draw 119 is held out for the test split of the evaluation, as all from 100 on; for development",
    ),
    ("identify --out folder --draws 0-3", "nominal.yaml: draws nothing (no key 'randomise')"),
    ("identify --out folder --draws 3-1", "draws: the range 3-1 ends before it begins"),
    (
        "identify --out folder --draws x",
        "draws: expected numbers and ranges such as 0-19 or 0,3,7-9",
    ),
    (
        "identify --out text --draws 0 --backend mujoco://?plant=random",
        "text: cannot be made (there",
    ),
    (
        "identify --out folder --draws 0 --recordings folder",
        "option '--recordings': with '--draws' each robot has a folder of its own; leave it out",
    ),
    (
        "identify --out x.json --fit-only --draws 0",
        "option '--draws': with '--fit-only' all is as it was recorded; leave it out",
    ),
    ("record --label head", "Missing option '--out'."),
    (
        "record --out x.mcap",
        "Missing option '--label'. Choose from: key, head, hand-left, hand-right, bumper",
    ),
    (
        "record --out x.mcap --label foot --seconds 1",
        "option '--label': must be key, head, hand-left, hand-right or bumper, got 'foot'",
    ),
    (
        "record --out x.mcap --label key --seconds 1",
        "labels by key need a terminal to press keys in: start it in one, or give another --label,",
    ),
    ("record --out x.mcap --label head --seconds 0", "seconds must be a time above 0, got 0.0"),
    ("record --out x.mcap --label head --seconds nan", "seconds must be a time above 0, got nan"),
    ("record --out x.mcap --label head --seconds inf", "seconds must be a time above 0, got inf"),
    (
        "record --out x.mcap --label head --seconds x",
        "option '--seconds': must be a number, got 'x'",
    ),
    ("record --out folder --label head --seconds 1", "folder: cannot be written (it is a folder)"),
    ("record --out x.mcap --label head --play wav", "unknown experiment 'wav' (did you mean wave?"),
    ("record --out x.mcap --label head --play none.yaml", "none.yaml: cannot be read (there is no"),
    ("record --out x.mcap --label head --motion wave", "unknown option '--motion'"),
    (
        "record --out x.mcap --label head --play wave --seed -1",
        "option '--seed': must be 0 or more",
    ),
    (
        "record --out x.mcap --label head --seconds 1 --seed 3",
        "a seed is for an experiment: leave it out",
    ),
    (
        "record --out x.mcap --label head --seconds 1 --link Had",
        "unknown link 'Had' (did you mean Head?",
    ),
    (
        "record --out x.mcap --label head --seconds 1 --joint LElbow",
        "unknown joint 'LElbow' (did you mean LElbowYaw or LElbowRoll or RElbowYaw?",
    ),
    ("record --out x.mcap --label head --seconds 1 --backend x", "unknown backend 'x'"),
    ("list plant", "unknown kind 'plant' (did you mean plants?"),
    ("list plants worlds", "Got unexpected extra argument(s) (worlds)"),
    ("list ''", "an argument: must not be empty"),
    ("replay none.mcap", "none.mcap: cannot be read (there is no such file)"),
    ("replay folder", "folder: cannot be read (it is a folder)"),
    ("replay text", "text: is not an MCAP file"),
    (
        "replay run.mcap",
        "run.mcap: does not say of which backend it is (cycle, response_delay, identity)",
    ),
    (
        "evaluate",
        "give either --suite or --log; suites: paper, fit, mirror, types, all",
    ),
    ("evaluate --log folder", "folder: it: holds no first hour (no first_hour.json)"),
    ("evaluate --log none.mcap", "none.mcap: cannot be read (there is no such file)"),
    ("evaluate --log text", "text: is not an MCAP file"),
    ("evaluate run.mcap", "run.mcap: recordings come after --log"),
    ("evaluate --suite typ", "unknown suite 'typ' (did you mean types?"),
    ("evaluate --suite ,", "unknown suite ''"),
    ("evaluate --suite paper --log run.mcap", "give either --suite or --log"),
    ("evaluate --suite paper --observer x", "unknown mode 'x'"),
    (
        "evaluate --suite paper --models none.json",
        "none.json: cannot be read (there is no such file); 'pepper identify' writes model files",
    ),
    (
        "evaluate --suite paper --models folder",
        "folder: cannot be read (it is a folder); 'pepper identify' writes model files",
    ),
    ("evaluate --suite paper --workers 0", "option '--workers': must be 1 or more, got '0'"),
    (
        "evaluate --suite paper --workers two",
        "option '--workers': must be a whole number, got 'two'",
    ),
    ("evaluate --suite paper --report x.txt", "x.txt: a report is Markdown and ends in .md"),
    ("evaluate --suite paper --report folder", "folder: a report is Markdown and ends in .md"),
    ("evaluate --suite paper --json folder", "folder: cannot be written (it is a folder)"),
    ("bench --seconds 0", "option '--seconds': must be 2 or more, got '0'"),
    ("bench --seconds nan", "option '--seconds': must be a finite number, got 'nan'"),
    ("bench --plant none", "unknown plant 'none' (did you mean nominal or worn?"),
    ("bench --plant none.yaml", "none.yaml: cannot be read (there is no such file)"),
    ("bench --busy", "option '--busy': goes with --tick"),
    ("bench --tick --callbacks", "options --tick and --callbacks: give one of them"),
    ("bench --tick --plant worn", "option '--plant': --tick has a plant of its own; leave it out"),
    (
        "bench --callbacks --plant worn",
        "option '--plant': --callbacks has a plant of its own; leave it out",
    ),
    ("bench --peers --plant worn", "option '--plant': --peers simulates no robot; leave it out"),
    ("bench --peers --tick", "options --tick and --peers: give one of them"),
    ("bench --part x", "option '--part': must be loop, startup or throughput, got 'x'"),
    ("bench --part loop --tick", "option '--part': does not go with --tick"),
    (
        "bench --part startup --plant worn",
        "option '--plant': --part startup has plants of its own; leave it out",
    ),
    ("bench --soak 60 --tick", "options --tick and --soak: give one of them"),
    ("bench --soak 60 --plant worn --plant cold", "option '--plant': --soak takes one plant"),
    ("bench --soak 1", "option '--soak': must be 60 or more, got '1'"),
    ("bench --soak inf", "option '--soak': must be a finite number, got 'inf'"),
    ("bench --soak nan", "option '--soak': must be a finite number, got 'nan'"),
    ("calibrate --control-law x", "option '--control-law': must be pd or integral, got 'x'"),
    ("calibrate --plant none --check", "unknown plant 'none' (did you mean nominal or worn?"),
    ("calibrate --plant folder.yaml", "folder.yaml: cannot be read (it is a folder)"),
    (
        "calibrate --plant random",
        "config/plants/random.yaml: each robot of this plant is drawn again; fit one that stays",
    ),
    ("calibrate --out x.txt", "x.txt: a plant file ends in .yaml"),
    ("calibrate --out folder.yaml", "folder.yaml: cannot be written (it is a folder)"),
    (
        "calibrate --check --out x.yaml",
        "--check fits nothing, so there is no plant for --out to write",
    ),
    ("calibrate --plot folder", "folder: cannot be written (it is a folder)"),
    ("calibrate --plot x", "unknown figure format ''"),
    ("calibrate --plot x.gif", "unknown figure format 'gif'"),
    ("calibrate --plot pictures.png", "pictures.png: cannot be written (it is a folder)"),
    (
        "calibrate --plot /dev/null/x.png",
        "/dev/null/x.png: cannot be written (a part of its path is no folder)",
    ),
    ("calibrate --workers 0", "option '--workers': must be 1 or more, got '0'"),
    ("calibrate --workers -1", "option '--workers': must be 1 or more, got '-1'"),
    ("doctor", "there is no terminal to ask on before the robot moves: give --yes, or --no-motion"),
    ("doctor mujco", "unknown backend 'mujco' (did you mean mujoco?"),
    ("doctor mujoco naoqi --no-motion", "Got unexpected extra argument(s) (naoqi)"),
    (f"run {300 * 'x'}", "unknown experiment 'xxx"),
    ("doctor nosuch --no-motion", "unknown backend 'nosuch' (did you mean naoqis?"),
    ("doctor 'mujoco://?plant=x' --no-motion", "unknown plant 'x'"),
    ("doctor --json folder --no-motion", "folder: cannot be written (it is a folder)"),
    ("plot", "Missing argument 'LOG'."),
    ("plot none.mcap", "none.mcap: cannot be read (there is no such file)"),
    ("plot folder", "folder: cannot be read (it is a folder)"),
    ("plot text", "text: is not an MCAP file"),
    ("plot run.mcap", "the log holds no tick to draw"),
    ("plot run.mcap --from nan", "option '--from': must be a finite number, got nan"),
    ("plot run.mcap --from -inf", "option '--from': must be a finite number, got -inf"),
    ("plot run.mcap --from soon", "option '--from': must be a number, got 'soon'"),
    ("plot run.mcap --to inf", "option '--to': must be a finite number, got inf"),
    ("plot run.mcap --out folder", "folder: cannot be written (it is a folder)"),
    ("plot run.mcap --out x", "unknown figure format ''"),
    ("plot run.mcap --out x.gif", "unknown figure format 'gif'"),
    ("plot run.mcap --out pictures.png", "pictures.png: cannot be written (it is a folder)"),
    ("render run.mcap --out x.gif --format png", "x.gif: does not end in .png, as --format says"),
    ("render run.mcap --format avi", "option '--format': must be mp4, gif or png"),
    ("render none.mcap --out x.png", "none.mcap: cannot be read (there is no such file)"),
    ("render text --out x.png", "text: is not an MCAP file"),
    ("render run.mcap --out x.png", "the log holds no tick to draw"),
    ("render run.mcap --out x", "unknown film format ''"),
    ("render run.mcap --out x.avi", "unknown film format 'avi' (possible: gif, mp4, png)"),
    ("render run.mcap --out pictures.png", "pictures.png: cannot be written (it is a folder)"),
    ("render run.mcap --out x.mp4 --at 1", "--at is for a PNG, and x.mp4 is a film: use --from"),
    ("render run.mcap --out x.mp4 --fps 0", "option '--fps': must be"),
    ("render run.mcap --out x.mp4 --fps 12.5", "option '--fps': must be"),
    ("render run.mcap --out x.mp4 --speed nan", "option '--speed': must be a finite number"),
    ("render run.mcap --out x.mp4 --speed -1", "speed -1: must be 0.01 to 100 times real time"),
    ("render run.mcap --out x.mp4 --size big", "option '--size': must be WxH, such as 1280x720"),
    ("render run.mcap --out x.mp4 --size 641x480", "size 641x480: both must be even numbers, 360"),
    (
        "render run.mcap --out x.mp4 --view top",
        "option '--view': must be front, left, right or back, got 'top'",
    ),
    ("log info", "Missing argument 'LOG'."),
    ("log info none.mcap", "none.mcap: cannot be read (there is no such file)"),
    ("log info folder", "folder: cannot be read (it is a folder)"),
    ("log info empty", "empty: is empty"),
    ("log info ''", "an argument: must not be empty"),
    ("log info run.mcap --json folder", "folder: cannot be written (it is a folder)"),
    ("log export run.mcap", "Missing option '--format'. Choose from: parquet, csv, npz"),
    (
        "log export run.mcap --format xls",
        "option '--format': must be parquet, csv or npz, got 'xls'",
    ),
    ("log export text --format csv", "text: is not an MCAP file"),
    (
        "log export run.mcap --format csv --out x.npz",
        "x.npz: a file of format csv must end in .csv",
    ),
    (
        "log export run.mcap --format csv --out /dev/null/x.csv",
        "/dev/null: cannot be made (there is a file of this name)",
    ),
    ("serve --port -1", "option '--port': must be 0 or more, got '-1'"),
    ("serve --port 99999", "option '--port': must be 65535 or less, got '99999'"),
    ("serve --port http", "option '--port': must be a whole number, got 'http'"),
    ("serve --plant none", "unknown plant 'none' (did you mean nominal or worn?"),
    ("serve --plant folder.yaml", "folder.yaml: cannot be read (it is a folder)"),
    ("serve --world none", "unknown world 'none'"),
    (
        "serve --posture stand",
        "unknown posture 'stand' (did you mean Stand or StandZero or StandInit?",
    ),
    ("serve --network none", "unknown network 'none'"),
    ("serve --network none.yaml", "none.yaml: cannot be read (there is no such file)"),
    ("serve --host ''", "option '--host': must not be empty"),
    ("serve --clock 1.5", "option '--clock': must be a whole number, got '1.5'"),
    ("serve --seed -1", "option '--seed': must be 0 or more, got '-1'"),
    ("serve --fault hng", "unknown fault 'hng' (did you mean hang?"),
    ("serve --fault hang:x=1", "fault 'hang': unknown argument 'x'"),
    ("serve --fault hang:seconds=-1", "fault 'hang': seconds must be at least 0, got -1"),
    (
        "serve --fault hang:seconds=1,seconds=2",
        "fault 'hang:seconds=1,seconds=2': 'seconds' is given twice",
    ),
    ("serve --fault slow:nan", "fault 'slow': delay must be a number, got 'nan'"),
    (
        "serve --fault hot:joint=Elbow",
        "unknown motor 'Elbow' (did you mean RElbowYaw or LElbowYaw or RElbowRoll?",
    ),
    ("serve --fault value:key=x", "unknown sensor 'x'"),
    ("serve --fault press:sensors=x", "unknown sensor to press 'x'"),
    ("serve --fault network:none", "unknown network 'none'"),
]


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path)
    return tmp_path


@pytest.mark.parametrize(("words", "expected"), CASES, ids=[words[:60] for words, _ in CASES])
def test_it_is_one_line_and_code_2(
    words: str, expected: str, files: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    before = sorted(files.rglob("*"))
    assert run(shlex.split(words)) == 2
    captured = capfd.readouterr()
    assert captured.out == ""
    lines = captured.err.splitlines()
    assert len(lines) == 1, captured.err
    prefix, colon, message = lines[0].partition(": ")
    assert (prefix, colon) == ("pepper", ": ")
    check_line(message)
    assert expected in message
    assert sorted(files.rglob("*")) == before, "nothing half-written"


def test_one_way_to_say_that_a_folder_is_a_folder(files: Path) -> None:
    """The same words for every program that reads or writes it."""
    for words in ("plot run.mcap --out folder", "log info folder", "demo --json folder"):
        assert message_of(words) in (
            "folder: cannot be written (it is a folder)",
            "folder: cannot be read (it is a folder)",
        )


def test_without_a_command_the_help_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["log"]):
        assert run(words) == 2
        captured = capsys.readouterr()
        assert "Usage: pepper" in captured.out
        assert captured.err == ""


def test_no_command_offers_shell_completion(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--help"], ["log", "--help"], ["log", "info", "--help"], ["run", "--help"]):
        assert run(words) == 0
        assert "completion" not in capsys.readouterr().out


# -- help -------------------------------------------------------------------------------------------------------------


def parameters() -> list[tuple[str, Any]]:
    """All options and arguments of all commands, with the words of the command."""
    found = []
    for name in COMMANDS:
        command = load_command(name)
        parts = getattr(command, "commands", None) or {"": command}
        for part, inner in parts.items():
            found += [(f"{name} {part}".strip(), parameter) for parameter in inner.params]
    return found


@pytest.mark.parametrize(
    ("command", "parameter"), parameters(), ids=lambda value: getattr(value, "name", value)
)
def test_each_option_says_what_it_takes(command: str, parameter: Any) -> None:
    assert parameter.help, "no help"
    assert parameter.help[0].isupper()
    assert parameter.help.endswith("."), parameter.help
    described = parameter.type_descriptor
    if parameter.param_type_name == "option" and not parameter.is_bool_flag:
        assert parameter.metavar or described.is_choice, "no word for what it takes"
    if described.annotation is float:
        assert parameter.metavar == {"speed": "X", "weight": "KG"}.get(parameter.name, "SECONDS")
    if parameter.name == "workers":
        assert parameter.help == "Processes that work at the same time; by default one per core."
    takes_value = parameter.param_type_name == "option" and not parameter.is_bool_flag
    if (
        takes_value
        and parameter.default is None
        and not parameter.required
        and not parameter.multiple
    ):
        left_out = ("json_file", "log", "out", "plot", "report", "soak", "experiment", "link")
        optional = {
            *left_out,
            "network",
            "split",
            "suite",
            "prompts",
            "again",
            "recordings",
            "weight",
        }
        assert "default" in parameter.help or parameter.name in optional, "what happens without it?"


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_is_that_of_the_list(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert run([name, "-h"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "<bool>" not in shown
    assert "<str>" not in shown
    assert "Traceback" not in shown
    entry = COMMANDS[name]
    assert load_command(name).help, "no help"
    if name != "log":
        assert f"Example: {entry.example}" in shown
        assert f"More: docs/{entry.docs}" in shown
    docs = ROOT / "docs"
    assert not docs.exists() or (docs / entry.docs).is_file()
    options = {option for _, p in parameters() if _.split()[0] == name for option in p.opts}
    for option in re.findall(r"--[a-z-]+", entry.example):
        assert option in options, "an example that is out of date"
