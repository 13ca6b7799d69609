"""axe-core over every panel in every theme: nothing that a screen reader or a weak eye stumbles over."""

import json
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from rig.archive import add_folders
from rig.devices import OrderSocket, SessionNews
from tests.rig.command_line import SAMPLES
from tests.rig.desk.desk_page import SIZE, DeskProcess, Page
from tests.rig.desk.test_theme import themes

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
PACKAGE = "axe-core@4.10.3"
PANELS = {"1": "Rig", "2": "Balance", "3": "Measure", "4": "Calibrate", "5": "Runs"}
Shown = tuple[DeskProcess, Page]
STILL = """
document.head.append(Object.assign(document.createElement('style'),
  {textContent: '@layer theme { * { transition: none !important; animation: none !important; } }'}))
"""
"""A colour that is just changing is no colour that anybody reads."""
RUN = """
axe.run(document.querySelector('.q-dialog') || document, {resultTypes: ['violations']}).then(
  found => JSON.stringify(found.violations.map(
  v => [v.id, v.nodes.map(n => n.target.join(' ') + ': ' + n.html.slice(0, 160) + ' ' +
  n.any.concat(n.all).map(a => a.message).join('; ').slice(0, 200))])))
"""


@pytest.fixture(scope="session")
def axe(request: pytest.FixtureRequest) -> str:
    """The script of axe-core, installed by npm once into pytest's cache."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("npm fetches axe-core; install it for this test")
    folder = Path(request.config.cache.mkdir("axe"))  # type: ignore[union-attr]
    script = folder / "node_modules" / "axe-core" / "axe.min.js"
    if not script.exists():
        command = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", "--prefix", str(folder)]
        done = subprocess.run([*command, PACKAGE], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            pytest.skip(f"npm could not install {PACKAGE}: {done.stderr.strip().splitlines()[-1:]}")
    return script.read_text("utf-8")


@pytest.fixture
def judge(shown: Shown, axe: str) -> Iterator[Callable[[str], None]]:
    """Has axe look at the page as it is, in every theme; what it finds fails the test at its end."""
    _, page = shown
    wrong: dict[str, Any] = {}

    def judged(what: str) -> None:
        if not page.ask("typeof axe === 'object'"):
            page.ask(axe + "; true")
            page.ask(STILL)
        for theme, colours in themes().items():
            page.prefer(theme)
            for place, ink in {"#light-off": "off-ink", "#lamp-recording": "bar-ink"}.items():
                red, green, blue = (int(colours[ink][k : k + 2], 16) for k in (1, 3, 5))
                # a lamp is dim until it was told of
                colour = f"rgb({red}, {green}, {blue})"
                page.wait(f"getComputedStyle(document.querySelector({place!r})).color === {colour!r}")
            page.wait("!document.querySelector('[class*=enter-active], [class*=leave-active]')")
            if found := json.loads(page.ask(RUN)):
                wrong[f"{what}, {theme}"] = found

    yield judged
    page.prefer("dark")
    assert wrong == {}, json.dumps(wrong, indent=1)


def test_no_panel_at_rest_has_a_violation(shown: Shown, judge: Callable[[str], None]) -> None:
    _, page = shown
    for key, name in PANELS.items():
        page.key(key)
        page.wait(f"document.querySelector('.q-tab--active').innerText.toLowerCase() === {name.lower()!r}")
        judge(name)
    desk = str(page.ask("location.origin"))
    page.browser.open(f"{desk}/rerun")
    page.wait_text("not connected: rig view has ended")
    judge("the page around Rerun's")
    page.open(desk)


def test_no_state_of_a_session_has_a_violation(
    shown: Shown, judge: Callable[[str], None], desk_output: Path
) -> None:
    _, page = shown
    page.key("3")
    session_news = SessionNews()
    session_news.begin_run("run 1", 255, None)
    folder = desk_output / "axe"
    folder.mkdir(parents=True)
    with OrderSocket(folder, session_news, {}):
        for state in (
            {"phase": "rest", "progress": "spread 3 px"},
            {"phase": "release", "instruction": "release by hand now"},
            {"phase": "measuring", "alarm": "the laser is dark"},
        ):
            session_news.state(state, [("elapsed", "0:01")])
            words = str(state.get("instruction") or state.get("alarm") or state["progress"])
            page.wait(f"document.body.innerText.toLowerCase().includes({words!r})")
            judge(state["phase"])
        page.key("?")
        page.wait("document.querySelector('.q-dialog .rows') !== null")
        judge("keys")
        page.type("\x1b")
        page.ask("document.querySelector('.q-dialog__backdrop')?.click()")
        page.wait("document.querySelector('.q-dialog .rows') === null")
    page.wait("document.getElementById('amplitude').offsetParent === null")


def test_no_form_error_list_picture_or_hand_over_has_a_violation(
    shown: Shown, judge: Callable[[str], None], desk_output: Path
) -> None:
    _, page = shown
    page.key("4")
    page.click("lever")
    page.wait_text("Lever: from px to radians")
    judge("the form of a calibration")
    ladder = desk_output.parent / "geometry.toml"
    ladder.write_text("[geometry]\narm_m = -1.0\npixel_pitch_m = 4.8e-6\n")
    page.fill("lever given", ladder.name)
    page.click("File it")
    page.wait_text("arm_m = -1.0: should be greater than 0")
    judge("a form whose list was wrong")
    page.click("close")
    page.wait("document.querySelector('.errors > *') === null")
    page.key("3")
    runs = "document.querySelector('[data-key=\"session.runs\"]')"
    page.wait(f"{runs}.offsetParent !== null")
    before = page.ask(f"{runs}.value")
    page.fill("session.runs", "0")
    page.click("Start")
    page.wait("document.querySelector('.errors > *') !== null")
    judge("an error")
    page.click("close")
    page.fill("session.runs", str(before))
    page.key("1")
    page.click("Live picture")
    page.wait("document.querySelectorAll('.lamps > span').length > 3", 150.0)
    judge("the picture with its lamps")
    page.click("Stop")
    page.wait_text("No live picture yet")
    page.key("5")
    folder = finished(desk_output)
    page.wait_text(folder.name)
    page.mark(folder.name)
    judge("a session that is marked")
    page.click("archive")
    page.wait_text("1-3 of 3")
    judge("the archive")
    # not the panel of this name
    page.ask(
        "[...document.querySelectorAll('.q-btn-toggle button')].find(b => b.innerText === 'sessions').click()"
    )
    page.wait_text(folder.name)
    # what has just ended hands over
    page.key("3")
    news = SessionNews()
    news.begin_run("run 1", 255, None)
    with OrderSocket(folder, news, {}):
        page.wait("document.getElementById('amplitude').offsetParent !== null")
    page.wait_text("THE LAST SESSION")
    page.wait_text(" ± ")
    judge("the page of the end")


def finished(output: Path) -> Path:
    """A session that has ended, with results and a report, in the archive of the desk, too."""
    add_folders(output.parent / "archive.duckdb", [SAMPLES / "series", SAMPLES / "uncalibrated"])
    folder = output / "over"
    shutil.copytree(SAMPLES / "series", folder)
    (folder / "report.html").write_text("<html lang='en'><head><title>r</title></head></html>", "utf-8")
    return folder


def test_what_the_safety_bar_says_hides_no_end_of_a_page(shown: Shown) -> None:
    _, page = shown
    page.key("4")
    page.wait(
        "[...document.querySelectorAll('button')].some(b => b.offsetParent && b.innerText == 'FILE IT')"
    )
    end = "document.scrollingElement.scrollTo(0, 1e6), [...document.querySelectorAll('.q-tab-panel .box')]"
    end = f"({end}.find(b => b.offsetParent).getBoundingClientRect().bottom)"
    bar = "document.getElementById('safety')"
    try:
        page.browser.call("Emulation.setDeviceMetricsOverride", **{**SIZE, "width": 390, "height": 500})
        page.ask(f"{bar}.lastElementChild.insertAdjacentHTML('afterend', '<p id=long>{'long ' * 90}</p>')")
        page.wait(f"{bar}.offsetHeight > 180")
        page.wait(f"{end} <= {bar}.getBoundingClientRect().top + 1")
    finally:
        page.ask("document.getElementById('long').remove()")
        page.browser.call("Emulation.setDeviceMetricsOverride", **SIZE)
