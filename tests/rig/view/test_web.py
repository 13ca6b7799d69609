"""`rig view --view web` in a real browser."""

import signal
import subprocess
import sys
import urllib.parse
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.terminal import palette
from tests.rig.view.headless_browser import headless_browser, wait_for_picture
from tests.rig.view.headless_viewer import pixels_of
from tests.rig.view.replay_record import make_record

pytestmark = pytest.mark.slow

WANTED = (palette.TRAJECTORY_COLOUR, palette.X_COLOUR, palette.Y_COLOUR, palette.PERIOD_COLOUR)


def drawn(picture: NDArray[np.uint8]) -> bool:
    return all(pixels_of(picture, colour) > 60 for colour in WANTED)


def test_a_page_shows_a_record_and_asks_this_machine_only(tmp_path: Path) -> None:
    with (
        headless_browser(webgl=True) as browser,
        subprocess.Popen(
            [sys.executable, "-m", "rig", "view", make_record(tmp_path / "run.mcap", 60.0), "--view", "web"],
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as view,
    ):
        try:
            assert view.stdout is not None
            browser.open(view.stdout.readline().split()[4])
            picture = wait_for_picture(browser, drawn, 120.0, tmp_path / "page.png")
            for colour in WANTED:
                assert pixels_of(picture, colour) > 60, f"nothing drawn in {colour}"
            asked = {urllib.parse.urlsplit(address).hostname for address in browser.requested}
            assert asked <= {"127.0.0.1", None}, asked
        finally:
            view.send_signal(signal.SIGINT)
            view.wait(60.0)
