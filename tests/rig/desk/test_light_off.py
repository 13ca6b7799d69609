"""LIGHT OFF, and what lights: in a real browser, with a board that is a process of its own."""

import contextlib
import json
import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from rig.measure.session_file import RunState, SessionFile
from rig.settings import load_configuration, stored_configuration
from tests.rig.desk.board_process import BoardProcess, board_process
from tests.rig.desk.desk_page import DeskProcess, Page, desk_page
from tests.rig.view.headless_browser import HeadlessBrowser

pytestmark = [pytest.mark.slow, pytest.mark.timeout(240)]
SERIAL = """
[controller]
kind = "serial"
port = "PORT"
# a program that a busy machine holds up for longer than usual is no trip of its own
watchdog_s = 5.0
[environment_sensor]
kind = "none"
[laser]
kind = "controller"
max_power_w = 0.001
power_w = 0.0009
when_dark = "wait"
[preflight]
when = "never"
[instrument]
# nothing is fitted while one looks at the desk
kind = "tomlinson"
"""
Rig = tuple[BoardProcess, DeskProcess, Page, Path]


@pytest.fixture(scope="module")
def state_home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the rig's state is, for all tests of this file and their desk."""
    return tmp_path_factory.mktemp("state")


@pytest.fixture(autouse=True)
def _use_state_home(state_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(state_home))


@pytest.fixture(scope="module")
def rig(
    desk_configuration: Callable[[str], Path], browser: HeadlessBrowser, state_home: Path
) -> Iterator[Rig]:
    """A board, a desk of it, its page, its configuration; each test leaves them dark and acknowledged."""
    with pytest.MonkeyPatch.context() as patch, contextlib.ExitStack() as stack:
        patch.setenv("XDG_STATE_HOME", str(state_home))
        board = stack.enter_context(board_process())
        config = desk_configuration(SERIAL.replace("PORT", board.port))
        # the usual port may be taken by another desk of this machine before this one is opened again
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        try:
            with desk_page(browser, config, "--port", str(port)) as (desk, page):
                yield board, desk, page, config
        finally:
            # a session outlives its desk, and would take the port when the next board gets the same name
            for channel in (config.parent / "runs").glob("*/.orders.json"):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(int(json.loads(channel.read_text())["pid"]), signal.SIGKILL)


LAMP = "document.getElementById('lamp-{}').textContent"


def start(page: Page) -> None:
    page.key("3")
    page.click("Start …")
    page.click("Start the session")


def session_of(config: Path) -> tuple[Path, int]:
    """Folder and process of the session that runs."""
    folder = next((config.parent / "runs").glob("*/.orders.json"))
    return folder.parent, int(json.loads(folder.read_text())["pid"])


EVERYTHING = (
    "[...document.querySelectorAll('button, a, input, textarea, select, [tabindex]')]"
    ".filter(e => e.offsetParent && !e.disabled && e.tabIndex >= 0 && !e.closest('#safety'))"
)
"""Whatever can have the focus in what is seen, but LIGHT OFF."""
OF_PANEL = f"{EVERYTHING}.filter(e => e.closest('.q-tab-panel'))"


HELD_UP = """(() => {
  const ws = window.socket.io.engine.transport.ws, send = ws.send.bind(ws);
  ws.send = said => String(said).startsWith('42["event"') ? setTimeout(send, 7000, said) : send(said);
  window.rigNormal = () => { ws.send = send; };
})()"""
"""What is pressed comes later, as from a network that was away, and at a desk that was frozen."""


LIVE_PICTURE = "[...document.querySelectorAll('[data-deliberate]')].find(b => b.innerText === 'LIVE PICTURE')"


def test_what_is_typed_and_what_is_heard_late_light_nothing_and_a_held_key_does(rig: Rig) -> None:
    """On each panel whatever can have the focus gets a text; dialogs that open get the rest of it.

    Who pressed in vain has gone to look why, into the beam's way.
    """
    board, desk, page, config = rig
    killed = config.parent / "runs" / "killed"
    killed.mkdir(parents=True)
    file = SessionFile.create(killed, config, 1, stored_configuration(load_configuration(config)))
    file.note(1, "run-1.mcap", RunState.RECORDING)
    file.close()
    page.key("3")
    page.click("Start …")
    page.wait_text("The laser will be lit")
    page.type("glass ball\r as ")
    page.wait("document.querySelector('.q-dialog') !== null")
    page.click("Not now")
    page.wait("document.querySelector('.q-dialog') === null")
    assert board.changes == []
    assert "session is starting" not in page.text()
    walked = 0
    for key in "12345":
        chosen = f"document.querySelectorAll('.q-tab')[{int(key) - 1}]?.ariaSelected === 'true'"
        page.wait_while(chosen, partial(page.key, key))
        page.ask("document.activeElement.blur()")
        page.type("glass ball as pm rxb ")
        page.wait_while(chosen, partial(page.key, key))
        if key == "5":
            page.wait_text("interrupted")
            box = "[...document.querySelectorAll('.q-table tbody .q-checkbox')][0]"
            page.ask(f"{box}.click()")
            page.wait(f"{box}.ariaChecked === 'true'")
        here = EVERYTHING if key == "1" else OF_PANEL
        number = 0
        while number < int(page.ask(f"{here}.length") or 0):
            page.ask(f"{here}[{number}].focus()")
            # what is marked stays so, for Resume
            if not page.ask("document.activeElement.closest('.q-checkbox') !== null"):
                page.type("a \r")
            number, walked = number + 1, walked + 1
            if page.ask("document.querySelector('.q-dialog') !== null"):
                page.type("glass ball\r ")
                page.wait_while("document.querySelector('.q-dialog') === null", lambda: escape(page))
            # a tab that was chosen is left again
            page.wait_while(chosen, partial(page.key, key))
            assert board.changes == [], f"panel {key}, {number} of what can have the focus"
    assert walked > 30
    assert page.text().count("session is starting") == 0
    assert not list((config.parent / "runs").glob("*/.orders.json"))
    # a question of the last button may come late, but before the list of keys, which is asked for last
    page.wait_while("document.querySelector('.q-dialog table') !== null", partial(ask_for_keys, page))
    page.wait_while("document.querySelector('.q-dialog') === null", partial(escape, page))
    page.wait_while("document.querySelectorAll('.q-tab')[0]?.ariaSelected === 'true'", partial(page.key, "1"))
    page.wait_text("No live picture yet")
    page.ask(HELD_UP)
    page.click("Live picture")
    page.wait_text("s before the desk heard of it: press it again")
    assert board.changes == []
    page.ask("window.rigNormal()")
    # a dialog that closes gives the focus back later, which ends a hold
    deadline_s = time.monotonic() + 120.0
    while not board.lit:
        assert time.monotonic() < deadline_s, page.text()
        if page.ask(f"{LIVE_PICTURE}?.offsetParent != null"):
            hold(page)
        time.sleep(0.1)
    page.browser.call("Input.dispatchKeyEvent", type="keyUp", key=" ")
    page.click("Stop")
    page.wait_text("No live picture yet")
    # without what was typed
    page.open(desk.address)


def hold(page: Page) -> None:
    """Hold the space bar on the button of the live picture for 2 s."""
    page.browser.call("Input.dispatchKeyEvent", type="keyUp", key=" ")
    page.ask(f"{LIVE_PICTURE}?.focus()")
    page.browser.call("Input.dispatchKeyEvent", type="keyDown", key=" ", text=" ")
    page.ask("new Promise(held => setTimeout(held, 2000))")


def ask_for_keys(page: Page) -> None:
    escape(page)
    page.key("?")


def escape(page: Page) -> None:
    for kind in ("keyDown", "keyUp"):
        page.browser.call(
            "Input.dispatchKeyEvent", type=kind, key="Escape", code="Escape", windowsVirtualKeyCode=27
        )


def test_a_trip_of_the_live_picture_is_an_alarm_that_stays_once_it_is_stopped(rig: Rig) -> None:
    board, _, page, _ = rig
    page.click("Live picture")
    board.wait_lit(True, 120)
    page.wait(f"{LAMP.format('laser')} === 'laser on'")
    board.interlock(closed=False)
    board.wait_lit(False)
    page.wait_text("INTERLOCK")
    page.wait_text("close the interlock first".upper())
    assert page.ask(
        "[...document.querySelectorAll('.cries button')]"
        ".filter(b => b.innerText.startsWith('ACKNOWLEDGE TRIP')).every(b => b.disabled)"
    )
    page.click("Stop")
    page.wait_text("No live picture yet")
    # it stays, with the interlock open, of which nobody hears any more: then the devices refuse
    page.key("3")
    page.click("Acknowledge trip")
    page.in_dialog()
    page.wait_text("is still open")
    assert page.ask("document.querySelector('.alarm').offsetParent !== null")
    page.click("Start …")
    page.click("Start the session")
    page.wait_text("acknowledge it first")
    assert not board.lit
    page.click("close")
    board.interlock(closed=True)
    page.acknowledge()


def test_light_off_darkens_a_frozen_session_from_another_tab_with_a_dialog_open(
    rig: Rig, browser: HeadlessBrowser
) -> None:
    board, desk, page, config = rig
    start(page)
    board.wait_lit(True, 120)
    page.wait("parseFloat(document.getElementById('amplitude').innerText) > 50")
    _, pid = session_of(config)
    page.wait_text("laser on")
    os.kill(pid, signal.SIGSTOP)
    try:
        page.wait_text("Session does not answer")
        page.wait("/no frame for \\d+ s: values are old/.test(document.body.innerText)")
        with browser.another() as other:
            second = Page(other)
            second.browser.call(
                "Emulation.setDeviceMetricsOverride", width=360, height=640, deviceScaleFactor=1, mobile=True
            )
            second.open(desk.address)
            second.key("?")
            second.wait("document.querySelector('.q-dialog table') !== null")
            second.wait(f"{LAMP.format('laser')}.startsWith('laser unknown; on, confirmed ')")
            second.point_at("document.getElementById('light-off')")
            pressed_ns = time.monotonic_ns()
            dark_ns = board.wait_lit(False)
            # the board's own watchdog would take 1.4 s after the freeze, which is long ago or still to come
            assert dark_ns < pressed_ns + 5_000_000_000
    finally:
        os.kill(pid, signal.SIGCONT)
    page.wait_text("LIGHT OFF was pressed")
    assert not board.lit
    page.click("Stop")
    page.click("Stop it")
    page.wait("document.getElementById('amplitude').offsetParent === null")
    page.acknowledge()


GREY = "getComputedStyle(document.querySelector('.q-tab-panels')).filter.includes('grayscale')"


def test_light_off_darkens_the_live_picture_until_acknowledged_and_a_desk_that_dies_is_said(rig: Rig) -> None:
    """Of a desk that hangs, and then dies, the page says so, and it finds the next one."""
    board, desk, page, config = rig
    page.key("1")
    page.click("Live picture")
    board.wait_lit(True)
    page.wait(f"{LAMP.format('laser')} === 'laser on'")
    page.wait(f"{LAMP.format('interlock')} === 'interlock closed'")
    page.wait_text("nearest edge")
    page.ask("document.getElementById('light-off').click()")
    board.wait_lit(False)
    page.wait_text("LIGHT OFF was pressed")
    # an own act is no alarm, and neither is what follows from it; a picture that is late on a busy machine is
    # one, for a moment
    page.wait("document.querySelector('.alarm').offsetParent === null && !window.rigBeep")
    page.acknowledge()
    page.wait_text("Light again".upper())
    assert not board.lit
    page.click("Light again")
    board.wait_lit(True)
    page.ask("document.getElementById('light-off').click()")
    board.wait_lit(False)
    page.click("Stop")
    page.wait_text("No live picture yet")
    fact = (
        r"/^laser off, confirmed \d\d:\d\d:\d\d by board( and camera)?, \d+ s ago; light forbidden until ack/"
    )
    page.wait(f"{fact}.test({LAMP.format('laser')})")
    # over device sets: the trip is the rig's
    page.wait_text("LIGHT OFF was pressed")
    page.click("Live picture")
    page.wait_text("acknowledge it first")
    page.acknowledge()
    assert not board.lit
    page.click("Live picture")
    board.wait_lit(True)
    audit = (config.parent / "runs" / "audit.jsonl").read_text()
    told = [json.loads(line)["what"] for line in audit.splitlines()]
    assert {"lit", "dark", "latch", "acknowledge"} <= set(told)
    page.wait(f"{LAMP.format('laser')} === 'laser on'")
    desk.send(signal.SIGSTOP)
    page.wait_text("Not connected: the desk does not answer (last heard at")
    page.wait_text("start rig desk again: this page reconnects automatically")
    assert page.ask(GREY)
    page.wait("window.rigBeep")
    desk.kill()
    # no last value; on a busy machine the picture may have stood still, and its light gone off, just before
    page.wait(f"/^laser (unknown; on|off), confirmed /.test({LAMP.format('laser')})")
    page.wait(f"{LAMP.format('age')}.includes('not connected')")
    page.wait("document.getElementById('light-off').innerText.includes('no connection: key switch')")
    page.point_at("document.getElementById('light-off')")
    page.wait_text("DID NOT REACH THE DESK")
    again = DeskProcess(config)
    try:
        assert again.address == desk.address
        # that camera sees light whatever the board does, which is a trip once it was told to be dark
        quiet = "(!window.rigBeep || document.body.innerText.includes('(OUTPUT)'))"
        page.wait(f"!{GREY} && {quiet} && document.querySelector('.q-tab') !== null")
        page.click("Live picture")
        page.wait("/nearest edge|acknowledge it first/.test(document.body.innerText)")
    finally:
        again.ended()
