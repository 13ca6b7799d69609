"""`rig view --view web` in a real browser."""

import signal
import subprocess
import sys
import urllib.parse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.terminal import palette
from rig.view.show import show_records
from tests.rig.view.headless_browser import HeadlessBrowser, headless_browser, wait_for_picture
from tests.rig.view.headless_viewer import pixels_of
from tests.rig.view.replay_record import make_record

pytestmark = pytest.mark.slow

WANTED = (palette.TRAJECTORY_COLOUR, palette.X_COLOUR, palette.Y_COLOUR, palette.PERIOD_COLOUR)


@pytest.fixture(scope="module")
def browser() -> Iterator[HeadlessBrowser]:
    with headless_browser(webgl=True) as started:
        yield started


@pytest.mark.parametrize("kind", ["mcap", "rrd"])
def test_a_page_shows_records_and_rerun_files(browser: HeadlessBrowser, tmp_path: Path, kind: str) -> None:
    record, shown = make_record(tmp_path / "run.mcap", 60.0), tmp_path / f"run.{kind}"
    if kind == "rrd":
        show_records([record], rrd=shown)
    with subprocess.Popen(
        [sys.executable, "-m", "rig", "view", str(shown), "--view", "web"],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as view:
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


def drawn(picture: NDArray[np.uint8]) -> bool:
    return all(pixels_of(picture, colour) > 60 for colour in WANTED)
