"""Serves the desk until Ctrl-C: on this machine by a key, on other interfaces with TLS and passwords only."""

import asyncio
import contextlib
import http
import ipaddress
import socket
import ssl
import threading
import urllib.parse
import webbrowser
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import FileResponse
from nicegui import ui
from starlette.concurrency import run_in_threadpool
from starlette.responses import HTMLResponse, RedirectResponse, Response

from processing.errors import ConfigurationError
from rig.desk.desk import Desk
from rig.desk.few_visitors import FewVisitors
from rig.desk.guard import LOOPBACK, PERSON, Door, Guard, let_in
from rig.desk.login import LOGIN, LOGOUT, login_page
from rig.desk.off_switch import OffSwitch
from rig.desk.page import build_page
from rig.desk.panels.live_picture import picture_now
from rig.desk.people import People
from rig.desk.safety_bar import DARK
from rig.desk.sessions import SERVED, served_file
from rig.desk.theme import themed_report
from rig.presentation import say
from rig.rerun import cookies_of
from rig.terminal import told_of_hang_up

_PORT = 8642
_MOST_PX = 2000
_GOODBYE_S = 3
_MOST_LOGIN_BYTES = 4096
_LOGIN_S = 10.0


@dataclass(frozen=True, slots=True)
class Entrance:
    """How the desk is reached: port (0: the last one, the usual one, or any) and address to listen on.

    `certificate` and `certificate_key` are PEM files for TLS, `passwords` a file of `rig desk-password`,
    `behind` the address at which a reverse proxy of this machine has it.
    """

    port: int = 0
    listen: str = LOOPBACK
    certificate: Path | None = None
    certificate_key: Path | None = None
    passwords: Path | None = None
    behind: str = ""

    @property
    def proxied(self) -> str:
        """Host of `behind`, as a browser states it; raises ConfigurationError for one that cannot be."""
        if not self.behind:
            return ""
        told = urllib.parse.urlsplit(self.behind)
        if told.scheme != "https" or not told.hostname or told.path.strip("/") or told.query:
            raise ConfigurationError(
                f"--behind {self.behind}: should be the address that the proxy serves with TLS, without a "
                "path, for example https://rig.lab"
            )
        if self.passwords is None:
            raise ConfigurationError(
                f"--behind {self.behind}: others could reach the laser: --passwords must be stated"
            )
        if self.remote:
            raise ConfigurationError(
                f"--behind {self.behind}: others could bypass the proxy: leave --listen {self.listen} out"
            )
        return told.netloc.lower().removesuffix(":443")

    @property
    def remote(self) -> bool:
        """Whether others reach it; raises ConfigurationError where they could without TLS or password."""
        try:
            remote = not ipaddress.ip_address(self.listen).is_loopback
        except ValueError:
            raise ConfigurationError(
                f"--listen {self.listen}: should be an address of this machine, for example 0.0.0.0 for all"
            ) from None
        if remote and (self.certificate is None or self.passwords is None):
            missing = " and ".join(
                name
                for name, value in (("--certificate", self.certificate), ("--passwords", self.passwords))
                if value is None
            )
            raise ConfigurationError(
                f"--listen {self.listen}: others could reach the laser: {missing} must be stated; "
                "or leave --listen out and use a tunnel"
            )
        return remote

    def tls(self) -> ssl.SSLContext | None:
        """None without a certificate; raises ConfigurationError for one that cannot be used."""
        if self.certificate is None:
            return None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            context.load_cert_chain(self.certificate, self.certificate_key)
        except (OSError, ssl.SSLError) as error:
            why = error.strerror or error
            raise ConfigurationError(
                f"--certificate {self.certificate}: cannot be used: {why}; its key is needed too, "
                "in the same file or as --certificate-key"
            ) from None
        return context


def open_desk(
    source: Path,
    overrides: tuple[str, ...] = (),
    entrance: Entrance | None = None,
    *,
    browser: bool = True,
    archive: Path = Path(),
) -> int:
    """Serve the desk of a configuration until Ctrl-C; a session that it has started goes on.

    The runs of an `archive` that is there are listed, too. The address with its key is printed on stdout,
    then the one for watching only. Raises ConfigurationError
    where a desk of this configuration is open already.
    """
    entrance = entrance or Entrance()
    remote, tls, behind = entrance.remote, entrance.tls(), entrance.proxied
    desk = Desk(source, overrides, archive)
    desk.hold()
    try:
        return _serve(desk, entrance, tls, remote=remote, behind=behind, browser=browser)
    finally:
        desk.close()


def _serve(
    desk: Desk,
    entrance: Entrance,
    tls: ssl.SSLContext | None,
    *,
    remote: bool,
    behind: str,
    browser: bool,
) -> int:
    people = People(desk.place.key, desk.place.watch_key, entrance.passwords)
    listening = _listening(entrance, desk.place.port)
    number = int(listening.getsockname()[1])
    switch = OffSwitch(desk.lighting.off, lambda *told: guard.admits(*told), entrance.listen, tls)
    door = Door(number, switch.port, tls is not None, remote, behind)
    app = _application(desk, people, door)
    title = f"rig desk {desk.source.name}"
    ui.run_with(app, title=title, dark=True, language="en-US", show_welcome_message=False, tailwind=False)
    guard = Guard(app, people, door)
    switch.start()
    desk.safety.start()
    desk.following.start()
    desk.alarming.start()
    own = f"{door.scheme}://{LOOPBACK}:{number}/?key="
    address = own + desk.place.key
    desk.place.opened_at(address, number)
    print(address, flush=True)
    say("the desk is at this address, in a browser on this machine; Ctrl-C ends it, sessions go on")
    say(f"to watch only: {own}{desk.place.watch_key}")
    if remote:
        say(f"from other machines: {door.scheme}://NAME-OF-THIS-MACHINE:{number}/ with name and password")
    if behind:
        say(f"from other machines: https://{behind}/ with name and password")
    if browser:
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(address)
    settings = uvicorn.Config(
        guard,
        http=FewVisitors,
        log_level="warning",
        access_log=False,
        ws="websockets-sansio",
        # in a laboratory a network is faster than what this would cost the computer of the rig
        ws_per_message_deflate=False,
        ssl_certfile=entrance.certificate,
        ssl_keyfile=entrance.certificate_key,
        # a browser that keeps its connection does not answer the goodbye of TLS, and who reads slowly none
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


def _application(desk: Desk, people: People, door: Door) -> FastAPI:
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

    @app.post(DARK)
    async def dark(request: Request) -> Response:
        # a thread of its own: those of a pool may all be waiting
        press = urllib.parse.unquote(request.url.query)
        threading.Thread(target=desk.lighting.off, args=(press,), name="light off", daemon=True).start()
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

    @app.get(LOGIN)
    async def ask() -> Response:
        return HTMLResponse(login_page())

    @app.post(LOGIN)
    async def enter(request: Request) -> Response:
        body = b""
        try:
            async with asyncio.timeout(_LOGIN_S):
                async for part in request.stream():
                    body += part
                    if len(body) > _MOST_LOGIN_BYTES:
                        too_long = login_page("that is too long")
                        return HTMLResponse(too_long, http.HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        except TimeoutError:
            return HTMLResponse(login_page("that took too long"), http.HTTPStatus.REQUEST_TIMEOUT)
        told = urllib.parse.parse_qs(body.decode(errors="replace"))
        name, password = (told.get(key, [""])[0] for key in ("name", "password"))
        try:
            cookie = await run_in_threadpool(people.enter, name, password)
        except ConfigurationError as error:
            return HTMLResponse(login_page(str(error)), http.HTTPStatus.TOO_MANY_REQUESTS)
        if cookie is None:
            return HTMLResponse(login_page("name or password is wrong"), http.HTTPStatus.FORBIDDEN)
        host = request.headers.get("host", "")
        return let_in(RedirectResponse("/", http.HTTPStatus.SEE_OTHER), door, host, cookie)

    @app.post(LOGOUT)
    async def leave(request: Request) -> Response:
        for cookie in cookies_of(request.headers.get("cookie", ""), door.cookie):
            people.leave(cookie)
        answer = RedirectResponse(LOGIN, http.HTTPStatus.SEE_OTHER)
        answer.delete_cookie(door.cookie)
        return answer

    @ui.page("/")
    def page(request: Request) -> None:
        build_page(desk, people, door.off_port or 0, request.scope[PERSON])

    return app


def _listening(entrance: Entrance, last: int) -> socket.socket:
    """A socket that is bound; raises ConfigurationError if the port asked for is taken."""
    asked = entrance.port
    family = socket.AF_INET6 if ":" in entrance.listen else socket.AF_INET
    for number in (asked,) if asked else dict.fromkeys((last or _PORT, _PORT, 0)):
        listening = socket.socket(family)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((entrance.listen, number))
            # from now on a browser waits instead of being refused
            listening.listen(64)
        except OSError as error:
            listening.close()
            if asked:
                raise ConfigurationError(
                    f"--port {asked}: {error.strerror or error}; name another, or leave it out"
                ) from None
            continue
        return listening
    raise ConfigurationError(
        f"--listen {entrance.listen}: it has no free port, or is not an address of this machine"
    )
