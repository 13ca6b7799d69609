"""Nobody gets to the desk without its key, under another name, or from a foreign page."""

import asyncio
from typing import Any

import pytest

pytest.importorskip("starlette", reason="rig desk is not installed: pip install '.[desk]'")

from rig.desk.server import Guard

KEY, PORT, OFF_PORT = "the-key", 8642, 8643
HOST, OFF_HOST = f"127.0.0.1:{PORT}", f"127.0.0.1:{OFF_PORT}"
COOKIE, OWN = f"rig_desk_{PORT}={KEY}", f"http://{HOST}"


async def _app(scope: Any, receive: Any, send: Any) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"the desk"})


GUARD = Guard(_app, KEY, PORT, OFF_PORT)
OFF_GUARD = Guard(_app, KEY, PORT, OFF_PORT, is_off_server=True)


def ask(
    kind: str = "http", query: str = "", method: str = "GET", guard: Guard = GUARD, **headers: str
) -> dict[str, Any]:
    """The first thing that is answered; by default the desk's own page asks, with its cookie."""
    answers: list[dict[str, Any]] = []

    async def send(message: dict[str, Any]) -> None:
        answers.append(message)

    async def receive() -> dict[str, Any]:
        return {"type": "http.request"}

    headers = {"host": HOST, "cookie": COOKIE, **headers}
    scope = {
        "type": kind,
        "method": method,
        "path": "/",
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode("latin-1")) for name, value in headers.items()],
    }
    asyncio.run(guard(scope, receive, send))  # type: ignore[arg-type]
    return answers[0]


def press(**headers: str) -> int:
    """How LIGHT OFF is answered at its own port."""
    answer = ask(method="POST", guard=OFF_GUARD, **{"host": OFF_HOST, "origin": OWN, **headers})
    return int(answer["status"])


def test_the_key_in_the_address_becomes_a_cookie_and_leaves_the_address() -> None:
    answer = ask(query=f"key={KEY}", cookie="")
    headers = dict(answer["headers"])
    assert (answer["status"], headers[b"location"]) == (303, b"/")
    assert b"HttpOnly" in headers[b"set-cookie"]
    assert b"samesite=strict" in headers[b"set-cookie"].lower()
    assert ask(query="key=another", cookie="")["status"] == 403


def test_with_the_cookie_one_enters_and_the_page_may_ask_no_other_host() -> None:
    answer = ask()
    assert answer["status"] == 200
    policy = dict(answer["headers"])[b"content-security-policy"].decode()
    assert "default-src 'self'" in policy
    assert f"connect-src 'self' http://127.0.0.1:{OFF_PORT} http://localhost:{OFF_PORT};" in policy


@pytest.mark.parametrize(
    ("asked", "status"),
    [
        ({"cookie": ""}, 403),
        ({"cookie": f"rig_desk_{PORT}=another"}, 403),
        ({"cookie": f"rig_desk_{PORT}="}, 403),
        ({"host": "evil.example"}, 421),
        ({"host": f"evil.example:{PORT}"}, 421),
        ({"origin": "http://evil.example"}, 403),
        ({"origin": "null"}, 403),
        ({"method": "POST"}, 403),
    ],
)
def test_others_are_refused(asked: dict[str, str], status: int) -> None:
    assert ask(**asked)["status"] == status


def test_the_desks_own_page_alone_opens_a_web_socket_and_presses_light_off() -> None:
    for name in ("127.0.0.1", "localhost"):
        host = f"{name}:{PORT}"
        assert ask("websocket", host=host, origin=f"http://{host}")["type"] == "websocket.accept"
    for foreign in ({"origin": "http://evil.example"}, {"origin": "http://127.0.0.1:1"}, {}):
        assert ask("websocket", **foreign)["type"] == "websocket.close"
    assert press() == 200
    assert press(origin="http://evil.example") == 403
    assert press(host=f"evil.example:{OFF_PORT}") == 421
    assert press(cookie="") == 403


FOREIGN = (
    'settings={"dark": true, "size": [1, 2]}',
    'half="unclosed',
    "a b=c",
    "alone",
    "user@host=1",
    "expires=1",
    "caf\xe9=\xe9",
    f"rig_desk_{PORT}=of-somebody-else",
    "=",
)


@pytest.mark.parametrize("foreign", FOREIGN)
def test_cookies_of_other_programs_on_this_machine_shut_nobody_out(foreign: str) -> None:
    """A browser has one set for all ports of a host; who is shut out cannot switch the light off either."""
    for cookie in (f"{foreign}; {COOKIE}", f"{COOKIE}; {foreign}"):
        assert press(cookie=cookie) == 200
        assert ask("websocket", cookie=cookie, origin=OWN)["type"] == "websocket.accept"
    assert press(cookie=foreign) == press(cookie=f"x=1; {foreign}") == 403
