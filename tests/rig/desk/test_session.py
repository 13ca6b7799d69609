"""A whole session at the desk of the simulated rig: align, check, measure; a trip; a desk that is killed."""

import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.rig.desk.desk_page import SIZE, DeskProcess, Page, desk_page
from tests.rig.view.headless_browser import HeadlessBrowser
from tests.waiting import until

INTERLOCK = """
[controller]
# a program that a busy machine holds up for longer than usual is no trip of its own
watchdog_s = 5.0
[laser]
kind = "controller"
max_power_w = 0.001
power_w = 0.0009
when_dark = "wait"
[preflight]
when = "never"
"""
NOT_FITTED = """
[instrument]
kind = "tomlinson"
"""
HANDED_OVER = "[...document.querySelectorAll('button')].some(b => b.offsetParent && b.innerText === 'REPORT')"
OPENS = """
[faults]
interlock_opens_at_s = {}
interlock_open_for_s = 1.5
"""


pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


def test_a_session_from_align_to_report_with_a_trip_and_a_desk_that_is_killed(
    desk_configuration: Callable[[str], Path], browser: HeadlessBrowser
) -> None:
    config = desk_configuration(INTERLOCK)
    with desk_page(browser, config) as (desk, page):
        # align: the picture lives, the exposure changes and is kept
        page.click("Live picture")
        page.wait_text("100 µs, gain")
        page.click("+")
        page.wait_text("125 µs, gain")
        page.wait("document.querySelector('[data-key=\"camera.exposure_us\"]').placeholder === 'now 125'")
        page.click("Keep for runs")
        page.wait_text("camera.exposure_us = 125")
        # preflight gives the camera free and takes it itself
        page.key("1")
        page.click("Run preflight")
        page.wait_text("checks passed")
        page.wait("/NO-GO|GO/.test(document.body.innerText)")
        # measure; only now, so that the interlock opens in the session however long all that has taken
        config.write_text(config.read_text("utf-8") + OPENS.format(8.0), encoding="utf-8")
        page.key("3")
        page.fill("session.sample", 'steel "on" K8 – µ')
        page.wait("![...document.querySelectorAll('button')].some(b => b.disabled && b.innerText == 'START')")
        page.click("Start …")
        page.in_dialog()
        page.wait("parseFloat(document.getElementById('amplitude').innerText) > 50")
        folder = next((config.parent / "runs").glob("*/session.json")).parent
        # the interlock opens: an alarm that stays until it is acknowledged
        page.wait_text("the interlock of the controller opened")
        page.wait_text("Acknowledge trip".upper())
        desk.kill()
        # the session goes on without the desk, and another one finds it
        again = DeskProcess(config)
        try:
            page.open(again.address)
            page.wait_text("the interlock of the controller opened")
            page.acknowledge()
            page.click("Light again")
            page.wait_text("laser lit: again")
            page.click("Stop")
            page.click("Stop it")
            page.wait(HANDED_OVER, 120.0)
        finally:
            again.ended()
    state = json.loads((folder / "session.json").read_text())
    assert [entry["state"] for entry in state["entries"]] == ["stopped"]
    assert state["configuration"]["session"]["sample"] == 'steel "on" K8 – µ'
    assert state["configuration"]["camera"]["exposure_us"] == 125
    audit = (folder / "audit.jsonl").read_text()
    assert '"what": "acknowledge"' in audit
    assert (folder / "report.html").exists()
    assert not (folder / ".orders.json").exists()


def tab_to(page: Page, words: str) -> None:
    """Press Tab until what has the focus begins with these words, as it is read aloud."""
    name = "(e => e.ariaLabel || e.innerText || '')(document.activeElement)"
    for _ in range(150):
        if str(page.ask(name)).strip().lower().startswith(words.lower()):
            return
        for kind in ("rawKeyDown", "keyUp"):
            page.browser.call(
                "Input.dispatchKeyEvent", type=kind, key="Tab", code="Tab", windowsVirtualKeyCode=9
            )
    raise AssertionError(f"no Tab leads to {words!r}")


def hold_enter(page: Page, until: str) -> None:
    """Hold Enter until an expression is true."""
    enter = {"key": "Enter", "code": "Enter", "windowsVirtualKeyCode": 13}
    page.browser.call("Input.dispatchKeyEvent", type="rawKeyDown", **enter)
    page.wait(until)
    page.browser.call("Input.dispatchKeyEvent", type="keyUp", **enter)


@pytest.fixture(scope="module")
def config(desk_configuration: Callable[[str], Path]) -> Path:
    return desk_configuration(INTERLOCK + NOT_FITTED)


@pytest.fixture(scope="module")
def page(config: Path, browser: HeadlessBrowser) -> Iterator[Page]:
    """The page of one desk for sessions one after the other."""
    with desk_page(browser, config) as (_, opened):
        yield opened


def test_a_session_by_keyboard_alone_in_a_phones_width(page: Page) -> None:
    fits = "document.documentElement.scrollWidth <= 391"
    page.browser.call(
        "Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=1, mobile=True
    )
    for panel in "24513":
        page.type(panel)
        page.wait(fits, 10.0)
    page.wait("document.querySelector('[data-key=\"session.notes\"]').offsetParent !== null")
    tab_to(page, "notes")
    page.type("by keys")
    tab_to(page, "Start … a session")
    page.type("\r")
    page.wait("document.querySelector('.q-dialog [data-deliberate]') !== null")
    tab_to(page, "Start the session")
    page.type("\r")
    assert "session is starting" not in page.text(), "a key that is only pressed starts nothing"
    hold_enter(page, "document.querySelector('.q-dialog [data-deliberate]') === null")
    page.wait("parseFloat(document.getElementById('amplitude').innerText) > 50")
    page.wait(fits)
    tab_to(page, "Stop the session")
    page.type("\r")
    page.wait_text("nothing is lost")
    tab_to(page, "Stop it")
    page.type("\r")
    page.wait(HANDED_OVER, 120.0)
    page.wait_text("stopped")
    page.wait(fits)
    tab_to(page, "Report")
    page.browser.call("Emulation.setDeviceMetricsOverride", **SIZE)


def test_a_session_that_died_is_resumed_and_a_frozen_one_is_stopped(page: Page, config: Path) -> None:
    """Killed, and resumed in Runs; then stopped by the same keys as one that answers."""
    # hidden, it still has the text of the session before
    measuring = "(a => a.offsetParent && parseFloat(a.innerText) > 50)(document.getElementById('amplitude'))"
    page.key("3")
    page.click("Start …")
    page.in_dialog()
    page.wait(measuring)
    (channel,) = (config.parent / "runs").glob("*/.orders.json")
    folder = channel.parent
    os.kill(process_of(folder), signal.SIGKILL)
    page.wait_text("Session died")
    page.key("5")
    page.wait_text("interrupted")
    page.mark(folder.name)
    page.click("Resume")
    page.wait_text(f"Measure the missing runs of {folder}?")
    page.in_dialog()
    page.key("3")
    # until the resumed session speaks, the amplitude is the dead one's
    until(lambda: states(folder)[0] == "interrupted")
    page.wait(measuring)
    os.kill(process_of(folder), signal.SIGSTOP)
    page.wait_text("Session does not answer")
    tab_to(page, "Stop the session")
    page.type("\r")
    page.wait_text("End its process?")
    tab_to(page, "Stop it")
    page.type("\r")
    page.wait_text("its process ends")
    page.wait_text("0 of 1 runs complete; terminated")
    assert states(folder) == ["interrupted", "stopped"]


def process_of(folder: Path) -> int:
    return int(json.loads((folder / ".orders.json").read_text())["pid"])


def states(folder: Path) -> list[str]:
    """Of the runs of a session, in their order."""
    return [entry["state"] for entry in json.loads((folder / "session.json").read_text())["entries"]]
