"""Makes the pictures of README and docs beside this file, from a run of configs/demo.toml.

    make pictures

With the folder of a session that was measured already it is shown: make pictures ARGS=DIR. The view needs
Mesa's software Vulkan (Debian: mesa-vulkan-drivers, libvulkan1). What the pictures show is written beside
them, so that a test notices when something else is drawn.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import get_args

import cv2
import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1]))

from rig.report import draw_run, styled  # noqa: E402
from rig.report.drawing import png  # noqa: E402
from rig.view import LayoutName  # noqa: E402
from rig.view.layout import TIMELINE  # noqa: E402
from rig.view.show import show_record  # noqa: E402
from tests.rig.drawn_pictures import (  # noqa: E402
    CONFIGURATION,
    DRAWN,
    RESULT_FIGURES,
    drawn_now,
)
from tests.rig.view.headless_viewer import headless_viewer, software_vulkan  # noqa: E402

BAR_PX = 36
MOMENT_S = {"balancing": 120.0, "measuring": 60.0, "analysing": 60.0}
"""When each layout is photographed."""
NOTES_GONE_S = 12.0
"""The viewer's notes at its start have gone by then."""
WIDTH_PX = 1600


def main(session: Path) -> None:
    """Draw and photograph every layout of the session's first run, and its report's figures."""
    with tempfile.TemporaryDirectory() as folder:
        for layout in get_args(LayoutName):
            rrd = Path(folder) / f"{layout}.rrd"
            show_record(session / "run-1.mcap", rrd=rrd, layout=layout)
            photograph(rrd, HERE / f"rerun-{layout}.png", MOMENT_S[layout])
    gather_figures(session, HERE / "result.png")
    DRAWN.write_text(json.dumps(drawn_now(), indent=2) + "\n", encoding="utf-8")


def photograph(rrd: Path, picture: Path, at_s: float) -> None:
    """Save how the file looks at a moment."""
    with headless_viewer(str(rrd)) as shown:
        shown.wait_loaded()
        shown.client.set_time(TIMELINE, duration=at_s, play_state="paused")
        time.sleep(NOTES_GONE_S)
        window = shown.picture(picture)
    # without the viewer's own bar, whose warnings are about this way of drawing
    save(window[BAR_PX:, :, ::-1], picture)


def figures_of(session: Path) -> dict[str, bytes]:
    """The figures of the first run by name, as PNG."""
    with styled():
        return {drawing.name: png(drawing) for drawing in draw_run(session, 1)}


def gather_figures(session: Path, picture: Path) -> None:
    """Save figures of a report as one picture, row by row on a white sheet."""
    rows, figures = [], figures_of(session)
    for names in RESULT_FIGURES:
        images = [
            cv2.imdecode(np.frombuffer(figures[name], dtype=np.uint8), cv2.IMREAD_COLOR) for name in names
        ]
        height = max(image.shape[0] for image in images)
        rows.append(np.hstack([padded(image, height) for image in images]))
    sheet = np.vstack(rows)
    height_px = round(sheet.shape[0] * WIDTH_PX / sheet.shape[1])
    save(cv2.resize(sheet, (WIDTH_PX, height_px), interpolation=cv2.INTER_AREA), picture)


def padded(image: np.ndarray, height: int) -> np.ndarray:
    return cv2.copyMakeBorder(image, 0, height - image.shape[0], 0, 0, cv2.BORDER_CONSTANT, value=(255,) * 3)


def save(image: np.ndarray, path: Path) -> None:
    cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    if software_vulkan() is None:
        raise SystemExit("Mesa's software Vulkan is not installed: mesa-vulkan-drivers, libvulkan1")
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as made:
            run = [sys.executable, "-m", "rig", "run", str(CONFIGURATION), "-o", f"{made}/session"]
            subprocess.run(run, check=True)
            main(Path(made) / "session")
