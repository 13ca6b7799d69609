"""A network namespace for libaravis and its fake camera, with the loopback interface only."""

import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[4]
SYSTEM_PACKAGES = Path("/usr/lib/python3/dist-packages")
FAKE_CAMERA = "arv-fake-gv-camera-0.8"


class Missing(Exception):
    """What the machine lacks, in words."""


def camera_program() -> str:
    """Path of Aravis's fake camera."""
    found = shutil.which(FAKE_CAMERA)
    if found is None:
        raise Missing(f"{FAKE_CAMERA} is not installed (Debian: apt install aravis-tools)")
    return found


def python_path(folder: Path) -> str:
    """A PYTHONPATH with PyGObject on it, and nothing else of the system's packages.

    PyGObject is rarely in a virtual environment; the system's is linked to from `folder` where it
    was made for this Python.
    """
    if importlib.util.find_spec("gi") is not None:
        return ""
    system = SYSTEM_PACKAGES / "gi"
    suffix = sysconfig.get_config_var("EXT_SUFFIX")
    if not (system / f"_gi{suffix}").is_file():
        raise Missing(f"no PyGObject for this Python ({suffix}) in {SYSTEM_PACKAGES}: apt install python3-gi")
    folder.mkdir()
    (folder / "gi").symlink_to(system)
    return str(folder)


def command() -> list[str]:
    """What begins a command in a network of its own, as root or, where the system allows it, without."""
    if not shutil.which("unshare") or not shutil.which("ip"):
        raise Missing("unshare or ip is not installed (Debian: apt install util-linux iproute2)")
    said = ""
    for options in (["--net"], ["--map-root-user", "--net"]):
        begin = ["unshare", *options, "sh", "-c", 'ip link set lo up && exec "$@"', "sh"]
        tried = subprocess.run([*begin, "true"], capture_output=True, text=True, check=False)
        if tried.returncode == 0:
            return begin
        said = tried.stderr.strip()
    raise Missing(f"no network namespace can be made here: {said}")


def run_alone(arguments: list[str], folder: Path, timeout_s: float) -> subprocess.CompletedProcess[str]:
    """Run this Python with these arguments, PyGObject at hand, in a network of its own.

    Raises
    ------
    Missing
        Something is not installed or not allowed.
    """
    camera_program()
    paths = [python_path(folder / "system"), str(PROJECT)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    check = "import gi; gi.require_version('Aravis', '0.8'); from gi.repository import Aravis"
    begin = command()
    tried = subprocess.run(
        [sys.executable, "-c", check], env=environment, capture_output=True, text=True, check=False
    )
    if tried.returncode:
        words = (tried.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise Missing(f"libaravis can't be loaded (Debian: apt install gir1.2-aravis-0.8): {words}")
    return subprocess.run(
        [*begin, sys.executable, *arguments],
        env=environment,
        cwd=PROJECT,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )
