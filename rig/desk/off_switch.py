"""LIGHT OFF beside the event loop: a server of one address, in threads of its own.

The desk's own server answers `/dark`, too; this one also does when that loop is busy.
"""

import http
import http.server
import socket
import ssl
import threading
import urllib.parse
from collections.abc import Callable
from typing import Any

from rig.channel import FewConnections
from rig.desk.guard import LOOPBACK
from rig.desk.safety_bar import DARK

Admits = Callable[[str, str, str, str], bool]


class OffSwitch:
    """Serves while it is open; `admits` judges host, origin, cookie and peer of who asks, `off` switches off.

    `off` is given the name of the press. `tls` is that of the desk.
    """

    def __init__(
        self,
        off: Callable[[str], list[str]],
        admits: Admits,
        listen: str = LOOPBACK,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        self._server = (_Server6 if ":" in listen else _Server)(off, admits, listen, tls)
        self.port = int(self._server.server_address[1])

    def start(self) -> None:
        """Begin to listen."""
        threading.Thread(target=self._server.serve_forever, name="off switch", daemon=True).start()

    def close(self) -> None:
        """Listen no more."""
        self._server.shutdown()
        self._server.server_close()


class _Server(FewConnections):
    def __init__(
        self, off: Callable[[str], list[str]], admits: Admits, listen: str, tls: ssl.SSLContext | None
    ) -> None:
        super().__init__((listen, 0), _Handler)
        self.off, self.admits = off, admits
        if tls is not None:
            # whoever is slow to shake hands does so in a thread of their own
            self.socket = tls.wrap_socket(self.socket, server_side=True, do_handshake_on_connect=False)


class _Server6(_Server):
    address_family = socket.AF_INET6


class _Handler(http.server.BaseHTTPRequestHandler):
    timeout = 10.0
    server: _Server

    def do_POST(self) -> None:
        origin = self.headers.get("Origin", "")
        host, cookie = self.headers.get("Host", ""), self.headers.get("Cookie", "")
        asked = urllib.parse.urlsplit(self.path)
        if asked.path != DARK or not self.server.admits(host, origin, cookie, str(self.client_address[0])):
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
