"""Appearance of the three layouts, drawn by the headless viewer from a fixed scene.

Reference pictures lie in tests/rig/data, a fifth of the window's size: they hold what is where and in
which colour, not how a version of Mesa smooths a line. RIG_UPDATE_PICTURES=1 writes them again; look
at them before they are committed.
"""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.terminal import palette
from rig.view.layout import TIMELINE, X_STRETCH
from rig.view.running_view import LayoutName
from tests.rig.view import scene as view_scene
from tests.rig.view.headless_viewer import headless_viewer, pixels_of, require_software_vulkan

pytestmark = pytest.mark.slow

REFERENCES = Path(__file__).parent / "data"
SCALE = 5
TILE = 10
TILE_LIMIT = 12.0
"""Side of a tile / pixels of the reference, and its mean difference at which it looks different / of 255."""

EQUAL = "Trajectory / arcsec, equal scales"
STRETCHED = f"Trajectory / arcsec, X stretched {X_STRETCH:.0f} times"
VIEWS: dict[str, tuple[str, ...]] = {
    "measuring": (
        EQUAL,
        "Y(t), slow mode / arcsec",
        "X(t), across the swing / arcsec",
        "Amplitude / arcsec",
        "Period / s",
        "Losses",
        "Clock drift / ppm",
        "Conditions",
        "Camera",
        "Balance",
        "State",
        "Events",
    ),
    "balancing": (
        EQUAL,
        STRETCHED,
        "Transverse amplitude / arcsec",
        "Transverse, width / %",
        "Tilt of the line / deg",
        "Rotation of the line / (deg/min)",
        "Rest position X / arcsec",
        "Rest position Y / arcsec",
        "Drift X, Y / (arcsec/min)",
        "T_V / T_U",
        "Advice",
        "Balance",
        "Camera",
    ),
    "analysing": (
        "Decay: amplitude / arcsec against time / s",
        "Residuals of the amplitude / arcsec",
        "T(α): period / s against amplitude / arcsec",
        "Residuals of the period / ms",
        EQUAL,
        "Report",
    ),
}
COLOURS = {
    "measuring": "TRAJECTORY_COLOUR X_COLOUR BLUE Y_COLOUR AMPLITUDE_COLOUR PERIOD_COLOUR SKY_BLUE",
    "balancing": "TRAJECTORY_COLOUR X_COLOUR Y_COLOUR VERMILLION YELLOW BLUISH_GREEN REDDISH_PURPLE",
    "analysing": "TRAJECTORY_COLOUR DATA_COLOUR EXACT_FIT_COLOUR ASYMPTOTIC_FIT_COLOUR",
}
"""Names of what is drawn in each layout; where, its reference picture holds."""


@pytest.mark.parametrize("layout", ["measuring", "balancing", "analysing"])
def test_layout(layout: LayoutName, tmp_path: Path) -> None:
    require_software_vulkan()
    path = tmp_path / "scene.rrd"
    with view_scene.plotting_into(path, layout=layout) as plot:
        view_scene.play(plot)
    with headless_viewer(str(path)) as shown:
        state = shown.wait_loaded()
        assert {view.name for view in state.views} == set(VIEWS[layout])
        assert all(view.visible and not view.reports for view in state.views), state.views
        assert shown.client.get_state().recordings[0].current_timeline == TIMELINE
        shown.client.set_time(TIMELINE, duration=58.0, play_state="paused")
        # messages of the start cover a corner of the window for some seconds
        name = f"view-{layout}.png"
        window = shown.picture_once(
            tmp_path / "window.png", lambda window: worst_tile(window, name)[0] < TILE_LIMIT
        )
        assert window.shape == (950, 1500, 3)
        assert shown.problems() == []
    if os.environ.get("RIG_UPDATE_PICTURES"):
        cv2.imwrite(str(REFERENCES / name), smaller(window)[..., ::-1])
    worst, tile, mean = worst_tile(window, name)
    assert worst < TILE_LIMIT, f"{name}: tile {tile} differs by {worst:.1f} of 255 on average"
    assert mean < 1.5
    for colour in COLOURS[layout].split():
        assert pixels_of(window, getattr(palette, colour)) > 60, f"nothing drawn in {colour}"


def test_the_trajectory_points_up_and_fades(tmp_path: Path) -> None:
    # From the middle to the upper right in two periods, after a long stay at the lower left.
    require_software_vulkan()
    path = tmp_path / "scene.rrd"
    period_s = view_scene.PERIOD_S
    with view_scene.plotting_into(path, amplitude=100.0, period_s=period_s) as plot:
        time_s = np.arange(0, 8 * period_s, 0.01)
        late = np.clip((time_s - 6 * period_s) / (2 * period_s), 0, 1)
        x = np.where(late > 0, 90 * late, -60 + 20 * np.sin(time_s))
        y = np.where(late > 0, 90 * late, -60 + 20 * np.cos(time_s))
        # A lost spot between the two: no line may lead from one to the other.
        x[(late == 0) & (time_s > 5.8 * period_s)] = np.nan
        plot.samples(time_s, x, y, np.zeros(len(time_s), dtype=np.int64))
    with headless_viewer(str(path)) as shown:
        shown.wait_loaded()
        view = shown.picture_once(
            tmp_path / "view.png", lambda view: pixels_of(view, palette.TRAJECTORY_COLOUR) > 100, EQUAL
        )
    ny, nx = view.shape[:2]
    upper_right, lower_left = view[: ny // 2, nx // 2 :], view[ny // 2 :, : nx // 2]
    assert pixels_of(upper_right, palette.TRAJECTORY_COLOUR) > 100
    assert pixels_of(lower_left, palette.TRAJECTORY_COLOUR) < 20
    red, green, blue = (lower_left[..., channel].astype(int) for channel in range(3))
    assert np.count_nonzero((red > 80) & (red < 190) & (green > 80) & (blue < 100)) > 100


def smaller(window: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The window at the size of its reference."""
    size = (window.shape[1] // SCALE, window.shape[0] // SCALE)
    return cv2.resize(window, size, interpolation=cv2.INTER_AREA).astype(np.uint8)


def worst_tile(window: NDArray[np.uint8], name: str) -> tuple[float, tuple[int, int], float]:
    """How much the window differs from its reference: in the tile that differs most, which, and the mean."""
    reference = cv2.imread(str(REFERENCES / name), cv2.IMREAD_COLOR)
    assert reference is not None, f"no reference {REFERENCES / name}"
    difference = np.abs(smaller(window).astype(float) - reference[..., ::-1]).mean(axis=2)
    rows, columns = difference.shape[0] // TILE, difference.shape[1] // TILE
    tiles = difference.reshape(rows, TILE, columns, TILE).mean(axis=(1, 3))
    row, column = np.unravel_index(int(tiles.argmax()), tiles.shape)
    return float(tiles.max()), (int(row), int(column)), float(difference.mean())
