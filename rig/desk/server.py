"""Serves the desk on a loopback port until Ctrl-C."""

import contextlib
import secrets
import socket
import webbrowser
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Response
from fastapi.responses import FileResponse
from nicegui import ui
from starlette.concurrency import run_in_threadpool

from processing.errors import ConfigurationError
from rig.desk.desk import Desk
from rig.desk.guard import LOOPBACK, Guard
from rig.desk.look_now import picture_now
from rig.desk.page import build_page
from rig.desk.sessions import SERVED, served_file
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
        return Response(status_code=404) if path is None else FileResponse(path, headers=sandbox)

    @ui.page("/")
    def page() -> None:
        build_page(desk)

    ui.run_with(app, title=f"rig desk {source.name}", dark=True, show_welcome_message=False, tailwind=False)
    desk.following.start()
    print(address, flush=True)
    say("the desk is at this address, in a browser on this machine; Ctrl-C ends it, sessions go on")
    if browser:
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(address)
    settings = uvicorn.Config(
        Guard(app, key, number), log_level="warning", access_log=False, ws="websockets-sansio"
    )
    try:
        with contextlib.suppress(KeyboardInterrupt):
            uvicorn.Server(settings).run(sockets=[listening])
    finally:
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
