"""Draws for development and draws held out for tests; lists of draws; days of a robot."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config import (
    ConfigError,
    RobotIdentity,
    draws,
    load_plant,
    parent_plants,
    plant_hash,
)
from pepper_driver.config.loading import package_file, read_yaml
from pepper_driver.config.plant import plant_names
from pepper_driver.config.population import (
    MAX_DRAWS,
    HeldOutDrawError,
    allow_test_draws,
    parse_draws,
    with_same_draws,
)
from pepper_driver.config.workers import run_jobs
from support.examples import examples
from support.plant_files import ROBOT, Tree, save

DAYS = {"factors": {"friction.load": [0.5, 2.0]}, "values": {"battery.charge": [0.2, 0.9]}}
DRAWN = {
    "factors": {"kp": [0.8, 1.25]},
    "values": {"battery.charge": [0.2, 0.9]},
    "model_error": [0.0, 0.05],
    "days": DAYS,
}


def population(folder: Path, name: str = "mine.yaml", **keys: object) -> str:
    tree = {"name": "mine", "description": "", "extends": ["nominal", "integral"], **keys}
    return save(folder, {"randomise": DRAWN, **tree}, name)


def identity_of(plant: str, draw: int | None = None, day: int | None = None) -> RobotIdentity:
    made = load_plant(plant, ROBOT, draw=draw, day=day)
    return RobotIdentity(name=made.name, identity=plant_hash(made, ROBOT))


def has_integral(draw: int) -> bool:
    return any(drive.ki > 0 for drive in load_plant("random", ROBOT, draw=draw).actuators)


# -- lists of draws ---------------------------------------------------------------------------------------------------

RANGES = st.lists(st.tuples(st.integers(0, 30), st.integers(0, 5)), min_size=1, max_size=6)


@examples(200)
@given(RANGES)
def test_a_list_of_draws_is_what_its_ranges_hold(ranges: list[tuple[int, int]]) -> None:
    text = ",".join(f"{first}-{first + more}" if more else str(first) for first, more in ranges)
    numbers = [number for first, more in ranges for number in range(first, first + more + 1)]
    if len(set(numbers)) < len(numbers):
        with pytest.raises(ConfigError, match="give a draw twice"):
            parse_draws(text)
    else:
        assert parse_draws(text) == tuple(numbers)
        assert parse_draws(f" {text.replace(',', ' , ')} ") == tuple(numbers)


@examples(300)
@given(st.text() | st.text(alphabet="0123456789-, ٣²", max_size=20))
def test_any_text_is_a_list_of_draws_or_one_line(text: str) -> None:
    try:
        numbers = parse_draws(text)
    except ConfigError as error:
        assert str(error).startswith("draws: ")
        assert len(str(error).splitlines()) == 1
    else:
        assert 0 < len(numbers) <= MAX_DRAWS
        assert len(set(numbers)) == len(numbers)
        assert min(numbers) >= 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected numbers and ranges such as 0-19"),
        ("-3", "expected numbers"),
        ("1.5", "expected numbers"),
        ("0-", "expected numbers"),
        ("0,,2", "expected numbers"),
        ("7-3", "the range 7-3 ends before it begins"),
        ("0-3,2", "give a draw twice"),
        ("0-1000", "more than 1000"),
        ("0-999999999999", "more than 1000"),
        ("0-600,700-1300", "more than 1000"),
    ],
)
def test_a_wrong_list_of_draws_is_refused(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_draws(text)


# -- draws held out ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("draw", [100, 119, 10**17])
def test_draws_for_tests_are_refused_for_every_caller(tmp_path: Path, draw: int) -> None:
    extending = save(tmp_path, {"name": "mine", "extends": "random"})
    for plant in ("random", extending):
        for ask in (
            partial(load_plant, plant, ROBOT, draw=draw),
            partial(load_plant, plant, ROBOT, draw=draw, day=2),
            partial(parent_plants, plant, ROBOT, draw=draw),
        ):
            with pytest.raises(HeldOutDrawError) as caught:
                ask()
            message = str(caught.value)
            assert f"draw {draw} is held out for the test split" in message
            assert "for development there are 0 to 99" in message
            assert len(message.splitlines()) == 1


def test_draws_for_tests_are_allowed_inside_the_block_alone() -> None:
    with allow_test_draws():
        with allow_test_draws():
            pass
        assert load_plant("random", ROBOT, draw=100).name == "random-100"
        assert parent_plants("random", ROBOT, draw=101, day=1)[0] == identity_of("random", 101)
    with pytest.raises(HeldOutDrawError):
        load_plant("random", ROBOT, draw=100)
    with pytest.raises(KeyError), allow_test_draws():
        raise KeyError  # whatever happens inside
    with pytest.raises(HeldOutDrawError):
        load_plant("random", ROBOT, draw=100)


def name_of(draw: int) -> str:
    try:
        return load_plant("random", ROBOT, draw=draw).name
    except HeldOutDrawError:
        return "refused"


@pytest.mark.parametrize("workers", [1, 2])
def test_a_job_takes_what_is_allowed_to_its_process(workers: int) -> None:
    jobs: list[Callable[[], str]] = [partial(name_of, draw) for draw in (99, 100)]
    assert list(run_jobs(map(with_same_draws, jobs), workers=workers)) == ["random-99", "refused"]
    with allow_test_draws():
        allowed = [with_same_draws(job) for job in jobs]
    # Also where the worker has done other jobs before, and none but this one is allowed.
    several = [jobs[1], allowed[1], jobs[1], allowed[0]]
    expected = ["refused", "random-100", "refused", "random-99"]
    assert list(run_jobs(several, workers=workers)) == expected


def test_they_are_refused_for_every_plant_that_is_drawn() -> None:
    for plant in plant_names():
        if draws(plant, ROBOT):
            load_plant(plant, ROBOT, draw=99)
            with pytest.raises(HeldOutDrawError):
                load_plant(plant, ROBOT, draw=100)


SECTION = read_yaml(package_file("plants", "random.yaml"))["randomise"]
SECTIONS = st.sampled_from(
    [{}, {"randomise": None}, {"randomise": {}}, {"randomise": SECTION}, {"randomise": DRAWN}]
)
PARENTS = st.sampled_from(
    ["random", "nominal", ["random"], ["random", "nominal"], ["nominal", "integral"]]
)
LINK = st.tuples(st.none() | PARENTS, SECTIONS)


@examples(200)
@given(PARENTS, st.lists(LINK, min_size=1, max_size=4), st.integers(0, 2**70))
def test_no_chain_of_files_reaches_them(
    tmp_path_factory: pytest.TempPathFactory,
    parent: Tree,
    links: list[tuple[Tree, Tree]],
    draw: int,
) -> None:
    """Each file extends the one before, or others, with or without a section of its own."""
    folder = tmp_path_factory.mktemp("chain")
    for number, (others, section) in enumerate(links):
        extended = parent if number == 0 else others or f"{number - 1}.yaml"
        path = save(folder, {"name": "mine", "extends": extended, **section}, f"{number}.yaml")
    try:
        plant = load_plant(path, ROBOT, draw=draw)
    except ConfigError:  # also where nothing is drawn, or a list has no section
        return
    assert draw < 100
    assert plant.name == f"mine-{draw}"


@pytest.mark.parametrize("number", [2, 100, None])
def test_a_file_sets_no_limit_of_its_own(tmp_path: Path, number: int | None) -> None:
    section = {**DRAWN, "development": number}
    with pytest.raises(ConfigError, match="unknown key 'development'"):
        load_plant(population(tmp_path, randomise=section), ROBOT)


# -- both laws --------------------------------------------------------------------------------------------------------


def test_draws_take_the_plants_of_a_list_in_turn(tmp_path: Path) -> None:
    path = population(tmp_path)
    for draw in range(4):
        law = ("nominal", "integral")[draw % 2]
        first, plant = load_plant(law, ROBOT), load_plant(path, ROBOT, draw=draw)
        np.testing.assert_allclose(plant.per_joint("ki", ROBOT), first.per_joint("ki", ROBOT))
        assert identity_of(law) in parent_plants(path, ROBOT, draw=draw)
        assert (identity_of("integral") in parent_plants(path, ROBOT, draw=draw)) == (draw % 2 == 1)
    assert load_plant(path, ROBOT) == load_plant(path, ROBOT, draw=0)
    assert draws(path, ROBOT)


def test_a_plant_that_extends_a_population_draws_the_same_laws(tmp_path: Path) -> None:
    path = save(tmp_path, {"name": "mine", "extends": "random", "heat": {"reference": 40.0}})
    for draw in (2, 3):
        assert parent_plants(path, ROBOT, draw=draw)[0] == identity_of("random", draw)
        own, first = load_plant(path, ROBOT, draw=draw), load_plant("random", ROBOT, draw=draw)
        np.testing.assert_array_equal(own.per_joint("ki", ROBOT), first.per_joint("ki", ROBOT))


def test_the_population_has_as_many_robots_of_either_law() -> None:
    assert sum(map(has_integral, range(100))) == 50
    with allow_test_draws():
        assert sum(map(has_integral, range(100, 120))) == 10


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"extends": []}, "expected the name of a plant, or a list of names, got a list"),
        ({"extends": [["nominal"]]}, "expected the name of a plant"),
        ({"extends": [7]}, "expected the name of a plant"),
        ({"extends": ["nominal", "integrel"]}, "did you mean integral"),
        ({"randomise": None}, "nothing is drawn here"),
    ],
)
def test_a_wrong_list_of_plants_is_refused(tmp_path: Path, keys: Tree, message: str) -> None:
    with pytest.raises(ConfigError, match=r"mine\.yaml line \d+: key 'extends'") as caught:
        load_plant(population(tmp_path, **keys), ROBOT)
    assert message in str(caught.value)


def test_a_list_is_no_way_out_of_a_plant_that_extends_itself(tmp_path: Path) -> None:
    path = population(tmp_path, extends=["nominal", "mine.yaml"])
    load_plant(path, ROBOT, draw=0)
    with pytest.raises(ConfigError, match="extends itself"):
        load_plant(path, ROBOT, draw=1)


# -- offsets and integers ---------------------------------------------------------------------------------------------


def test_integers_are_drawn_with_both_ends(tmp_path: Path) -> None:
    drawing = {**DRAWN, "integers": {"transport.command_delay": [1, 3]}}
    path = population(tmp_path, randomise=drawing)
    drawn = [load_plant(path, ROBOT, draw=draw).transport.command_delay for draw in range(90)]
    assert set(drawn) == {1, 2, 3}
    assert min(drawn.count(number) for number in (1, 2, 3)) > 15, "with equal probability"


def test_offsets_are_added_to_each_joint(tmp_path: Path) -> None:
    path = population(tmp_path, randomise={**DRAWN, "offsets": {"friction.ripple": [0.1, 0.2]}})
    ripple = load_plant(path, ROBOT, draw=3).per_joint("friction.ripple", ROBOT)
    assert len(set(ripple)) == len(ROBOT.joint_names)
    assert 0.1 <= ripple.min() < ripple.max() <= 0.2


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"integers": {"transport.command_delay": [3, 1]}}, "above the upper"),
        ({"integers": {"transport.command_delay": [1.5, 3]}}, "command_delay.0"),
        ({"integers": {"transport.command_delay": [30, 40]}}, "transport.command_delay"),
        ({"integers": {"transport.comand_delay": [1, 3]}}, "did you mean transport.command_delay"),
        ({"offsets": {"friction.riple": [0.0, 0.1]}}, "did you mean friction.ripple"),
        ({"offsets": {"friction.ripple": [0.1, 0.0]}}, "above the upper"),
        ({"offsets": {"friction.ripple": [-0.5, -0.4]}}, "ripple"),
        ({"days": {"factors": {}}}, "values"),
        ({"days": {**DAYS, "factors": {"kpp": [1.0, 2.0]}}}, "randomise.days.factors.kpp"),
        ({"days": {**DAYS, "values": {"heat.strt": [1.0, 2.0]}}}, "did you mean heat.start"),
        ({"days": {**DAYS, "values": {"heat.start": [2.0, 1.0]}}}, "above the upper"),
        ({"days": [1]}, "days"),
    ],
)
def test_a_wrong_population_is_refused(tmp_path: Path, keys: Tree, message: str) -> None:
    with pytest.raises(ConfigError, match=r"mine\.yaml") as caught:
        load_plant(population(tmp_path, randomise={**DRAWN, **keys}), ROBOT, draw=1, day=1)
    assert message in str(caught.value)


# -- days -------------------------------------------------------------------------------------------------------------


def test_a_day_changes_what_the_plant_says_and_nothing_else() -> None:
    first, other = (load_plant("random", ROBOT, draw=3, day=day) for day in (0, 4))
    assert first == load_plant("random", ROBOT, draw=3)
    assert (first.name, other.name) == ("random-3", "random-3-day-4")
    for key in ("kp", "ki", "kd", "half_gap", "dead_band", "friction.load", "friction.breakaway"):
        np.testing.assert_array_equal(first.per_joint(key, ROBOT), other.per_joint(key, ROBOT))
    ratio = other.per_joint("friction.contact.motor", ROBOT) / first.per_joint(
        "friction.contact.motor", ROBOT
    )
    assert 0.79 < ratio.min() < ratio.max() < 1.26
    assert len(set(ratio)) == len(ROBOT.joint_names)
    assert first.transport == other.transport
    assert first.body.masses == other.body.masses
    assert first.battery.charge != other.battery.charge
    assert first.heat.start != other.heat.start
    assert first.body.payloads[0].mass != other.body.payloads[0].mass


def test_days_are_reproducible_and_differ_by_draw_and_day() -> None:
    days = [(draw, day) for draw in (3, 5) for day in (0, 1, 2)]
    made = [identity_of("random", draw, day).identity for draw, day in days]
    assert len(set(made)) == len(days)
    assert made == [identity_of("random", draw, day).identity for draw, day in days]


def test_models_of_the_first_day_serve_the_others() -> None:
    own, law, nominal = identity_of("random", 3), identity_of("integral"), identity_of("nominal")
    assert parent_plants("random", ROBOT, draw=3, day=2) == (own, law, nominal)
    assert parent_plants("random", ROBOT, draw=3, day=0) == (law, nominal)
    assert parent_plants("random", ROBOT, draw=3) == (law, nominal), "another robot is no parent"


def test_days_without_a_draw_are_those_of_the_first_robot() -> None:
    assert load_plant("random", ROBOT, day=2) == load_plant("random", ROBOT, draw=0, day=2)


@pytest.mark.parametrize("plant", ["nominal", "drift"])
def test_a_day_where_days_are_alike_is_refused(plant: str) -> None:
    for day in (0, 1):
        with pytest.raises(
            ConfigError, match=rf"{plant}\.yaml: all days .* day={day} says nothing"
        ):
            load_plant(plant, ROBOT, day=day)


def test_a_day_is_counted_from_zero() -> None:
    with pytest.raises(ConfigError, match="day takes a whole number from 0, got -1"):
        load_plant("random", ROBOT, draw=1, day=-1)


def test_every_robot_for_development_loads() -> None:
    assert len({identity_of("random", draw).identity for draw in range(100)}) == 100
