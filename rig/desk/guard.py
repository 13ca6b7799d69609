"""Stands around the whole desk: lets nobody in but a browser that has its key, from the desk's own page."""

import hmac
import http
import urllib.parse

from starlette.datastructures import Headers
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from rig.terminal import LOOPBACK

_NAMES = (LOOPBACK, "localhost")
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' OFF_SWITCH; form-action 'self'; "
    "frame-ancestors 'none'"
)
_REFUSED = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>rig desk</title><style>
:root { color-scheme: light dark; } body { font: 18px sans-serif; margin: 12vh auto; max-width: 26em; }
</style></head><body><main><h1>rig desk</h1>
<p>This browser does not have the key of this desk.</p>
<p>Open the address that <code>rig desk</code> printed in its terminal: it contains the key.
To darken the laser now, turn the key switch.</p>
</main></body></html>"""


class Guard:
    """ASGI middleware around the whole desk, which listens on the loopback interface at `port`.

    Without the key (in the address at first, then in a cookie) nothing is answered: other users of this
    machine do not have it. The name of the host is checked so that no foreign page can ask under a name of
    its own (DNS rebinding), the origin so that none can use the browser's cookie, least of all for the web
    socket, which browsers open for anyone. `off_port` is where LIGHT OFF is heard beside this server.
    """

    def __init__(self, app: ASGIApp, key: str, port: int, off_port: int) -> None:
        self._app, self._key = app, key
        self._hosts, self._off_hosts = ({f"{name}:{one}" for name in _NAMES} for one in (port, off_port))
        self._origins = {f"http://{host}" for host in self._hosts}
        self._policy = _POLICY.replace(
            "OFF_SWITCH", " ".join(f"http://{host}" for host in sorted(self._off_hosts))
        )
        # browsers keep one set of cookies for all ports of a host
        self._cookie = f"rig_desk_{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        refused = self._refusal(scope)
        if refused is None:
            await self._app(scope, receive, self._with_policy(send))
        elif scope["type"] == "websocket":
            # closed before it was accepted, which the browser sees as 403
            await send({"type": "websocket.close", "code": 1008})
        else:
            await refused(scope, receive, send)

    def admits(self, host: str, origin: str, cookie: str) -> bool:
        """Whether what LIGHT OFF's own port hears comes from a page of this desk that was let in."""
        return host in self._off_hosts and origin in self._origins and self._has_key(cookie)

    def _refusal(self, scope: Scope) -> Response | None:
        """The answer to who may not enter, or has just come with the key; None for who may."""
        headers = Headers(scope=scope)
        origin = headers.get("origin")
        if headers.get("host", "") not in self._hosts:
            return PlainTextResponse("wrong host", http.HTTPStatus.MISDIRECTED_REQUEST)
        if origin is None and (scope["type"] == "websocket" or scope["method"] == "POST"):
            return PlainTextResponse("no origin", http.HTTPStatus.FORBIDDEN)
        if origin is not None and origin not in self._origins:
            return PlainTextResponse("wrong origin", http.HTTPStatus.FORBIDDEN)
        if scope["type"] == "http" and scope["method"] == "GET":
            query = urllib.parse.parse_qs(scope["query_string"].decode(errors="replace"))
            if self._is_key(query.get("key", [""])[0]):
                # the key leaves the address, and with it the browser's history
                answer = RedirectResponse("/", http.HTTPStatus.SEE_OTHER)
                answer.set_cookie(self._cookie, self._key, httponly=True, samesite="strict")
                return answer
        if self._has_key(headers.get("cookie", "")):
            return None
        return HTMLResponse(_REFUSED, http.HTTPStatus.FORBIDDEN)

    def _has_key(self, cookies: str) -> bool:
        # Python's own parser gives up at the first cookie, of whatever program, that is not well formed
        parts = (part.strip().partition("=") for part in cookies.split(";"))
        return any(self._is_key(value) for name, _, value in parts if name == self._cookie)

    def _is_key(self, told: str) -> bool:
        return hmac.compare_digest(told.encode(), self._key.encode())

    def _with_policy(self, send: Send) -> Send:
        policy = self._policy

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
