"""Layouts for other programs: what they plot is in a log, and is of the joint that they name."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from pepper_driver.backends.log_file import fields_of, topics_of
from pepper_driver.log.schema import JSON_TOPICS, layout_metadata
from support import ROOT
from support.log_samples import ROBOT

FOLDER = ROOT / "examples" / "layouts"
FOXGLOVE: dict[str, Any] = json.loads((FOLDER / "foxglove.json").read_text())
PLOTJUGGLER = ElementTree.parse(FOLDER / "plotjuggler.xml").getroot()
LAYOUT = layout_metadata(ROBOT)
PATH = re.compile(r"(?P<topic>/\w+)[./](?P<field>\w+)(\[(?P<index>\d+)\])?(\.@(?P<modifier>\w+))?")
MODIFIERS = {None, "abs"}
"""Those that Lichtblick computes in plots over time; ``negative`` it leaves out."""


def element(path: str) -> str:
    """Name of the value that a path means: of a joint, or of a field of a JSON topic."""
    found = PATH.fullmatch(path)
    assert found is not None, path
    assert found["modifier"] in MODIFIERS
    for topic in JSON_TOPICS:
        if topic.topic == found["topic"]:
            assert found["field"] in topic.types
            return found["field"]
    (field,) = (f for f in fields_of(LAYOUT)[found["topic"]] if f.name == found["field"])
    assert field.elements is not None
    return field.elements[int(found["index"])]


def panels(tree: Any) -> Iterator[str]:
    """All panels of a tree of panels, from the left and top."""
    if isinstance(tree, str):
        yield tree
        for tab in FOXGLOVE["configById"][tree].get("tabs", ()):
            yield from panels(tab["layout"])
    else:
        assert tree["direction"] in ("row", "column")
        assert 0 < tree["splitPercentage"] < 100
        yield from panels(tree["first"])
        yield from panels(tree["second"])


def test_each_panel_has_one_place() -> None:
    placed = list(panels(FOXGLOVE["layout"]))
    assert sorted(placed) == sorted(FOXGLOVE["configById"])


@pytest.mark.parametrize("joint", ROBOT.joint_names)
def test_each_joint_is_plotted_with_its_threshold(joint: str) -> None:
    config = FOXGLOVE["configById"][f"Plot!{joint}"]
    assert config["foxglovePanelTitle"] == config["lichtblickPanelTitle"]
    assert config["foxglovePanelTitle"].startswith(f"{joint}: ")
    assert [element(path["value"]) for path in config["paths"]] == [joint, joint]
    assert [path["value"].partition("[")[0] for path in config["paths"]] == [
        "/tick.residual",
        "/tick.threshold",
    ]


def test_states_are_those_of_the_joints_they_name() -> None:
    paths = FOXGLOVE["configById"]["StateTransitions!states"]["paths"]
    assert [element(path["value"]) for path in paths] == [path["label"] for path in paths]
    assert [path["label"] for path in paths] == [
        *ROBOT.chains["left_arm"],
        *ROBOT.chains["right_arm"],
    ]


def test_topics_and_frames_are_in_a_log() -> None:
    topics, config = topics_of(LAYOUT), FOXGLOVE["configById"]
    for panel in ("Table!contact", "Table!event"):
        assert config[panel]["topicPath"] in topics
    robot = config["3D!robot"]
    assert set(robot["topics"]) == {"/robot_description"} < set(topics)
    assert robot["followTf"] in ROBOT.links
    assert {layer["frameId"] for layer in robot["layers"].values()} == {"odom"}


def curves(of: ElementTree.Element) -> list[str]:
    return [curve.attrib["name"] for curve in of.iter("curve")]


def test_plotjuggler_computes_what_it_plots_below_zero() -> None:
    computed = {}
    for snippet in PLOTJUGGLER.iter("snippet"):
        assert snippet.findtext("function") == "return -value"
        computed[snippet.attrib["name"]] = snippet.findtext("linked_source")
    for name, source in computed.items():
        assert source is not None
        assert name == f"-threshold {element(source)}"
    for name in curves(PLOTJUGGLER):
        assert name in computed or element(name)
    assert set(computed) <= set(curves(PLOTJUGGLER))


def test_plotjuggler_shows_each_joint_once() -> None:
    shown = []
    for area in PLOTJUGGLER.iter("DockArea"):
        joint = area.attrib["name"].partition(":")[0]
        if joint in ROBOT.joint_names:
            shown.append(joint)
            residual, threshold, negative = curves(area)
            assert (element(residual), element(threshold)) == (joint, joint)
            assert residual.startswith("/tick/residual[")
            assert threshold.startswith("/tick/threshold[")
            assert negative == f"-threshold {joint}"
        # PlotJuggler takes a curve once in a plot.
        assert len(set(curves(area))) == len(curves(area))
    assert sorted(shown) == sorted(ROBOT.joint_names)


def test_plotjuggler_splits_its_tabs_as_it_says() -> None:
    for splitter in PLOTJUGGLER.iter("DockSplitter"):
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert len(sizes) == int(splitter.attrib["count"]) == len(splitter)
        assert sum(sizes) == pytest.approx(1.0, abs=1e-5)


def test_they_are_copied_with_the_examples(tmp_path: Path) -> None:
    from pepper_driver.cli.examples import copy_examples, examples_folder

    copy_examples(examples_folder(), tmp_path)
    for path in FOLDER.iterdir():
        assert (tmp_path / "layouts" / path.name).read_bytes() == path.read_bytes()
