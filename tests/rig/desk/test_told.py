"""What a browser is told while nobody looks at the page."""

from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from rig.desk.alarm_bar import sentence
from rig.desk.alarm_list import CATALOGUE, AlarmKey
from rig.devices import OrderSocket, SessionNews
from rig.presentation import Verdict
from rig.settings import Configuration
from tests.rig.desk.desk_page import DeskProcess, Page, desk_page
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


def test_an_alarm_is_told_to_the_browser_once_with_its_remedy(
    shown: tuple[DeskProcess, Page], desk_output: Path
) -> None:
    _, page = shown
    page.ask(RECORD)
    news = SessionNews(Configuration(camera={"driver": "simulated"}))  # type: ignore[arg-type]
    news.begin_run("run 1", 255, None)
    folder = desk_output / "told"
    folder.mkdir(parents=True)
    alarm = CATALOGUE[AlarmKey.PREFLIGHT]
    news.preflight([Verdict("spot", False, "it is lost", "look for it")])
    of_preflight = f"window.told.filter(one => one[2] === {str(AlarmKey.PREFLIGHT)!r})"
    with OrderSocket(folder, news, {}):
        news.state({"phase": "preflight"}, [])
        page.wait(f"{of_preflight}.length")
        ((title, text, _, stays),) = page.ask(of_preflight)
        assert (title, stays) == (AlarmKey.PREFLIGHT, True)
        assert alarm.remedy in text
        # the page is told four times a second what cries
        page.wait_text(sentence(alarm.remedy))
        page.wait("(window.looks = (window.looks || 0) + 1) > 15")
        assert page.ask(f"{of_preflight}.length") == 1


def test_a_panel_that_cannot_be_drawn_says_so_once_and_holds_nothing_up(
    desk_configuration: Callable[[str], Path], browser: HeadlessBrowser
) -> None:
    config = desk_configuration("")
    with desk_page(browser, config) as (_, page):
        news = SessionNews(Configuration(camera={"driver": "simulated"}))  # type: ignore[arg-type]
        news.begin_run("run 1", 255, None)
        folder = config.parent / "runs" / "older"
        folder.mkdir(parents=True)
        # a row without the keys of this version
        with OrderSocket(folder, news, {}, lambda: {"preflight": [{"name": "spot", "ok": False}]}):
            page.wait_text("Rig is not brought up to date: KeyError")
            page.ask("document.querySelectorAll('.errors button').forEach(one => one.click())")
            page.wait("(window.looks = (window.looks || 0) + 1) > 15")
            assert page.ask("document.querySelectorAll('.errors > *').length") == 0
            assert page.ask("document.documentElement.classList.contains('dead')") is False
