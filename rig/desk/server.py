"""Serves the desk on a loopback port until Ctrl-C, to nobody but who knows its key."""

import contextlib
import hmac
import http
import secrets
import socket
import threading
import urllib.parse
import webbrowser
from http.cookies import CookieError, SimpleCookie
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, HTMLResponse
from nicegui import ui
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from processing.errors import ConfigurationError
from rig.desk.desk import Desk
from rig.desk.off_switch import LOOPBACK, OffSwitch
from rig.desk.page import build_page
from rig.desk.panels.live_picture import picture_now
from rig.desk.safety_bar import DARK
from rig.desk.sessions import SERVED, served_file
from rig.desk.theme import themed_report
from rig.presentation import say

_PORT = 8642
_MOST_PX = 2000


def open_desk(source: Path, overrides: tuple[str, ...] = (), *, port: int = 0, browser: bool = True) -> int:
    """Serve the desk of a configuration until Ctrl-C; a session that it has started goes on.

    `port` 0: the usual one, or any other if that is taken. The address with its key is printed on stdout.
    """
    desk = Desk(source, overrides)
    listening = _listening(port)
    number = listening.getsockname()[1]
    key = secrets.token_urlsafe(24)
    address = f"http://{LOOPBACK}:{number}/?key={key}"
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

    def admits(host: str, origin: str, cookie: str) -> bool:
        return host in switch_hosts and guard.admits(origin, cookie)

    switch = OffSwitch(desk.light_off, admits)
    switch_hosts = {f"{name}:{switch.port}" for name in (LOOPBACK, "localhost")}

    @app.post(DARK)
    async def dark(request: Request) -> Response:
        # a thread of its own: those of a pool may all be waiting
        press = urllib.parse.unquote(request.url.query)
        threading.Thread(target=desk.light_off, args=(press,), name="light off", daemon=True).start()
        return Response(status_code=http.HTTPStatus.OK)

    @app.get("/picture")
    async def picture(width: int = 900, height: int = 600, zoom: float = 1.0) -> Response:
        size = (max(16, min(width, _MOST_PX)), max(16, min(height, _MOST_PX)))
        data = await run_in_threadpool(picture_now, desk, *size, max(1.0, min(zoom, 64.0)))
        return Response(data, media_type="image/png", headers={"Cache-Control": "no-store"})

    @app.get(SERVED + "/{name:path}")
    async def session_file(name: str, theme: str = "") -> Response:
        path = served_file(desk.config.session.output, name)
        # a session may come from anywhere: its page runs no script, and is no part of the desk's
        sandbox = {"Content-Security-Policy": "sandbox allow-popups allow-downloads"}
        if path is None:
            return Response(status_code=404)
        if theme and path.suffix == ".html":
            text = await run_in_threadpool(path.read_text, "utf-8", "replace")
            return HTMLResponse(themed_report(text, theme), headers=sandbox)
        return FileResponse(path, headers=sandbox)

    @ui.page("/")
    def page() -> None:
        build_page(desk, switch.port)

    ui.run_with(
        app,
        title=f"rig desk {source.name}",
        dark=True,
        language="en-US",
        show_welcome_message=False,
        tailwind=False,
    )
    guard = Guard(app, key, number, switch.port)
    switch.start()
    desk.safety.start()
    desk.following.start()
    print(address, flush=True)
    say("the desk is at this address, in a browser on this machine; Ctrl-C ends it, sessions go on")
    if browser:
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(address)
    settings = uvicorn.Config(guard, log_level="warning", access_log=False, ws="websockets-sansio")
    try:
        with contextlib.suppress(KeyboardInterrupt):
            uvicorn.Server(settings).run(sockets=[listening])
    finally:
        switch.close()
        desk.close()
    return 0


def _listening(port: int) -> socket.socket:
    """A socket that is bound; raises ConfigurationError if the port asked for is taken."""
    for number in (port,) if port else (_PORT, 0):
        listening = socket.socket()
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((LOOPBACK, number))
            # from now on a browser waits instead of being refused
            listening.listen(64)
        except OSError as error:
            listening.close()
            if port:
                raise ConfigurationError(
                    f"--port {port}: {error.strerror or error}; name another, or leave it out"
                ) from None
            continue
        return listening
    raise ConfigurationError("no port of this machine is free; close something that listens")


POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'OFF_SWITCH; frame-ancestors 'none'"
)


class Guard:
    """ASGI middleware around the whole desk: for who knows its key, from this machine's browser.

    Without the key (in the address at first, then in a cookie) nothing is answered: other users of this
    machine have neither. The name of the host is checked so that no foreign page can ask under a name of its
    own (DNS rebinding), the origin so that none can use the browser's cookie, least of all for the web
    socket, which browsers open for anyone.
    """

    def __init__(self, app: ASGIApp, key: str, port: int, off_port: int | None = None) -> None:
        self._app = app
        names = () if off_port is None else (LOOPBACK, "localhost")
        others = [f" http://{name}:{off_port}" for name in names]
        self._policy = POLICY.replace("OFF_SWITCH", "".join(others)).encode()
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
            # a report is shown within the desk's own page
            framed = str(scope.get("path", "")).startswith(f"{SERVED}/")
            await self._app(scope, receive, self._with_policy(send, framed=framed))
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

    def admits(self, origin: str, cookie: str) -> bool:
        """Whether it comes from a page of this desk, in a browser that knows the key."""
        return origin in self._origins and self._fits(_cookie(cookie, self._cookie))

    def _with_policy(self, send: Send, *, framed: bool) -> Send:
        policy = self._policy.replace(b"ancestors 'none'", b"ancestors 'self'") if framed else self._policy

        async def passed(message: dict[str, object]) -> None:
            if message["type"] == "http.response.start":
                headers = message.setdefault("headers", [])
                assert isinstance(headers, list)
                headers += [(b"content-security-policy", policy), (b"referrer-policy", b"no-referrer")]
            await send(message)

        return passed  # type: ignore[return-value]

    def _fits(self, key: str) -> bool:
        return hmac.compare_digest(key.encode(), self._key.encode())


def _cookie(header: str, name: str) -> str:
    try:
        found = SimpleCookie(header).get(name)
    except CookieError:
        return ""
    return "" if found is None else found.value
