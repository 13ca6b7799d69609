"""LIGHT OFF beside the event loop: a server of one address, in threads of its own.

The desk's own server answers `/dark`, too; this one also does when that loop is busy.
"""

import http
import http.server
import threading
import urllib.parse
from collections.abc import Callable
from typing import Any

from rig.desk.head import DARK
from rig.orders import LOOPBACK


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
