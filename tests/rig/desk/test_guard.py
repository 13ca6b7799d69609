"""Nobody gets to the desk without its key, under another name, or from a foreign page."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="rig desk is not installed: pip install '.[desk]'")

from processing.errors import ConfigurationError
from rig.desk.guard import Door, Guard
from rig.desk.people import People, Role, password_line
from rig.desk.server import Entrance

KEY, WATCH_KEY, PORT = "the-key", "the-watch-key", 8642
HOST = f"127.0.0.1:{PORT}"


HERE = Door(PORT, 8643)


async def _app(scope: Any, receive: Any, send: Any) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"the desk"})


def ask(
    kind: str = "http",
    query: str = "",
    *,
    method: str = "GET",
    path: str = "/",
    peer: str = "127.0.0.1",
    door: Door = HERE,
    people: People | None = None,
    **headers: str,
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
        "path": path,
        "client": (peer, 50_000),
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode("latin-1")) for name, value in headers.items()],
    }
    asyncio.run(Guard(_app, people or People(KEY, WATCH_KEY), door)(scope, receive, send))  # type: ignore[arg-type]
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


REMOTE = Door(PORT, 8643, tls=True, remote=True)
LAB = f"rig.lab:{PORT}"


@pytest.fixture
def people(tmp_path: Path) -> People:
    path = tmp_path / "passwords.txt"
    lines = [
        password_line("ada", Role.ACT, "the long password"),
        password_line("eve", Role.WATCH, "another one"),
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    path.chmod(0o600)
    return People(KEY, WATCH_KEY, path)


def test_the_key_for_watching_lets_in_to_watch_only() -> None:
    seen: list[Any] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        seen.append(scope["rig.person"].role)
        await _app(scope, receive, send)

    for key in (KEY, WATCH_KEY):
        headers = [(b"host", HOST.encode()), (b"cookie", f"rig_desk_{PORT}={key}".encode())]
        scope = {"type": "http", "method": "GET", "path": "/", "query_string": b"", "headers": headers}

        async def nothing(_: Any = None) -> Any:
            return {"type": "http.request"}

        asyncio.run(Guard(app, People(KEY, WATCH_KEY), Door(PORT))(scope, nothing, nothing))
    assert seen == [Role.ACT, Role.WATCH]


def test_a_key_is_worth_nothing_from_another_machine(people: People) -> None:
    told = ask(host=LAB, cookie=COOKIE, peer="192.0.2.7", door=REMOTE, people=people)
    assert (told["status"], dict(told["headers"])[b"location"]) == (303, b"/login")
    told = ask(query=f"key={KEY}", host=LAB, peer="192.0.2.7", door=REMOTE, people=people)
    assert dict(told["headers"])[b"location"] == b"/login"
    for path in ("/picture", "/_nicegui_ws/socket.io/", "/sessions/a.html"):
        assert (
            ask(path=path, host=LAB, cookie=COOKIE, peer="192.0.2.7", door=REMOTE, people=people)["status"]
            == 403
        )


def test_a_password_lets_in_from_another_machine_and_only_from_the_desks_own_page(people: People) -> None:
    cookie = people.enter("eve", "another one")
    assert cookie is not None
    headers = {"host": LAB, "cookie": f"rig_desk_{PORT}={cookie}"}
    assert ask(peer="192.0.2.7", door=REMOTE, people=people, **headers)["status"] == 200
    own = {"origin": f"https://{LAB}"}
    opened = ask("websocket", peer="192.0.2.7", door=REMOTE, people=people, **headers, **own)
    assert opened["type"] == "websocket.accept"
    for origin in (f"http://{LAB}", "https://evil.example", f"https://evil.example:{PORT}"):
        told = ask("websocket", peer="192.0.2.7", door=REMOTE, people=people, **headers, origin=origin)
        assert told["type"] == "websocket.close"
    login = {"method": "POST", "path": "/login", "peer": "192.0.2.7", "door": REMOTE, "people": people}
    assert ask(host=LAB, **login)["status"] == 403, "a form of a foreign page"  # type: ignore[arg-type]
    assert ask(host=LAB, origin=f"https://{LAB}", **login)["status"] == 200  # type: ignore[arg-type]


def test_passwords_are_not_tried_for_long(people: People) -> None:
    assert people.enter("ada", "the long password") is not None
    for name in ("ada", "eve", "nobody", "ada", "ada"):
        assert people.enter(name, "wrong") is None
    with pytest.raises(ConfigurationError, match="wait a minute"):
        people.enter("ada", "the long password")


def test_a_file_of_passwords_holds_none_and_is_nobody_elses(tmp_path: Path) -> None:
    path = tmp_path / "passwords.txt"
    line = password_line("ada", Role.ACT, "the long password")
    assert "the long password" not in line
    path.write_text(line, encoding="utf-8")
    path.chmod(0o644)
    with pytest.raises(ConfigurationError, match="others may read it"):
        People(KEY, WATCH_KEY, path)
    with pytest.raises(ConfigurationError, match="at least 10"):
        password_line("ada", Role.ACT, "short")


@pytest.mark.parametrize("more", [{}, {"certificate": Path("c.pem")}, {"passwords": Path("p.txt")}])
def test_other_interfaces_are_refused_without_tls_and_passwords(more: dict[str, Path]) -> None:
    with pytest.raises(ConfigurationError, match="others could reach the laser: --"):
        _ = Entrance(listen="0.0.0.0", **more).remote  # type: ignore[arg-type]
    assert not Entrance().remote


BEHIND = Door(PORT, 8643, behind="rig.lab")


def test_through_a_proxy_one_comes_from_elsewhere_whatever_address_the_proxy_has(people: People) -> None:
    told = ask(host="rig.lab", cookie=COOKIE, door=BEHIND, people=people)
    assert (told["status"], dict(told["headers"])[b"location"]) == (303, b"/login"), "a key opens nothing"
    cookie = people.enter("ada", "the long password")
    headers = {"host": "rig.lab", "cookie": f"rig_desk_{PORT}={cookie}"}
    entered = ask(door=BEHIND, people=people, **headers)
    assert entered["status"] == 200
    policy = dict(entered["headers"])[b"content-security-policy"]
    assert b"connect-src 'self';" in policy, "the second port is not to be had through it"
    own = ask("websocket", door=BEHIND, people=people, origin="https://rig.lab", **headers)
    assert own["type"] == "websocket.accept"
    for origin in ("http://rig.lab", "https://evil.example", f"http://{HOST}", "https://rig.lab:444"):
        told = ask("websocket", door=BEHIND, people=people, origin=origin, **headers)
        assert told["type"] == "websocket.close"
    for host in ("rig.lab:80", "evil.example", "rig.lab.evil.example"):
        assert ask(door=BEHIND, people=people, **{**headers, "host": host})["status"] == 421
    assert ask(door=HERE, people=people, **headers)["status"] == 421, "without a proxy nobody calls it so"
    assert ask(host=HOST, cookie=COOKIE, door=BEHIND)["status"] == 200, "on the machine itself the key is"


def test_who_has_left_is_out_and_the_other_logins_of_the_name_stay(people: People) -> None:
    first, second = (people.enter("ada", "the long password") for _ in range(2))
    assert first is not None
    assert second is not None
    here, there = people.by_login(first), people.by_login(second)
    assert here is not None
    assert there is not None
    people.leave(first)
    assert people.by_login(first) is None
    assert not people.is_in(here), "a page that is still open does nothing any more"
    assert people.is_in(there)
    people.leave("no such cookie")
    key = people.by_key(KEY)
    assert key is not None
    assert people.is_in(key)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"behind": "http://rig.lab"}, "that the proxy serves with TLS"),
        ({"behind": "https://rig.lab/desk"}, "without a path"),
        ({"behind": "https://rig.lab"}, "--passwords must be stated"),
        (
            {"behind": "https://rig.lab", "listen": "0.0.0.0", "certificate": Path("c.pem")},
            "others could bypass the proxy",
        ),
    ],
)
def test_a_proxy_is_refused_where_it_would_open_too_much(more: dict[str, object], said: str) -> None:
    passwords = {} if "must be stated" in said else {"passwords": Path("p.txt")}
    with pytest.raises(ConfigurationError, match=said):
        _ = Entrance(**more, **passwords).proxied  # type: ignore[arg-type]
    assert Entrance(behind="https://rig.lab:443", passwords=Path("p.txt")).proxied == "rig.lab"


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
    guard = Guard(_app, People(KEY, WATCH_KEY), HERE)
    assert guard.admits("127.0.0.1:8643", origin, cookie, "127.0.0.1")
    assert ask("websocket", host=HOST, cookie=cookie, origin=origin)["type"] == "websocket.accept"
    without = foreign if order == "before" else f"x=1; {foreign}"
    assert not guard.admits("127.0.0.1:8643", origin, without, "127.0.0.1")
