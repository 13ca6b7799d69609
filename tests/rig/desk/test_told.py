"""What a browser is told while nobody looks at the page, and what comes back of earlier sessions."""

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from rig.alarms import CATALOGUE, AlarmKey
from rig.channel import Channel, SessionNews
from rig.desk.kept import Kept
from rig.settings import Configuration
from tests.rig.desk.desk_page import Page, desk_page
from tests.rig.view.headless_browser import HeadlessBrowser

pytestmark = [pytest.mark.slow, pytest.mark.timeout(240)]
RECORD = """
window.told = [];
window.Notification = class {
  constructor(title, how) { window.told.push([title, how.body, how.tag, how.requireInteraction]); }
};
window.Notification.permission = 'granted';
"""
"""A browser without windows grants no notifications: what is asked of it is kept."""


def test_an_alarm_is_told_to_the_browser_once_with_its_remedy_and_so_is_the_desks_death(
    desk_configuration: Callable[[str], Path], browser: HeadlessBrowser
) -> None:
    config = desk_configuration("")
    with desk_page(browser, config) as (desk, page):
        page.ask(RECORD)
        news = SessionNews(Configuration(camera={"driver": "simulated"}))  # type: ignore[arg-type]
        news.begin_run("run 1", 255, None)
        folder = config.parent / "runs" / "told"
        folder.mkdir(parents=True)
        alarm = CATALOGUE[AlarmKey.PREFLIGHT]
        with Channel(folder, news, {}, lambda: {"preflight": [{"name": "spot", "ok": False}]}):
            news.state({"phase": "preflight"}, [])
            page.wait("window.told.length")
            title, text, tag, stays = page.ask("window.told[0]")
            assert (title, tag, stays) == (alarm.title, AlarmKey.PREFLIGHT, True)
            assert alarm.remedy in text
            # the page is told four times a second what cries
            page.wait_text(alarm.remedy)
            looks = "(window.looks = (window.looks || 0) + 1) > 15"
            page.wait(looks)
            assert page.ask("window.told.length") == 1
        os.kill(desk.pid, signal.SIGSTOP)
        try:
            page.wait("window.told.some(one => one[2] === 'desk lost')")
        finally:
            os.kill(desk.pid, signal.SIGCONT)


def test_what_a_session_was_started_with_is_chosen_again(
    desk_configuration: Callable[[str], Path], browser: HeadlessBrowser
) -> None:
    config = desk_configuration("")
    kept = Kept(config)
    kept.hold(config.parent / "runs")
    values = {"session.sample": "ruby on K8", "session.final_amplitude_arcsec": "7.5", "session.runs": "3"}
    kept.use("Ada", "ruby on K8, Ada", values)
    kept.close()
    with desk_page(browser, config) as (_, page):
        named(page, "Ada")
        page.key("4")
        before = (
            "document.querySelector('[aria-label=\"values of an earlier session\"]')?.closest('.q-field')"
        )
        page.wait(f"{before}?.offsetParent != null")
        page.ask(f"{before}.querySelector('.q-field__control').click()")
        choice = (
            "[...document.querySelectorAll('.q-menu .q-item')].find(one => one.innerText.includes('ruby'))"
        )
        page.wait(f"{choice} != null")
        page.ask(f"{choice}.click()")
        for key, value in values.items():
            page.wait(f"document.querySelector('[data-key=\"{key}\"]').value === {value!r}")
        # of somebody else they are not
        named(page, "Eve")
        page.wait(f"!{before}?.offsetParent")


def named(page: Page, name: str) -> None:
    """Say who sits at the tab."""
    page.ask("document.querySelector('[aria-label=\"who sits at this tab\"]').click()")
    field = "document.querySelector('.q-dialog input')"
    page.wait(f"{field} != null && ({field}.focus(), {field}.select(), document.activeElement === {field})")
    page.browser.call("Input.insertText", text=name)
    page.wait(f"{field}.value === {name!r}")
    page.click("That is me")
    page.wait("document.querySelector('.q-dialog') === null")
