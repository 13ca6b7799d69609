"""A crowd that says nothing does not shut the desk."""

import contextlib
import http.client
import socket
import threading
from contextlib import ExitStack
from typing import Any

import pytest

pytest.importorskip("uvicorn", reason="rig desk is not installed: pip install '.[desk]'")
import uvicorn

from rig.desk.few_visitors import MOST_VISITORS, FewVisitors
from rig.desk.guard import LOOPBACK
from rig.desk.off_switch import OffSwitch


async def _app(scope: Any, receive: Any, send: Any) -> None:
    if scope["type"] == "http":
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"8")]})
        await send({"type": "http.response.body", "body": b"the desk"})


def visit(port: int, method: str, path: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(LOOPBACK, port, timeout=30.0)
    try:
        connection.request(method, path)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def crowd_at(port: int, many: int, held: ExitStack) -> list[socket.socket]:
    silent = [held.enter_context(socket.create_connection((LOOPBACK, port))) for _ in range(many)]
    for one in silent:
        one.sendall(b"GET / HTTP/1.1\r\nX-never-ends: ")
    return silent


def test_the_page_answers_and_the_oldest_who_asks_nothing_gives_way() -> None:
    settings = uvicorn.Config(_app, http=FewVisitors, log_level="error", lifespan="off")
    server = uvicorn.Server(settings)
    with socket.socket() as listening, ExitStack() as held:
        listening.bind((LOOPBACK, 0))
        listening.listen(512)
        port = listening.getsockname()[1]
        serving = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
        serving.start()
        try:
            silent = crowd_at(port, MOST_VISITORS + 20, held)
            assert visit(port, "GET", "/") == (200, b"the desk")
            silent[0].settimeout(20.0)
            with contextlib.suppress(ConnectionResetError):
                assert silent[0].recv(1) == b""
            assert len(server.server_state.connections) <= MOST_VISITORS
        finally:
            server.should_exit = server.force_exit = True
            serving.join(30.0)
    assert not serving.is_alive()


def test_the_light_can_be_switched_off_all_the_same() -> None:
    presses: list[str] = []

    def off(press: str) -> list[str]:
        presses.append(press)
        return ["the laser is off"]

    switch = OffSwitch(off, lambda *_told: True)
    switch.start()
    try:
        with ExitStack() as held:
            crowd_at(switch.port, 200, held)
            assert visit(switch.port, "POST", "/dark?now") == (200, b"the laser is off")
    finally:
        switch.close()
    assert presses == ["now"]
