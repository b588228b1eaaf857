"""The robots of a population are identified one by one, kept by all that makes them, and counted when they fail."""

import json
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from pepper_driver.backends import make_backend
from pepper_driver.config import (
    ConfigError,
    Experiment,
    PepperError,
    RobotConfig,
    load_experiment,
)
from pepper_driver.config.cluster import sources_hash
from pepper_driver.config.files import OutputError
from pepper_driver.config.population import HeldOutDrawError, allow_test_draws
from pepper_driver.identification import (
    IdentifiedRobot,
    fit_folder,
    identify_population,
    record_joints,
)
from pepper_driver.identification import identify as identify_module
from pepper_driver.identification import population as population_module
from pepper_driver.identification.measurements.friction import HeldWeight
from pepper_driver.identification.measurements.program import FRICTION, held_weight
from pepper_driver.identification.runs import IdentificationRun, perform
from pepper_driver.observer import ModelSet, Recording
from support.identification import ROBOT, SHORT
from support.plant_files import save

PLANT = "mujoco://?plant=random"
JOINT = "LElbowRoll"


def identified(
    folder: Path,
    *draws: int,
    workers: int = 1,
    seed: int = 0,
    uri: str = PLANT,
    weight: HeldWeight | None = None,
    keep_recordings: bool = False,
) -> tuple[IdentifiedRobot, ...]:
    return identify_population(
        uri,
        draws,
        SHORT,
        "affine",
        folder,
        joints=[JOINT],
        weight=weight,
        seed=seed,
        keep_recordings=keep_recordings,
        workers=workers,
    )


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """Addresses and names of the runs that are performed."""
    performed: list[tuple[str, str]] = []

    def counted(uri: str, run: IdentificationRun, **options: str) -> Recording:
        performed.append((uri, run.name))
        return perform(uri, run, identity=options["identity"])

    monkeypatch.setattr(identify_module, "perform", counted)
    return performed


def failing(
    monkeypatch: pytest.MonkeyPatch, draw: int, error: BaseException, after: int = 0
) -> None:
    """Let the runs of one robot fail, after some of them."""
    done: list[str] = []

    def fails(uri: str, run: IdentificationRun, **options: str) -> Recording:
        if f"draw={draw}&" in f"{uri}&":
            done.append(run.name)
            if len(done) > after:
                raise error
        return perform(uri, run, identity=options["identity"])

    monkeypatch.setattr(identify_module, "perform", fails)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[IdentifiedRobot, ...]:
    """Two robots, each identified in a process of its own."""
    return identified(tmp_path_factory.mktemp("population"), 3, 2, workers=2)


def folder_of(robots: tuple[IdentifiedRobot, ...]) -> Path:
    assert robots[0].file is not None
    return robots[0].file.parent


def test_each_robot_is_identified_as_a_single_one(
    made: tuple[IdentifiedRobot, ...], tmp_path: Path
) -> None:
    assert [(one.draw, one.name, one.state) for one in made] == [
        (3, "random-3", "identified"),
        (2, "random-2", "identified"),
    ]
    for one in made:
        record_joints(f"{PLANT}&draw={one.draw}", [JOINT], SHORT, tmp_path / one.name, workers=1)
        alone = fit_folder(tmp_path / one.name, "affine")
        assert one.file is not None
        models = ModelSet.load(one.file)
        assert models == replace(alone.models, created_by=models.created_by)
        assert one.report["fit"]["affine"] == alone.as_json()["fit"]["affine"]
        assert one.file.name.startswith(f"{one.name}-")
    # Nothing stays but models and reports.
    assert len(list(folder_of(made).iterdir())) == 4


def test_robots_that_are_weighed_are_measured_too(
    made: tuple[IdentifiedRobot, ...], tmp_path: Path
) -> None:
    (weighed,) = identified(tmp_path, 2, weight=held_weight(0.5, "left"))
    not_weighed = made[1]
    assert weighed.file is not None
    assert not_weighed.file is not None
    assert ModelSet.load(not_weighed.file).measured is None
    measured = ModelSet.load(weighed.file).measured
    assert measured is not None
    scales = {name: joint.torque_scale is not None for name, joint in measured.joints.items()}
    assert scales[JOINT]
    assert not scales["RElbowRoll"]
    assert weighed.file.name != not_weighed.file.name


def test_what_is_there_is_taken(
    made: tuple[IdentifiedRobot, ...], runs: list[tuple[str, str]]
) -> None:
    seen: list[tuple[str, str, int, int]] = []
    again = identify_population(
        PLANT,
        [3, 2],
        SHORT,
        "affine",
        folder_of(made),
        joints=[JOINT],
        workers=1,
        progress=lambda one, done, total: seen.append((one.name, one.state, done, total)),
    )
    assert not runs
    assert again == tuple(replace(one, state="kept") for one in made)
    assert seen == [("random-2", "kept", 1, 2), ("random-3", "kept", 2, 2)]


@pytest.mark.parametrize(
    ("what", "damage"),
    [
        ("models", lambda text: text[: len(text) // 2]),
        ("report", lambda text: "[]"),
        ("report", lambda text: text[:9]),
        ("models", None),
    ],
)
def test_what_is_damaged_is_made_again(
    made: tuple[IdentifiedRobot, ...], runs: list[tuple[str, str]], what: str, damage: object
) -> None:
    file = made[1].file
    assert file is not None
    before = file.read_bytes()
    path = file if what == "models" else file.with_name(f"{file.stem}-report.json")
    if callable(damage):
        path.write_text(damage(path.read_text()))
    else:
        path.unlink()
    states = [one.state for one in identified(folder_of(made), 3, 2)]
    assert states == ["kept", "identified"]
    assert {f"draw={made[1].draw}" in uri for uri, _ in runs} == {True}
    assert file.read_bytes() == before


def test_the_name_of_the_file_holds_what_the_models_depend_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing(monkeypatch, 2, PepperError("not now"))
    folders = []

    def note(*, uri: str = PLANT, seed: int = 0) -> None:
        identified(tmp_path, 2, uri=uri, seed=seed)
        folders.append({path.name for path in tmp_path.iterdir()})

    note()
    note()
    assert len(folders[-1]) == 1, "the same"
    note(seed=1)
    note(uri=f"{PLANT}&seed=1")
    note(uri=f"{PLANT}&day=1")
    mine = save(tmp_path.parent, {"name": "x/../y", "extends": "random"}, "random.yaml")
    note(uri=f"mujoco://?plant={mine}")  # under this name the same robot
    assert [len(names) for names in folders] == [1, 1, 2, 3, 4, 4]
    monkeypatch.setattr(population_module, "sources_hash", lambda apart: "other code")
    note()
    monkeypatch.setattr(population_module, "environment", lambda: {"numpy": "1.0"})
    note()
    assert [len(names) for names in folders[-2:]] == [5, 6]
    assert all(name.startswith("random-2-") for name in folders[-1])


def test_a_robot_that_fails_is_said_and_the_others_are_identified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing(monkeypatch, 2, PepperError("the robot was stopped: it fell"))
    first, second = identified(tmp_path, 2, 4)
    assert (first.state, first.reason) == ("failed", "the robot was stopped: it fell")
    assert first.file is None
    assert second.state == "identified"
    failing(monkeypatch, 2, ZeroDivisionError("a defect\nof two lines"))
    first, second = identified(tmp_path, 2, 4)
    assert (first.state, first.reason) == ("failed", "ZeroDivisionError: a defect")
    assert second.state == "kept"
    monkeypatch.undo()
    assert [one.state for one in identified(tmp_path, 2, 4)] == ["identified", "kept"]


def test_a_robot_that_cannot_be_built_is_counted(tmp_path: Path) -> None:
    # Some draws have a gap that is wider than the range of the hands.
    mine = {"name": "mine", "extends": "random", "factors": {"half_gap": {"LHand": 50.0}}}
    uri = f"mujoco://?plant={save(tmp_path, mine)}"
    robots = identified(tmp_path / "out", *range(4), uri=uri)
    states = {one.draw: one.state for one in robots}
    assert set(states.values()) == {"failed", "identified"}
    for one in robots:
        assert ("half_gap" in one.reason) == (one.state == "failed")


def test_what_was_interrupted_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, runs: list[tuple[str, str]]
) -> None:
    failing(monkeypatch, 4, KeyboardInterrupt(), after=2)
    with pytest.raises(KeyboardInterrupt):
        identified(tmp_path, 2, 4)
    (recordings,) = tmp_path.glob("*-recordings")
    kept = {path.stem for path in recordings.glob("*.npz")}
    assert recordings.name.startswith("random-4-")
    assert len(kept) == 2
    monkeypatch.undo()
    performed: list[str] = []

    def counted(uri: str, run: IdentificationRun, **options: str) -> Recording:
        performed.append(run.name)
        return perform(uri, run, identity=options["identity"])

    monkeypatch.setattr(identify_module, "perform", counted)
    assert [one.state for one in identified(tmp_path, 2, 4)] == ["kept", "identified"]
    assert len(performed) == 1
    assert performed[0] not in kept
    assert not recordings.exists()


def test_kept_recordings_serve_the_next_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, runs: list[tuple[str, str]]
) -> None:
    first = identified(tmp_path, 2, keep_recordings=True)
    assert runs
    runs.clear()
    apart = population_module._APART
    # As if a file of the observer had changed.
    monkeypatch.setattr(
        population_module,
        "sources_hash",
        lambda patterns: "changed" if patterns == apart else sources_hash(patterns),
    )
    (again,) = identified(tmp_path, 2)
    assert again.state == "identified"
    assert not runs
    assert again.file is not None
    assert first[0].file is not None
    assert again.file != first[0].file
    assert ModelSet.load(again.file) == ModelSet.load(first[0].file)
    assert not list(tmp_path.glob("*-recordings"))


def test_what_drives_a_robot_counts_for_its_recordings() -> None:
    names = (
        "robot.py",
        "session.py",
        "identification/runs.py",
        "observer/recording.py",
        "controller/qp.py",
    )
    patterns = (*population_module._APART, *population_module._NOT_RECORDED)
    for name in (*names, "config/controller.yaml", "backends/mujoco_/motors.py"):
        assert not any(fnmatchcase(name, pattern) for pattern in patterns)
    for name in ("observer/residuals/fusion.py", "identification/fit.py"):
        assert any(fnmatchcase(name, pattern) for pattern in patterns)


def test_motions_of_the_measurement_count_where_robots_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders: list[str] = []

    def refused(uri: str, joints: object, experiment: object, folder: Path, **_: object) -> None:
        folders.append(folder.name)
        raise PepperError("not now")

    def changed(name: str, robot: RobotConfig) -> Experiment:
        experiment = load_experiment(name, robot)
        return replace(experiment, stiffness=0.5) if name == FRICTION else experiment

    monkeypatch.setattr(population_module, "record_joints", refused)
    weight = held_weight(0.5, "left")
    identified(tmp_path, 2)
    identified(tmp_path, 2, weight=weight)
    monkeypatch.setattr(population_module, "load_experiment", changed)
    identified(tmp_path, 2)
    identified(tmp_path, 2, weight=weight)
    alone, weighed, again, otherwise = folders
    assert alone == again
    assert len({alone, weighed, otherwise}) == 3


def test_draws_for_tests_are_refused_before_anything_moves(
    tmp_path: Path, runs: list[tuple[str, str]]
) -> None:
    for draws in ([100], [0, 1, 119]):
        with pytest.raises(HeldOutDrawError, match=f"draw {draws[-1]} is held out"):
            identified(tmp_path / "out", *draws)
    assert not runs
    assert not (tmp_path / "out").exists()


@pytest.fixture
def other(tmp_path: Path) -> str:
    """Another population: its robots that are held out are not those of the test split."""
    path = tmp_path / "other.yaml"
    section = "{factors: {kp: [0.9, 1.1]}, values: {}, model_error: [0.0, 0.0]}"
    path.write_text(f"name: other\ndescription: other\nextends: nominal\nrandomise: {section}\n")
    return f"mujoco://?plant={path}"


def test_inside_the_block_draws_for_tests_are_identified_in_other_processes(
    tmp_path: Path, other: str
) -> None:
    with allow_test_draws():
        robots = identified(tmp_path / "out", 100, 101, workers=2, uri=other)
    assert [one.state for one in robots] == ["identified", "identified"]
    assert [one.name for one in robots] == ["other-100", "other-101"]
    with pytest.raises(HeldOutDrawError):
        identified(tmp_path / "out", 100, workers=2, uri=other)


def test_inside_the_block_every_robot_is_allowed_however_late_it_is_sent(
    tmp_path: Path, other: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other threads send the later jobs."""

    def in_a_thread(jobs: Iterable[Callable[[], object]], **_: object) -> Iterator[object]:
        with ThreadPoolExecutor(1) as pool:
            sent = pool.submit(list, jobs).result()
            return iter(pool.submit(lambda: [job() for job in sent]).result())

    monkeypatch.setattr(population_module, "run_jobs", in_a_thread)
    monkeypatch.setattr(
        population_module, "record_joints", lambda uri, *_, **__: make_backend(uri, ROBOT)
    )
    monkeypatch.setattr(population_module, "fit_folder", lambda *_, **__: ended("it is there"))
    with allow_test_draws():
        robots = identified(tmp_path / "out", 100, 101, uri=other)
    assert [one.reason for one in robots] == ["it is there", "it is there"]


def ended(reason: str) -> None:
    raise PepperError(reason)


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("mujoco", "draws nothing"),
        ("mujoco://?plant=random&draw=2", "its draw has no meaning next to a list of draws"),
        ("mujoco://?plant=randon", "did you mean random"),
        ("mock", "unknown key 'draw'"),
        ("naoqi://127.0.0.1", "unknown key 'draw'"),
    ],
)
def test_a_backend_without_draws_is_refused(tmp_path: Path, uri: str, message: str) -> None:
    with pytest.raises((ConfigError, PepperError), match=message):
        identified(tmp_path / "out", 0, 1, uri=uri)
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="there is a file of this name"):
        identified(tmp_path / "file", 0)


def test_a_joint_that_is_not_in_the_models_is_a_warning(
    made: tuple[IdentifiedRobot, ...],
) -> None:
    report = json.loads(json.dumps(made[0].report))
    (found,) = made[0].warnings
    assert found.startswith(f"{JOINT}: too little excitation")
    report["fit"]["affine"][JOINT]["test"] = -3.0
    report["warnings"] = [{"kind": "gaps", "joint": None, "run": "calibration-1", "text": "gaps"}]
    assert replace(made[0], report=report).warnings == (
        "calibration-1: gaps",
        f"{JOINT}: its model predicts the test run no better than a constant (-3 %)",
    )
