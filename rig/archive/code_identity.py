"""Which code made a result: version, commit, and a hash of the sources and of the libraries' versions."""

import functools
import hashlib
from pathlib import Path

from rig.instrument import versions

_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("rig", "acquisition", "calibration", "processing")
_LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless")


@functools.cache
def code_identity() -> str:
    """For example `0.1.0 (394556fc) 5f1c0e9d0a7b3c24`; equal where the same sources would run.

    The commit alone does not say it: a checkout may be changed, an installation has none.
    """
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for path in sorted((_ROOT / package).rglob("*.py")):
            digest.update(f"{path.relative_to(_ROOT).as_posix()}\0".encode() + path.read_bytes())
    known = versions()
    digest.update("".join(f"{name} {known[name]}\n" for name in _LIBRARIES).encode())
    return f"{known['optical-pendulum-rig']} ({known['commit'][:8]}) {digest.hexdigest()[:16]}"
