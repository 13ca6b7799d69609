"""What Windows lacks, or does otherwise, found where neither is at hand."""

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from acquisition import atomic_write

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("rig", "acquisition", "calibration", "processing")

WITHOUT_POSIX = """
import importlib, os, pkgutil, signal, sys
# the standard library and what is installed know their systems themselves
import asyncio, multiprocessing.connection, subprocess, tempfile
import cv2, matplotlib.pyplot, numba, rerun, scipy.optimize, serial, typer, usb.core
try:
    import nicegui
except ImportError:
    pass

for name in ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"):
    sys.modules[name] = None
for name in ("O_CLOEXEC", "O_DIRECTORY", "O_NOCTTY", "O_NOFOLLOW", "O_NONBLOCK", "fork", "geteuid", "getuid",
             "killpg", "nice", "openpty", "pread", "pwrite", "sched_getaffinity", "setsid", "uname"):
    vars(os).pop(name, None)
for name in ("SIGCHLD", "SIGHUP", "SIGKILL", "SIGPIPE", "SIGUSR1", "SIGUSR2", "pthread_kill", "setitimer"):
    vars(signal).pop(name, None)

# what only Linux has is loaded where it is opened; the firmware runs on the board
ELSEWHERE = ("acquisition.cameras.v4l2.linux", "acquisition.cameras.aravis", "rig.control.firmware")
for package in sys.argv[1:]:
    root = importlib.import_module(package)
    for module in pkgutil.walk_packages(root.__path__, f"{package}."):
        if not module.name.startswith(ELSEWHERE) and not module.name.endswith("__main__"):
            try:
                importlib.import_module(module.name)
            except ImportError as error:
                # an extra that is not installed
                if sys.modules.get(error.name or "", 0) is None:
                    raise

from acquisition.cameras.drivers import find_cameras
sys.platform = "win32"
print(*find_cameras()[1], sep="\\n")
"""


def test_every_module_is_there_without_what_only_posix_has() -> None:
    """And so is the search for cameras, which `rig doctor` and `rig init` begin with."""
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_POSIX, *PACKAGES],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "there are such cameras on Linux only" in done.stdout


def test_text_has_the_same_encoding_on_every_system() -> None:
    """Windows would take the one of the country, and a log of an operator's name could not be read again."""
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        # runs on the controller
        if "firmware" not in path.parts
        for source in [path.read_text(encoding="utf-8")]
        # a tree of each file takes seconds
        if re.search(r"open\(|_text\(|run\(|Popen\(|check_output\(", source)
        for line in _unstated(ast.parse(source))
    ]
    assert not found


def _unstated(tree: ast.AST) -> Iterator[int]:
    """Lines with a call that reads or writes text and leaves the encoding to the system."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        stated = {key.arg: key.value for key in node.keywords}
        if "encoding" in stated:
            continue
        owner = node.func.value if isinstance(node.func, ast.Attribute) else None
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        mode = stated.get("mode")
        if (name, owner) == ("open", None) or name == "fdopen":
            mode = node.args[1] if len(node.args) > 1 else mode
        elif name == "open" and node.args:
            mode = node.args[0]
        of_text = (
            isinstance(mode, ast.Constant)
            and isinstance(mode.value, str)
            and set(mode.value) <= set("rwxat+")
        )
        if (
            (name == "read_text" and not node.args)
            or name == "write_text"
            or ((name, owner) == ("open", None) and (mode is None or of_text))
            or (name in ("open", "fdopen") and of_text)
            or (name in ("run", "Popen", "check_output") and "text" in stated)
        ):
            yield node.lineno


def test_what_implies_an_encoding_is_found() -> None:
    lines = [
        "path.read_text()", "open(path)", "open(path, 'w')", "path.open('a')", "os.fdopen(1, 'w')",
        "run(words, text=True)", "path.read_text(encoding='utf-8')", "path.read_text('utf-8')",
        "open(path, 'rb')", "path.open('xb')", "camera.open()", "archive.open(name)",
    ]  # fmt: skip
    assert list(_unstated(ast.parse("\n".join(lines)))) == [1, 2, 3, 4, 5, 6]


def test_a_full_disk_leaves_nothing_where_no_open_file_can_be_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real_unlink = Path.unlink
    refused: list[Path] = []

    def unlink(path: Path, missing_ok: bool = False) -> None:
        if any(number.exists() and number.samefile(path) for number in Path("/proc/self/fd").iterdir()):
            refused.append(path)
            raise PermissionError(13, "is used by another process", str(path))
        real_unlink(path, missing_ok)

    def full(number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    monkeypatch.setattr(Path, "unlink", unlink)
    with pytest.raises(OSError, match="No space left"):
        atomic_write.replace(tmp_path / "file", b"data")
    assert not refused
    assert not list(tmp_path.iterdir())
