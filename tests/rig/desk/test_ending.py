"""A desk serves whichever of its two servers is up first, and ends with its terminal."""

import contextlib
import http.client
import signal
import urllib.parse
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.rig.desk.desk_page import DeskProcess

OFF_IS_LATE = """
import threading, time, uvicorn
from rig.cli import main

run = uvicorn.Server.run

def late(server, sockets):
    if threading.current_thread() is not threading.main_thread():
        time.sleep(3.0)
    run(server, sockets)

uvicorn.Server.run = late
main()
"""
"""A desk whose thread of LIGHT OFF gets no processor before the page is served."""


def fetch(address: str, path: str, cookie: str = "") -> http.client.HTTPResponse:
    told = urllib.parse.urlsplit(address)
    assert told.hostname is not None
    connection = http.client.HTTPConnection(told.hostname, told.port, timeout=30.0)
    with contextlib.closing(connection):
        connection.request("GET", path, headers={"Cookie": cookie})
        answer = connection.getresponse()
        answer.read()
        return answer


@pytest.mark.slow
def test_a_desk_whose_light_off_is_late_serves_and_ends_with_its_terminal(
    desk_configuration: Callable[[str], Path],
) -> None:
    desk = DeskProcess(desk_configuration(""), program=("-c", OFF_IS_LATE))
    try:
        address = desk.address
        entered = fetch(address, f"/?{urllib.parse.urlsplit(address).query}")
        assert entered.status == 303
        cookie = str(entered.headers["Set-Cookie"]).partition(";")[0]
        # made in a thread of the server, which waits for more
        assert fetch(address, "/picture", cookie).status == 200
        status, said = desk.ended(signal.SIGHUP)
        assert (status, said[1:]) == (0, [])
    finally:
        desk.kill()
