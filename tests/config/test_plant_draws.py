"""Plants drawn at random; and any numbers at all, which give a plant or one line of error."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config import ConfigError, load_plant, plant_hash
from support.examples import examples
from support.plant_files import (
    ROBOT,
    Tree,
    nominal,
    numbers,
    variant,
)

DRAWN = {
    "factors": {"kp": [0.8, 1.25], "friction.gap.link": [0.5, 0.5]},
    "values": {"battery.charge": [0.2, 0.9], "transport.late": [0.1, 0.1]},
    "model_error": [0.03, 0.08],
}


def test_draws_are_reproducible_and_differ(tmp_path: Path) -> None:
    path = variant(tmp_path, randomise=DRAWN)
    plants = [load_plant(path, ROBOT, draw=draw) for draw in (0, 1, 2)]
    assert load_plant(path, ROBOT, draw=1) == plants[1]
    assert load_plant(path, ROBOT) == plants[0]
    assert len({plant_hash(plant, ROBOT) for plant in plants}) == 3
    assert [plant.name for plant in plants] == ["mine-0", "mine-1", "mine-2"]


def test_draws_stay_within_their_bounds(tmp_path: Path) -> None:
    path, first = variant(tmp_path, randomise=DRAWN), load_plant("nominal", ROBOT)
    factors, charges, errors = [], [], []
    for draw in range(30):
        plant = load_plant(path, ROBOT, draw=draw)
        factors += list(plant.per_joint("kp", ROBOT) / first.per_joint("kp", ROBOT))
        np.testing.assert_allclose(
            plant.per_joint("friction.gap.link", ROBOT),
            0.5 * first.per_joint("friction.gap.link", ROBOT),
        )
        charges.append(plant.battery.charge)
        errors += [abs(mass - 1) for mass in plant.body.masses.values()]
        assert plant.transport.late == pytest.approx(0.1)
        assert set(plant.body.coms) == set(plant.body.masses) < set(ROBOT.links)
    assert 0.8 <= min(factors) < 0.85
    assert 1.2 < max(factors) <= 1.25
    assert np.mean(np.log(factors)) == pytest.approx(0.0, abs=0.02), "even in the logarithm"
    assert 0.2 <= min(charges) < max(charges) <= 0.9
    assert 0.03 <= min(errors) < 0.04
    assert 0.07 < max(errors) <= 0.08


def test_a_draw_where_nothing_is_drawn_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="randomise"):
        load_plant("nominal", ROBOT, draw=3)
    load_plant(variant(tmp_path), ROBOT)


@pytest.mark.parametrize(
    ("drawing", "message"),
    [
        ({"factors": {"kp": [1.2, 0.8]}}, "above the upper"),
        ({"factors": {"kp": [0.0, 0.8]}}, "factors.kp.0"),
        ({"factors": {"kpp": [0.5, 0.8]}}, "no number has this key"),
        ({"values": {"battery.charge": [0.9, 0.2]}}, "above the upper"),
        ({"values": {"battery.charge": [2.0, 2.0]}}, "battery.charge"),
        ({"values": {"battery.chrge": [0.2, 0.2]}}, "did you mean battery.charge"),
        ({"values": {"flexibilities.7.stiffness": [1.0, 2.0]}}, "no number has this key"),
        ({"model_error": [0.5, 0.1]}, "above the upper"),
        ({"model_error": [0.5, 1.0]}, "must be below 1"),
    ],
)
def test_a_wrong_drawing_is_refused(tmp_path: Path, drawing: Tree, message: str) -> None:
    whole = {"factors": {}, "values": {}, "model_error": [0.0, 0.0], **drawing}
    with pytest.raises(ConfigError, match=r"mine\.yaml") as caught:
        load_plant(variant(tmp_path, randomise=whole), ROBOT)
    assert message in str(caught.value)


KEYS = [".".join(map(str, path)) for path in numbers(nominal()["actuators"][0])]
OTHERS = [".".join(map(str, p)) for p in numbers(nominal()) if p[0] != "actuators"]
ANY = (
    st.floats(-1e300, 1e300)
    | st.integers()
    | st.floats(1e-3, 1e3)
    | st.sampled_from([math.inf, math.nan])
)
BY_JOINT = st.dictionaries(st.sampled_from(ROBOT.joint_names), ANY, max_size=3)


@examples(100)
@given(st.dictionaries(st.sampled_from(KEYS), ANY | BY_JOINT, max_size=3))
def test_any_factor_gives_a_plant_or_one_line(
    tmp_path_factory: pytest.TempPathFactory, factors: Tree
) -> None:
    path = variant(tmp_path_factory.mktemp("plant"), factors=factors)
    try:
        plant = load_plant(path, ROBOT)
    except ConfigError as error:
        assert str(error).startswith(path)
        assert "\n" not in str(error)
    else:
        for key in KEYS:
            values = plant.per_joint(key, ROBOT)
            assert np.isfinite(values).all()
            assert (values >= 0).all()


PAIR = st.tuples(ANY, ANY).map(list) | st.tuples(st.floats(0, 1e300), st.floats(0, 1e300)).map(
    sorted
)
EVEN = st.sampled_from([[0.0, 0.0], [0.01, 0.1]])


@examples(150)
@given(
    st.dictionaries(st.sampled_from(KEYS), PAIR, max_size=2),
    st.dictionaries(st.sampled_from(OTHERS), PAIR, max_size=2),
    EVEN | PAIR,
    st.dictionaries(st.sampled_from(KEYS), PAIR, max_size=2),
    st.dictionaries(st.sampled_from(OTHERS), st.tuples(ANY, ANY).map(list), max_size=1),
    st.integers(0, 2**40),
    st.integers(0, 2**40),
)
def test_any_drawing_gives_a_plant_or_one_line(
    tmp_path_factory: pytest.TempPathFactory,
    factors: Tree,
    values: Tree,
    error: list[float],
    offsets: Tree,
    integers: Tree,
    draw: int,
    day: int,
) -> None:
    first = {"factors": factors, "values": values}
    drawing = {
        **first,
        "model_error": error,
        "offsets": offsets,
        "integers": integers,
        "days": first,
    }
    path = variant(tmp_path_factory.mktemp("plant"), randomise=drawing)
    try:
        plant = load_plant(path, ROBOT, draw=draw, day=day)
    except ConfigError as problem:
        assert str(problem).startswith(path)
    else:
        assert plant.name == (f"mine-{draw}-day-{day}" if day else f"mine-{draw}")


@pytest.mark.parametrize(
    "keys",
    [
        {"factors": {"kp": 10**400}},
        {
            "randomise": {
                "factors": {},
                "values": {"battery.charge": [-1.7e308, 1.7e308]},
                "model_error": [0.0, 0.0],
            }
        },
    ],
)
def test_numbers_beyond_all_measure_are_refused(tmp_path: Path, keys: Tree) -> None:
    with pytest.raises(ConfigError):
        load_plant(variant(tmp_path, **keys), ROBOT)


def test_a_draw_is_counted_from_zero() -> None:
    with pytest.raises(ConfigError, match="draw takes a whole number from 0, got -1"):
        load_plant("random", ROBOT, draw=-1)
