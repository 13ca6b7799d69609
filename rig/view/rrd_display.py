"""Shows Rerun files in a window, or as a web page on this machine."""

import secrets
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from processing.errors import ConfigurationError
from rig.rerun import (
    display_missing,
    free_port,
    hidden_loopback,
    name_stream,
    page_address,
    start_page_server,
    start_program,
)


def show_rrd(paths: Sequence[Path], mode: Literal["spawn", "web"]) -> None:
    """Show the files until the window is closed or Ctrl-C is pressed.

    Raises
    ------
    ConfigurationError
        No display is available for a window.
    """
    files = [str(path) for path in paths]
    if mode == "spawn":
        if missing := display_missing():
            raise ConfigurationError(missing)
        _wait_for(start_program("--port", str(free_port(0)), "--hide-welcome-screen", *files))
        return
    host, key = hidden_loopback(), secrets.token_urlsafe(16)
    port, web_port = free_port(9876, host), free_port(9090)
    server = start_program("--serve-grpc", "--port", str(port), *files, host=host)
    page = start_page_server(web_port, key)
    try:
        name_stream(page, f"rerun+http://{host}:{port}/proxy")
        print(f"the view is at {page_address(web_port, key)} (Ctrl-C ends it)", flush=True)
        _wait_for(server)
    finally:
        page.kill()
        page.communicate()


def _wait_for(program: subprocess.Popen[bytes]) -> None:
    """Wait until the program ends, or end it after Ctrl-C."""
    try:
        program.wait()
    except KeyboardInterrupt:
        pass
    finally:
        program.kill()
        program.wait()
