"""Stands around the whole desk: lets nobody in but who has a key or a password, from the desk's own page."""

import http
import urllib.parse
from dataclasses import dataclass

from starlette.datastructures import Headers
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from rig.desk.login import LOGIN, refused_page
from rig.desk.people import People, Person
from rig.desk.sessions import SERVED
from rig.rerun import cookies_of

LOOPBACK = "127.0.0.1"
PERSON = "rig.person"
"""Where in a request the person stands who has made it."""
_HERE = frozenset({LOOPBACK, "::1"})
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'OFF_SWITCH; form-action 'self'; "
    "frame-ancestors 'none'"
)


@dataclass(frozen=True, slots=True)
class Door:
    """Where the desk listens; `remote` is True on an interface that others reach, then always with TLS.

    `behind` is the name, with a port that is not 443, under which a reverse proxy of this machine with TLS
    has it; empty without one.
    """

    port: int
    off_port: int | None = None
    tls: bool = False
    remote: bool = False
    behind: str = ""

    def is_proxied(self, host: str) -> bool:
        """Whether a request that calls the desk so has come through the proxy."""
        return bool(self.behind) and host == self.behind

    @property
    def scheme(self) -> str:
        """`http`, or `https`."""
        return "https" if self.tls else "http"

    def knows(self, host: str, port: int | None = None) -> bool:
        """Whether a request may call the desk so, with the number of its port at the end.

        From another machine it is called by any name: only the one in its certificate gets there.
        """
        if port is None and self.is_proxied(host):
            return True
        name, _, number = host.rpartition(":")
        if number != str(self.port if port is None else port):
            return False
        return bool(name) if self.remote else name in (LOOPBACK, "localhost")

    def is_own(self, origin: str, host: str) -> bool:
        """Whether a request comes from a page of this desk."""
        if self.is_proxied(host):
            return origin == f"https://{host}"
        if self.remote:
            return origin == f"{self.scheme}://{host}"
        return origin in {f"{self.scheme}://{name}:{self.port}" for name in (LOOPBACK, "localhost")}

    @property
    def cookie(self) -> str:
        """Its name; browsers keep one set of cookies for all ports of a host."""
        return f"rig_desk_{self.port}"


class Guard:
    """ASGI middleware around the whole desk: for who knows its key, from this machine's browser.

    Without the key (in the address at first, then in a cookie) nothing is answered: other users of this
    machine have neither. A key is worth something on this machine only; from another one a password is. The
    name of the host is checked so that no foreign page can ask under a name of its own (DNS rebinding), the
    origin so that none can use the browser's cookie, least of all for the web socket, which browsers open for
    anyone.
    """

    def __init__(self, app: ASGIApp, people: People, door: Door) -> None:
        self._app, self._people, self._door = app, people, door

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        refused = self._refusal(scope)
        if refused is None:
            host = Headers(scope=scope).get("host", "")
            # a report is shown within the desk's own page
            framed = str(scope.get("path", "")).startswith(f"{SERVED}/")
            await self._app(scope, receive, self._with_policy(send, host, framed=framed))
        elif scope["type"] == "websocket":
            # closed before it was accepted, which the browser sees as 403
            await send({"type": "websocket.close", "code": 1008})
        else:
            await refused(scope, receive, send)

    def _refusal(self, scope: Scope) -> Response | None:
        """The answer to who may not enter, or has just come with the key; None for who may."""
        door, headers = self._door, Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        if not door.knows(host):
            return PlainTextResponse("wrong host", http.HTTPStatus.MISDIRECTED_REQUEST)
        changes = scope["type"] == "websocket" or scope["method"] == "POST"
        if origin is None and changes:
            return PlainTextResponse("no origin", http.HTTPStatus.FORBIDDEN)
        if origin is not None and not door.is_own(origin, host):
            return PlainTextResponse("wrong origin", http.HTTPStatus.FORBIDDEN)
        # what a proxy passes on has come from anywhere
        here = _is_here(scope) and not door.is_proxied(host)
        if scope["type"] == "http" and scope["method"] == "GET" and here:
            query = urllib.parse.parse_qs(scope["query_string"].decode(errors="replace"))
            key = query.get("key", [""])[0]
            if key and self._people.by_key(key) is not None:
                # the key leaves the address, and with it the browser's history
                return let_in(RedirectResponse("/", http.HTTPStatus.SEE_OTHER), door, host, key)
        if scope["path"] == LOGIN and self._people.by_password:
            return None
        person = self._person(headers.get("cookie", ""), here=here)
        if person is not None:
            scope[PERSON] = person
            return None
        if self._people.by_password and scope["path"] == "/":
            return RedirectResponse(LOGIN, http.HTTPStatus.SEE_OTHER)
        return HTMLResponse(refused_page(), http.HTTPStatus.FORBIDDEN)

    def admits(self, host: str, origin: str, cookie: str, peer: str) -> bool:
        """Whether it comes from a page of this desk, in a browser that was let in; asked beside the desk."""
        door = self._door
        name = host.rpartition(":")[0]
        own = door.knows(host, door.off_port) and door.is_own(origin, f"{name}:{door.port}")
        return own and self._person(cookie, here=peer in _HERE) is not None

    def _person(self, cookies: str, *, here: bool) -> Person | None:
        for cookie in cookies_of(cookies, self._door.cookie):
            person = (self._people.by_key(cookie) if here else None) or self._people.by_login(cookie)
            if person is not None:
                return person
        return None

    def _with_policy(self, send: Send, host: str, *, framed: bool) -> Send:
        door, name = self._door, host.rpartition(":")[0]
        beside = door.off_port is not None and not door.is_proxied(host)
        other = f" {door.scheme}://{name}:{door.off_port}" if beside else ""
        policy = POLICY.replace("OFF_SWITCH", other)
        if framed:
            policy = policy.replace("ancestors 'none'", "ancestors 'self'")

        async def passed(message: dict[str, object]) -> None:
            if message["type"] == "http.response.start":
                headers = message.setdefault("headers", [])
                assert isinstance(headers, list)
                headers += [
                    (b"content-security-policy", policy.encode()),
                    (b"referrer-policy", b"same-origin"),
                ]
            await send(message)

        return passed  # type: ignore[return-value]


def let_in(answer: Response, door: Door, host: str, cookie: str) -> Response:
    """The answer with the cookie of who may enter; `host` is how the request calls the desk."""
    secure = door.tls or door.is_proxied(host)
    answer.set_cookie(door.cookie, cookie, httponly=True, samesite="strict", secure=secure)
    return answer


def _is_here(scope: Scope) -> bool:
    client = scope.get("client")
    return client is None or client[0] in _HERE
