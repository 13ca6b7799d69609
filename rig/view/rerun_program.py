"""The program of the viewer, bound to 127.0.0.1, and the page that it serves.

The executable inside the package is started directly: the `rerun` command is a Python wrapper, and the viewer
would continue to run after the wrapper is ended. By default the viewer listens on all interfaces and sends
usage data; both are switched off here. Its page is served with a content security policy, so that the browser
contacts this machine only.
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
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Self

import rerun_cli

from processing.errors import ConfigurationError
from rig.interruption import LOOPBACK, free_port, process_group_options
from rig.view.running_view import ShowMode, no_window, page_address, ports_of_view

_CHECK_INTERVAL_S, _MAX_START_S = 0.05, 30.0
"""Interval of the checks whether the page's server answers, and the longest wait for it."""
_SERVER_MEMORY = "200MiB"
"""Memory in which the page's server keeps data for a browser that connects late."""


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
        status = settings.lstat()
        if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
            # another user could have created it in the common temporary folder, to change the settings
            settings = Path(tempfile.mkdtemp(prefix="rerun-settings-"))
        environment["XDG_CONFIG_HOME"] = str(settings)
    subprocess.run(
        [program(), "analytics", "disable"], check=True, capture_output=True, timeout=60, env=environment
    )
    return environment


def _start_program(*arguments: str, outlives_group: bool) -> subprocess.Popen[bytes]:
    """Start the program on 127.0.0.1, without output."""
    return subprocess.Popen(
        [program(), "--bind", LOOPBACK, *arguments],
        env=quiet_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        **(process_group_options() if outlives_group else {}),
    )


class _GuardedPage(ThreadingHTTPServer):
    """Serves the page of `inner_port` with a policy: the browser contacts only it and `stream_port`."""

    daemon_threads = True

    def __init__(self, port: int, inner_port: int, stream_port: int) -> None:
        super().__init__((LOOPBACK, port), _PageRequest)
        self.inner_port = inner_port
        own_sources = "'self' data: blob:"
        self.policy = (
            f"default-src {own_sources} 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval'; "
            f"connect-src {own_sources} http://{LOOPBACK}:{stream_port}"
        )
        threading.Thread(target=self.serve_forever, name="page", daemon=True).start()


class _PageRequest(BaseHTTPRequestHandler):
    """Answers a request for a file of the page with that of the viewer's server."""

    server: _GuardedPage

    def do_GET(self) -> None:
        inner = http.client.HTTPConnection(LOOPBACK, self.server.inner_port, timeout=_MAX_START_S)
        # an error here only means that the page or the viewer was closed
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
        """Print no log of requests."""


class ViewerProgram:
    """The running viewer, the server of a stream: a window, or a page on the loopback."""

    def __init__(self, mode: ShowMode, ports: tuple[int, int] | None) -> None:
        if mode == "spawn" and (reason := no_window()):
            raise ConfigurationError(reason)
        self._is_page = mode == "web"
        port, web_port = ports or ports_of_view()
        self.url = f"rerun+http://{LOOPBACK}:{port}/proxy"
        arguments = ["--port", str(port), "--hide-welcome-screen"]
        if self._is_page:
            inner_port = free_port(web_port + 1)
            arguments += ["--serve-web", "--web-viewer-port", str(inner_port)]
            arguments += ["--server-memory-limit", _SERVER_MEMORY]
        self._process = _start_program(*arguments, outlives_group=not self._is_page)
        if self._is_page:
            self._await_page(inner_port)
            _GuardedPage(web_port, inner_port, port)
            print(f"the view is at {page_address(port, web_port)} (Ctrl-C ends it)", flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_error: object) -> None:
        if self._is_page or kind is not None:
            self._process.kill()
            self._process.wait()
        elif self._process.poll() is None:
            # a window stays open until the user closes it; this process does not wait for it
            self._process.returncode = 0

    def _await_page(self, web_port: int) -> None:
        deadline_s = time.monotonic() + _MAX_START_S
        while self.is_open and time.monotonic() < deadline_s:
            with suppress(OSError), socket.create_connection((LOOPBACK, web_port), _CHECK_INTERVAL_S):
                return
            time.sleep(_CHECK_INTERVAL_S)

    @property
    def is_open(self) -> bool:
        """Whether the viewer is still running."""
        return self._process.poll() is None

    def wait(self) -> None:
        """Wait until the viewer is closed, or Ctrl-C ends it."""
        try:
            self._process.wait()
        except KeyboardInterrupt:
            self._process.kill()
