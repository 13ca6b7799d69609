"""Makes the pictures of the view for README and docs: one of each layout, beside this file.

    python docs/pictures/make_pictures.py [RECORD.mcap]

With a record every layout shows it, `analysing` with the results beside it; without one the fixed
scene of the tests is drawn. Needs Mesa's software Vulkan (Debian: mesa-vulkan-drivers, libvulkan1).
"""

import math
import sys
import tempfile
import time
from pathlib import Path
from typing import get_args

import cv2

BAR_PX = 36
MOMENT_S = {"balancing": 60.0, "measuring": 240.0}
"""When each layout is photographed; the end where that comes before, or where nothing is said."""
NOTES_GONE_S = 12.0
"""The viewer's notes at its start have gone by then."""
HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1]))

from rig.rerun.layout import TIMELINE  # noqa: E402
from rig.rerun.messages import LayoutName  # noqa: E402
from rig.view.recorded import write_rrd  # noqa: E402
from rig.view.viewer import Viewer  # noqa: E402
from tests.rig.view import scene  # noqa: E402
from tests.rig.view.headless_viewer import headless_viewer, software_vulkan  # noqa: E402


def main(record: Path | None) -> None:
    """Draw and photograph every layout."""
    if software_vulkan() is None:
        raise SystemExit("Mesa's software Vulkan is not installed: mesa-vulkan-drivers, libvulkan1")
    with tempfile.TemporaryDirectory() as folder:
        for layout in get_args(LayoutName):
            rrd = Path(folder) / f"{layout}.rrd"
            draw(rrd, layout, record)
            photograph(rrd, HERE / f"rerun-{layout}.png", MOMENT_S.get(layout, math.inf))


def draw(rrd: Path, layout: LayoutName, record: Path | None) -> None:
    """The record, or the scene, in a layout."""
    if record is not None:
        write_rrd([record], rrd, layout=layout)
        return
    with Viewer(rrd, layout=layout, title="scene") as viewer:
        scene.play(viewer)


def photograph(rrd: Path, picture: Path, moment_s: float) -> None:
    """Save how the file looks at a moment."""
    with headless_viewer(str(rrd)) as shown:
        state = shown.wait_loaded()
        timeline = next(line for line in state.recordings[0].timelines if line.name == TIMELINE)
        # A little before the end, where every panel has something to show.
        end_s = (timeline.end or 0) * 1e-9
        at_s = min(moment_s, end_s - min(2.0, 0.02 * end_s))
        shown.client.set_time(TIMELINE, duration=at_s, play_state="paused")
        time.sleep(NOTES_GONE_S)
        window = shown.picture(picture)
    # Without the viewer's own bar, whose warnings are about this way of drawing.
    cv2.imwrite(str(picture), window[BAR_PX:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(f"{picture.name}: {picture.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
