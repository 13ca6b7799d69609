"""What Windows lacks, or does otherwise, found where neither is at hand."""

import os
import subprocess
import sys
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
ELSEWHERE = ("acquisition.cameras.aravis", "rig.control.firmware")
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
