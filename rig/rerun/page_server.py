"""Serves the viewer as a web page to a browser on this machine, in a process of its own.

The files of the page are requested once from Rerun's own server. They are served from here with a content
security policy, because the page would otherwise send usage data and load fonts from other hosts: with the
policy a browser connects to 127.0.0.1 only. The process ends when its standard input is closed, so it does
not outlive the session that started it.
"""

import http.client
import http.server
import os
import subprocess
import sys
import threading
import time
import urllib.parse
from pathlib import Path
from typing import Any

from rig.rerun.ports import LOOPBACK, free_port
from rig.rerun.process_group import own_group
from rig.rerun.rerun_program import start_program

FILES = {
    "/": "text/html; charset=utf-8",
    "/re_viewer.js": "text/javascript",
    "/re_viewer_bg.wasm": "application/wasm",
    "/favicon.ico": "image/x-icon",
}
POLICY = (
    "default-src 'self'; "
    "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; "
    "worker-src 'self' blob:; "
    f"connect-src 'self' data: blob: http://{LOOPBACK}:*"
)
FETCH_LIMIT_S = 30.0


def start_page_server(port: int) -> subprocess.Popen[bytes]:
    """Start a process that serves the page on a port of 127.0.0.1 until its standard input is closed."""
    path = os.pathsep.join(
        part for part in (str(Path(__file__).resolve().parents[2]), os.environ.get("PYTHONPATH")) if part
    )
    return subprocess.Popen(
        [sys.executable, "-P", "-c", "from rig.rerun.page_server import main; main()", str(port)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": path},
        **own_group(),
    )


def page_address(port: int, stream_url: str) -> str:
    """Address of the page for a browser, with the address of the live stream that it shows."""
    return f"http://{LOOPBACK}:{port}/?url={urllib.parse.quote(stream_url, safe='')}"


def main() -> None:
    """Serve until the standard input is closed."""
    server = http.server.ThreadingHTTPServer((LOOPBACK, int(sys.argv[1])), PageHandler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    sys.stdin.buffer.read()


class PageHandler(http.server.BaseHTTPRequestHandler):
    """Answers requests with the viewer's files, which are fetched at the first request."""

    protocol_version = "HTTP/1.1"
    files: dict[str, bytes] = {}  # noqa: RUF012 - one cache for all requests of the process
    fetching = threading.Lock()

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        with self.fetching:
            if not self.files:
                self.files.update(viewer_files())
        data = self.files.get(path)
        if data is None:
            self.send_error(http.HTTPStatus.NOT_FOUND)
            return
        self.send_response(http.HTTPStatus.OK)
        self.send_header("Content-Type", FILES[path])
        self.send_header("Content-Length", str(len(data)))
        self.send_header("rerun-final-length", str(len(data)))
        self.send_header("Content-Security-Policy", POLICY)
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not logged."""


def viewer_files() -> dict[str, bytes]:
    """Files of the page by path, from Rerun's own server, which is started and stopped for this."""
    port = free_port(0)
    program = start_program("--serve-web", "--web-viewer-port", str(port), "rerun+http://127.0.0.1:1/proxy")
    try:
        deadline_s = time.monotonic() + FETCH_LIMIT_S
        while True:
            try:
                return {path: _fetched(port, path) for path in FILES}
            except OSError:
                if time.monotonic() > deadline_s:
                    raise
                time.sleep(0.1)
    finally:
        program.kill()
        program.wait()


def _fetched(port: int, path: str) -> bytes:
    connection = http.client.HTTPConnection(LOOPBACK, port, timeout=FETCH_LIMIT_S)
    try:
        connection.request("GET", path)
        return connection.getresponse().read()
    finally:
        connection.close()
