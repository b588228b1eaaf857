"""Picture of the robot with the N90 of each place, for groups of states and laws of motor boards; needs ``plot``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import ConvexHull

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.visuals import Visual, load_visuals
from pepper_driver.controller import RobotModel
from pepper_driver.evaluation.touch.n90 import N90
from pepper_driver.evaluation.touch.summary_data import GROUPS, ObserverSummary
from pepper_driver.figure_style import NOTE_SIZE, TITLE_SIZE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap, LogNorm
    from matplotlib.figure import Figure

LAWS = {
    "nominal": "stiff motor boards\n(law nominal)",
    "integral": "softer motor boards with an integral\n(law integral)",
}
"""Human-readable names of the laws."""

STATES_IN_WORDS = {
    "standing": "standing\nnothing moves",
    "attentive": "attentive\nstanding, arms and head swing a little",
    "in motion": "in motion\nbreathing, gestures, whole body, driving",
}
"""By group of states."""

POSTURE = {
    "LShoulderPitch": 1.57,
    "RShoulderPitch": 1.57,
    "LShoulderRoll": 0.8,
    "RShoulderRoll": -0.8,
    "LElbowRoll": -0.01,
    "RElbowRoll": 0.01,
}
"""[rad] Arms away from the body, so that no place hides another."""

MIN_COLOUR_FORCE, MAX_COLOUR_FORCE = 2.0, 30.0
"""[N] Ends of the colours."""

TICKS = (2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 30.0)
"""[N] Forces of the suites."""

NOT_REACHED, NO_DATA, OUTLINE, DARK = "#3A3A3A", "#F4F4F4", "#B8BEC2", "#22282C"

_PLACES = {
    "Head": "head",
    "Neck": "head",
    "torso": "trunk",
    "Hip": "hip",
    "Pelvis": "hip",
    "Tibia": "base",
    "WheelFL_link": "base",
    "WheelFR_link": "base",
    "WheelB_link": "base",
    **{f"{side}Shoulder": "shoulder" for side in "LR"},
    **{f"{side}Bicep": "upper arm" for side in "LR"},
    **{f"{side}Elbow": "forearm" for side in "LR"},
    **{f"{side}ForeArm": "forearm" for side in "LR"},
    **{f"{side}_{link}": "hand" for side in "lr" for link in ("wrist", "gripper")},
}
"""Place of each link."""

_DRAWN = ("hip", "base", "trunk", "head", "shoulder", "upper arm", "forearm", "hand")
"""Places from the one behind to the one in front."""

SHOULDER_END = 0.05
"""[m] The upper arm is the place ``shoulder`` up to here from its joint."""

_NUMBERS: dict[str, tuple[str, tuple[float, float, float]]] = {
    "head": ("Head", (0.0, 0.0, 0.178)),
    "shoulder": ("LBicep", (0.0, 0.01, 0.0)),
    "upper arm": ("LBicep", (0.112, 0.013, 0.0)),
    "forearm": ("LForeArm", (0.075, 0.0, 0.0)),
    "hand": ("l_wrist", (0.052, 0.0, 0.0)),
    "trunk": ("torso", (0.1, 0.0, 0.145)),
    "hip": ("Pelvis", (0.0, 0.0, 0.16)),
    "base": ("Tibia", (0.0, 0.0, -0.255)),
}
"""Link and point [m] at which the number of a place is written: on its left side."""

_NAMES: dict[str, tuple[str, tuple[float, float, float], tuple[float, float]]] = {
    "head": ("Head", (0.0, -0.11, 0.15), (-0.03, 0.0)),
    "shoulder": ("RBicep", (0.0, -0.05, 0.0), (-0.03, 0.035)),
    "upper arm": ("RBicep", (0.112, -0.055, 0.0), (-0.015, 0.02)),
    "forearm": ("RForeArm", (0.075, -0.04, 0.0), (-0.015, 0.015)),
    "hand": ("r_wrist", (0.052, -0.045, 0.0), (-0.02, 0.01)),
    "trunk": ("torso", (0.0, -0.09, 0.03), (-0.02, 0.0)),
    "hip": ("Pelvis", (0.0, -0.1, 0.16), (-0.03, 0.0)),
    "base": ("Tibia", (0.0, -0.16, -0.15), (-0.03, 0.0)),
}
"""Link, point [m] and way from it in the picture [m] where the name of a place ends: next to its right side."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Part:
    """One shape from the front: corners (n, 2) [m], its place; ``detail`` is the colour of eyes and the like."""

    corners: FloatArray
    place: str
    detail: str


@styled
def n90_figure(
    observer: ObserverSummary, laws: Sequence[str], robot: RobotConfig, *, simulated: bool = True
) -> Figure:
    """Draw one small robot for each law and group of states, its places coloured by N90, with the number on them.

    A group without any touch has no robot.

    Args:
        observer: With N90 by group.
        laws: A row for each.
        robot: Its description.
        simulated: False for real robots: the title then does not say so.
    """
    groups = [
        name
        for name in GROUPS
        if any(cell.state == name and cell.law in laws for cell in observer.groups)
    ] or list(GROUPS)[:1]
    laws = laws or ("",)
    figure = new_figure(3.9 * max(len(groups), 2) + 0.6, 4.7 * len(laws) + 2.0)
    panels = figure.subplots(len(laws), len(groups), squeeze=False)
    colours, norm = _colours()
    picture = _picture(robot)
    for row, law in enumerate(laws):
        for column, group in enumerate(groups):
            axes = panels[row, column]
            found = {
                place: cell.n90
                for place in _NUMBERS
                if (cell := observer.group(law, place, group)) is not None
            }
            _draw(axes, picture, found, colours, norm)
            if row == 0:
                first, *more = STATES_IN_WORDS[group].split("\n")
                axes.set_title(first, fontsize=TITLE_SIZE, fontweight="bold", pad=20.0)
                axes.text(
                    0.5, 1.015, *more, transform=axes.transAxes, ha="center", fontsize=NOTE_SIZE
                )
        panels[row, 0].set_ylabel(law_in_words(law), fontsize=TITLE_SIZE, labelpad=8.0)
    figure.suptitle(
        f"N90: force in newtons at which nine touches in ten are detected{', in simulation' * simulated}\n"
        "touches of 1 s from all sides; both arms count as one; small is good",
        fontsize=TITLE_SIZE,
    )
    _legend(figure, panels.ravel().tolist(), colours, norm)
    return figure


def _colours() -> tuple[Colormap, LogNorm]:
    import matplotlib as mpl
    from matplotlib.colors import ListedColormap, LogNorm

    # Without its darkest part, on which an outline is not seen.
    colours = mpl.colormaps["viridis_r"](np.linspace(0.0, 0.88, 256))
    return ListedColormap(colours), LogNorm(MIN_COLOUR_FORCE, MAX_COLOUR_FORCE, clip=True)


def _draw(
    axes: Axes,
    picture: Picture,
    found: dict[str, N90 | None],
    colours: Colormap,
    norm: LogNorm,
) -> None:
    parts, numbers, names = picture
    for place in _DRAWN:
        fill, hatch = _fill(found.get(place), colours, norm)
        own = [part for part in parts if part.place == place]
        # A pale border around the whole place, then its shapes without any between them.
        for part in own:
            axes.fill(*part.corners.T, facecolor=fill, edgecolor=OUTLINE, linewidth=2.2)
        for part in own:
            edge = "#8A8A8A" if hatch else fill
            axes.fill(*part.corners.T, facecolor=fill, edgecolor=edge, linewidth=0.0, hatch=hatch)
    for part in parts:
        if part.detail:
            axes.fill(*part.corners.T, facecolor=part.detail, edgecolor="none")
    for place, where in numbers.items():
        value = found.get(place)
        text = "-" if value is None else newtons_text(value)
        fill, _ = _fill(value, colours, norm)
        dark = _luminance(fill) < 0.45
        axes.text(
            *where,
            text,
            ha="center",
            va="center",
            fontsize=9.5 if len(text) < 3 else 8.5,
            fontweight="bold",
            color="white" if dark else "black",
            bbox={"boxstyle": "round,pad=0.12", "facecolor": fill, "edgecolor": "none"},
        )
    for place, (x, y) in names.items():
        axes.text(x, y, place, ha="right", va="center", fontsize=NOTE_SIZE, color=DARK)
    axes.set_aspect("equal")
    corners = np.vstack([part.corners for part in parts])
    (left, low), (right, high) = corners.min(axis=0), corners.max(axis=0)
    axes.set_xlim(left - 0.12, right + 0.02)
    axes.set_ylim(low - 0.02, high + 0.02)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)


def law_in_words(law: str) -> str:
    """Return the human-readable name of a law, in at most two lines."""
    return LAWS.get(law, f"motor boards: {law}")


def newtons_text(value: N90) -> str:
    """Return N90 alone, without its interval: ``7.4``, ``12``, ``<2`` or ``>30``."""
    return value.text.split(" (")[0].replace(" ", "")


def _fill(value: N90 | None, colours: Colormap, norm: LogNorm) -> tuple[str, str]:
    """Return colour and hatch of a place."""
    from matplotlib.colors import to_hex

    if value is None:
        return NO_DATA, ""
    if math.isinf(value.newtons):
        return NOT_REACHED, "////"
    return to_hex(colours(norm(value.newtons))), ""


def _luminance(colour: str) -> float:
    red, green, blue = (int(colour[n : n + 2], 16) / 255.0 for n in (1, 3, 5))
    return 0.299 * red + 0.587 * green + 0.114 * blue


def _legend(figure: Figure, panels: Sequence[Axes], colours: Colormap, norm: LogNorm) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.patches import Patch

    bar = figure.colorbar(
        ScalarMappable(norm=norm, cmap=colours),
        ax=panels,
        orientation="horizontal",
        ticks=TICKS,
        shrink=0.6,
        aspect=40.0,
        pad=0.02,
    )
    bar.ax.set_xticklabels([f"{tick:g}" for tick in TICKS])
    bar.ax.minorticks_off()
    bar.set_label("N90 [N], light touches are detected at the left end")
    figure.legend(
        handles=[
            Patch(
                facecolor=NOT_REACHED,
                edgecolor="#8A8A8A",
                hatch="////",
                label="N90 is not reached with the forces that acted",
            ),
            Patch(facecolor=NO_DATA, edgecolor=OUTLINE, label="not touched (-)"),
        ],
        loc="outside lower center",
        ncols=2,
        frameon=False,
    )


# -- the robot from the front -----------------------------------------------------------------------------------------

Places = dict[str, tuple[float, float]]
Picture = tuple[tuple[_Part, ...], Places, Places]


def _picture(robot: RobotConfig) -> Picture:
    """Return the shapes, the farthest first, and where numbers and names of places are written."""
    model, position = RobotModel(robot), np.zeros(len(robot.joint_names))
    for name, angle in POSTURE.items():
        position[robot.joint_index(name)] = angle
    poses = {link: model.link_pose(link, position) for link in robot.links}
    shapes = []
    for visual in load_visuals(robot):
        pose = poses[visual.link] @ visual.transform_visual_to_link
        points = _surface(visual) @ pose[:3, :3].T + pose[:3, 3]
        front = points[:, 1:]
        shapes.append(
            (
                float(points[:, 0].max()) if _detail(visual) else float(points[:, 0].mean()),
                _Part(
                    corners=front[ConvexHull(front).vertices],
                    place=_place(visual),
                    detail=_detail(visual),
                ),
            )
        )
    shapes.sort(key=lambda shape: shape[0])

    def seen(link: str, point: Sequence[float]) -> FloatArray:
        place: FloatArray = poses[link][1:3, :3] @ np.array(point) + poses[link][1:3, 3]
        return place

    numbers = {name: seen(link, point) for name, (link, point) in _NUMBERS.items()}
    names = {name: seen(link, point) + way for name, (link, point, way) in _NAMES.items()}
    return tuple(part for _, part in shapes), _pairs(numbers), _pairs(names)


def _pairs(places: dict[str, FloatArray]) -> Places:
    return {name: (float(x), float(y)) for name, (x, y) in places.items()}


def _place(visual: Visual) -> str:
    place = _PLACES.get(visual.link, "")
    if place == "upper arm" and visual.transform_visual_to_link[0, 3] < SHOULDER_END:
        return "shoulder"
    return place


def _detail(visual: Visual) -> str:
    """Return the colour of eyes, ears and mouth; nothing for what is coloured by N90."""
    red, green, blue, _ = visual.rgba
    if visual.link == "Head" and max(red, green, blue) - min(red, green, blue) + red < 0.9:
        if visual.shape == "cylinder" and visual.size[0] > 0.04:
            return ""
        return DARK if red < 0.15 else "#8FA3AD"
    return ""


def _surface(visual: Visual) -> FloatArray:
    """(n, 3) points on a shape, in its own frame [m]."""
    if visual.shape == "box":
        half = np.array(visual.size) / 2.0
        corners: FloatArray = np.array(np.meshgrid(*([-1.0, 1.0],) * 3)).reshape(3, -1).T * half
        return corners
    angles = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(36)])
    radius = visual.size[0]
    if visual.shape == "cylinder":
        end = np.array([0.0, 0.0, visual.size[1] / 2.0])
        return np.vstack([radius * ring - end, radius * ring + end])
    levels = np.linspace(-np.pi / 2.0, np.pi / 2.0, 19)
    return radius * np.vstack([np.cos(a) * ring + [0.0, 0.0, np.sin(a)] for a in levels])
