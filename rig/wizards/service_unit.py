"""`rig service`: systemd units for a desk and for nights without a terminal, as a user's own services."""

import os
import sys
from pathlib import Path
from typing import Literal

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError

Service = Literal["desk", "night"]
_STOP_S = 90
"""A disk or a processing that hangs is abandoned after 60 s; systemd kills only later."""
_NAMES: dict[Service, str] = {"desk": "rig-desk.service", "night": "rig-night@.service"}

_DESK = """\
# Written by rig service desk: the page is at the port; see rig desk --help for who may enter.
[Unit]
Description=Operator's desk of the optical pendulum rig: {title}

[Service]
Type=exec
ExecStart={python} -m rig desk {file} --no-browser --port {port}
WorkingDirectory={folder}
# a session goes on when its desk ends, and the next desk shows it again
KillMode=process
TimeoutStopSec={stop_s}
Restart=on-failure
RestartSec=5
NoNewPrivileges=yes

[Install]
WantedBy=default.target
"""
_NIGHT = """\
# Written by rig service night: a person starts it, systemctl --user start rig-night@NAME, and finds
# runs/NAME. No timer, no Restart: nothing lights the laser unless somebody has just asked for it.
[Unit]
Description=Night %i of the optical pendulum rig: {title}

[Service]
Type=exec
ExecStart={python} -m rig run --plan {file} -o "{escaped_folder}/runs/%i"
WorkingDirectory={folder}
# first asked to end, by which the record is closed and the laser dark
KillMode=mixed
TimeoutStopSec={stop_s}
NoNewPrivileges=yes
"""


def units_folder() -> Path:
    """Where systemd looks for a user's own units."""
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "systemd" / "user"


def service_unit(service: Service, file: Path, port: int) -> str:
    """The text of a unit that runs this Python, on a configuration or a plan, in the present folder."""
    here = Path.cwd()
    words = {
        "title": _in_unit(file.name),
        "python": _quoted(sys.executable),
        "file": _quoted(str(file.absolute())),
        "folder": _in_unit(str(here)),
        "escaped_folder": _escaped(str(here)),
        "port": port,
        "stop_s": _STOP_S,
    }
    return (_DESK if service == "desk" else _NIGHT).format(**words)


def write_unit(service: Service, file: Path, folder: Path, port: int) -> Path:
    """Write a unit; one that says the same stays.

    Raises
    ------
    ConfigurationError
        Another one of this name is there.
    RecordError
        It cannot be written.
    """
    path = folder / _NAMES[service]
    text = service_unit(service, file, port)
    try:
        if path.exists():
            if path.read_text(encoding="utf-8") == text:
                return path
            raise ConfigurationError(f"{path}: another one exists and is not overwritten; remove it first")
        folder.mkdir(parents=True, exist_ok=True)
        whole_file.write_new(path, text.encode())
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None
    return path


def _in_unit(text: str) -> str:
    """A value that systemd takes as it stands, without words."""
    return text.replace("%", "%%")


def _escaped(text: str) -> str:
    """What stands between quotes in a command of a unit."""
    return _in_unit(text).replace("\\", "\\\\").replace('"', '\\"').replace("$", "$$")


def _quoted(text: str) -> str:
    return f'"{_escaped(text)}"'
