"""A desk that dies, hangs and comes again: what the page says by itself."""

import os
import signal
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.rig.desk.desk_page import DeskProcess, desk_page
from tests.rig.desk.test_page import RECORD
from tests.rig.view.headless_browser import HeadlessBrowser

pytestmark = [pytest.mark.slow, pytest.mark.timeout(240)]
GREY = "getComputedStyle(document.querySelector('.q-tab-panels')).filter.includes('grayscale')"


def test_a_desk_that_dies_is_said_by_the_page_which_finds_the_next_one(
    desk_configuration: Callable[[str], Path], browser: HeadlessBrowser
) -> None:
    config = desk_configuration("")
    # the usual port may be taken by another desk of this machine between the two
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with desk_page(browser, config, "--port", str(port)) as (desk, page):
        page.wait_text("recording nothing")
        page.ask(RECORD)
        os.kill(desk.pid, signal.SIGSTOP)
        page.wait_text("Not connected: the desk does not answer (last heard at")
        page.wait_text("start rig desk again: this page reconnects automatically")
        assert page.ask(GREY)
        page.wait("window.rigBeep && window.told.some(one => one[2] === 'desk lost')")
        desk.kill()
        again = DeskProcess(config)
        try:
            assert again.address == desk.address
            page.wait(f"!{GREY} && !window.rigBeep && document.querySelector('.q-tab') !== null")
            page.click("Live picture")
            page.wait_text("nearest edge")
        finally:
            again.end()
