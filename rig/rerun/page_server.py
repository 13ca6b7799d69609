"""Serves the viewer and its stream as one web page to a browser on this machine, in a process of its own.

The files of the page are requested once from Rerun's own server. They are served from here with a content
security policy, because the page would otherwise send usage data and load fonts from other hosts: with the
policy a browser connects to this server only. The process ends when its standard input is closed, so it does
not outlive the session that started it.

Rerun's server of the stream answers whoever asks. Here only a request counts that names this server as its
host, so that no foreign page can read the data under a name of its own (DNS rebinding), and that has the key
of the page's address, or the cookie that the page got with it: other users of this machine have neither.
"""

import contextlib
import hmac
import http.client
import http.server
import os
import subprocess
import sys
import threading
import time
import urllib.parse
from typing import Any

from rig.rerun.cookies import cookies_of
from rig.rerun.ports import LOOPBACK, free_port
from rig.rerun.process_group import start_python
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
    "connect-src 'self' data: blob:"
)
FETCH_LIMIT_S = 30.0
_KEY_VARIABLE = "RIG_PAGE_KEY"
_MOST_ASKED_BYTES = 1024 * 1024
_PIECE_BYTES = 64 * 1024
_PASSED_ON = ("content-type", "accept", "x-grpc-web", "x-user-agent", "grpc-timeout")


def start_page_server(port: int, key: str) -> subprocess.Popen[bytes]:
    """Start a process that serves the page on a port of 127.0.0.1 until its standard input is closed.

    Each line that is written there is the address of the stream from then on; see `name_stream`. `key` opens
    the page. It is handed over in the environment, which other users cannot read.
    """
    program, nowhere = "from rig.rerun.page_server import main; main()", subprocess.DEVNULL
    streams = {"stdin": subprocess.PIPE, "stdout": nowhere, "stderr": nowhere}
    return start_python("-c", program, str(port), **streams, env={_KEY_VARIABLE: key})


def name_stream(server: subprocess.Popen[bytes], stream_url: str) -> None:
    """Tell the server of the page where the stream is now."""
    if server.stdin is not None:
        # a server that has ended is noticed by the browser
        with contextlib.suppress(OSError):
            server.stdin.write(f"{stream_url}\n".encode())
            server.stdin.flush()


def page_address(port: int, key: str) -> str:
    """Address of the page for a browser, with the key that opens it."""
    stream = urllib.parse.quote(f"rerun+http://{LOOPBACK}:{port}/proxy", safe="")
    return f"http://{LOOPBACK}:{port}/?key={key}&url={stream}"


def main() -> None:
    """Serve until the standard input is closed."""
    port = int(sys.argv[1])
    PageHandler.key = os.environ[_KEY_VARIABLE]
    PageHandler.hosts = frozenset({f"{LOOPBACK}:{port}", f"localhost:{port}"})
    server = http.server.ThreadingHTTPServer((LOOPBACK, port), PageHandler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    for line in sys.stdin.buffer:
        PageHandler.stream = urllib.parse.urlsplit(line.decode().strip()).netloc


class PageHandler(http.server.BaseHTTPRequestHandler):
    """Answers with the viewer's files, which are fetched at the first request, and passes the stream on.

    `stream` is the address (HOST:PORT) of the stream's server, `hosts` the names under which this one may be
    asked.
    """

    protocol_version = "HTTP/1.1"
    key = ""
    hosts: frozenset[str] = frozenset()
    stream = ""
    files: dict[str, bytes] = {}  # noqa: RUF012 - one cache for all requests of the process
    fetching = threading.Lock()

    def do_GET(self) -> None:
        address = urllib.parse.urlsplit(self.path)
        key = urllib.parse.parse_qs(address.query).get("key", [""])[0]
        if not self._may_ask(key):
            return
        with self.fetching:
            if not self.files:
                self.files.update(viewer_files())
        data = self.files.get(address.path)
        if data is None:
            self.send_error(http.HTTPStatus.NOT_FOUND)
            return
        self.send_response(http.HTTPStatus.OK)
        self.send_header("Content-Type", FILES[address.path])
        self.send_header("Content-Length", str(len(data)))
        self.send_header("rerun-final-length", str(len(data)))
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("Referrer-Policy", "no-referrer")
        if key:
            self.send_header(
                "Set-Cookie", f"{self._cookie_name}={self.key}; Path=/; HttpOnly; SameSite=Strict"
            )
        self.end_headers()
        self.wfile.write(data)

    def do_POST(self) -> None:
        length = int(self.headers.get("Content-Length") or 0)
        if not self._may_ask("") or not self.stream or length > _MOST_ASKED_BYTES:
            self.close_connection = True
            return
        connection = http.client.HTTPConnection(self.stream)
        try:
            asked = self.rfile.read(length)
            headers = {name: self.headers[name] for name in _PASSED_ON if name in self.headers}
            connection.request("POST", self.path, asked, headers)
            self._pass_on(connection.getresponse())
        except (OSError, http.client.HTTPException):
            # one of both sides has gone
            self.close_connection = True
        finally:
            connection.close()

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not logged."""

    @property
    def _cookie_name(self) -> str:
        """Browsers keep one set of cookies for all ports of a host."""
        return f"rig_page_{self.connection.getsockname()[1]}"

    def _may_ask(self, key: str) -> bool:
        """Whether the request is for this server and by who knows the key; it is answered if not."""
        if self.headers.get("Host", "") not in self.hosts:
            self.close_connection = True
            self.send_error(http.HTTPStatus.MISDIRECTED_REQUEST)
            return False
        told = [key] if key else cookies_of(self.headers.get("Cookie", ""), self._cookie_name)
        if not any(hmac.compare_digest(one.encode(), self.key.encode()) for one in told):
            self.close_connection = True
            self.send_error(http.HTTPStatus.FORBIDDEN, "open the address that rig has printed")
            return False
        return True

    def _pass_on(self, answer: http.client.HTTPResponse) -> None:
        """Everything that comes, as soon as it comes."""
        self.send_response(answer.status)
        for name in ("content-type", "grpc-status", "grpc-message", "grpc-encoding"):
            value = answer.getheader(name)
            if value is not None:
                self.send_header(name, value)
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        while data := answer.read1(_PIECE_BYTES):
            self.wfile.write(f"{len(data):x}\r\n".encode() + data + b"\r\n")
        self.wfile.write(b"0\r\n\r\n")


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
