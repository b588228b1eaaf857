"""Observers of the judge, each against what makes it that observer, and their walk over a take."""

import logging
import math
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends.selection import parse_uri
from pepper_driver.config import (
    RobotIdentity,
    UnknownNameError,
    load_observer_settings,
    load_plant,
    plant_hash,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import ArgumentError
from pepper_driver.config.evaluation_baselines import STATIC_BASELINES, EvaluationBaselines
from pepper_driver.controller import Tick
from pepper_driver.evaluation.touch import observers as module
from pepper_driver.evaluation.touch.observers import (
    ABLATIONS,
    BASELINES,
    DEFAULT,
    OBSERVERS,
    ModelFiles,
    make,
    oracle_uri,
    watch_all,
)
from pepper_driver.evaluation.touch.records import Touched
from pepper_driver.observer import (
    Contact,
    FusionModel,
    ModelFileError,
    ModelKind,
    ModelSet,
    Observation,
    Observer,
    Recording,
    shipped,
)
from pepper_driver.observer.constants import BIAS_TIME, CONFIRMING_RATIO, HELD_FACTOR
from pepper_driver.observer.detection.threshold import REST, SLIDING, identified_thresholds
from pepper_driver.observers import make_observer
from support.evaluation import CYCLE, INDEX, JOINT, JOINTS, ROBOT, Script, contact, recording

FILES = ModelFiles(
    fusion=shipped("fusion")["nominal"],
    affine=shipped("affine")["nominal"],
    cart=shipped("cart")["nominal"],
)
FUSION_MODELS = ModelSet.load(FILES.fusion)
FACTORS = dict(zip(STATIC_BASELINES, (2.0, 3.0, 4.0, 5.0), strict=True))
BASELINE_FACTORS = EvaluationBaselines(version=1, factors=FACTORS, chosen_on="a test")
PAPER = np.radians(2.5)


def moving(seconds: float = 4.0) -> Recording:
    """A shoulder that is to move for the first seconds, of which its encoder shows nothing for the last of them."""
    run = recording(seconds)
    time = run.time
    columns: dict[str, Any] = {}
    for name, values in (
        ("sent_position", 0.3 * np.sin(2.0 * time)),
        ("velocity", 0.6 * np.cos(2.0 * time)),
        ("acceleration", -1.2 * np.sin(2.0 * time)),
        ("load_torque", 1.0 + 0.5 * np.sin(2.0 * time)),
    ):
        column = np.zeros((len(run), JOINTS))
        column[:, INDEX] = values
        columns[name] = column
    position = columns["sent_position"].copy()
    late = time > seconds - 1.0
    position[late] -= 0.2 * np.sin(np.pi * (time[late, None] - seconds + 1.0))
    # Its motors work against that.
    current = 60.0 * np.abs(columns["sent_position"] - position)
    return replace(run, position=position, current=current, **columns)


RUN = moving()


def aside(run: Recording, joint: int, first: int, current_change: float = 0.3) -> Recording:
    """The same with a joint that stands aside from this tick on; its motor works against that [A]."""
    position, current = run.position.copy(), run.current.copy()
    position[first:, joint] -= 0.003
    current[first:, joint] += current_change
    return replace(run, position=position, current=current)


def observe(
    observer: Observer, run: Recording = RUN, ticks: int | None = None
) -> list[Observation]:
    observer.reset()
    return [observer.step(tick) for tick in islice(run.ticks(), ticks)]


def by_joint(value: Callable[[FusionModel], float]) -> FloatArray:
    found = [FUSION_MODELS.models[name] for name in ROBOT.joint_names]
    return np.array([value(m) for m in found if isinstance(m, FusionModel)])


def made(name: str) -> Observer:
    return make(name, ROBOT, FILES, baselines=BASELINE_FACTORS)


def begins(observations: list[Observation]) -> list[Contact]:
    return [c for o in observations for c in o.contacts if c.phase == "begin"]


def test_each_name_is_made_and_no_other() -> None:
    assert set(DEFAULT) <= set(OBSERVERS) == {"fusion", *BASELINES, *ABLATIONS}
    assert len(set(OBSERVERS)) == len(OBSERVERS) == 1 + 4 + 4 + 2 + 10
    with pytest.raises(UnknownNameError, match=r"'fusion-without-models'.*fusion-without-model"):
        made("fusion-without-models")
    with pytest.raises(UnknownNameError, match="momentum-adaptive@matched"):
        made("momentum-adaptive@matched")
    with pytest.raises(ArgumentError, match="the oracle needs the recording"):
        made("oracle")


def test_ours_is_the_observer_as_users_have_it() -> None:
    identity = plant_hash(load_plant("nominal", ROBOT), ROBOT)
    users = make_observer("fusion", ROBOT, [RobotIdentity(name="nominal", identity=identity)])
    theirs, ours = observe(users), observe(made("fusion"))
    assert any(o.contacts for o in ours)
    for one, other in zip(ours, theirs, strict=True):
        assert one.contacts == other.contacts
        np.testing.assert_array_equal(one.residual, other.residual)
        np.testing.assert_array_equal(one.threshold, other.threshold)


@pytest.mark.parametrize("name", STATIC_BASELINES)
def test_a_static_baseline_has_its_threshold_and_a_matched_one(name: str) -> None:
    own = np.full(JOINTS, PAPER)
    if name == "momentum":
        own = by_joint(lambda m: m.momentum_bound)
    plain, matched = observe(made(name)), observe(made(f"{name}@matched"))
    for one, other in zip(plain[::20], matched[::20], strict=True):
        np.testing.assert_allclose(one.threshold, own, rtol=1e-12)
        np.testing.assert_allclose(other.threshold, FACTORS[name] * own, rtol=1e-12)
        np.testing.assert_array_equal(one.residual, other.residual)


def test_what_a_static_baseline_expects() -> None:
    features = RUN.features(INDEX)
    kinds: dict[str, ModelKind] = {"paper-affine": "affine", "paper-cart": "cart"}
    for name, kind in kinds.items():
        tree = ModelSet.load(shipped(kind)["nominal"]).models[JOINT]
        assert not isinstance(tree, FusionModel)
        said = [o.expected[INDEX] for o in observe(made(name), ticks=100)]
        np.testing.assert_array_equal(said, tree.predict(features[:100]))
    assert all((o.expected == 0.0).all() for o in observe(made("error"), ticks=100))


def thresholds(phase: int) -> FloatArray:
    """Thresholds of joints alone in a phase of the motion, as identified."""
    false_contacts = load_observer_settings().false_contacts
    return by_joint(lambda m: float(identified_thresholds(m, false_contacts)[phase]))


def first_thresholds() -> FloatArray:
    """Thresholds of the first tick, in which one joint is to move and friction holds it."""
    first = thresholds(REST)
    first[INDEX] *= HELD_FACTOR
    return first


def test_momentum_with_our_threshold() -> None:
    """The residual of ours by the current alone, each joint by its spread, and no base."""
    adaptive = observe(made("momentum-adaptive"), ticks=1)[0]
    bare = observe(made("fusion-without-model"), ticks=1)[0]
    np.testing.assert_array_equal(adaptive.residual, bare.residual)
    # No joint slides in the first tick; later one does, and its spread has begun to learn.
    np.testing.assert_allclose(adaptive.threshold, first_thresholds())
    later = observe(made("momentum-adaptive"), ticks=60)[-1].threshold / thresholds(REST)
    # Those of its arm are wider by what its hand may hold, and wait for that to show.
    slides = thresholds(SLIDING)[INDEX] / thresholds(REST)[INDEX]
    assert slides < later[INDEX] < 1.3 * slides
    arm = [ROBOT.joint_index(joint) for joint in ROBOT.limbs[ROBOT.limb_of(JOINT)]]
    # By the current alone it is touched once it slides, and shakes the others.
    np.testing.assert_allclose(np.delete(later, arm), HELD_FACTOR, rtol=0.05)
    wheels = np.zeros((len(RUN), 3))
    wheels[100:200] = 3.0
    pushed = replace(recording(len(RUN) * CYCLE), wheel_speed=wheels)
    assert not begins(observe(made("momentum-adaptive"), pushed))


def test_model_and_current_make_ours_where_they_agree() -> None:
    # Before their bias learns from residuals that differ.
    run = aside(recording(1.0), INDEX, 1)
    ours, model, current = (
        observe(made(name), run, ticks=2)[1].residual
        for name in ("fusion", "fusion-without-current", "fusion-without-model")
    )
    smaller = np.copysign(np.minimum(np.abs(model), np.abs(current)), model)
    np.testing.assert_allclose(ours, np.where(model * current > 0.0, smaller, 0.0), atol=1e-15)
    assert abs(model[INDEX] - current[INDEX]) > 1e-4


def test_without_adaptation_thresholds_are_those_identified() -> None:
    """Joints of a limb are judged together: their thresholds are lower by one factor."""
    fixed = observe(made("fusion-without-adaptation"), recording(8.0))
    ours = observe(made("fusion"), recording(8.0))
    fraction, own = fixed[-1].threshold / thresholds(REST), ours[-1].threshold / thresholds(REST)
    for joints in ROBOT.limbs.values():
        limb = [ROBOT.joint_index(joint) for joint in joints]
        assert fraction[limb].max() <= 1.0 + 1e-9
        assert np.ptp(fraction[limb]) < 1e-9
    assert (
        max(np.ptp(own[[ROBOT.joint_index(j) for j in limb]]) for limb in ROBOT.limbs.values())
        > 1e-3
    )


@pytest.mark.parametrize(("current", "decides"), [(0.3, "model"), (0.05, "current")])
def test_without_bias_the_residual_keeps_what_does_not_change(current: float, decides: str) -> None:
    """The residual of ours is that of the channel that decides, less a bias with its time constant."""
    # A joint of no arm: the loads of the hands, which this observer learns as well, are not in its torque.
    head = ROBOT.joint_index("HeadYaw")
    run = aside(recording(5.0), head, 1, current)
    ours, without, fixed, model = (
        np.array([o.residual[head] for o in observe(made(name), run)])
        for name in (
            "fusion",
            "fusion-without-bias",
            "fusion-without-adaptation",
            "fusion-without-current",
        )
    )
    np.testing.assert_array_equal(without, fixed)
    assert (without[20] < 0.8 * model[20]) == (decides == "current")
    for last in (100, 200, 400):
        left = math.exp(-(last - 20) * CYCLE / BIAS_TIME)
        assert ours[last] / ours[20] == pytest.approx(left * without[last] / without[20], rel=0.02)


def test_without_loads_the_residual_is_that_of_empty_hands() -> None:
    run = replace(RUN, position=RUN.sent_position - 0.001)
    ours, without = (
        np.array([o.residual for o in observe(made(name), run)])
        for name in ("fusion", "fusion-without-loads")
    )
    arms = [ROBOT.joint_index(name) for name in ROBOT.joint_names if name[0] in "LR"]
    others = [j for j in range(JOINTS) if j not in arms]
    # The others differ by the ticks in which their bias learns.
    change = np.abs(ours - without).max(axis=0)
    assert change[arms].max() > 1e-4 > 1e-6 > change[others].max()


def test_without_limbs_each_joint_is_judged_alone() -> None:
    ours, without = observe(made("fusion")), observe(made("fusion-without-limbs"))
    np.testing.assert_allclose(without[0].threshold[INDEX], first_thresholds()[INDEX])
    both, alone = (np.array([o.threshold for o in seen]) for seen in (ours, without))
    lower = np.array((both < alone - 1e-9).any(axis=0), dtype=np.bool_)
    assert lower[[ROBOT.joint_index("LElbowRoll"), INDEX]].all()


def test_without_confirmation_a_push_on_the_base_lowers_no_threshold() -> None:
    wheels = np.zeros((len(RUN), 3))
    wheels[100:200] = 3.0
    pushed = replace(aside(recording(len(RUN) * CYCLE), INDEX, 100), wheel_speed=wheels)
    ours, without = (
        np.array([o.threshold[INDEX] for o in observe(made(name), pushed)])
        for name in ("fusion", "fusion-without-confirmation")
    )
    assert ours[105] == pytest.approx(CONFIRMING_RATIO * without[105], rel=1e-6)
    np.testing.assert_allclose(ours[:100], without[:100])


def test_without_the_base_turned_wheels_are_not_detected() -> None:
    wheels = np.zeros((len(RUN), 3))
    wheels[100:200] = 3.0
    pushed = replace(recording(len(RUN) * CYCLE), wheel_speed=wheels)
    assert [c.link for c in begins(observe(made("fusion"), pushed))][:1] == ["base_link"]
    assert not begins(observe(made("fusion-without-base"), pushed))
    # The rule of the paper knows chains of joints, and no base.
    assert not begins(observe(made("fusion-without-isolation"), pushed))


def test_without_isolation_the_residuals_are_ours_and_the_events_the_papers() -> None:
    ours, without = observe(made("fusion")), observe(made("fusion-without-isolation"))
    first = next(row for row, o in enumerate(ours) if o.contacts)
    for one, other in zip(ours[:first], without[:first], strict=True):
        np.testing.assert_array_equal(one.residual, other.residual)
    assert begins(ours)[0].torque is not None
    assert begins(without)[0].torque is None


def test_models_must_be_of_one_robot_and_of_their_kind(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="has no models of kind 'cart'"):
        make("paper-cart", ROBOT, ModelFiles(fusion=FILES.fusion))
    foreign = shipped("affine")["integral"]
    with pytest.raises(ModelFileError, match="on another robot than"):
        make("paper-affine", ROBOT, replace(FILES, affine=foreign))
    with pytest.raises(ModelFileError, match="of kind 'cart', not 'fusion'"):
        make("fusion", ROBOT, replace(FILES, fusion=shipped("cart")["nominal"]))
    with pytest.raises(ModelFileError, match="no such file"):
        make("momentum", ROBOT, ModelFiles(fusion=tmp_path / "none.json"))


def test_the_oracle_is_the_drawn_robot_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def note(_: Recording, uri: str, __: object) -> FloatArray:
        asked.append(dict(parse_uri(uri).query))
        return np.full((1, JOINTS), 0.1)

    monkeypatch.setattr(module, "untouched_error", note)
    uri = oracle_uri("random", 7, 2) + "&seed=4&world=table"
    oracle = make("oracle", ROBOT, FILES, recording=RUN, uri=uri)
    make("oracle", ROBOT, FILES, recording=RUN, uri=oracle_uri("nominal"))
    assert asked == [
        {"plant": "random", "draw": "7", "day": "2", "seed": "4"},
        {"plant": "nominal"},
    ]
    assert observe(oracle, ticks=1)[0].expected[INDEX] == 0.1


# -- watching ---------------------------------------------------------------------------------------------------------

TOUCH = Touched(
    row="touches",
    place="hand",
    limb="left_arm",
    link="LForeArm",
    asked=12.0,
    force=12.0,
    rise=0.2,
    onset=2.0,
    release=3.0,
    torque={JOINT: 4.0, "LElbowRoll": -0.4},
    friction_bound=None,
    moving=False,
)
STILL = recording(6.0)
TIME = STILL.time


class Broken(Script):
    """Raises in one tick."""

    def step(self, tick: Tick) -> Observation:
        if self._row == 10:
            raise ZeroDivisionError("no\nreason")
        return super().step(tick)


def test_torques_are_means_over_the_plateau_of_joints_that_turn() -> None:
    estimate, true = np.full((len(TIME), JOINTS), 99.0), np.full((len(TIME), JOINTS), 77.0)
    plateau = (TIME >= 2.3) & (TIME <= 2.8)  # after the rise and 0.1 s, until the fall
    estimate[plateau] = np.where(np.arange(plateau.sum())[:, None] % 2, 3.0, np.nan)
    true[plateau] = np.where(np.arange(plateau.sum())[:, None] % 2, 4.0, 1000.0)
    late = replace(TOUCH, onset=4.0, release=4.53)  # two ticks are no plateau
    script = {"script": Script(torque=estimate)}
    found = watch_all(script, STILL, [late, TOUCH], ROBOT, true_torque=true)["script"].torques
    assert [(t.touch, t.joint, t.true, t.estimate) for t in found] == [(1, JOINT, 4.0, 3.0)]
    assert not watch_all(script, STILL, [TOUCH], ROBOT)["script"].torques
    # A tap has no rise to speak of, and is taken to need the minimum rise.
    tap = replace(TOUCH, rise=0.0, onset=2.1, release=2.9)
    assert watch_all(script, STILL, [tap], ROBOT, true_torque=true)["script"].torques == (
        replace(found[0], touch=0),
    )
    with pytest.raises(ArgumentError, match="true torques of shape"):
        watch_all(script, STILL, [TOUCH], ROBOT, true_torque=true[1:])


def test_thresholds_are_those_of_an_untouched_robot() -> None:
    threshold = np.full((len(TIME), JOINTS), np.radians(2.0))
    threshold[(TIME >= 1.0) & (TIME <= 5.3)] = 1.0
    threshold[TIME > 5.3, INDEX] = np.radians(4.0)
    threshold[:, 3] = np.nan
    touch = replace(TOUCH, onset=1.0, release=4.5)
    said = watch_all({"script": Script(threshold=threshold)}, STILL, [touch], ROBOT)["script"]
    # 1 s before the touch, 0.7 s after what follows it.
    assert said.threshold_deg[JOINT] == pytest.approx(2.0)
    assert said.threshold_deg["HipRoll"] == pytest.approx(2.0)
    assert "HeadYaw" not in said.threshold_deg
    assert len(said.threshold_deg) == JOINTS - 1


def test_one_that_fails_does_not_cost_the_others(caplog: pytest.LogCaptureFixture) -> None:
    events = (
        contact(1, 2.2),
        replace(contact(1, 3.1), phase="end"),
    )

    class Worn(Script):
        def step(self, tick: Tick) -> Observation:
            logging.getLogger("pepper_driver.observer.contact_observer").warning("has worn")
            return super().step(tick)

    contenders = {"broken": Broken(events), "good": Worn(events)}
    said = watch_all(contenders, STILL, [TOUCH], ROBOT)
    assert said["broken"].failure == "ZeroDivisionError: no reason"
    assert not said["broken"].events
    assert not caplog.records
    assert [(e.id, e.phase, e.joint) for e in said["good"].events] == [
        (1, "begin", JOINT),
        (1, "end", JOINT),
    ]
    # Once more: they were reset. Warnings are for real robots.
    again = watch_all(contenders, STILL, [TOUCH], ROBOT, warn=True)
    assert again["good"].events == said["good"].events
    assert len(caplog.records) == len(STILL)


def test_an_event_is_received_in_the_tick_that_reports_it() -> None:
    end = replace(contact(1, 2.2), phase="end")  # of a contact that fell 0.8 s ago

    class Late(Script):
        def step(self, tick: Tick) -> Observation:
            done = super().step(tick)
            said = (end,) if abs(tick.measurement.time - 3.0) < CYCLE / 2 else ()
            return replace(done, contacts=(*done.contacts, *said))

    events = watch_all({"late": Late((contact(1, 1.0),))}, STILL, [TOUCH], ROBOT)["late"].events
    assert [event.time for event in events] == pytest.approx([1.0, 3.0], abs=CYCLE)
