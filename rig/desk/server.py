"""Serves the desk on the loopback interface until Ctrl-C, to a browser that has its key.

LIGHT OFF is heard by a second server, too, in a thread of its own: it answers while the page's is busy.
"""

import asyncio
import contextlib
import hmac
import http
import logging
import socket
import threading
import urllib.parse
import webbrowser
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import FileResponse
from nicegui import ui
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.middleware.cors import CORSMiddleware
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from processing.errors import ConfigurationError
from rig.control import run_in_thread
from rig.desk.desk import Desk
from rig.desk.page import DARK, DEAD_S, build_page, build_rerun
from rig.desk.panels.live_picture import picture_now
from rig.desk.panels.runs import RERUN
from rig.desk.sessions import SERVED, served_file
from rig.desk.tables import static
from rig.devices import check_wiring
from rig.interruption import LOOPBACK, call_on_hang_up
from rig.terminal import say

_NAMES = (LOOPBACK, "localhost")
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' OFF_SWITCH; form-action 'self'; "
    "frame-ancestors 'none'; frame-src http://127.0.0.1:*"
)


class Guard:
    """ASGI middleware around the whole desk, which listens on the loopback interface at `port`.

    Without the key (in the address at first, then in a cookie) nothing is answered: other users of this
    machine do not have it. The name of the host is checked so that no foreign page can ask under a name of
    its own (DNS rebinding), the origin so that none can use the browser's cookie, least of all for the web
    socket, which browsers open for anyone. `off_port` is where LIGHT OFF is heard beside the page's server;
    its guard, which `hears_off`, admits the same pages.
    """

    def __init__(self, app: ASGIApp, key: str, port: int, off_port: int, *, hears_off: bool = False) -> None:
        self._app, self._key = app, key
        self._refused = static("refused.html")
        hosts, off_hosts = ([f"{name}:{one}" for name in _NAMES] for one in (port, off_port))
        self._hosts = off_hosts if hears_off else hosts
        self.origins = [f"http://{host}" for host in hosts]
        self._policy = _POLICY.replace("OFF_SWITCH", " ".join(f"http://{host}" for host in off_hosts))
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

    def _refusal(self, scope: Scope) -> Response | None:
        """The answer to who may not enter, or has just come with the key; None for who may."""
        headers = Headers(scope=scope)
        origin = headers.get("origin")
        if headers.get("host", "") not in self._hosts:
            return PlainTextResponse("wrong host", http.HTTPStatus.MISDIRECTED_REQUEST)
        if origin is None and (scope["type"] == "websocket" or scope["method"] == "POST"):
            return PlainTextResponse("no origin", http.HTTPStatus.FORBIDDEN)
        if origin is not None and origin not in self.origins:
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
        return HTMLResponse(self._refused, http.HTTPStatus.FORBIDDEN)

    def _has_key(self, cookies: str) -> bool:
        # Python's own parser gives up at the first cookie, of whatever program, that is not well formed
        parts = (part.strip().partition("=") for part in cookies.split(";"))
        return any(self._is_key(value) for name, _, value in parts if name == self._cookie)

    def _is_key(self, stated: str) -> bool:
        return hmac.compare_digest(stated.encode(), self._key.encode())

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


_log = logging.getLogger(__name__)
_PORT = 8642
_MOST_PX = 2000
_GOODBYE_S = 3


def open_desk(
    source: Path,
    overrides: tuple[str, ...] = (),
    port: int = 0,
    *,
    browser: bool = True,
    archive: Path = Path(),
) -> int:
    """Serve the desk of a configuration until Ctrl-C; a session that it has started goes on.

    `port` 0 is the last one, the usual one, or any. The runs of an `archive` that is there are listed, too.
    The address with its key is printed on stdout. Raises ConfigurationError where a desk of this
    configuration is open already.
    """
    desk = Desk(source, overrides, archive)
    desk.place.hold(desk.config.session.output)
    try:
        check_wiring(desk.config.laser, desk.config.controller)
        return _serve(desk, port, browser=browser)
    finally:
        desk.close()


def _serve(desk: Desk, port: int, *, browser: bool) -> int:
    listening, hearing_off = _listening(port, desk.place.port), socket.create_server((LOOPBACK, 0))
    number, off_port = (int(one.getsockname()[1]) for one in (listening, hearing_off))
    app = _application(desk, off_port)
    title = f"rig desk {desk.source.name}"
    ui.run_with(
        app,
        title=title,
        dark=None,
        language="en-US",
        show_welcome_message=False,
        tailwind=False,
        # on a loaded machine a browser answers late: what is pressed on a page given up by then is lost
        reconnect_timeout=DEAD_S,
    )
    guard = Guard(app, desk.place.key, number, off_port)
    of_off = CORSMiddleware(_light_off(desk), guard.origins, allow_credentials=True)
    off_guard = Guard(of_off, desk.place.key, number, off_port, hears_off=True)
    # it logs as the page's server does
    off_settings = uvicorn.Config(off_guard, log_config=None, access_log=False, lifespan="off")
    # when the page's server starts, NiceGUI looks through all servers there are, and fails at one not loaded
    off_settings.load()
    switch = uvicorn.Server(off_settings)
    threading.Thread(
        target=switch.run, kwargs={"sockets": [hearing_off]}, name="off switch", daemon=True
    ).start()
    desk.safety.start()
    desk.following.start()
    desk.alarming.start()
    address = f"http://{LOOPBACK}:{number}/?key={desk.place.key}"
    desk.place.opened_at(address, number)
    print(address, flush=True)
    say("the desk is at this address, in a browser on this machine; Ctrl-C ends it, sessions go on")
    if browser:
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(address)
    settings = uvicorn.Config(
        guard,
        log_level="warning",
        access_log=False,
        ws="websockets-sansio",
        # on one machine that would cost more than it saves
        ws_per_message_deflate=False,
        # who reads slowly holds nothing up
        timeout_graceful_shutdown=_GOODBYE_S,
    )
    server = uvicorn.Server(settings)

    def hung_up() -> None:
        server.should_exit = True

    try:
        with contextlib.suppress(KeyboardInterrupt), call_on_hang_up(hung_up):
            server.run(sockets=[listening])
    finally:
        switch.should_exit = True
    return 0


def _light_off(desk: Desk) -> FastAPI:
    """An application that hears LIGHT OFF."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

    @app.post(DARK)
    async def dark(request: Request) -> Response:
        try:
            # a thread of its own: those of a pool may all be waiting
            off = run_in_thread(desk.lighting.off, urllib.parse.unquote(request.url.query))
            problems = await asyncio.wrap_future(off)
        except Exception:
            _log.exception("LIGHT OFF has failed")
            problems = ["the desk has failed: turn the key switch"]
        return PlainTextResponse("; ".join(problems))

    return app


def _application(desk: Desk, off_port: int) -> FastAPI:
    app = _light_off(desk)

    @app.get("/picture")
    async def picture(width: int = 900, height: int = 600, zoom: float = 1.0) -> Response:
        size = (max(16, min(width, _MOST_PX)), max(16, min(height, _MOST_PX)))
        data = await run_in_threadpool(picture_now, desk, *size, max(1.0, min(zoom, 64.0)))
        return Response(data, media_type="image/png", headers={"Cache-Control": "no-store"})

    @app.get(SERVED + "/{name:path}")
    async def session_file(name: str) -> Response:
        path = served_file(desk.config.session.output, name)
        # a session may come from anywhere: its page runs no script, and is no part of the desk's
        sandbox = {"Content-Security-Policy": "sandbox allow-popups allow-downloads"}
        if path is None:
            return Response(status_code=404)
        return FileResponse(path, headers=sandbox)

    @ui.page("/")
    def page() -> None:
        build_page(desk, off_port)

    @ui.page(RERUN)
    def rerun() -> None:
        build_rerun(desk, off_port)

    return app


def _listening(asked: int, last: int) -> socket.socket:
    """A socket that is bound; raises ConfigurationError if the port asked for is taken."""
    why: OSError | None = None
    for number in (asked,) if asked else dict.fromkeys((last or _PORT, _PORT, 0)):
        listening = socket.socket()
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((LOOPBACK, number))
            # from now on a browser waits instead of being refused
            listening.listen(64)
        except OSError as error:
            listening.close()
            why = error
            continue
        return listening
    raise ConfigurationError(
        f"--port {asked}: {getattr(why, 'strerror', None) or why}; name another, or leave it out"
    )
