"""Serves the desk on the loopback interface until Ctrl-C, to a browser that has its key.

A second server for LIGHT OFF runs in a thread of its own: it answers while the page's server is busy.
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

    Requests without the key (in the address at first, then in a cookie) are refused: other users of this
    machine do not have it. The name of the host is checked so that no foreign page can ask under a name of
    its own (DNS rebinding), the origin so that none can use the browser's cookie, least of all for the web
    socket, which browsers open for any page. `off_port` is that of the separate server of LIGHT OFF; the
    guard of that server, with `is_off_server`, admits the same pages.
    """

    def __init__(
        self, app: ASGIApp, key: str, port: int, off_port: int, *, is_off_server: bool = False
    ) -> None:
        self._app, self._key = app, key
        self._refused_page = static("refused.html")
        hosts, off_hosts = ([f"{name}:{number}" for name in _NAMES] for number in (port, off_port))
        self._hosts = off_hosts if is_off_server else hosts
        self.origins = [f"http://{host}" for host in hosts]
        self._policy = _POLICY.replace("OFF_SWITCH", " ".join(f"http://{host}" for host in off_hosts))
        # browsers keep one set of cookies for all ports of a host
        self._cookie = f"rig_desk_{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        response = self._own_response(scope)
        if response is None:
            await self._app(scope, receive, self._with_policy(send))
        elif scope["type"] == "websocket":
            # closed before it was accepted, which the browser sees as 403
            await send({"type": "websocket.close", "code": 1008})
        else:
            await response(scope, receive, send)

    def _own_response(self, scope: Scope) -> Response | None:
        """A refusal, or the cookie for a request with the key; None for a request that is admitted."""
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
        return HTMLResponse(self._refused_page, http.HTTPStatus.FORBIDDEN)

    def _has_key(self, cookies: str) -> bool:
        # Python's own parser stops at the first cookie, of any program, that is not well formed
        pairs = (cookie.strip().partition("=") for cookie in cookies.split(";"))
        return any(self._is_key(value) for name, _, value in pairs if name == self._cookie)

    def _is_key(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self._key.encode())

    def _with_policy(self, send: Send) -> Send:
        policy = self._policy

        async def send_with_policy(message: dict[str, object]) -> None:
            if message["type"] == "http.response.start":
                headers = message.setdefault("headers", [])
                assert isinstance(headers, list)
                headers += [
                    (b"content-security-policy", policy.encode()),
                    (b"referrer-policy", b"same-origin"),
                ]
            await send(message)

        return send_with_policy  # type: ignore[return-value]


_log = logging.getLogger(__name__)
_DEFAULT_PORT = 8642
_MIN_PX, _MAX_PX, _MAX_ZOOM = 16, 2000, 64.0
_SHUTDOWN_S = 3


def open_desk(
    source: Path,
    overrides: tuple[str, ...] = (),
    port: int = 0,
    *,
    browser: bool = True,
    archive: Path = Path(),
) -> int:
    """Serve the desk of a configuration until Ctrl-C; a session that it has started goes on.

    `port` 0 stands for the last port, else the default one, else any. The runs of an `archive`, if it exists,
    are listed as well. The address with its key is printed on stdout. Raises ConfigurationError if a desk of
    its folder of sessions is open already.
    """
    desk = Desk(source, overrides, archive)
    desk.store.hold(desk.config.session.output)
    try:
        check_wiring(desk.config.laser, desk.config.controller)
        return _serve(desk, port, browser=browser)
    finally:
        desk.close()


def _serve(desk: Desk, port: int, *, browser: bool) -> int:
    page_socket, off_socket = _bound_socket(port, desk.store.port), socket.create_server((LOOPBACK, 0))
    page_port, off_port = (int(bound.getsockname()[1]) for bound in (page_socket, off_socket))
    app = _application(desk, off_port)
    ui.run_with(
        app,
        title=f"rig desk {desk.source.name}",
        dark=None,
        language="en-US",
        show_welcome_message=False,
        tailwind=False,
        # a browser on a busy machine answers late; presses on a page that was deleted by then would be lost
        reconnect_timeout=DEAD_S,
    )
    guard = Guard(app, desk.store.key, page_port, off_port)
    off_app = CORSMiddleware(_off_application(desk), guard.origins, allow_credentials=True)
    off_guard = Guard(off_app, desk.store.key, page_port, off_port, is_off_server=True)
    # without a log configuration it logs as the page's server does
    off_settings = uvicorn.Config(off_guard, log_config=None, access_log=False, lifespan="off")
    # when the page's server starts, NiceGUI inspects all servers, and fails at one that is not loaded
    off_settings.load()
    off_server = uvicorn.Server(off_settings)
    threading.Thread(
        target=off_server.run, kwargs={"sockets": [off_socket]}, name="off switch", daemon=True
    ).start()
    desk.safety.start()
    desk.follower.start()
    desk.alarming.start()
    address = f"http://{LOOPBACK}:{page_port}/?key={desk.store.key}"
    desk.store.opened_at(address)
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
        # on one machine compression costs more than it saves
        ws_per_message_deflate=False,
        # a slow reader does not delay the end
        timeout_graceful_shutdown=_SHUTDOWN_S,
    )
    server = uvicorn.Server(settings)

    def end() -> None:
        server.should_exit = True

    try:
        with contextlib.suppress(KeyboardInterrupt), call_on_hang_up(end):
            server.run(sockets=[page_socket])
    finally:
        off_server.should_exit = True
    return 0


def _off_application(desk: Desk) -> FastAPI:
    """An application that answers LIGHT OFF alone."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

    @app.post(DARK)
    async def dark(request: Request) -> Response:
        try:
            # a thread of its own: all threads of a pool may be waiting
            problems_future = run_in_thread(desk.lighting.off, urllib.parse.unquote(request.url.query))
            problems = await asyncio.wrap_future(problems_future)
        except Exception:
            _log.exception("LIGHT OFF has failed")
            problems = ["the desk has failed: turn the key switch"]
        return PlainTextResponse("; ".join(problems))

    return app


def _application(desk: Desk, off_port: int) -> FastAPI:
    app = _off_application(desk)

    @app.get("/picture")
    async def picture(width: int = 900, height: int = 600, zoom: float = 1.0) -> Response:
        width_px, height_px = (max(_MIN_PX, min(size, _MAX_PX)) for size in (width, height))
        zoom = max(1.0, min(zoom, _MAX_ZOOM))
        jpeg = await run_in_threadpool(picture_now, desk, width_px, height_px, zoom)
        return Response(jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    @app.get(SERVED + "/{name:path}")
    async def session_file(name: str) -> Response:
        path = served_file(desk.config.session.output, name)
        # a session may be anybody's: its page runs no script, and has no access to the desk's
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


def _bound_socket(stated_port: int, last_port: int) -> socket.socket:
    """A socket that listens at the stated port; if that is 0, at the last port, the default port, or any."""
    candidates = (
        (stated_port,) if stated_port else dict.fromkeys((last_port or _DEFAULT_PORT, _DEFAULT_PORT, 0))
    )
    problem: OSError | None = None
    for port in candidates:
        bound = socket.socket()
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            bound.bind((LOOPBACK, port))
            # from now on a browser waits instead of being refused
            bound.listen(64)
        except OSError as error:
            bound.close()
            problem = error
            continue
        return bound
    reason = getattr(problem, "strerror", None) or problem
    raise ConfigurationError(f"--port {stated_port}: {reason}; name another, or leave it out")
