"""A desk that dies, hangs and comes again: what the page says by itself."""

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.rig.desk.desk_page import DeskProcess, desk_page
from tests.rig.view.headless_browser import HeadlessBrowser

pytestmark = [pytest.mark.slow, pytest.mark.timeout(240)]
GREY = "getComputedStyle(document.querySelector('.q-tab-panels')).filter.includes('grayscale')"


def test_a_desk_that_dies_is_said_by_the_page_which_finds_the_next_one(
    desk_configuration: Callable[[str], Path], browser: HeadlessBrowser
) -> None:
    config = desk_configuration("")
    with desk_page(browser, config) as (desk, page):
        page.wait_text("recording nothing")
        os.kill(desk.pid, signal.SIGSTOP)
        page.wait_text("Not connected: the desk does not answer (last heard at")
        page.wait_text("start rig desk again: this page reconnects automatically")
        assert page.ask(GREY)
        page.wait("window.rigBeep")
        desk.kill()
        again = DeskProcess(config)
        try:
            assert again.address == desk.address
            page.wait(f"!{GREY} && !window.rigBeep && document.querySelector('.q-tab') !== null")
            page.click("Live picture")
            page.wait_text("nearest edge")
        finally:
            again.end()


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
    DeskProcess(other).end()
