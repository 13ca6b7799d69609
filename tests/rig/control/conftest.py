"""Fixtures of the controller's tests: the interpreter, the board, settings for it."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rig.control.settings import ControllerSettings
from tests.rig.control.stepped import Clock, stepped_clock
from tests.rig.control.wires import FirmwareBoard

PACKAGE = "@micropython/micropython-webassembly-pyscript"
VERSION = "1.27.0"


@pytest.fixture(scope="session")
def micropython(request: pytest.FixtureRequest) -> Path:
    """Folder of the MicroPython interpreter for node, installed by npm once into pytest's cache."""
    assert request.config.cache is not None
    found = interpreter(Path(request.config.cache.mkdir("micropython")))
    if isinstance(found, str):
        pytest.skip(found)
    return found


def interpreter(place: Path) -> Path | str:
    """The package of the interpreter in a folder of its version below `place`, or why there is none."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        return "node and npm run the MicroPython interpreter; install them to test the firmware"
    folder = place / VERSION
    package = folder / "node_modules" / PACKAGE
    if not (package / "micropython.mjs").is_file():
        done = subprocess.run(
            ["npm", "install", "--no-audit", "--no-fund", "--prefix", str(folder), f"{PACKAGE}@{VERSION}"],
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        if done.returncode:
            return f"npm could not install {PACKAGE}: {done.stderr.strip().splitlines()[-1:]}"
    return package


@contextmanager
def micropython_boards(package: Path, folder: Path) -> Iterator[Callable[..., FirmwareBoard]]:
    """Starts boards and ends them all."""
    boards: list[FirmwareBoard] = []

    def make(through_wire: bool = False) -> FirmwareBoard:
        own = folder / f"board{len(boards)}"
        own.mkdir()
        boards.append(FirmwareBoard(package, own, through_wire))
        return boards[-1]

    yield make
    for board in boards:
        board.close()


@pytest.fixture
def make_board(micropython: Path, tmp_path: Path) -> Iterator[Callable[..., FirmwareBoard]]:
    """Starts boards and ends them with the test."""
    with micropython_boards(micropython, tmp_path) as make:
        yield make


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The clock of all that the host does with lines, which goes on only while somebody waits."""
    return stepped_clock(monkeypatch)


@pytest.fixture
def board(make_board: Callable[..., FirmwareBoard]) -> FirmwareBoard:
    """A board on a clean wire."""
    return make_board()


def settings_for(port: str, **changes: object) -> ControllerSettings:
    """Settings as a user would state them, patient enough for a busy test machine."""
    values: dict[str, object] = {
        "kind": "serial",
        "port": port,
        "timeout_s": 0.5,
        "watchdog_s": 2.5,
        **changes,
    }
    return ControllerSettings.model_validate(values)
