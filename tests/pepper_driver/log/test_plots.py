"""Pictures of a log: what is drawn, in which unit, and where it is written."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from pepper_driver.config import MissingExtraError, UnknownNameError, load_robot
from pepper_driver.figure_style import PlotError, joint_title
from pepper_driver.log import LogError, LogEvent, RunLog
from pepper_driver.log.plots import BAR, contact_figure, plot_contacts
from pepper_driver.log.topics import EventPhase
from pepper_driver.observer.interface import Contact

ROBOT = load_robot()
N = len(ROBOT.joint_names)
TICKS = 200
ROLL, ELBOW = (ROBOT.joint_index(name) for name in ("LShoulderRoll", "LElbowRoll"))


def contact(joint: str | None, onset: float, **changes: Any) -> Contact:
    values: dict[str, Any] = {
        "id": 1,
        "phase": "begin",
        "kind": "contact",
        "limb": ROBOT.limb_of(joint),
        "joint": "HeadYaw",  # another one than the one that is drawn
        "shown_by": joint,
        "link": "somewhere",
        "direction": 1,
        "intensity_deg": 3.0,
        "torque": None,
        "torque_std": None,
        "onset_time": onset,
        "detection_time": onset + 0.1,
        "time": onset + 0.1,
    }
    return Contact(**(values | changes))


@pytest.fixture
def log() -> RunLog:
    random = np.random.default_rng(0)
    time = np.arange(TICKS) * 0.012
    torque = np.zeros((TICKS, N))
    torque[50:80, ELBOW] = 4.0
    names = ("position", "sent_position", "reference_position", "expected", "residual")
    return RunLog(
        metadata={
            "backend": "mujoco://?plant=$worn$",
            "seed": "3",
            "start": "2026-11-25T09:19:05+00:00",
            "observer_name": "fusion",
        },
        complete=True,
        joint_names=ROBOT.joint_names,
        chains=ROBOT.chains,
        hand_joints=ROBOT.hands.joints,
        robot=ROBOT.name,
        fields={
            "time": time,
            "limited": np.zeros((TICKS, N), dtype=np.bool_),
            **{name: random.normal(0.0, 0.01, (TICKS, N)) for name in names},
            "threshold": np.full((TICKS, N), np.deg2rad(2.5)),
            "torque": random.normal(0.0, 0.1, (TICKS, N)),
            "torque_std": np.full((TICKS, N), 0.2),
        },
        contacts=[
            contact(None, 0.6),
            contact("LShoulderRoll", 0.6, phase="update", time=0.8),
            contact("LShoulderRoll", 0.6, phase="end", time=0.9),
            contact("LElbowRoll", 1.2, id=2, kind="collision"),
            contact("RElbowRoll", 1.5, id=3),
            contact("LShoulderRoll", 1.8, id=4, kind="rebound"),
            contact(None, 2.0, id=5),
        ],
        truth={"time": time, "contact_torque": torque},
    )


def panels(figure: Figure) -> list[Axes]:
    return [axes for axes in figure.axes if axes.get_visible()]


def lines(axes: Axes, label: str) -> list[Line2D]:
    return [line for line in axes.lines if line.get_label() == label]


def data(line: Line2D) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.asarray(line.get_ydata(), dtype=np.float64)


def spans(axes: Axes, label: str) -> list[tuple[float, float]]:
    """Begin and end of each area with this label."""
    areas = [p for p in axes.patches if isinstance(p, Rectangle) and p.get_label() == label]
    return [(round(a.get_x(), 6), round(a.get_x() + a.get_width(), 6)) for a in areas]


def test_panels_show_the_log_in_degrees(log: RunLog) -> None:
    top, middle, bottom, torque = panels(contact_figure(log, ["LShoulderRoll"]))
    sent, measured = log["sent_position"][:, ROLL], log["position"][:, ROLL]
    (line,) = lines(top, "commanded")
    np.testing.assert_allclose(data(line), np.rad2deg(sent))
    np.testing.assert_allclose(np.asarray(line.get_xdata()), log["time"])
    (line,) = lines(top, "measured")
    np.testing.assert_allclose(data(line), np.rad2deg(measured))
    (line,) = lines(middle, "measured")
    np.testing.assert_allclose(data(line), np.rad2deg(sent - measured))
    (line,) = lines(middle, "predicted for free motion")
    np.testing.assert_allclose(data(line), np.rad2deg(log["expected"][:, ROLL]))
    (line,) = lines(bottom, "residual r: measured - predicted")
    np.testing.assert_allclose(data(line), np.rad2deg(log["residual"][:, ROLL]))
    upper, lower = lines(bottom, "threshold of r")
    np.testing.assert_allclose(data(upper), 2.5)
    np.testing.assert_allclose(data(lower), -2.5)
    assert {upper.get_linestyle(), lower.get_linestyle()} == {"--"}
    (line,) = lines(torque, "external torque, estimated")
    np.testing.assert_allclose(data(line), log["torque"][:, ROLL])
    (line,) = lines(torque, "external torque, true")
    assert log.truth is not None
    np.testing.assert_allclose(data(line), log.truth["contact_torque"][:, ROLL])
    (band,) = (area for area in torque.collections if "deviations" in str(area.get_label()))
    (path,) = band.get_paths()
    low, high = log["torque"][:, ROLL] - 0.4, log["torque"][:, ROLL] + 0.4
    assert path.get_extents().y0 == pytest.approx(low.min())
    assert path.get_extents().y1 == pytest.approx(high.max())
    assert [axes.get_ylabel() for axes in (top, middle, bottom, torque)] == [
        "position\n[deg]",
        "tracking error\n[deg]",
        "residual r\n[deg]",
        "external torque\n[N m]",
    ]
    assert torque.get_xlabel() == "time [s]"


def test_hands_are_shown_in_percent(log: RunLog) -> None:
    top, *_ = panels(contact_figure(log, ["LHand"]))
    (line,) = lines(top, "measured")
    hand = ROBOT.joint_index("LHand")
    np.testing.assert_allclose(data(line), 100 * log["position"][:, hand])
    assert top.get_ylabel() == "position\n[% of aperture]"


def test_contacts_of_the_joint_and_of_its_chain(log: RunLog) -> None:
    """The last place of a contact counts; it lasts to its end, or to the end of the log."""
    end = round(float(log["time"][-1]), 6)
    elsewhere = "contact elsewhere on limb, or trunk"
    for axes in panels(contact_figure(log, ["LShoulderRoll"])):
        assert spans(axes, "contact reported") == [(0.6, 0.9)]
        assert spans(axes, elsewhere) == [(1.2, end), (2.0, end)]
        assert spans(axes, "rebound reported") == [(1.8, end)]
    for axes in panels(contact_figure(log, ["LElbowRoll"])):
        assert spans(axes, "contact reported") == [(1.2, end)]
    for axes in panels(contact_figure(log, ["HeadYaw"])):
        assert spans(axes, "contact reported") == []
        assert spans(axes, "rebound reported") == []


def reflex(name: str, phase: EventPhase, time: float, *joints: str) -> LogEvent:
    return LogEvent(time=time, kind="reflex", name=name, phase=phase, joints=joints)


def test_reflexes_and_faults_are_marked(log: RunLog) -> None:
    log = replace(
        log,
        events=[
            reflex("Hold", "begin", 0.7),
            reflex("Soften", "begin", 0.8, "LElbowRoll"),
            LogEvent(time=1.0, kind="sensor", name="head", phase="begin"),
            reflex("Hold", "end", 1.1),
            reflex("Soften", "end", 1.3, "LElbowRoll"),
            reflex("Hold", "begin", 1.5),
            LogEvent(time=2.2, kind="fault", text="stale"),
        ],
    )
    end = round(float(log["time"][-1]), 6)
    for axes in panels(contact_figure(log, ["LShoulderRoll"])):
        assert spans(axes, "reflex Hold acts") == [(0.7, 1.1), (1.5, end)]
        assert spans(axes, "reflex Soften acts") == []
        assert len(lines(axes, "robot stopped")) == 1
        drawn = [data(line) for line in axes.lines if len(data(line)) == TICKS]
        # The bars of the two reflexes stand above all lines.
        top = axes.transData.inverted().transform(axes.transAxes.transform((0.0, 1 - 2 * BAR)))[1]
        assert all(np.nanmax(values) < top for values in drawn)
    for axes in panels(contact_figure(log, ["LElbowRoll"])):
        assert spans(axes, "reflex Soften acts") == [(0.8, 1.3)]


def test_a_stretch_of_time(log: RunLog) -> None:
    log = replace(log, events=[LogEvent(time=2.2, kind="fault", text="stale")])
    figure = contact_figure(log, ["LShoulderRoll"], start=0.5, stop=1.0)
    for axes in panels(figure):
        assert axes.get_xlim() == pytest.approx((0.504, 0.996))
        assert spans(axes, "contact reported") == [(0.6, 0.9)]
        assert spans(axes, "rebound reported") == []
        assert lines(axes, "robot stopped") == []
    (line,) = lines(panels(figure)[0], "measured")
    assert len(data(line)) == 42
    assert panels(contact_figure(log, start=2.0))[0].get_xlim()[1] == pytest.approx(log["time"][-1])
    (tick,) = (
        axes for axes in panels(contact_figure(log, ["HeadYaw"], start=1.2, stop=1.2061))[:1]
    )
    first, last = tick.get_xlim()
    assert first < 1.2 < last
    assert all(line.get_marker() == "o" for line in tick.lines), "a line of one point is invisible"
    for start, stop, why in (
        (2.0, 1.0, "from 2 s to 1 s is no stretch of time"),
        (1.0, 1.0, "no stretch of time"),
        (np.nan, None, "no stretch of time"),
        (5.0, None, r"it goes from 0\.00 s to 2\.39 s"),
    ):
        with pytest.raises(LogError, match=why):
            contact_figure(log, start=start, stop=stop)


def test_what_the_gate_altered_is_shown_as_it_was_requested(log: RunLog) -> None:
    label = "requested, before the safety gate"
    assert not lines(panels(contact_figure(log, ["LShoulderRoll"]))[0], label)
    limited = log["limited"].copy()
    limited[100, ROLL] = True
    log = replace(log, fields={**log.fields, "limited": limited})
    (line,) = lines(panels(contact_figure(log, ["LShoulderRoll"]))[0], label)
    np.testing.assert_allclose(data(line), np.rad2deg(log["reference_position"][:, ROLL]))
    assert not lines(panels(contact_figure(log, ["LElbowRoll"]))[0], label)


def shaded(axes: Axes) -> tuple[float, float] | None:
    for area in axes.collections:
        if area.get_label() == "true push that loads this limb":
            times = np.concatenate(
                [path.vertices for path in area.get_paths()] or [np.zeros((0, 2))]
            )
            return (times[:, 0].min(), times[:, 0].max()) if len(times) else None
    return None


def test_true_push_is_marked_on_its_chain_only(log: RunLog) -> None:
    time = log["time"]
    for joint in ("LShoulderRoll", "LElbowRoll"):
        for axes in panels(contact_figure(log, [joint])):
            assert shaded(axes) == pytest.approx((time[50], time[79]))
    for axes in panels(contact_figure(log, ["RElbowRoll"])):
        assert shaded(axes) is None
    without = contact_figure(replace(log, truth=None), ["LShoulderRoll"])
    assert not any("true" in axes.get_title() for axes in panels(without))
    assert not any("true" in label for label in legend(without))


def titles(figure: Figure) -> list[str]:
    """Title of each joint, without its remarks."""
    return [axes.get_title().splitlines()[0] for axes in panels(figure) if axes.get_title()]


def remarks(figure: Figure) -> list[str]:
    return [axes.get_title().splitlines()[1] for axes in panels(figure) if axes.get_title()]


def legend(figure: Figure) -> list[str]:
    (found,) = figure.legends
    return [text.get_text() for text in found.get_texts()]


def test_joints_by_default(log: RunLog) -> None:
    assert titles(contact_figure(log)) == [
        "left shoulder roll (LShoulderRoll)",
        "left elbow roll (LElbowRoll)",
        "right elbow roll (RElbowRoll)",
    ]
    one = replace(log, contacts=[contact("HeadYaw", 0.1)])
    assert titles(contact_figure(one)) == ["head yaw (HeadYaw)"]
    moving = log["sent_position"].copy()
    moving[0, [2, 5, 9]] = 1.0, 2.0, 3.0
    still = replace(log, contacts=[], fields={**log.fields, "sent_position": moving})
    assert titles(contact_figure(still)) == [
        joint_title(ROBOT.joint_names[index]) for index in (2, 5, 9)
    ]


def test_all_joints_fit(log: RunLog) -> None:
    figure = contact_figure(log, ROBOT.joint_names)
    assert len(panels(figure)) == 4 * N
    assert titles(figure) == [joint_title(name) for name in ROBOT.joint_names]


def test_titles_say_which_run_it_is_and_count(log: RunLog) -> None:
    figure = contact_figure(log)
    assert figure.get_suptitle().splitlines() == [
        "Pepper in simulation (plant $worn$, seed 3)",
        "2026-11-25 09:19 UTC, 2.4 s, observer fusion, 4 contacts reported",
    ]
    assert remarks(figure) == [
        "1 contact reported on this joint; 1 rebound; 1 true push on this limb",
        "1 contact reported on this joint; 1 true push on this limb",
        "1 contact reported on this joint; no true push on this limb",
    ]
    assert not any(text.get_parse_math() for text in figure.texts)
    # Counts are those of the stretch that is drawn.
    part = contact_figure(log, ["LShoulderRoll"], start=0.0, stop=0.5)
    assert "0.5 of 2.4 s" in part.get_suptitle()
    assert "no contact reported" in part.get_suptitle()
    assert remarks(part) == ["no contact reported on this joint; no true push on this limb"]


@pytest.mark.parametrize(
    ("backend", "words"),
    [
        ("mujoco", "Pepper in simulation (plant nominal, seed 3)"),
        ("mujoco://?seed=3", "Pepper in simulation (plant nominal, seed 3)"),
        ("naoqi://pepper.local", "Pepper at naoqi://pepper.local"),
        ("naoqi://[", "Pepper at naoqi://["),
        ("", "Pepper, backend unknown"),
    ],
)
def test_the_robot_in_words(log: RunLog, backend: str, words: str) -> None:
    log = replace(log, metadata={**log.metadata, "backend": backend})
    assert contact_figure(log, ["HeadYaw"]).get_suptitle().splitlines()[0] == words


@pytest.mark.parametrize("start", ["", "yesterday"])
def test_a_log_without_its_metadata(log: RunLog, start: str) -> None:
    bare = replace(log, metadata={"start": start}, complete=False)
    assert contact_figure(bare, ["HeadYaw"]).get_suptitle().splitlines() == [
        "Pepper, backend unknown",
        "2.4 s, observer of unknown name, 4 contacts reported",
        "log cut short",
    ]
    cut = replace(bare, missing="the end is missing")
    assert contact_figure(cut, ["HeadYaw"]).get_suptitle().endswith("the end is missing")


def test_the_legend_names_all_that_is_drawn_once(log: RunLog) -> None:
    log = replace(
        log,
        events=[reflex("Hold", "begin", 0.7), LogEvent(time=2.2, kind="fault", text="stale")],
    )
    figure = contact_figure(log)
    labels = legend(figure)
    assert len(labels) == len(set(labels))
    drawn = {
        str(artist.get_label())
        for axes in panels(figure)
        for artist in (*axes.lines, *axes.patches, *axes.collections)
    }
    assert drawn == set(labels), "dashed and dotted lines too"
    looks = {
        (line.get_color(), line.get_linestyle(), str(line.get_label()))
        for axes in panels(figure)
        for line in axes.lines
    }
    assert len({look[:2] for look in looks}) == len(looks), "no two lines look the same"


def test_reflexes_beyond_the_colours_look_different(log: RunLog) -> None:
    names = [f"reflex {number}" for number in range(6)]
    log = replace(log, events=[reflex(name, "begin", 0.7) for name in names])
    bars = {
        (area.get_facecolor(), area.get_hatch())
        for area in panels(contact_figure(log, ["HeadYaw"]))[0].patches
        if "reflex" in str(area.get_label())
    }
    assert len(bars) == len(names)


def test_panels_of_one_quantity_and_unit_have_the_same_limits(log: RunLog) -> None:
    values = log["position"].copy()
    values[:, ELBOW] *= 2.0
    log = replace(log, fields={**log.fields, "position": values, "residual": values})
    figure = contact_figure(log, ["LShoulderRoll", "LElbowRoll", "LHand"])
    by_label: dict[str, set[tuple[float, float]]] = {}
    for axes in panels(figure):
        by_label.setdefault(axes.get_ylabel(), set()).add(axes.get_ylim())
        for line in axes.lines:
            inside = data(line)[np.isfinite(data(line))]
            if len(inside) == TICKS:
                assert axes.get_ylim()[0] <= inside.min()
                assert inside.max() <= axes.get_ylim()[1]
    assert all(len(limits) == 1 for limits in by_label.values())
    assert by_label["position\n[deg]"] != by_label["position\n[% of aperture]"]


def test_noise_of_a_joint_at_rest_does_not_fill_its_panel(log: RunLog) -> None:
    still = {name: np.zeros((TICKS, N)) for name in ("sent_position", "position", "expected")}
    step = np.deg2rad(0.09)
    still["position"] = np.where(np.arange(TICKS)[:, None] % 2, step, 0.0) * np.ones(N)
    log = replace(log, fields={**log.fields, **still}, contacts=[], truth=None)
    figure = contact_figure(log, ["HeadYaw"])
    assert "no joint was moved" in figure.get_suptitle()
    for axes in panels(figure)[:2]:
        low, high = axes.get_ylim()
        assert high - low >= 1.0


def test_contacts_are_named_with_link_and_torque(log: RunLog) -> None:
    torque = log["torque"].copy()
    torque[110, ELBOW] = 3.0
    log = replace(log, fields={**log.fields, "torque": torque})
    log.contacts[3] = replace(log.contacts[3], link="LForeArm")
    *_, residual, bottom = panels(contact_figure(log, ["LElbowRoll"]))
    assert [text.get_text() for text in bottom.texts] == ["left fore arm\n+3.0 ± 0.4 N m"]
    assert not residual.texts
    unknown = np.full((TICKS, N), np.nan)
    log = replace(log, fields={**log.fields, "torque": unknown, "torque_std": unknown})
    *_, residual = panels(contact_figure(log, ["LElbowRoll"]))
    assert [text.get_text() for text in residual.texts] == ["left fore arm\n3.0 deg"]


def test_many_contacts_leave_room_for_the_lines(log: RunLog) -> None:
    many = [contact("HeadYaw", 0.01 * n, id=n) for n in range(200)]
    *_, bottom = panels(contact_figure(replace(log, contacts=many), ["HeadYaw"]))
    assert not bottom.texts
    assert len(spans(bottom, "contact reported")) == 200
    assert not [line for line in bottom.lines if "onset" in str(line.get_label())]


BLIND = {
    name: np.full((TICKS, N), np.nan)
    for name in ("expected", "residual", "threshold", "torque", "torque_std")
}


def test_without_an_observer_there_is_no_empty_panel(log: RunLog, tmp_path: Path) -> None:
    log = replace(log, fields={**log.fields, **BLIND}, contacts=[])
    figure = contact_figure(log, ["HeadYaw"])
    assert len(figure.axes) == 2
    assert "no observer watched these joints" in figure.get_suptitle()
    assert "predicted for free motion" not in legend(figure)
    assert figure.axes[-1].get_xlabel() == "time [s]"
    plot_contacts(log, tmp_path / "a.png")


def test_a_joint_that_is_not_observed_has_no_empty_panel(log: RunLog) -> None:
    fields = {name: values.copy() for name, values in log.fields.items()}
    for name in BLIND:
        fields[name][:, ROLL] = np.nan
    figure = contact_figure(replace(log, fields=fields), ["LShoulderRoll", "LElbowRoll"])
    assert len(figure.axes) == 2 + 4
    assert all(any(np.isfinite(data(line)).any() for line in axes.lines) for axes in figure.axes)
    assert "not observed" in remarks(figure)[0]
    assert "not observed" not in remarks(figure)[1]
    assert [axes.get_xlabel() for axes in figure.axes].count("time [s]") == 2


def test_nothing_known_of_a_joint(log: RunLog) -> None:
    unknown = np.full((TICKS, N), np.nan)
    log = replace(
        log, fields={**log.fields, **BLIND, "position": unknown, "sent_position": unknown}
    )
    with pytest.raises(LogError, match="holds no value of HeadYaw there"):
        contact_figure(log, ["HeadYaw"])


@pytest.mark.parametrize(
    ("name", "magic"), [("a.png", b"\x89PNG"), ("b.SVG", b"<?xml"), ("c.pdf", b"%PDF")]
)
def test_formats_without_display(
    log: RunLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, magic: bytes
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    path = tmp_path / "new" / name
    plot_contacts(log, path)
    content = path.read_bytes()
    assert content.startswith(magic)
    if name == "a.png":
        size = [int.from_bytes(content[at : at + 4]) for at in (16, 20)]
        assert size[0] >= 1400


def test_errors(log: RunLog, tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="did you mean LElbowRoll"):
        plot_contacts(log, tmp_path / "a.png", ["LElbowRol"])
    with pytest.raises(UnknownNameError, match="figure format 'gif'"):
        plot_contacts(log, tmp_path / "a.gif")
    with pytest.raises(UnknownNameError, match="possible: pdf, png, svg"):
        plot_contacts(log, tmp_path / "a")
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(PlotError, match="it is a folder") as caught:
        plot_contacts(log, tmp_path / "folder.png")
    assert "\n" not in str(caught.value)
    empty = replace(log, fields={name: array[:0] for name, array in log.fields.items()})
    with pytest.raises(LogError, match="no tick"):
        plot_contacts(empty, tmp_path / "a.png")
    assert [p.name for p in tmp_path.iterdir()] == ["folder.png"]


def test_matplotlib_is_optional(
    log: RunLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"pepper-driver\[plot\]"):
        plot_contacts(log, tmp_path / "a.png")
