"""A server in threads that a crowd of silent connections cannot fill.

Anybody on the machine may connect to its loopback ports, and say nothing: each connection would take a thread
and an open file of the process that measures, until it can open none of its own.
"""

import contextlib
import http.server
import socket
import threading
from typing import Any

MOST_CONNECTIONS = 64
"""Far more than the desks and commands of one rig."""


class FewConnections(http.server.ThreadingHTTPServer):
    """Keeps `MOST_CONNECTIONS`; one more takes the place of the oldest that has not proved itself."""

    request_queue_size = 128
    """A crowd at the door makes others wait for milliseconds, and not until their system tries again."""
    daemon_threads = True
    # a reader that hangs keeps nobody from ending
    block_on_close = False

    def __init__(self, *words: Any) -> None:
        self._open: dict[int, tuple[socket.socket, bool]] = {}
        self._one_at_a_time = threading.Lock()
        super().__init__(*words)

    def proved(self, connection: socket.socket) -> None:
        """This one may stay: who has it may ask."""
        with self._one_at_a_time:
            if id(connection) in self._open:
                self._open[id(connection)] = connection, True

    def process_request(self, request: Any, client_address: Any) -> None:
        with self._one_at_a_time:
            self._open[id(request)] = request, False
            crowded = len(self._open) > MOST_CONNECTIONS
            given_up = next((one for one, proved in self._open.values() if crowded and not proved), None)
            if given_up is not None:
                del self._open[id(given_up)]
        if given_up is not None:
            # its thread reads the end, and closes it
            with contextlib.suppress(OSError):
                given_up.shutdown(socket.SHUT_RDWR)
        super().process_request(request, client_address)

    def close_request(self, request: Any) -> None:
        with self._one_at_a_time:
            self._open.pop(id(request), None)
        super().close_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Who has gone is no event."""
