"""A desk that dies, hangs and comes again: what the page says by itself, and what survives."""

import http.client
import os
import signal
import urllib.parse
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.rig.desk.desk_page import DeskProcess, Page, desk_page
from tests.rig.view.headless_browser import HeadlessBrowser

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(240)]
GREY = "getComputedStyle(document.querySelector('.q-tab-panels')).filter.includes('grayscale')"
VALUE = "document.querySelector('[data-key=\"{}\"]').value"


def test_a_desk_that_dies_is_said_by_the_page_which_finds_the_next_one_with_all_that_was_typed(
    desk_configuration: Callable[[str], Path], browser: HeadlessBrowser
) -> None:
    config = desk_configuration("")
    with desk_page(browser, config) as (desk, page):
        page.key("4")
        page.fill("session.sample", "glass ball 7")
        page.wait_text("you have acted since")
        os.kill(desk.pid, signal.SIGSTOP)
        page.wait_text("THE DESK DOES NOT ANSWER (last heard at")
        page.wait_text("start rig desk again: this page reconnects automatically")
        assert page.ask(GREY)
        page.wait("window.rigBeep")
        # no desk hears this
        page.fill("session.notes", "typed without a desk")
        desk.kill()
        again = DeskProcess(config)
        try:
            assert again.address == desk.address
            page.wait(f"!{GREY} && document.querySelector('.q-tab--active').innerText === 'MEASURE'")
            page.wait(f"{VALUE.format('session.sample')} === 'glass ball 7'")
            page.wait(f"{VALUE.format('session.notes')} === 'typed without a desk'")
            page.wait_text("you have acted since")
            page.wait("!window.rigBeep")
            page.ask("location.reload()")
            page.wait(f"{VALUE.format('session.notes')} === 'typed without a desk'")
            page.wait("document.querySelector('.q-tab--active').innerText === 'MEASURE'")
        finally:
            again.end()


def test_a_page_that_is_only_fetched_acts_not_and_the_link_for_watching_never_does(
    desk_configuration: Callable[[str], Path], browser: HeadlessBrowser
) -> None:
    config = desk_configuration("")
    desk = DeskProcess(config)
    try:
        parts = urllib.parse.urlsplit(desk.address)
        key = urllib.parse.parse_qs(parts.query)["key"][0]
        connection = http.client.HTTPConnection("127.0.0.1", parts.port, timeout=30)
        connection.request("GET", "/", headers={"Cookie": f"rig_desk_{parts.port}={key}"})
        assert connection.getresponse().status == 200
        connection.close()
        with browser.another() as tab:
            page = Page(tab)
            page.open(desk.address)
            page.wait_text("you have acted since", 20.0)
            # another kind of browser: it has no cookie yet
            page.browser.call("Network.clearBrowserCookies")
            page.open(desk.watching)
            page.wait_text("read only")
            page.click("Live picture")
            page.wait_text("its address allows watching only")
            assert "TAKE OVER" not in page.text()
    finally:
        desk.end()


def test_a_second_desk_of_a_configuration_is_refused_and_says_where_the_first_is(
    desk_configuration: Callable[[str], Path],
) -> None:
    config = desk_configuration("")
    desk = DeskProcess(config)
    try:
        with pytest.raises(AssertionError, match="it already has an open desk") as refused:
            DeskProcess(config)
        assert desk.address in str(refused.value)
        # its sessions would be ordered about by two
        other = config.with_name("other.toml")
        other.write_text(config.read_text("utf-8"), "utf-8")
        with pytest.raises(AssertionError, match="another configuration has its sessions there") as refused:
            DeskProcess(other)
        assert desk.address in str(refused.value)
    finally:
        desk.end()
    # the refused one has left nothing behind
    for free in (other, config):
        DeskProcess(free).end()


def test_a_browser_that_does_not_say_what_it_keeps_costs_no_traceback(
    desk_configuration: Callable[[str], Path], browser: HeadlessBrowser
) -> None:
    desk = DeskProcess(desk_configuration(""))
    try:
        with browser.another() as tab:
            page = Page(tab)
            never = "Object.defineProperty(window, 'rigKept', {value: () => new Promise(() => {})})"
            tab.call("Page.enable")
            tab.call("Page.addScriptToEvaluateOnNewDocument", source=never)
            page.open(desk.address)
            assert page.ask("Promise.race([window.rigKept(), 0])") == 0
            page.wait("performance.now() > 8000")
            # the desk goes on
            page.key("4")
            page.fill("session.notes", "heard")
        assert [line for line in desk.said() if "Traceback" in line or "Error" in line] == []
    finally:
        desk.kill()
