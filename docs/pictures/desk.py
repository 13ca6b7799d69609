"""Makes the pictures of the operator's desk beside this file, from the simulated rig; needs Chromium.

python docs/pictures/desk.py
"""

import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1]))

from tests.rig.desk.desk_page import Page, desk_page  # noqa: E402

CONFIGURATION = """
extends = "{base}"
[session]
output = "{output}"
initial_amplitude_arcsec = 124.0
max_duration_s = 400.0
[camera]
driver = "simulated"
frame_rate_hz = 50
[view]
file = false
[start]
way = "at once"
[balance]
seconds = 20.0
[simulation.sensor]
width_px = 320
height_px = 640
[simulation.release]
way = "let go"
"""
SHOWN_FROM_HALF_CYCLES = 44


def main() -> None:
    """Photograph every panel."""
    with tempfile.TemporaryDirectory() as place:
        config = Path(place) / "rig.toml"
        base = HERE.parents[1] / "configs" / "live.toml"
        config.write_text(CONFIGURATION.format(base=base.as_posix(), output=Path(place).as_posix()))
        with desk_page(config) as (_, page):
            photograph(page)


def photograph(page: Page) -> None:
    """From align to measure, and stop."""
    page.click("Live picture")
    page.wait_text("clean spot")
    page.wait("document.querySelectorAll('rect').length > 30")
    save(page, "align")
    page.key("3")
    page.click("Run preflight")
    page.click("Plan")
    page.wait_text("u(b)", 120.0)
    page.wait("document.querySelectorAll('.light').length > 8")
    save(page, "preflight")
    page.key("2")
    page.key("m")
    page.wait("document.querySelector('[aria-label=\"faults of the balance\"]') !== null", 120.0)
    page.wait_text("go", 120.0)
    save(page, "balance")
    page.click("End")
    page.key("4")
    page.wait_text("rig desk")
    page.click("Start")
    half_cycles = "parseInt(document.body.innerText.match(/([0-9]+) half-cycles/)[1])"
    page.wait(f"{half_cycles} > {SHOWN_FROM_HALF_CYCLES}", 400.0)
    save(page, "measure")
    page.key("x")
    page.click("Stop it")
    page.wait_text("report.html", 200.0)


def save(page: Page, panel: str) -> None:
    """Save a picture of a panel."""
    page.picture(HERE / f"desk-{panel}.png")
    print(f"desk-{panel}.png")


if __name__ == "__main__":
    main()
