"""Nobody gets to the desk without its key, under another name, or from a foreign page."""

import asyncio
from typing import Any

import pytest

pytest.importorskip("starlette", reason="rig desk is not installed: pip install '.[desk]'")

from rig.desk.server import Guard

KEY, PORT = "the-key", 8642
HOST = f"127.0.0.1:{PORT}"


async def _app(scope: Any, receive: Any, send: Any) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"the desk"})


def ask(kind: str = "http", query: str = "", **headers: str) -> dict[str, Any]:
    """The first thing that is answered."""
    answers: list[dict[str, Any]] = []

    async def send(message: dict[str, Any]) -> None:
        answers.append(message)

    async def receive() -> dict[str, Any]:
        return {"type": "http.request"}

    scope = {
        "type": kind,
        "method": "GET",
        "path": "/",
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
    }
    asyncio.run(Guard(_app, KEY, PORT)(scope, receive, send))  # type: ignore[arg-type]
    return answers[0]


COOKIE = f"rig_desk_{PORT}={KEY}"


def test_the_key_in_the_address_becomes_a_cookie_and_leaves_the_address() -> None:
    answer = ask(query=f"key={KEY}", host=HOST)
    headers = dict(answer["headers"])
    assert answer["status"] == 303
    assert headers[b"location"] == b"/"
    assert b"HttpOnly" in headers[b"set-cookie"]
    assert b"samesite=strict" in headers[b"set-cookie"].lower()


def test_with_the_cookie_one_enters_and_the_page_may_ask_no_other_host() -> None:
    answer = ask(host=HOST, cookie=COOKIE)
    assert answer["status"] == 200
    assert b"default-src 'self'" in dict(answer["headers"])[b"content-security-policy"]


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"host": HOST}, 403),
        ({"host": HOST, "cookie": f"rig_desk_{PORT}=another"}, 403),
        ({"host": "evil.example", "cookie": COOKIE}, 421),
        ({"host": HOST, "cookie": COOKIE, "origin": "http://evil.example"}, 403),
        ({"host": HOST, "cookie": COOKIE, "origin": "null"}, 403),
    ],
)
def test_others_are_refused(headers: dict[str, str], status: int) -> None:
    assert ask(**headers)["status"] == status


@pytest.mark.parametrize("origin", ["http://evil.example", "http://127.0.0.1:1", None])
def test_a_foreign_page_opens_no_web_socket_even_with_the_cookie(origin: str | None) -> None:
    headers = {"host": HOST, "cookie": COOKIE, **({} if origin is None else {"origin": origin})}
    assert ask("websocket", **headers)["type"] == "websocket.close"


def test_the_desks_own_page_opens_it() -> None:
    answer = ask("websocket", host=HOST, cookie=COOKIE, origin=f"http://{HOST}")
    assert answer["type"] == "websocket.accept"
