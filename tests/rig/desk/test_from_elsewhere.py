"""From another machine: the lines of docs/desk-network.md are run; a browser enters by TLS and password."""

import re
import shlex
import shutil
import socket
import subprocess
import sys
import urllib.parse
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.rig.desk.desk_page import DeskProcess, Page
from tests.rig.view.headless_browser import HeadlessBrowser

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(240)]
DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "desk-network.md"
PASSWORDS = {"ada": "the long password", "guest": "another long one"}


def lines() -> list[list[str]]:
    """The words of each line that the document gives."""
    (block,) = re.findall(r"```text\n(openssl .*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    return [shlex.split(line) for line in block.splitlines()]


def own_address() -> str:
    """The address at which others reach this machine; skips without one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        try:
            # nothing is sent
            asked.connect(("192.0.2.1", 9))
            found = str(asked.getsockname()[0])
        except OSError:
            found = "127.0.0.1"
    if found.startswith("127."):
        pytest.skip("this machine has no address that others reach")
    return found


def test_a_tablet_enters_with_a_password_and_acts_or_watches(
    desk_configuration: Callable[[str], Path], browser: HeadlessBrowser
) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    config, address = desk_configuration(""), own_address()
    certificate, ada, guest, open_it = lines()
    subprocess.run(certificate, cwd=config.parent, check=True, capture_output=True, timeout=60)
    for words in (ada, guest):
        assert words[0] == "rig"
        subprocess.run(
            [sys.executable, "-m", *words],
            input=f"{PASSWORDS[words[3]]}\n",
            cwd=config.parent,
            check=True,
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert open_it[:3] == ["rig", "desk", "CONFIG"]
    desk = DeskProcess(config, *open_it[3:])
    try:
        parts = urllib.parse.urlsplit(desk.address)
        assert parts.scheme == "https"
        with browser.another() as tab:
            page = Page(tab)
            page.browser.call("Security.enable")
            page.browser.call("Security.setIgnoreCertificateErrors", ignore=True)
            for name, shown in (("guest", "read only"), ("ada", "you have acted since")):
                page.browser.call("Network.clearBrowserCookies")
                page.browser.open(f"https://{address}:{parts.port}/?{parts.query}")
                page.wait("document.querySelector('[name=password]') !== null")
                for field, text in (("name", name), ("password", PASSWORDS[name])):
                    page.ask(f"document.querySelector('[name={field}]').value = {text!r}")
                page.ask("document.querySelector('form').submit()")
                page.wait_text(shown)
            page.wait_text("Alarms: none")
            page.ask("document.getElementById('light-off').click()")
            page.wait_text("LIGHT OFF was taken")
    finally:
        desk.end()


def test_without_tls_or_passwords_no_other_interface_is_opened(
    desk_configuration: Callable[[str], Path],
) -> None:
    config = desk_configuration("")
    with pytest.raises(AssertionError, match="others could reach the laser: --certificate and --passwords"):
        DeskProcess(config, "--listen", "0.0.0.0")
