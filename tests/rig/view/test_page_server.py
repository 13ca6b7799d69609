"""The page's server answers only who names it and has its key, and passes the stream on to nobody else."""

import http.client
import http.server
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from rig.rerun.page_server import PageHandler, page_address
from rig.rerun.ports import LOOPBACK

KEY = "a-key-of-this-run"


class Stream(http.server.BaseHTTPRequestHandler):
    """A stream that answers with what it was asked."""

    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        data = self.rfile.read(int(self.headers["Content-Length"]))
        self.send_response(200)
        self.send_header("Content-Type", "application/grpc-web+proto")
        self.send_header("Content-Length", str(2 * len(data)))
        self.end_headers()
        self.wfile.write(2 * data)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing is logged."""


def served(handler: type[http.server.BaseHTTPRequestHandler]) -> http.server.ThreadingHTTPServer:
    server = http.server.ThreadingHTTPServer((LOOPBACK, 0), handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    return server


@pytest.fixture
def port() -> Iterator[int]:
    server_of_stream = served(Stream)

    class Page(PageHandler):
        key = KEY
        stream = f"{LOOPBACK}:{server_of_stream.server_address[1]}"
        files: dict[str, bytes] = {"/": b"<html>"}  # noqa: RUF012

    page = served(Page)
    found = int(page.server_address[1])
    Page.hosts = frozenset({f"{LOOPBACK}:{found}"})
    yield found
    for server in (page, server_of_stream):
        server.shutdown()
        server.server_close()


def asked(port: int, method: str, path: str, body: bytes = b"", **headers: str) -> tuple[int, bytes, str]:
    connection = http.client.HTTPConnection(LOOPBACK, port, timeout=20.0)
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    found = answer.status, answer.read(), answer.getheader("Set-Cookie", "")
    connection.close()
    return found


def test_the_address_opens_the_page_and_its_cookie_the_stream(port: int) -> None:
    path = page_address(port, KEY).removeprefix(f"http://{LOOPBACK}:{port}")
    status, data, cookie = asked(port, "GET", path)
    assert (status, data) == (200, b"<html>")
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    own = cookie.partition(";")[0]
    assert asked(port, "POST", "/read", b"abc", Cookie=own)[:2] == (200, b"abcabc")
    assert asked(port, "GET", "/", Cookie=own)[0] == 200


def test_nobody_else_is_answered(port: int) -> None:
    cookie = f"rig_page_{port}={KEY}"
    assert asked(port, "GET", f"/?key={KEY}", Host=f"evil.example:{port}")[0] == 421
    assert asked(port, "POST", "/read", b"abc", Host="evil.example", Cookie=cookie)[0] == 421
    for path, headers in (("/", {}), ("/?key=guess", {}), ("/", {"Cookie": f"rig_page_{port}=guess"})):
        assert asked(port, "GET", path, **headers)[0] == 403
    assert asked(port, "POST", "/read", b"abc")[0] == 403


@pytest.mark.parametrize("foreign", ['settings={"dark": true}', "a b=c", "alone", "rig_page_{}=of-another"])
def test_cookies_of_other_programs_on_this_host_do_not_shut_the_page(port: int, foreign: str) -> None:
    own, other = f"rig_page_{port}={KEY}", foreign.replace("{}", str(port))
    for cookies in (f"{own}; {other}", f"{other}; {own}"):
        assert asked(port, "GET", "/", Cookie=cookies)[0] == 200
    assert asked(port, "GET", "/", Cookie=other)[0] == 403
