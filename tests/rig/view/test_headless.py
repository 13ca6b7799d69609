"""Appearance of the three layouts, drawn by the headless viewer from a fixed scene.

Reference pictures lie in tests/rig/data, a fifth of the window's size: they hold what is where and in
which colour, not how a version of Mesa smooths a line. RIG_UPDATE_PICTURES=1 writes them anew; look
at them before they are committed.
"""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.presentation import palette
from rig.rerun.layout import TIMELINE, X_STRETCH
from rig.rerun.messages import LayoutName
from rig.view.viewer import Viewer
from tests.rig.view import scene as view_scene
from tests.rig.view.headless_viewer import headless_viewer, pixels_of, require_software_vulkan

pytestmark = pytest.mark.slow

REFERENCES = Path(__file__).parent / "data"
SCALE = 5

EQUAL = "Trajectory / arcsec, equal scales"
STRETCHED = f"Trajectory / arcsec, X stretched {X_STRETCH:.0f} times"
COLOURS: dict[str, dict[str, tuple[str, ...]]] = {
    "measuring": {
        EQUAL: (palette.TRAJECTORY_COLOUR,),
        "Y(t), slow mode / arcsec": (palette.Y_COLOUR,),
        "X(t), fast mode / arcsec": (palette.X_COLOUR,),
        "Amplitude / arcsec": (palette.AMPLITUDE_COLOUR,),
        "Period / s": (palette.PERIOD_COLOUR,),
        "Losses": palette.LOSSES[:2],
        "Camera": (palette.VERMILLION,),
        "Balance": (),
        "State": (),
        "Events": (),
    },
    "balancing": {
        EQUAL: (palette.TRAJECTORY_COLOUR,),
        STRETCHED: (palette.TRAJECTORY_COLOUR,),
        "Transverse amplitude / arcsec": (palette.X_COLOUR,),
        "Transverse, width / %": (palette.VERMILLION, palette.YELLOW),
        "Tilt of the line / deg": (palette.BLUISH_GREEN,),
        "Rotation of the line / (deg/min)": (palette.REDDISH_PURPLE,),
        "Rest position X / arcsec": (palette.X_COLOUR,),
        "Rest position Y / arcsec": (palette.Y_COLOUR,),
        "Drift X, Y / (arcsec/min)": (palette.X_COLOUR, palette.Y_COLOUR),
        "T_V / T_U": (palette.BLUISH_GREEN,),
        "Advice": (),
        "Balance": (),
        "Camera": (palette.VERMILLION,),
    },
    "analysing": {
        "Decay: amplitude / arcsec against time / s": (palette.EXACT_FIT_COLOUR,),
        "Residuals of the amplitude / arcsec": (palette.EXACT_FIT_COLOUR, palette.ASYMPTOTIC_FIT_COLOUR),
        "T(α): period / s against amplitude / arcsec": (palette.DATA_COLOUR, palette.EXACT_FIT_COLOUR),
        "Residuals of the period / ms": (palette.EXACT_FIT_COLOUR,),
        "Loops: moment / µN m against angle / arcsec": (palette.SKY_BLUE, palette.ORANGE),
        "Report": (),
    },
}
"""Each layout's views, and the colours of what must be drawn in them."""

ENTITIES = {
    "/lissajous/equal/trajectory/recent",
    "/lissajous/equal/trajectory/oldest",
    "/lissajous/equal/graticule/labels",
    "/deflection/x",
    "/deflection/y",
    "/amplitude/value",
    "/period/upper",
    "/balance/line_angle/value",
    "/losses/view_dropped",
    "/camera/image",
    "/camera/spot",
    "/state",
    "/events",
    "/analysis/loops/axes/grid",
    "/analysis/report",
}


@pytest.mark.parametrize("layout", ["measuring", "balancing", "analysing"])
def test_layout(layout: LayoutName, tmp_path: Path) -> None:
    require_software_vulkan()
    path = tmp_path / "scene.rrd"
    with Viewer(path, layout=layout, title="scene") as viewer:
        view_scene.play(viewer)
    with headless_viewer(str(path)) as shown:
        state = shown.wait_loaded()
        assert {view.name for view in state.views} == set(COLOURS[layout])
        assert all(view.visible and not view.reports for view in state.views), state.views
        known = {entity.entity_path for entity in shown.client.get_recording_schema(paths_only=True).entities}
        assert known >= ENTITIES
        assert shown.client.get_state().recordings[0].current_timeline == TIMELINE
        shown.client.set_time(TIMELINE, duration=58.0, play_state="paused")
        shown.rest()
        window = shown.picture(tmp_path / "window.png")
        assert window.shape == (950, 1500, 3)
        for number, (name, colours) in enumerate(COLOURS[layout].items()):
            view = shown.picture(tmp_path / f"view-{number}.png", name)
            assert ink(view) > 200, f"{name} is empty"
            for colour in colours:
                assert pixels_of(view, colour) > 60, f"{name}: nothing drawn in {colour}"
        assert shown.problems() == []
    compare(window, f"view-{layout}.png")


def test_the_trajectory_points_up_and_fades(tmp_path: Path) -> None:
    # From the middle to the upper right in two periods, after a long stay at the lower left.
    require_software_vulkan()
    path = tmp_path / "scene.rrd"
    period_s = view_scene.PERIOD_S
    with Viewer(path, amplitude=100.0, period_s=period_s) as viewer:
        time_s = np.arange(0, 8 * period_s, 0.01)
        late = np.clip((time_s - 6 * period_s) / (2 * period_s), 0, 1)
        x = np.where(late > 0, 90 * late, -60 + 20 * np.sin(time_s))
        y = np.where(late > 0, 90 * late, -60 + 20 * np.cos(time_s))
        # A lost spot between the two: no line may lead from one to the other.
        x[(late == 0) & (time_s > 5.8 * period_s)] = np.nan
        viewer.samples(time_s, x, y, np.zeros(len(time_s), dtype=np.int64))
    with headless_viewer(str(path)) as shown:
        shown.wait_loaded()
        shown.rest()
        view = shown.picture(tmp_path / "view.png", EQUAL)
    ny, nx = view.shape[:2]
    upper_right, lower_left = view[: ny // 2, nx // 2 :], view[ny // 2 :, : nx // 2]
    assert pixels_of(upper_right, palette.TRAJECTORY_COLOUR) > 100
    assert pixels_of(lower_left, palette.TRAJECTORY_COLOUR) < 20
    red, green, blue = (lower_left[..., channel].astype(int) for channel in range(3))
    assert np.count_nonzero((red > 80) & (red < 190) & (green > 80) & (blue < 100)) > 100


def ink(picture: NDArray[np.uint8]) -> int:
    """Pixels that differ from the most frequent one."""
    grey = picture.astype(int).sum(axis=2)
    return int(np.count_nonzero(np.abs(grey - np.bincount(grey.ravel()).argmax()) > 60))


def compare(window: NDArray[np.uint8], name: str) -> None:
    """The window, made smaller, against its reference: no tile of it may look different."""
    size = (window.shape[1] // SCALE, window.shape[0] // SCALE)
    small = cv2.resize(window, size, interpolation=cv2.INTER_AREA)
    reference = REFERENCES / name
    if os.environ.get("RIG_UPDATE_PICTURES"):
        cv2.imwrite(str(reference), small[..., ::-1])
    known = cv2.imread(str(reference), cv2.IMREAD_COLOR)
    assert known is not None, f"no reference {reference}"
    difference = np.abs(small.astype(float) - known[..., ::-1]).mean(axis=2)
    tile = 10
    tiles = difference.reshape(size[1] // tile, tile, size[0] // tile, tile).mean(axis=(1, 3))
    worst = np.unravel_index(int(tiles.argmax()), tiles.shape)
    assert tiles.max() < 12.0, f"{name}: tile {worst} differs by {tiles.max():.1f} of 255 on average"
    assert difference.mean() < 1.5
