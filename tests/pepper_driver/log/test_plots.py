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
from pepper_driver.log import LogError, LogEvent, RunLog
from pepper_driver.log.plots import BAR, PlotError, contact_figure, plot_contacts
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
        "joint": joint,
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
        metadata={"backend": "mujoco://?plant=$worn$", "seed": "3"},
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
    top, middle, bottom = panels(contact_figure(log, ["LShoulderRoll"]))
    sent, measured = log["sent_position"][:, ROLL], log["position"][:, ROLL]
    (line,) = lines(top, "desired, as sent")
    np.testing.assert_allclose(data(line), np.rad2deg(sent))
    np.testing.assert_allclose(np.asarray(line.get_xdata()), log["time"])
    (line,) = lines(top, "measured")
    np.testing.assert_allclose(data(line), np.rad2deg(measured))
    (line,) = lines(middle, "measured")
    np.testing.assert_allclose(data(line), np.rad2deg(sent - measured))
    (line,) = lines(middle, "expected in free motion")
    np.testing.assert_allclose(data(line), np.rad2deg(log["expected"][:, ROLL]))
    (line,) = lines(bottom, "contact observer signal r")
    np.testing.assert_allclose(data(line), np.rad2deg(log["residual"][:, ROLL]))
    upper, lower = lines(bottom, "threshold")
    np.testing.assert_allclose(data(upper), 2.5)
    np.testing.assert_allclose(data(lower), -2.5)
    assert {upper.get_linestyle(), lower.get_linestyle()} == {"--"}
    labels = [axes.get_ylabel() for axes in (top, middle, bottom)]
    assert labels == ["position [deg]", "tracking error [deg]", "r [deg]"]
    assert bottom.get_xlabel() == "time [s]"


def test_hands_are_shown_in_percent(log: RunLog) -> None:
    top, *_ = panels(contact_figure(log, ["LHand"]))
    (line,) = lines(top, "measured")
    hand = ROBOT.joint_index("LHand")
    np.testing.assert_allclose(data(line), 100 * log["position"][:, hand])
    assert top.get_ylabel() == "position [% of aperture]"


def test_contacts_of_the_joint_and_of_its_chain(log: RunLog) -> None:
    """Where a contact was felt at last counts; it lasts to its end, or to the end of the log."""
    end = round(float(log["time"][-1]), 6)
    elsewhere = "contact elsewhere on the chain or trunk"
    for axes in panels(contact_figure(log, ["LShoulderRoll"])):
        assert spans(axes, "contact") == [(0.6, 0.9)]
        assert spans(axes, elsewhere) == [(1.2, end), (2.0, end)]
        assert spans(axes, "rebound") == [(1.8, end)]
    for axes in panels(contact_figure(log, ["LElbowRoll"])):
        assert spans(axes, "contact") == [(1.2, end)]
    for axes in panels(contact_figure(log, ["HeadYaw"])):
        assert spans(axes, "contact") == []
        assert spans(axes, "rebound") == []


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
        assert spans(axes, "reflex Hold") == [(0.7, 1.1), (1.5, end)]
        assert spans(axes, "reflex Soften") == []
        assert len(lines(axes, "stopped")) == 1
        drawn = [data(line) for line in axes.lines if len(data(line)) == TICKS]
        # The bars of the two reflexes stand above all lines.
        top = axes.transData.inverted().transform(axes.transAxes.transform((0.0, 1 - 2 * BAR)))[1]
        assert all(np.nanmax(values) < top for values in drawn)
    for axes in panels(contact_figure(log, ["LElbowRoll"])):
        assert spans(axes, "reflex Soften") == [(0.8, 1.3)]


def test_a_stretch_of_time(log: RunLog) -> None:
    log = replace(log, events=[LogEvent(time=2.2, kind="fault", text="stale")])
    figure = contact_figure(log, ["LShoulderRoll"], start=0.5, stop=1.0)
    for axes in panels(figure):
        assert axes.get_xlim() == pytest.approx((0.504, 0.996))
        assert spans(axes, "contact") == [(0.6, 0.9)]
        assert spans(axes, "rebound") == []
        assert lines(axes, "stopped") == []
    (line,) = lines(panels(figure)[0], "measured")
    assert len(data(line)) == 42
    assert panels(contact_figure(log, start=2.0))[0].get_xlim()[1] == pytest.approx(log["time"][-1])
    assert panels(contact_figure(log, start=1.2, stop=1.2061))[0].lines
    for start, stop, why in (
        (2.0, 1.0, "from 2 s to 1 s is no stretch of time"),
        (1.0, 1.0, "no stretch of time"),
        (np.nan, None, "no stretch of time"),
        (5.0, None, r"it goes from 0\.00 s to 2\.39 s"),
    ):
        with pytest.raises(LogError, match=why):
            contact_figure(log, start=start, stop=stop)


def test_what_the_gate_altered_is_shown_as_it_was_wanted(log: RunLog) -> None:
    wanted = "reference, before the safety gate"
    assert not lines(panels(contact_figure(log, ["LShoulderRoll"]))[0], wanted)
    limited = log["limited"].copy()
    limited[100, ROLL] = True
    log = replace(log, fields={**log.fields, "limited": limited})
    (line,) = lines(panels(contact_figure(log, ["LShoulderRoll"]))[0], wanted)
    np.testing.assert_allclose(data(line), np.rad2deg(log["reference_position"][:, ROLL]))
    assert not lines(panels(contact_figure(log, ["LElbowRoll"]))[0], wanted)


def shaded(axes: Axes) -> tuple[float, float] | None:
    for area in axes.collections:
        if area.get_label() == "true push (simulation only)":
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
    for axes in panels(contact_figure(replace(log, truth=None), ["LShoulderRoll"])):
        assert not axes.collections


def test_joints_by_default(log: RunLog) -> None:
    def titles(log: RunLog) -> list[str]:
        return [axes.get_title() for axes in panels(contact_figure(log)) if axes.get_title()]

    assert titles(log) == ["LShoulderRoll", "LElbowRoll", "RElbowRoll"]
    assert titles(replace(log, contacts=[contact("HeadYaw", 0.1)])) == ["HeadYaw"]
    moving = log["sent_position"].copy()
    moving[0, [2, 5, 9]] = 1.0, 2.0, 3.0
    still = replace(log, contacts=[], fields={**log.fields, "sent_position": moving})
    assert titles(still) == [ROBOT.joint_names[i] for i in (2, 5, 9)]


def test_all_joints_fit(log: RunLog) -> None:
    figure = contact_figure(log, ROBOT.joint_names)
    assert len(panels(figure)) == 3 * N
    assert {axes.get_title() for axes in panels(figure)} - {""} == set(ROBOT.joint_names)


def test_title_and_legend(log: RunLog) -> None:
    figure = contact_figure(log)
    assert figure.get_suptitle() == "mujoco://?plant=$worn$, seed 3"
    assert not any(text.get_parse_math() for text in figure.texts)
    assert contact_figure(replace(log, complete=False, metadata={})).get_suptitle() == (
        "unknown backend, log cut short"
    )
    (legend,) = figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert len(labels) == len(set(labels))
    assert {"measured", "threshold", "contact", "true push (simulation only)"} <= set(labels)


def test_nothing_observed(log: RunLog, tmp_path: Path) -> None:
    nothing = np.full((TICKS, N), np.nan)
    blind = {name: nothing for name in ("expected", "residual", "threshold")}
    log = replace(log, fields={**log.fields, **blind}, contacts=[])
    *_, bottom = panels(contact_figure(log, ["HeadYaw"]))
    assert [text.get_text() for text in bottom.texts] == ["not observed"]
    plot_contacts(log, tmp_path / "a.png")


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
        assert size == [1600, 1000]


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
