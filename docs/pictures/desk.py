"""Makes the pictures of the operator's desk beside this file, from the simulated rig; needs Chromium.

python docs/pictures/desk.py
"""

import os
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1]))

from tests.rig.desk.desk_page import Page, desk_page  # noqa: E402
from tests.rig.view.headless_browser import headless_browser  # noqa: E402

CONFIGURATION = """
extends = "{base}"
[session]
output = "runs"
initial_amplitude_arcsec = 124.0
max_duration_s = 2400.0
[camera]
driver = "simulated"
frame_rate_hz = 50
[start]
way = "at once"
[simulation.axes]
{axes}
[simulation.sensor]
width_px = 320
height_px = 640
[simulation.release]
way = "let go"
"""
ASKEW = "rest_slow_arcsec = 6.0\nrest_fast_arcsec = -25.0"
TURNING = "spin_rad_per_s = 5e-4"
HANDED_OVER = "[...document.querySelectorAll('button')].some(b => b.offsetParent && b.innerText === 'REPORT')"
STILL = (
    "document.getAnimations().every(a => a.playState !== 'running' || "
    "a.effect.getComputedTiming().endTime === Infinity)"
)
SHOWN_FROM_HALF_CYCLES = 44
SHARPNESS_S = 6.0


def main() -> None:
    """Photograph every panel, and an alarm."""
    with_desk(ASKEW, photograph)
    with_desk(TURNING, photograph_alarm)


def with_desk(axes: str, do: Callable[[Page], None]) -> None:
    """Do something with the desk of a simulated rig with these axes."""
    with tempfile.TemporaryDirectory() as place:
        config = Path(place) / "rig.toml"
        base = HERE.parents[1] / "configs" / "live.toml"
        config.write_text(CONFIGURATION.format(base=base.as_posix(), axes=axes), encoding="utf-8")
        # sessions and calibrations are filed in the folder in which the desk was opened
        os.environ["PYTHONPATH"] = str(HERE.parents[1])
        with chdir(place), headless_browser() as browser, desk_page(browser, config) as (_, page):
            do(page)


def photograph_alarm(page: Page) -> None:
    """A run whose plane of swing turns, which is an alarm."""
    measure(page)
    page.wait_text("1 active", 200.0)
    page.key("a")
    page.wait_text("plane of swing")
    save(page, "alarm")


def measure(page: Page) -> None:
    """Until a run has been measured for a minute and a half."""
    page.key("3")
    page.wait_text("rig desk")
    page.click("Start …")
    page.in_dialog()
    half_cycles = "parseInt(document.body.innerText.match(/elapsed\\s.*?([0-9]+) half-cycles/)[1])"
    page.wait(f"{half_cycles} > {SHOWN_FROM_HALF_CYCLES}", 400.0)
    page.wait_text("b / rad", 200.0)


def photograph(page: Page) -> None:
    """From the live picture to measure, and stop."""
    page.click("Live picture")
    page.wait_text("clean spot")
    page.wait("document.querySelectorAll('[aria-label=\"histogram\"] svg path').length > 30")
    time.sleep(SHARPNESS_S)
    save(page, "align")
    page.click("Stop")
    page.key("2")
    page.point_at("document.querySelector('[aria-label=\"Measure the balance\"]')")
    page.wait("document.querySelector('svg[aria-label^=\"turn weight\"]') !== null", 120.0)
    save(page, "balance")
    page.click("End")
    measure(page)
    save(page, "measure")
    page.click("Stop")
    page.click("Stop it")
    page.wait(HANDED_OVER, 200.0)
    page.key("5")
    page.wait("document.querySelector('.q-table tbody .q-checkbox') !== null")
    page.ask("document.querySelector('.q-table tbody .q-checkbox').click()")
    page.wait_text("is marked")
    page.click("Fit again")
    page.wait_text("rig fit: done", 200.0)
    save(page, "sessions")
    page.key("4")
    page.wait_text("Lever: from px to radians")
    Path("ladder.toml").write_text(ladder(), encoding="utf-8")
    page.fill("lever given", "ladder.toml")
    page.click("File it")
    page.wait_text("lever-001.toml")
    save(page, "calibrate")


def ladder() -> str:
    """Readings of an autocollimator in arcsec, and where the spot was, some hundredths of a px off."""
    steps = ["kind = 'tilt'", "unit = 'arcsec'", "u_reference = 0.05", "pixel_pitch_m = 4.8e-6"]
    for reading, off_px in ((-60, 0.02), (-30, -0.03), (0, 0.01), (30, 0.04), (60, -0.02), (0, -0.01)):
        y_px = 320 - 2.0201 * reading + off_px
        steps += ["[[step]]", f"reference = {reading}", "x_px = 160.01", f"y_px = {y_px:.2f}", "u_px = 0.02"]
    return "\n".join(steps) + "\n"


def save(page: Page, panel: str) -> None:
    """Save a picture of a panel, once labels and buttons have stopped moving."""
    page.wait(STILL, 20.0)
    page.picture(HERE / f"desk-{panel}.png")
    print(f"desk-{panel}.png")


if __name__ == "__main__":
    main()
