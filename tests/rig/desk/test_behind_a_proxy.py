"""The desk behind nginx, as docs/desk-network.md configures it: TLS at the proxy."""

import os
import re
import shlex
import shutil
import socket
import ssl
import subprocess
import sys
import time
import urllib.parse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.rig.desk.desk_page import DeskProcess, Page
from tests.rig.view.headless_browser import HeadlessBrowser

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(240)]
DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "desk-network.md"
PASSWORD = "the long password"
NAME = "localhost"
"""In place of rig.lab: it needs no entry in this machine's names."""
WHOLE = """
daemon off;
pid {place}/nginx.pid;
error_log {place}/error.log;
events {{}}
http {{
access_log off;
client_body_temp_path {place}/body; proxy_temp_path {place}/proxy; fastcgi_temp_path {place}/fastcgi;
uwsgi_temp_path {place}/uwsgi; scgi_temp_path {place}/scgi;
{site}
}}
"""


def nginx() -> str:
    """The program; skips without it."""
    found = shutil.which("nginx", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/local/sbin")
    if found is None:
        pytest.skip("nginx is not installed: apt install nginx")
    return found


def documented(kind: str) -> str:
    """The block of this kind in the document's part about proxies."""
    part = DOCUMENT.read_text(encoding="utf-8").partition("## Behind a reverse proxy")[2]
    return re.findall(rf"```{kind}\n(.*?)```", part, re.DOTALL)[0]


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


@contextmanager
def proxy(program: str, place: Path, port: int, desk_port: int) -> Iterator[None]:
    """Nginx with the document's lines, at another port and with a certificate of its own."""
    subprocess.run(
        shlex.split(
            "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 "
            f"-subj /CN={NAME} -keyout rig.key -out rig.pem"
        ),
        cwd=place,
        check=True,
        capture_output=True,
    )
    site = documented("nginx")
    for stated, here in (
        ("listen 443 ssl", f"listen 127.0.0.1:{port} ssl"),
        ("rig.lab", NAME),
        ("/etc/nginx/", f"{place}/"),
        ("127.0.0.1:8642", f"127.0.0.1:{desk_port}"),
    ):
        assert stated in site
        site = site.replace(stated, here)
    whole = place / "nginx.conf"
    whole.write_text(WHOLE.format(place=place, site=site), encoding="utf-8")
    process = subprocess.Popen([program, "-p", str(place), "-c", str(whole)], stderr=subprocess.PIPE)
    try:
        deadline_s = time.monotonic() + 30.0
        while True:
            assert process.poll() is None, process.communicate()[1].decode()
            try:
                socket.create_connection(("127.0.0.1", port), 1.0).close()
                break
            except OSError:
                assert time.monotonic() < deadline_s
                time.sleep(0.05)
        yield
    finally:
        process.terminate()
        process.communicate(timeout=30)


def upgraded(port: int, cookie: str, origin: str) -> int:
    """The status of a WebSocket's opening through the proxy."""
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with context.wrap_socket(socket.create_connection(("127.0.0.1", port), 10)) as line:
        line.sendall(
            "GET /_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1\r\n"
            f"Host: {NAME}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nOrigin: {origin}\r\n"
            f"Cookie: {cookie}\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
            "Sec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        return int(line.recv(100).split()[1])


def test_through_the_proxy_one_enters_by_password_acts_and_logs_out(
    desk_configuration: Callable[[str], Path], browser: HeadlessBrowser, tmp_path: Path
) -> None:
    program = nginx()
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    config = desk_configuration("")
    port, desk_port = free_port(), free_port()
    command = [sys.executable, "-m", "rig", "desk-password", "passwords.txt", "ada"]
    subprocess.run(
        command, input=f"{PASSWORD}\n", cwd=config.parent, check=True, text=True, capture_output=True
    )
    words = shlex.split(documented("text"))
    assert words[:3] == ["rig", "desk", "CONFIG"]
    own = f"https://{NAME}:{port}"
    words = [{"https://rig.lab": own, "8642": str(desk_port)}.get(word, word) for word in words]
    desk = DeskProcess(config, *words[3:])
    try:
        with proxy(program, tmp_path, port, desk_port), browser.another() as tab:
            page = Page(tab)
            page.browser.call("Security.enable")
            page.browser.call("Security.setIgnoreCertificateErrors", ignore=True)
            # the key is worth nothing from there
            page.browser.open(f"{own}/?{urllib.parse.urlsplit(desk.address).query}")
            page.wait("document.querySelector('[name=password]') !== null")
            for field, text in (("name", "ada"), ("password", PASSWORD)):
                page.ask(f"document.querySelector('[name={field}]').value = {text!r}")
            page.ask("document.querySelector('form').submit()")
            page.wait_text("you have acted since")
            page.wait("window.socket?.io?.engine?.transport?.name === 'websocket'")
            (cookie,) = [
                one for one in page.browser.call("Network.getCookies")["cookies"] if "rig_desk" in one["name"]
            ]
            assert (cookie["secure"], cookie["httpOnly"], cookie["sameSite"]) == (True, True, "Strict")
            sent = f"{cookie['name']}={cookie['value']}"
            assert upgraded(port, sent, own) == 101
            assert upgraded(port, sent, "https://evil.example") == 403
            assert upgraded(port, sent, f"http://127.0.0.1:{desk_port}") == 403
            page.ask("document.getElementById('light-off').click()")
            page.wait_text("LIGHT OFF was taken")
            page.click("Log out")
            page.wait("document.querySelector('[name=password]') !== null")
            assert upgraded(port, sent, own) == 403, "the cookie is worth nothing any more"
    finally:
        desk.end()
