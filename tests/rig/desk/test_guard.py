"""Nobody gets to the desk without its key, under another name, or from a foreign page."""

import asyncio
from typing import Any

import pytest

pytest.importorskip("starlette", reason="rig desk is not installed: pip install '.[desk]'")

from rig.desk.server import Guard

KEY, PORT, OFF_PORT = "the-key", 8642, 8643
HOST, OFF_HOST = f"127.0.0.1:{PORT}", f"127.0.0.1:{OFF_PORT}"
COOKIE = f"rig_desk_{PORT}={KEY}"


async def _app(scope: Any, receive: Any, send: Any) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"the desk"})


GUARD = Guard(_app, KEY, PORT, OFF_PORT)
OFF_GUARD = Guard(_app, KEY, PORT, OFF_PORT, hears_off=True)


def ask(
    kind: str = "http", query: str = "", method: str = "GET", guard: Guard = GUARD, **headers: str
) -> dict[str, Any]:
    """The first thing that is answered."""
    answers: list[dict[str, Any]] = []

    async def send(message: dict[str, Any]) -> None:
        answers.append(message)

    async def receive() -> dict[str, Any]:
        return {"type": "http.request"}

    scope = {
        "type": kind,
        "method": method,
        "path": "/",
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode("latin-1")) for name, value in headers.items()],
    }
    asyncio.run(guard(scope, receive, send))  # type: ignore[arg-type]
    return answers[0]


def test_the_key_in_the_address_becomes_a_cookie_and_leaves_the_address() -> None:
    answer = ask(query=f"key={KEY}", host=HOST)
    headers = dict(answer["headers"])
    assert answer["status"] == 303
    assert headers[b"location"] == b"/"
    assert b"HttpOnly" in headers[b"set-cookie"]
    assert b"samesite=strict" in headers[b"set-cookie"].lower()
    assert ask(query="key=another", host=HOST)["status"] == 403


def test_with_the_cookie_one_enters_and_the_page_may_ask_no_other_host() -> None:
    answer = ask(host=HOST, cookie=COOKIE)
    assert answer["status"] == 200
    policy = dict(answer["headers"])[b"content-security-policy"].decode()
    assert "default-src 'self'" in policy
    assert f"connect-src 'self' http://127.0.0.1:{OFF_PORT} http://localhost:{OFF_PORT};" in policy


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"host": HOST}, 403),
        ({"host": HOST, "cookie": f"rig_desk_{PORT}=another"}, 403),
        ({"host": HOST, "cookie": f"rig_desk_{PORT}="}, 403),
        ({"host": "evil.example", "cookie": COOKIE}, 421),
        ({"host": f"evil.example:{PORT}", "cookie": COOKIE}, 421),
        ({"host": HOST, "cookie": COOKIE, "origin": "http://evil.example"}, 403),
        ({"host": HOST, "cookie": COOKIE, "origin": "null"}, 403),
        ({"host": HOST, "cookie": COOKIE, "method": "POST"}, 403),
    ],
)
def test_others_are_refused(headers: dict[str, str], status: int) -> None:
    assert ask(**headers)["status"] == status


@pytest.mark.parametrize("origin", ["http://evil.example", "http://127.0.0.1:1", None])
def test_a_foreign_page_opens_no_web_socket_even_with_the_cookie(origin: str | None) -> None:
    headers = {"host": HOST, "cookie": COOKIE, **({} if origin is None else {"origin": origin})}
    assert ask("websocket", **headers)["type"] == "websocket.close"


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_the_desks_own_page_opens_it(name: str) -> None:
    host = f"{name}:{PORT}"
    answer = ask("websocket", host=host, cookie=COOKIE, origin=f"http://{host}")
    assert answer["type"] == "websocket.accept"


def press(host: str = OFF_HOST, origin: str = f"http://{HOST}", cookie: str = COOKIE) -> int:
    """How LIGHT OFF is answered at its own port."""
    return int(ask(method="POST", guard=OFF_GUARD, host=host, origin=origin, cookie=cookie)["status"])


def test_light_off_is_taken_at_its_own_port_from_the_desks_own_page_only() -> None:
    assert press() == 200
    assert press(origin="http://evil.example") == 403
    assert press(host=f"evil.example:{OFF_PORT}") == 421
    assert press(cookie="") == 403


@pytest.mark.parametrize(
    "foreign",
    [
        'settings={"dark": true, "size": [1, 2]}',
        'half="unclosed',
        "a b=c",
        "alone",
        "user@host=1",
        "expires=1",
        "caf\xe9=\xe9",
        f"rig_desk_{PORT}=of-somebody-else",
        "=",
    ],
)
@pytest.mark.parametrize("order", ["before", "after"])
def test_cookies_of_other_programs_on_this_machine_shut_nobody_out(foreign: str, order: str) -> None:
    """A browser has one set for all ports of a host; who is shut out cannot switch the light off either."""
    cookie = f"{foreign}; {COOKIE}" if order == "before" else f"{COOKIE}; {foreign}"
    origin = f"http://{HOST}"
    assert press(cookie=cookie) == 200
    assert ask("websocket", host=HOST, cookie=cookie, origin=origin)["type"] == "websocket.accept"
    without = foreign if order == "before" else f"x=1; {foreign}"
    assert press(cookie=without) == 403
