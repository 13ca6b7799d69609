"""Serves the desk on the loopback interface until Ctrl-C, to a browser that has its key.

LIGHT OFF has a second server, of one address in threads of its own: it answers while the event loop is busy.
"""

import asyncio
import contextlib
import http
import http.server
import socket
import threading
import urllib.parse
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import FileResponse
from nicegui import ui
from starlette.concurrency import run_in_threadpool
from starlette.responses import PlainTextResponse, Response

from processing.errors import ConfigurationError
from rig.desk.desk import Desk
from rig.desk.guard import Guard
from rig.desk.page import DARK, build_page
from rig.desk.panels.live_picture import picture_now
from rig.desk.sessions import SERVED, served_file
from rig.devices import check_wiring
from rig.presentation import say
from rig.terminal import LOOPBACK, told_of_hang_up


class OffSwitch:
    """Serves while it is open; `admits` judges host, origin and cookie of who asks, `off` switches off.

    `off` is given the name of the press.
    """

    def __init__(self, off: Callable[[str], list[str]], admits: Callable[[str, str, str], bool]) -> None:
        self._server = _Server(off, admits)
        self.port = int(self._server.server_address[1])

    def start(self) -> None:
        """Begin to listen."""
        threading.Thread(target=self._server.serve_forever, name="off switch", daemon=True).start()

    def close(self) -> None:
        """Listen no more."""
        self._server.shutdown()
        self._server.server_close()


class _Server(http.server.ThreadingHTTPServer):
    """In threads; it writes nothing into the terminal."""

    request_queue_size = 64
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Who has gone is no event."""

    def __init__(self, off: Callable[[str], list[str]], admits: Callable[[str, str, str], bool]) -> None:
        super().__init__((LOOPBACK, 0), _Handler)
        self.off, self.admits = off, admits


class _Handler(http.server.BaseHTTPRequestHandler):
    timeout = 10.0
    server: _Server

    def do_POST(self) -> None:
        host, origin, cookie = (self.headers.get(name, "") for name in ("Host", "Origin", "Cookie"))
        asked = urllib.parse.urlsplit(self.path)
        if asked.path != DARK or not self.server.admits(host, origin, cookie):
            self.send_error(http.HTTPStatus.FORBIDDEN)
            return
        answer = "; ".join(self.server.off(urllib.parse.unquote(asked.query))).encode()
        self.send_response(http.HTTPStatus.OK)
        self.send_header("Content-Type", "text/plain; charset=utf-8")
        self.send_header("Content-Length", str(len(answer)))
        self.send_header("Access-Control-Allow-Origin", origin)
        self.send_header("Access-Control-Allow-Credentials", "true")
        self.end_headers()
        self.wfile.write(answer)

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not logged."""


_PORT = 8642
_MOST_PX = 2000
_GOODBYE_S = 3


def open_desk(
    source: Path,
    overrides: tuple[str, ...] = (),
    port: int = 0,
    *,
    browser: bool = True,
) -> int:
    """Serve the desk of a configuration until Ctrl-C; a session that it has started goes on.

    `port` 0 is the last one, the usual one, or any. The address with its key is printed on
    stdout. Raises ConfigurationError where a desk of this configuration is open already.
    """
    desk = Desk(source, overrides)
    desk.hold()
    try:
        check_wiring(desk.config.laser, desk.config.controller)
        return _serve(desk, port, browser=browser)
    finally:
        desk.close()


def _serve(desk: Desk, port: int, *, browser: bool) -> int:
    listening = _listening(port, desk.place.port)
    number = int(listening.getsockname()[1])
    switch = OffSwitch(desk.lighting.off, lambda *told: guard.admits(*told))
    app = _application(desk, switch.port)
    title = f"rig desk {desk.source.name}"
    ui.run_with(app, title=title, dark=None, language="en-US", show_welcome_message=False, tailwind=False)
    guard = Guard(app, desk.place.key, number, switch.port)
    switch.start()
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
        with contextlib.suppress(KeyboardInterrupt), told_of_hang_up(hung_up):
            server.run(sockets=[listening])
    finally:
        switch.close()
    return 0


def _application(desk: Desk, off_port: int) -> FastAPI:
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

    @app.post(DARK)
    async def dark(request: Request) -> Response:
        press = urllib.parse.unquote(request.url.query)
        loop = asyncio.get_running_loop()
        said: asyncio.Future[str] = loop.create_future()

        def off() -> None:
            problems = ["the desk has failed: turn the key switch"]
            try:
                problems = desk.lighting.off(press)
            finally:
                loop.call_soon_threadsafe(said.set_result, "; ".join(problems))

        # a thread of its own: those of a pool may all be waiting
        threading.Thread(target=off, name="light off", daemon=True).start()
        return PlainTextResponse(await said)

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
