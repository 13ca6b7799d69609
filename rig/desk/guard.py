"""Lets nobody to the desk but who knows its key, from this machine's browser, on the desk's own page.

Without the key (in the address at first, then in a cookie) nothing is answered: other users of this machine
have neither. The name of the host is checked so that no foreign page can ask under a name of its own (DNS
rebinding), the origin so that none can use the browser's cookie, least of all for the web socket, which
browsers open for anyone.
"""

import hmac
import http
import urllib.parse
from http.cookies import CookieError, SimpleCookie

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

LOOPBACK = "127.0.0.1"
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; frame-ancestors 'none'"
)


class Guard:
    """ASGI middleware around the whole desk on a port of 127.0.0.1."""

    def __init__(self, app: ASGIApp, key: str, port: int) -> None:
        self._app = app
        self._key = key
        # browsers keep one set of cookies for all ports of a host
        self._cookie = f"rig_desk_{port}"
        self._hosts = frozenset({f"{LOOPBACK}:{port}", f"localhost:{port}"})
        self._origins = frozenset(f"http://{host}" for host in self._hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        refused = self._refusal(scope)
        if refused is None:
            await self._app(scope, receive, _with_policy(send))
        elif scope["type"] == "websocket":
            # closed before it was accepted, which the browser sees as 403
            await send({"type": "websocket.close", "code": 1008})
        else:
            await refused(scope, receive, send)

    def _refusal(self, scope: Scope) -> Response | None:
        """The answer to who may not enter, or has just come with the key; None for who may."""
        headers = Headers(scope=scope)
        if headers.get("host", "") not in self._hosts:
            return PlainTextResponse("wrong host", http.HTTPStatus.MISDIRECTED_REQUEST)
        origin = headers.get("origin")
        if origin is None and scope["type"] == "websocket":
            return PlainTextResponse("no origin", http.HTTPStatus.FORBIDDEN)
        if origin is not None and origin not in self._origins:
            return PlainTextResponse("wrong origin", http.HTTPStatus.FORBIDDEN)
        query = urllib.parse.parse_qs(scope["query_string"].decode(errors="replace"))
        if scope["type"] == "http" and scope["method"] == "GET" and self._fits(query.get("key", [""])[0]):
            # the key leaves the address, and with it the browser's history
            welcome = RedirectResponse("/", http.HTTPStatus.SEE_OTHER)
            welcome.set_cookie(self._cookie, self._key, httponly=True, samesite="strict")
            return welcome
        if not self._fits(_cookie(headers.get("cookie", ""), self._cookie)):
            return PlainTextResponse("open the address that rig desk has printed", http.HTTPStatus.FORBIDDEN)
        return None

    def _fits(self, key: str) -> bool:
        return hmac.compare_digest(key.encode(), self._key.encode())


def _cookie(header: str, name: str) -> str:
    try:
        found = SimpleCookie(header).get(name)
    except CookieError:
        return ""
    return "" if found is None else found.value


def _with_policy(send: Send) -> Send:
    async def passed(message: dict[str, object]) -> None:
        if message["type"] == "http.response.start":
            headers = message.setdefault("headers", [])
            assert isinstance(headers, list)
            headers += [(b"content-security-policy", POLICY.encode()), (b"referrer-policy", b"no-referrer")]
        await send(message)

    return passed  # type: ignore[return-value]
