"""Starts the program that shows a live stream or Rerun files: a window, or a web page."""

import secrets
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

from processing.errors import ConfigurationError
from rig.rerun import (
    LOOPBACK,
    Mode,
    ShowMode,
    display_missing,
    free_port,
    hidden_loopback,
    name_stream,
    open_window,
    page_address,
    start_page_server,
    start_program,
)


class ViewerProgram:
    """The program is started once, when the address of the stream is known.

    `note` is called with messages to the user. When a worker is replaced, an open window connects to
    the new stream; a web page has to be reloaded.
    """

    def __init__(self, mode: Mode, web_port: int, note: Callable[[str], None]) -> None:
        self._mode = mode
        self._web_port = web_port
        self._note = note
        self._process: subprocess.Popen[bytes] | None = None
        self._window_port = 0

    @property
    def pids(self) -> tuple[int, ...]:
        """Its process number, if it was started."""
        return (self._process.pid,) if self._process is not None else ()

    def show(self, url: str) -> str:
        """Show the stream at this address; returns the window's address for commands, empty for a page."""
        if self._process is None:
            try:
                if self._mode == "web":
                    port, key = free_port(self._web_port), secrets.token_urlsafe(16)
                    self._process = start_page_server(port, key)
                    name_stream(self._process, url)
                    self._note(f"live view: {page_address(port, key)}")
                elif missing := display_missing():
                    self._note(missing)
                else:
                    self._window_port = free_port(0)
                    self._process = open_window(url, self._window_port)
            except (OSError, subprocess.SubprocessError) as error:
                self._note(f"the viewer's program could not be started: {error}")
        elif self._mode == "web":
            name_stream(self._process, url)
            self._note("the live view was restarted: reload the page")
        return f"rerun+http://{LOOPBACK}:{self._window_port}/proxy" if self._window_port else ""

    def close(self) -> None:
        """End the web server of the page; a window stays open until the user closes it."""
        if self._process is not None and self._mode == "web":
            self._process.kill()
            self._process.communicate()


def show_rrd(paths: Sequence[Path], mode: ShowMode) -> None:
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
