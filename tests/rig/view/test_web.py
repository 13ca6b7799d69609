"""`view.mode = "web"` in a real browser."""

import signal
import subprocess
import sys
import time
import urllib.parse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.presentation import palette
from rig.rerun.ports import LOOPBACK, free_port
from rig.view.viewer import Viewer
from tests.rig.view import scene as view_scene
from tests.rig.view.headless_browser import HeadlessBrowser, headless_browser, wait_for_picture
from tests.rig.view.headless_viewer import pixels_of

pytestmark = pytest.mark.slow

WANTED = (palette.TRAJECTORY_COLOUR, palette.X_COLOUR, palette.Y_COLOUR, palette.PERIOD_COLOUR)


@pytest.fixture(scope="module")
def browser() -> Iterator[HeadlessBrowser]:
    with headless_browser(webgl=True) as started:
        yield started


def test_the_page_draws_the_run(browser: HeadlessBrowser, tmp_path: Path) -> None:
    with Viewer(None, "web", port=free_port(0), web_port=free_port(0)) as viewer:
        view_scene.play(viewer)
        deadline = time.monotonic() + 30.0
        while not viewer.counts.notes:
            assert time.monotonic() < deadline
            time.sleep(0.1)
        address = viewer.counts.notes[0].removeprefix("live view: ")
        time.sleep(1.0)
        browser.open(address)
        picture = wait_for_picture(browser, drawn, 120.0, tmp_path / "page.png")
        for colour in WANTED:
            assert pixels_of(picture, colour) > 60, f"nothing drawn in {colour}"
        hosts = {urllib.parse.urlsplit(url).hostname for url in browser.requested}
        # data: and blob: addresses have no host.
        assert hosts - {None} == {LOOPBACK}


def test_a_rerun_file_is_shown_as_a_page(browser: HeadlessBrowser, tmp_path: Path) -> None:
    rrd = tmp_path / "scene.rrd"
    with Viewer(rrd) as viewer:
        view_scene.play(viewer)
    command = "import sys; from pathlib import Path; from rig.view.viewer_program import show_rrd; "
    command += "show_rrd([Path(sys.argv[1])], 'web')"
    with subprocess.Popen(
        [sys.executable, "-c", command, str(rrd)],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as shown:
        try:
            assert shown.stdout is not None
            browser.open(shown.stdout.readline().split()[4])
            picture = wait_for_picture(browser, drawn, 120.0, tmp_path / "page.png")
        finally:
            shown.send_signal(signal.SIGINT)
            shown.wait(60.0)
    assert drawn(picture)


def drawn(picture: NDArray[np.uint8]) -> bool:
    return all(pixels_of(picture, colour) > 60 for colour in WANTED)
