"""Identity of a record: SHA-256, camera and dates; and the lock of its writer."""

import contextlib
import datetime
import functools
import hashlib
import os
import stat
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from acquisition.camera import CameraInfo, ShutterKind
from processing.errors import RecordError
from processing.units import seconds

_BLOCK_BYTES = 1024 * 1024


@functools.lru_cache(maxsize=256)
def _cached_by_identity(path: Path, identity: tuple[int, ...]) -> str:
    return sha256_of(path)


def cached_sha256(path: Path) -> str:
    """SHA-256 of a file, or of a folder's sorted file names and hashes. Raises RecordError.

    It is remembered as long as device, inode, size and time of the file stay the same.
    """
    try:
        if path.is_dir():
            files = sorted(file for file in path.iterdir() if file.is_file())
            lines = [f"{cached_sha256(file)}  {file.name}\n" for file in files]
            return hashlib.sha256("".join(lines).encode()).hexdigest()
        state = path.stat()
    except (OSError, ValueError):
        return sha256_of(path)
    return _cached_by_identity(path.resolve(), (state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns))


def sha256_of(path: Path) -> str:
    """Hexadecimal SHA-256 of a file, read in pieces.

    Raises RecordError where any part cannot be read: the hash of a part would identify another file.
    """
    digest = hashlib.sha256()
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            # opening a pipe would wait for a writer
            raise RecordError(f"{path}: is not a file; a folder, pipe or device has no hash")
        with path.open("rb", buffering=0) as file:
            while block := file.read(_BLOCK_BYTES):
                digest.update(block)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RecordError(f"{str(path)!r}: is not the name of a file ({error})") from None
    return digest.hexdigest()


def camera_metadata(info: CameraInfo) -> dict[str, dict[str, str]]:
    """The section of the metadata that describes the camera."""
    names = ("driver", "vendor", "model", "serial", "width_px", "height_px", "full_scale_dn", "has_clock")
    return {"camera": {name: str(getattr(info, name)) for name in (*names, "shutter")}}


@dataclass(frozen=True, slots=True)
class RecordedCamera:
    """The camera as a record states it."""

    simulated: bool
    has_clock: bool | None
    """Whether the camera has a clock; None: not stated."""
    shutter: ShutterKind

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, Mapping[str, str]]) -> Self:
        """The camera from the metadata of any record."""
        camera = metadata.get("camera", {})
        return cls(
            camera.get("driver") == "simulated",
            {str(known): known for known in (True, False)}.get(camera.get("has_clock", "")),
            ShutterKind.of(camera.get("shutter", "")),
        )


def utc(time_ns: int) -> datetime.datetime:
    """Nanoseconds since 1970 as a date and time in UTC."""
    return datetime.datetime.fromtimestamp(seconds(time_ns), datetime.UTC)


def utc_text(time_ns: int) -> str:
    """UTC date and time to the millisecond, as text; an impossible (damaged) time as `N ns`."""
    try:
        moment = utc(time_ns)
    except (ValueError, OverflowError, OSError):
        return f"{time_ns} ns"
    return f"{moment:%Y-%m-%d %H:%M:%S}.{time_ns // 1_000_000 % 1000:03d} UTC"


fcntl: Any
try:
    import fcntl
except ImportError:
    # Windows has no such locks
    fcntl = None

_UNCHANGED_S = 30.0
"""Without locks, a file unchanged for so long counts as closed."""


def lock_for_writing(descriptor: int) -> None:
    """Lock an open file (its descriptor) until it is closed; does nothing where there are no locks."""
    if fcntl is not None:
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_being_written(path: Path) -> bool:
    """Whether a living process writes this file."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        if fcntl is not None:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
            return False
    except BlockingIOError:
        return True
    except OSError:
        pass
    finally:
        os.close(descriptor)
    return time.time() - path.stat().st_mtime < _UNCHANGED_S
