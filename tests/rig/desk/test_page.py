"""The desk in a browser: who may enter, what is said of bad input, what keys and mouse do."""

import http.client
import re
import threading
import urllib.parse
from dataclasses import asdict, replace
from http import HTTPStatus
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="rig desk is not installed: pip install '.[desk]'")

from acquisition.camera import Frame
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import DeviceError
from processing.spot import Spot
from rig.control import ControlState, LaserReport, Light, SafetyNow
from rig.desk.alarm_list import AlarmKey
from rig.desk.header import sentence
from rig.devices import OrderSocket, SessionNews
from rig.instrument import Block
from rig.terminal import Verdict
from tests.rig.control.test_states import status
from tests.rig.desk.desk_page import DeskProcess, Page

pytestmark = [pytest.mark.slow, pytest.mark.timeout(240)]
Shown = tuple[DeskProcess, Page]
FRAME = Frame(np.full((64, 32), 40, np.uint8), 1, 1, 1)
SPOT = Spot(16.0, 32.0, 0.01, 0.01, 2.0, 2.0, 0.0, 100.0, 4.0, 1.0, 0)
OF = "getElement(Number(document.querySelector('[aria-label=\"trajectory\"]').id.slice(1))).chart"


def news() -> SessionNews:
    """Of a session in its first run."""
    found = SessionNews()
    found.begin_run("run 1", 255, None)
    return found


def asked(address: str, path: str, headers: dict[str, str]) -> int:
    """The status that a program gets."""
    parts = urllib.parse.urlsplit(address)
    assert parts.hostname is not None
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=10)
    try:
        connection.request("GET", path, headers=headers)
        return connection.getresponse().status
    finally:
        connection.close()


def test_all_that_is_served_is_behind_the_guard(shown: Shown) -> None:
    """What the guard admits is in test_guard."""
    desk, page = shown
    assert page.ask("location.search + document.cookie") == "", "the key is out of reach of scripts"
    socket = "/_nicegui_ws/socket.io/?EIO=4&transport="
    for path in ("/", "/picture", f"{socket}polling"):
        assert asked(desk.address, path, {}) == HTTPStatus.FORBIDDEN
    parts = urllib.parse.urlsplit(desk.address)
    key = urllib.parse.parse_qs(parts.query)["key"][0]
    headers = {
        "Cookie": f"rig_desk_{parts.port}={key}",
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }
    for origin, answered in (
        ("http://evil.example", HTTPStatus.FORBIDDEN),
        (f"http://127.0.0.1:{parts.port}", HTTPStatus.SWITCHING_PROTOCOLS),
    ):
        assert asked(desk.address, f"{socket}websocket", {**headers, "Origin": origin}) == answered


def test_the_page_asks_no_other_host(shown: Shown) -> None:
    _, page = shown
    asked_for = [urllib.parse.urlsplit(address) for address in page.browser.requested]
    assert {parts.hostname for parts in asked_for if parts.scheme in ("http", "https", "ws")} == {"127.0.0.1"}


def test_keys_choose_the_panel_but_not_while_something_is_typed(shown: Shown) -> None:
    _, page = shown
    selected = "document.querySelector('.q-tab--active').innerText.toLowerCase()"
    page.key("2")
    page.wait(f"{selected} === 'balance'")
    page.key("3")
    page.wait(f"{selected} === 'measure'")
    page.fill("session.notes", "1")
    assert page.ask(selected) == "measure"
    page.fill("session.notes", "")


NO_NUMBERS = {
    "session.runs": ("0", "three", "1.5", "1e15", "nan"),
    "session.initial_amplitude_arcsec": ("1", "much", "inf", "124 px"),
    "session.final_amplitude_arcsec": ("-2", "1e9", "2,5"),
    "session.max_duration_s": ("1,5", "0", "nan", "1 kg"),
}


def test_bad_input_is_named_by_its_key_and_starts_nothing(shown: Shown) -> None:
    _, page = shown
    page.key("3")
    for key, typed in NO_NUMBERS.items():
        before = page.ask(f"document.querySelector('[data-key=\"{key}\"]').value")
        for one in typed:
            page.fill(key, one)
            page.click("Start")
            line = page.wait("document.querySelector('.errors > *')?.innerText")
            assert f"{key} = " in line
            assert re.search("should|must|is meant", line)
            page.click("close")
            page.wait("document.querySelector('.errors > *') === null")
        page.fill(key, before)
    assert "session is starting" not in page.text()


def test_buttons_say_what_is_missing_and_an_empty_page_says_what_to_do(shown: Shown) -> None:
    _, page = shown
    page.key("1")
    page.wait_text("No live picture yet. Press Live picture")
    page.wait_text("settings need a live picture")
    page.wait("[...document.querySelectorAll('button')].find(b => b.innerText.trim() === '+').disabled")


HOLD = "{}.forEach(b => {{ b.rigHeld = true; b.click(); b.rigHeld = false; }})"
"""Press buttons as a key does that was held on them."""


def feed(session_news: SessionNews, none: Deflections, ended: threading.Event) -> None:
    """Frames, as long as a session gets them."""
    while not ended.wait(0.2):
        session_news.look([FRAME], Block([SPOT], none, [], []))


def test_a_session_is_shown_before_its_record_begins_and_cries_are_seen_and_heard(
    shown: Shown, desk_output: Path
) -> None:
    _, page = shown
    taken = []
    lit = SafetyNow(laser=LaserReport(Light.ON), controller=ControlState.OPEN, status=status())
    now = {"safety": asdict(lit)}
    session_news = news()
    empty = np.zeros(0)
    none = Deflections(np.zeros(0, np.int64), empty, empty, empty, empty, DeflectionUnit.PX)

    def brake(value: str) -> str:
        if value == "off":
            raise DeviceError("the brake: does not answer; see its cable")
        taken.append("on")
        now["safety"] = asdict(replace(lit, status=status(brake_on=True)))
        return "the brake is on"

    folder = desk_output / "of-another"
    folder.mkdir(parents=True)
    page.key("3")
    noted: list[str] = []

    def note(value: str) -> str:
        noted.append(value)
        return "noted"

    with OrderSocket(folder, session_news, {"brake": brake, "note": note}, lambda: now):
        session_news.state({"phase": "rest", "progress": "spread 3 px"}, [])
        page.wait_text("nothing recorded yet")
        page.wait("document.querySelector('.steps [aria-current]').innerText === 'rest: spread 3 px'")
        page.wait_text("no frame yet: rest: spread 3 px")
        page.wait_while(
            "!document.body.innerText.includes('no frame yet')",
            lambda: session_news.look([FRAME], Block([SPOT], none, [], [])),
        )
        session_news.state({"phase": "release", "instruction": "release by hand now"}, [])
        page.wait_text("RELEASE BY HAND NOW")
        page.click("Brake")
        page.wait_text("the brake is on")
        # the button says what it does once the session has told its state
        page.click("Brake off")
        page.wait_text("the brake: does not answer; see its cable")
        page.click("close")
        assert taken == ["on"]
        field = "document.querySelector('[data-key=note]')"
        page.wait(f"({field}.focus(), true)")
        page.type("a door slammed\r")
        page.wait(f"{field}.value === ''")
        assert noted == ["a door slammed"]
        fed = threading.Event()
        feeding = threading.Thread(target=feed, args=(session_news, none, fed))
        feeding.start()
        session_news.state({"phase": "measuring", "temperature_c": 20.0, "alarm": "the laser is dark"}, [])
        page.wait_text("Run in trouble: the laser is dark")
        assert page.ask("document.querySelector('.alarm').getBoundingClientRect().height") <= 48
        colour = "getComputedStyle(document.querySelector('.alarm')).backgroundColor"
        assert page.ask(colour) == "rgb(213, 94, 0)"
        page.wait("window.rigBeep && window.rigAudio.state === 'running'")
        session_news.state({"phase": "measuring", "temperature_c": 20.0, "alarm": ""}, [])
        page.wait("document.querySelector('.alarm').offsetParent === null && !window.rigBeep")
        # it stays in the list until somebody has seen it
        page.wait_text("cleared")
        page.key("a")
        buttons = "[...document.querySelectorAll('.alarm-row button')].filter(b => b.innerText === 'SEEN')"
        page.wait_while(
            "document.body.innerText.includes('Alarms: none')",
            # the list may change between the look and the click
            lambda: page.ask(f"{buttons}.length") and page.ask(HOLD.format(buttons)),
        )
        page.key("a")
        fed.set()
        feeding.join()
        assert "nothing recorded yet" not in page.text()
    page.wait("document.getElementById('amplitude').offsetParent === null")


def test_a_trajectory_is_drawn_and_a_zoom_outlives_new_points(shown: Shown, desk_output: Path) -> None:
    _, page = shown
    session_news = news()
    y = np.linspace(-10.0, 10.0, 100)
    none = np.zeros_like(y)
    way = Deflections(np.arange(100) * 10**7, y, y, none, none, DeflectionUnit.PX)
    folder = desk_output / "of-charts"
    folder.mkdir(parents=True)
    page.key("3")
    with OrderSocket(folder, session_news, {}):
        session_news.look([FRAME], Block([SPOT], way, [], []))
        page.wait(f"{OF}.getOption().series[0].data.length > 90")
        page.ask(f"{OF}.dispatchAction({{type: 'dataZoom', dataZoomIndex: 0, start: 0, end: 75}})")
        page.wait(f"{OF}.getOption().dataZoom[0].end === 75")
        more = Deflections(way.times_ns + 10**9, 0.5 * y, y, none, none, DeflectionUnit.PX)
        session_news.look([FRAME], Block([SPOT], more, [], []))
        page.wait(f"{OF}.getOption().series[0].data.length > 190")
        assert page.ask(f"{OF}.getOption().dataZoom[0].end") == 75
        page.click("stretch X")
        page.wait(f"{OF}.getOption().xAxis[0].max === null")
        page.click("to scale")
        page.wait(f"{OF}.getOption().xAxis[0].max === 12")
        assert page.ask("rigNumber(-1.23456789, 'px')") == "−1.23457 px"
    page.wait("document.getElementById('amplitude').offsetParent === null")


def test_what_is_being_pressed_stays_while_its_alarm_goes_on(shown: Shown, desk_output: Path) -> None:
    _, page = shown
    session_news = news()
    folder = desk_output / "told"
    folder.mkdir(parents=True)
    session_news.preflight([Verdict("spot", False, "it is lost", "look for it")])
    with OrderSocket(folder, session_news, {}):
        session_news.state({"phase": "preflight"}, [])
        page.wait_text(sentence(AlarmKey.PREFLIGHT.remedy))
        row = f"document.querySelector('[data-alarm=\"{AlarmKey.STALLED}\"]')"
        session_news.state({"phase": "preflight", "alarm": "nothing processed for 5 s"}, [])
        page.wait(f"{row}?.textContent.includes('for 5 s')")
        page.ask(f"{row}.querySelector('button').held = true")
        session_news.state({"phase": "preflight", "alarm": "nothing processed for 6 s"}, [])
        page.wait(f"{row}.textContent.includes('for 6 s')")
        assert page.ask(f"{row}.querySelector('button').held") is True
    page.wait_text(f"last session: {folder.name}")


def test_a_panel_that_cannot_be_drawn_says_so_once_and_holds_nothing_up(
    shown: Shown, desk_output: Path
) -> None:
    _, page = shown
    page.key("1")
    folder = desk_output / "older"
    folder.mkdir(parents=True)
    # a row without the keys of this version
    with OrderSocket(folder, news(), {}, lambda: {"preflight": [{"name": "spot", "ok": False}]}):
        page.wait_text("Rig is not brought up to date: KeyError")
        # each part of the panel says it once, at its own time
        page.wait("(window.looks = (window.looks || 0) + 1) > 30")
        page.ask("window.looks = 0")
        page.ask("document.querySelectorAll('.errors button').forEach(one => one.click())")
        page.wait("(window.looks = (window.looks || 0) + 1) > 15")
        assert page.ask("document.querySelectorAll('.errors > *').length") == 0
        assert page.ask("document.documentElement.classList.contains('dead')") is False
    # the next test needs the camera, which the session had
    page.wait_text(f"last session: {folder.name}")


def test_exposure_region_and_focus_are_set_and_seen(shown: Shown) -> None:
    _, page = shown
    page.key("1")
    page.click("Live picture")
    page.wait_text("160 × 640 px")
    page.wait("document.querySelectorAll('[aria-label=\"histogram\"] svg path').length > 20")
    page.fill("camera.exposure_us", "1,5")
    page.click("Set")
    page.wait_text("exposure_us")
    page.click("close")
    page.fill("camera.exposure_us", "")
    for _ in range(4):
        page.click("+")
    page.wait_text("244.141 µs")
    page.wait("!document.body.innerText.includes('saturated\\tnone')")
    off = np.abs(page.browser.picture().reshape(-1, 3).astype(int) - (213, 94, 0)).max(axis=1)
    assert np.count_nonzero(off < 12) > 20, "saturated pixels are drawn in their colour"
    page.ask("document.querySelector('[aria-label=\"larger gain\"]').click()")
    page.wait_text("gain 1 dB")
    page.drag(".picture img", (0.45, 0.3), (0.55, 0.7))
    region = page.wait(
        "(document.body.innerText.match(/region\\s+(\\d+ × \\d+) px from/) ?? [])[1] != '160 × 640' && "
        "document.body.innerText.match(/region\\s+(\\d+) × (\\d+) px from \\((\\d+), (\\d+)\\)/).slice(1)"
    )
    width_px, height_px, left_px, top_px = map(int, region)
    # 640 rows fill the height of the picture, whose sides are as 800 to 540
    assert height_px == pytest.approx(0.4 * 640, abs=6)
    assert width_px == pytest.approx(0.1 * 800 * 640 / 540, abs=6)
    assert top_px == pytest.approx(0.3 * 640, abs=6)
    assert left_px == pytest.approx(0.5 * (160 - width_px), abs=6)
    page.click("Whole sensor")
    page.wait_text("160 × 640 px")
    page.click("Stop")
    page.wait_text("No live picture yet")


AWAY = """
window.socket.io.reconnectionDelay(6000);
window.socket.io.reconnectionDelayMax(6000);
window.socket.io.engine.close();
document.querySelector('[aria-label^=Keys]').click();
"""


def test_a_press_that_is_sent_late_is_heard(shown: Shown) -> None:
    """On a loaded machine the browser finds its connection closed, and is away for seconds."""
    _, page = shown
    page.ask(AWAY)
    page.wait("document.querySelector('[aria-label=\"keys\"] table') !== null", 20.0)
    page.ask("document.querySelector('.q-dialog__backdrop').click()")
    page.wait("document.querySelector('.q-dialog') === null")
