"""The robot where a pinhole camera shows it; what glows, the ghost and arrows, by the pixels there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco")

from pepper_driver.config import load_robot
from pepper_driver.config.arrays import FloatArray, PixelArray
from pepper_driver.config.visuals import load_visuals
from pepper_driver.controller import RobotModel
from pepper_driver.observer import Contact
from pepper_driver.rendering import View
from pepper_driver.rendering.scene import (
    AZIMUTHS,
    DISTANCE,
    ELEVATION,
    EYE_HEIGHT,
    FIELD_OF_VIEW,
    SceneRenderer,
)
from pepper_driver.viewer.drawing import FORCE_LENGTH, centres_of, touch_arrows
from pepper_driver.viewer.picture import Force, Picture
from support.rendering import require_gl

pytestmark = pytest.mark.usefixtures("gl")

ROBOT = load_robot()
STAND = ROBOT.posture("Stand")
SIZE = 400
ROLL = ROBOT.joint_index("LShoulderRoll")


def picture(**changes: Any) -> Picture:
    nothing = np.full(17, np.nan)
    values: dict[str, Any] = {
        "time": 0.0,
        "position": STAND,
        "commanded": changes.get("position", STAND),
        "residual": nothing,
        "threshold": nothing,
        "torque": nothing,
        "torque_std": nothing,
        "state": np.zeros(17, dtype=np.int64),
        "base": np.zeros(3),
        "tilt": np.zeros(2),
    }
    return Picture(**(values | changes))


@pytest.fixture(scope="module")
def gl() -> None:
    require_gl()


@pytest.fixture(scope="module")
def scene(gl: None) -> Iterator[SceneRenderer]:
    with SceneRenderer(ROBOT, SIZE, SIZE) as scene:
        yield scene


def pixel(point: FloatArray, base: FloatArray | None = None, view: View = "front") -> list[int]:
    """Row and column of a point of the world, by the equations of a pinhole."""
    turn, rise = np.radians([AZIMUTHS[view], ELEVATION])
    forward = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    x, y = (0.0, 0.0) if base is None else base[:2]
    from_camera = point - (np.array([x, y, EYE_HEIGHT]) - DISTANCE * forward)
    scale = 0.5 * SIZE / np.tan(np.radians(0.5 * FIELD_OF_VIEW)) / (from_camera @ forward)
    across, up = from_camera @ right, from_camera @ np.cross(right, forward)
    return [round(0.5 * SIZE - scale * up), round(0.5 * SIZE + scale * across)]


def centre(
    link: str, position: FloatArray = STAND, by: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> FloatArray:
    """(3,) of a link in the world, with the base at its origin, and a way from there."""
    pose = RobotModel(ROBOT).link_pose(link, position)
    point: FloatArray = (pose @ np.append(centres_of(load_visuals(ROBOT))[link], 1.0))[:3] + by
    return point


def raised() -> FloatArray:
    position = STAND.copy()
    position[ROLL] += 0.9
    return position


def near(pixels: PixelArray, place: list[int], reach: int = 3) -> FloatArray:
    """(n, 3) colours around a place."""
    row, column = place
    part = pixels[row - reach : row + reach + 1, column - reach : column + reach + 1]
    return part.reshape(-1, 3).astype(np.float64)


def is_orange(colors: FloatArray) -> bool:
    red, green, blue = np.median(colors, axis=0)
    return bool(red > 1.6 * green and green > 1.2 * blue)


def is_grey(colors: FloatArray) -> bool:
    return bool(np.ptp(np.median(colors, axis=0)) < 20.0)


def test_the_robot_stands_where_the_camera_looks(scene: SceneRenderer) -> None:
    pixels = scene.draw(picture())
    assert pixels.shape == (SIZE, SIZE, 3)
    assert pixels.dtype == np.uint8
    sky = pixels[2, 2].astype(int)
    assert np.abs(near(pixels, [2, 2], 2) - sky).max() < 4
    apart = np.abs(pixels.astype(int) - sky).max(axis=2)[: SIZE // 4] > 25
    head = pixel(centre("Head"))
    rows, columns = np.nonzero(apart)
    assert np.median(columns) == pytest.approx(head[1], abs=8)
    assert rows.min() == pytest.approx(pixel(centre("Head", by=(0.0, 0.0, 0.11)))[0], abs=8)


def test_an_arm_that_moves_moves_its_pixels_alone(scene: SceneRenderer) -> None:
    before, after = scene.draw(picture()), scene.draw(picture(position=raised()))
    changed = (before != after).any(axis=2)
    for position in (STAND, raised()):
        row, column = pixel(centre("LForeArm", position))
        assert changed[row - 2 : row + 3, column - 2 : column + 3].any()
    assert 300 < changed.sum() < 0.15 * changed.size
    for link in ("Head", "Tibia", "RForeArm"):
        row, column = pixel(centre(link))
        assert not changed[row, column]


def test_a_picture_of_the_same_moment_is_the_same(scene: SceneRenderer) -> None:
    np.testing.assert_array_equal(scene.draw(picture()), scene.draw(picture()))


@pytest.mark.parametrize(("excess", "orange"), [(0.9, False), (1.05, True), (2.0, True)])
def test_a_limb_glows_above_its_threshold(
    scene: SceneRenderer, excess: float, orange: bool
) -> None:
    residual = np.zeros(17)
    residual[ROLL] = -0.02 * excess
    pixels = scene.draw(picture(residual=residual, threshold=np.full(17, 0.02)))
    link = ROBOT.joints[ROLL].child
    place = pixel(centre(link, by=(0.05, 0.02, 0.0)))
    assert is_grey(near(pixels, place)) != orange
    if excess == 2.0:
        assert is_orange(near(pixels, place))
    assert is_grey(near(pixels, pixel(centre("RBicep", by=(0.05, 0.0, 0.0)))))


def corners(link: str) -> Iterator[FloatArray]:
    """Corners of the boxes around the shapes of a link, in the world."""
    pose = RobotModel(ROBOT).link_pose(link, STAND)
    for visual in load_visuals(ROBOT):
        if visual.link == link:
            size = np.array(visual.size)
            half = {
                "box": 0.5 * size,
                "cylinder": np.array([size[0], size[0], 0.5 * size[-1]]),
                "sphere": np.full(3, size[0]),
            }[visual.shape]
            for signs in product((-1.0, 1.0), repeat=3):
                inside = np.append(half * signs, 1.0)
                yield (pose @ visual.transform_visual_to_link @ inside)[:3]


def test_shapes_are_as_large_as_the_robot_has_them(scene: SceneRenderer) -> None:
    residual = np.zeros(17)
    residual[ROLL] = 0.04
    pixels = scene.draw(picture(residual=residual, threshold=np.full(17, 0.02))).astype(int)
    rows, columns = np.nonzero((pixels != scene.draw(picture())).any(axis=2))
    places = np.array([pixel(corner) for corner in corners(ROBOT.joints[ROLL].child)])
    for seen, expected in ((rows, places[:, 0]), (columns, places[:, 1])):
        assert seen.min() == pytest.approx(expected.min(), abs=6)
        assert seen.max() == pytest.approx(expected.max(), abs=6)


def test_the_ghost_is_seen_where_the_robot_is_not(scene: SceneRenderer) -> None:
    pixels = scene.draw(picture(commanded=raised()))
    _, green, blue = np.median(near(pixels, pixel(centre("LForeArm", raised()))), axis=0)
    assert blue > green + 20
    close = STAND.copy()
    close[ROLL] += 0.005
    without = scene.draw(picture())
    np.testing.assert_array_equal(scene.draw(picture(commanded=close)), without)


def touch(torque: float | None) -> Contact:
    return Contact(
        id=1,
        phase="begin",
        kind="contact",
        limb="left_arm",
        joint="LShoulderRoll",
        shown_by="LShoulderRoll",
        link="LBicep",
        direction=1,
        intensity_deg=2.0,
        torque=torque,
        torque_std=0.5,
        onset_time=0.0,
        detection_time=0.0,
        time=0.0,
    )


def test_the_arrow_of_a_touch_ends_where_its_force_does(scene: SceneRenderer) -> None:
    contact, before = touch(2.5), scene.draw(picture())
    red = (scene.draw(picture(), [contact]) != before).any(axis=2)
    model = RobotModel(ROBOT)
    arrows = touch_arrows(
        contact,
        ROBOT,
        lambda link: model.link_pose(link, STAND),
        centres_of(load_visuals(ROBOT)),
    )
    arrow = next(arrows)[1]
    assert 0.1 < np.linalg.norm(arrow.end - arrow.start) < 0.4
    rows, columns = np.nonzero(red)
    tip = pixel(arrow.end)
    farthest = int(columns.argmax())
    assert [rows[farthest], columns[farthest]] == pytest.approx(tip, abs=3)


def test_a_strong_touch_has_an_arrow_that_stays_in_the_picture(scene: SceneRenderer) -> None:
    before = scene.draw(picture())
    changed = (scene.draw(picture(), [touch(1000.0 * FORCE_LENGTH)]) != before).any(axis=2)
    assert changed.any()
    assert not changed[:, -5:].any()
    unknown = scene.draw(picture(), [touch(None)])
    assert (unknown != before).any()


@pytest.mark.parametrize("newtons", [20.0, 500.0])
def test_a_true_force_has_an_arrow_to_where_it_acts(scene: SceneRenderer, newtons: float) -> None:
    point = np.array([0.2, 0.3, 0.9])  # next to the robot, where nothing hides it
    force = Force(link="LForeArm", point=point, force=np.array([0.0, -newtons, 0.0]))
    changed = (scene.draw(picture(forces=(force,))) != scene.draw(picture())).any(axis=2)
    rows, columns = np.nonzero(changed)
    tip = int(columns.argmin())
    assert [rows[tip], columns[tip]] == pytest.approx(pixel(point), abs=4)
    length = columns.max() - columns.min()
    tail = pixel(point - FORCE_LENGTH * min(1.0, 40.0 / newtons) * force.force)
    assert length == pytest.approx(tail[1] - pixel(point)[1], rel=0.15)


def test_each_side_shows_the_arm_that_is_there(gl: None) -> None:
    """The tablet is seen from the front alone, a glowing left arm from the left."""
    residual = np.zeros(17)
    residual[ROLL] = 0.04
    shown = picture(residual=residual, threshold=np.full(17, 0.02))
    seen: dict[View, int] = {}
    for view in AZIMUTHS:
        with SceneRenderer(ROBOT, SIZE, SIZE, view=view) as scene:
            red, green, blue = np.moveaxis(scene.draw(shown).astype(int), 2, 0)
        seen[view] = int(((red > 1.6 * green) & (green > blue)).sum())
    assert seen["left"] > 300
    assert seen["right"] < 30
    assert min(seen["front"], seen["back"]) > 200


def test_the_camera_goes_with_the_base_and_a_turn_or_tilt_is_seen(scene: SceneRenderer) -> None:
    upper = slice(0, SIZE // 4)  # above the floor, whose grid moves
    stand = scene.draw(picture())[upper].astype(int)
    moved = scene.draw(picture(base=np.array([1.3, -0.7, 0.0])))[upper]
    assert np.abs(moved - stand).mean() < 0.5
    for changes in ({"base": np.array([0.0, 0.0, 0.4])}, {"tilt": np.array([0.1, 0.0])}):
        assert np.abs(scene.draw(picture(**changes))[upper] - stand).mean() > 2.0
    with SceneRenderer(ROBOT, SIZE, SIZE, heading=0.4) as turned:
        same = turned.draw(picture(base=np.array([0.0, 0.0, 0.4])))[upper]
    assert (np.abs(same - stand) > 60).mean() < 0.01, "all but the light is the same"


def test_what_is_not_known_is_drawn_at_zero(scene: SceneRenderer) -> None:
    shown = picture(position=np.zeros(17))
    unknown = replace(shown, position=np.full(17, np.nan), base=np.full(3, np.nan))
    np.testing.assert_array_equal(
        scene.draw(replace(unknown, commanded=np.zeros(17))), scene.draw(shown)
    )
