"""Starts the executable of the viewer, bound to 127.0.0.1.

The executable inside the package is started directly: the `rerun` command is a Python wrapper, and the viewer
would continue to run after the wrapper is ended. By default the viewer listens on all interfaces and sends
usage data; both are switched off here. Its page, which has settings of its own in the browser, is passed on
with a policy by which the browser asks this machine only.
"""

import http.client
import os
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Self

import rerun_cli

from processing.errors import ConfigurationError
from rig.terminal import LOOPBACK, free_port, own_group
from rig.view.scratch import no_window, page_address, ports_of_view
from rig.view.values import ShowMode

_LOOK_S, _START_LIMIT_S = 0.05, 30.0
_SERVER_MEMORY = "200MiB"
"""What the page's server keeps for a browser that comes late."""


def program() -> Path:
    """The viewer's executable inside its package."""
    folder = Path(rerun_cli.__file__).parent
    bundled = folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"
    if sys.platform == "darwin" and bundled.exists():
        return bundled
    return folder / ("rerun.exe" if sys.platform == "win32" else "rerun")


def quiet_environment() -> dict[str, str]:
    """Environment variables with which the program sends no usage data.

    Usage data can be switched off only by a command of the program, which stores this in the user's settings.
    On Linux the program is given a settings folder of its own, so that the user's settings do not change.
    """
    environment = {**os.environ, "RERUN_APP_ONLY": "true"}
    if sys.platform.startswith("linux"):
        settings = Path(tempfile.gettempdir()) / f"rerun-settings-{os.getuid()}"
        settings.mkdir(mode=0o700, exist_ok=True)
        made = settings.lstat()
        if not stat.S_ISDIR(made.st_mode) or made.st_uid != os.getuid() or made.st_mode & 0o077:
            # in a folder for all users anyone could have made it before, and read or change what is in it
            settings = Path(tempfile.mkdtemp(prefix="rerun-settings-"))
        environment["XDG_CONFIG_HOME"] = str(settings)
    subprocess.run(
        [program(), "analytics", "disable"], check=True, capture_output=True, timeout=60, env=environment
    )
    return environment


def start_program(
    *arguments: str, environment: dict[str, str] | None = None, alone: bool = True
) -> subprocess.Popen[bytes]:
    """Start the program on 127.0.0.1, without output; `alone`: it outlives this one's process group."""
    return subprocess.Popen(
        [program(), "--bind", LOOPBACK, *arguments],
        env=environment if environment is not None else quiet_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        **(own_group() if alone else {}),
    )


class GuardedPage(ThreadingHTTPServer):
    """The page of the viewer's server at `inner_port`, with a policy: a browser asks nobody else.

    `stream_port` is that of the stream, which the page may read.
    """

    daemon_threads = True

    def __init__(self, port: int, inner_port: int, stream_port: int) -> None:
        super().__init__((LOOPBACK, port), _PageRequest)
        self.inner_port = inner_port
        own = "'self' data: blob:"
        self.policy = (
            f"default-src {own} 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval'; "
            f"connect-src {own} http://{LOOPBACK}:{stream_port}"
        )
        threading.Thread(target=self.serve_forever, name="page", daemon=True).start()


class _PageRequest(BaseHTTPRequestHandler):
    """A file of the page, from the viewer's server."""

    server: GuardedPage

    def do_GET(self) -> None:
        inner = http.client.HTTPConnection(LOOPBACK, self.server.inner_port, timeout=_START_LIMIT_S)
        # who has closed the page, or the viewer, is no event
        with suppress(OSError, http.client.HTTPException):
            inner.request("GET", self.path)
            answer = inner.getresponse()
            body = answer.read()
            self.send_response(answer.status)
            for name in ("Content-Type", "Content-Encoding"):
                if value := answer.getheader(name):
                    self.send_header(name, value)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Content-Security-Policy", self.server.policy)
            self.end_headers()
            self.wfile.write(body)
        inner.close()

    def log_message(self, *_: object) -> None:
        """Nobody reads it."""


class ViewerProgram:
    """The viewer's program, with files or as the server of a stream: a window, or a page on the loopback."""

    def __init__(self, mode: ShowMode, ports: tuple[int, int] | None, files: Sequence[str] = ()) -> None:
        if mode == "spawn" and (missing := no_window()):
            raise ConfigurationError(missing)
        self._is_page = mode == "web"
        port, web_port = ports or ports_of_view()
        self.url = f"rerun+http://{LOOPBACK}:{port}/proxy"
        words = ["--port", str(port), "--hide-welcome-screen", *files]
        if self._is_page:
            inner_port = free_port(web_port + 1)
            words += ["--serve-web", "--web-viewer-port", str(inner_port)]
            words += ["--server-memory-limit", _SERVER_MEMORY]
        self._process = start_program(*words, alone=not self._is_page)
        if self._is_page:
            self._await_page(inner_port)
            GuardedPage(web_port, inner_port, port)
            print(f"the view is at {page_address(port, web_port)} (Ctrl-C ends it)", flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_error: object) -> None:
        if self._is_page or kind is not None:
            self._process.kill()
            self._process.wait()
        elif self._process.poll() is None:
            # a window stays until it is closed; nothing waits for it any more
            self._process.returncode = 0

    def _await_page(self, web_port: int) -> None:
        deadline_s = time.monotonic() + _START_LIMIT_S
        while self.is_open and time.monotonic() < deadline_s:
            with suppress(OSError), socket.create_connection((LOOPBACK, web_port), _LOOK_S):
                return
            time.sleep(_LOOK_S)

    @property
    def is_open(self) -> bool:
        """Whether it has not been closed."""
        return self._process.poll() is None

    def wait(self) -> None:
        """Wait until it is closed, or Ctrl-C ends it."""
        try:
            self._process.wait()
        except KeyboardInterrupt:
            self._process.kill()
