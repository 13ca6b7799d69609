"""The desk in a browser: who may enter and act, what is said of bad input, which keys work."""

import http.client
import urllib.parse
from http import HTTPStatus

import pytest

from tests.rig.desk.desk_page import DeskProcess, Page
from tests.rig.view.headless_browser import headless_browser

pytestmark = pytest.mark.slow
Shown = tuple[DeskProcess, Page]


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


def test_the_key_is_not_left_in_the_address(shown: Shown) -> None:
    _, page = shown
    assert page.ask("location.search") == ""
    assert page.ask("document.cookie") == "", "the key is out of reach of scripts"


@pytest.mark.parametrize("path", ["/", "/picture", "/_nicegui_ws/socket.io/?EIO=4&transport=polling"])
def test_nothing_is_answered_without_the_key(shown: Shown, path: str) -> None:
    desk, _ = shown
    assert asked(desk.address, path, {}) == HTTPStatus.FORBIDDEN


def test_a_foreign_origin_gets_no_web_socket_with_the_key(shown: Shown) -> None:
    desk, _ = shown
    parts = urllib.parse.urlsplit(desk.address)
    key = urllib.parse.parse_qs(parts.query)["key"][0]
    headers = {
        "Cookie": f"rig_desk_{parts.port}={key}",
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }
    socket = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    own, foreign = f"http://127.0.0.1:{parts.port}", "http://evil.example"
    assert asked(desk.address, socket, {**headers, "Origin": foreign}) == HTTPStatus.FORBIDDEN
    assert asked(desk.address, socket, {**headers, "Origin": own}) == HTTPStatus.SWITCHING_PROTOCOLS


def test_the_page_asks_no_other_host(shown: Shown) -> None:
    desk, page = shown
    host = urllib.parse.urlsplit(desk.address).netloc
    asked_for = [urllib.parse.urlsplit(address) for address in page.browser.requested]
    assert {parts.netloc for parts in asked_for if parts.scheme in ("http", "https", "ws")} == {host}


def test_keys_choose_the_panel_but_not_while_something_is_typed(shown: Shown) -> None:
    _, page = shown
    selected = "document.querySelector('.q-tab--active').innerText.toLowerCase()"
    page.key("2")
    page.wait(f"{selected} === 'balance'")
    page.key("4")
    page.wait(f"{selected} === 'measure'")
    page.fill("session.notes", "1")
    assert page.ask(selected) == "measure"
    page.fill("session.notes", "")


@pytest.mark.parametrize(
    ("key", "typed", "said"),
    [
        ("session.runs", "0", "should be greater than or equal to 1"),
        ("session.runs", "three", "session.runs = 'three'"),
        ("session.initial_amplitude_arcsec", "1", "must be below"),
        ("session.final_amplitude_arcsec", "-2", "should be greater than 0"),
        ("session.max_duration_s", "1,5", "with a point: 1.5"),
    ],
)
def test_bad_input_is_named_at_its_field_and_starts_nothing(
    shown: Shown, key: str, typed: str, said: str
) -> None:
    _, page = shown
    page.key("4")
    page.wait_text("AT MOST / S".lower())
    before = page.ask(f"document.querySelector('[data-key=\"{key}\"]').value")
    page.fill(key, typed)
    page.wait(
        f"document.querySelector('[data-key=\"{key}\"]').closest('.q-field').innerText.includes({said!r})"
    )
    page.click("Start")
    page.wait("document.querySelector('.q-notification') !== null")
    page.click("close")
    page.fill(key, before)
    page.wait("document.querySelectorAll('.q-field--error').length === 0")
    assert "session begins" not in page.text()


def test_a_second_tab_watches_until_it_takes_over(shown: Shown) -> None:
    desk, page = shown
    page.wait("!document.body.innerText.includes('this tab watches')")
    with headless_browser() as browser:
        second = Page(browser)
        second.open(desk.address)
        second.wait_text("this tab watches")
        second.click("Live picture")
        second.wait_text("Take over first")
        assert "peak" not in page.text()
        second.click("Take over")
        second.wait("!document.body.innerText.includes('this tab watches')")
        page.wait_text("this tab watches")
    # who was left behind acts again
    page.wait("!document.body.innerText.includes('this tab watches')")


def test_everything_that_can_be_pressed_or_filled_has_a_name(shown: Shown) -> None:
    _, page = shown
    nameless = (
        "[...document.querySelectorAll('button, input, [role=tab]')].filter(e => e.offsetParent && "
        "!(e.innerText || e.ariaLabel || e.labels?.[0]?.innerText || e.closest('label')?.innerText)"
        ").map(e => e.outerHTML)"
    )
    for key in "1234":
        page.key(key)
        assert page.ask(nameless) == []
