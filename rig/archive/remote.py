"""An archive that lies elsewhere (`s3://bucket/name`): a copy of its files here, and what is new sent there.

All files of an archive are written once, whole, and never changed, so that names alone tell what is missing
on which side; each is proved when it is brought or sent. What follows from nothing else is never taken away
here because it is gone there, and a place where the archive is gone is refused. Commands read and write the
copy, as they would an archive on a disk; it lies in the user's cache, and a command that was killed leaves in
it what the next one sends.
"""

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path

from acquisition.record import whole_file
from processing.errors import ConfigurationError
from rig.archive.bucket import Bucket
from rig.archive.copied import Copy, fetch
from rig.archive.sending import send


def is_remote(archive: str) -> bool:
    """Whether an archive is named by a URL and not by a path."""
    return re.match(r"[a-z][a-z0-9+]+://", archive) is not None


@contextlib.contextmanager
def opened(archive: str, *, believed: bool = True) -> Iterator[Path]:
    """The folder of an archive named by a path, or a copy of one named by a URL of fsspec.

    What is new in the copy is sent when it is left, also after an error. What is not `believed` is left as it
    is on both sides, for who compares them. Raises ConfigurationError without
    the packages that reach it, RecordError where it cannot be reached.
    """
    if not is_remote(archive):
        yield Path(archive)
        return
    copy = Copy(archive)
    if not believed:
        yield copy.folder
        return
    fetch(copy)
    try:
        yield copy.folder
    except ConfigurationError as error:
        # the copy is not what was asked for, and nothing is to be added to it
        raise ConfigurationError(str(error).replace(str(copy.folder), archive)) from None
    finally:
        send(copy)


def brought(archive: str) -> Path:
    """The folder in which an archive can be read: its own, or the copy, once what is new there is fetched.

    Sends nothing, for who only looks. Raises as `opened` does.
    """
    if not is_remote(archive):
        return Path(archive)
    copy = Copy(archive)
    fetch(copy)
    return copy.folder


def write_new(archive: str, name: str, data: bytes) -> None:
    """Write one file of a remote archive, whole or not at all; one that is there already stays as it is."""
    Bucket(archive).create(name, data)


def restored(archive: str, *, repair: bool) -> dict[str, tuple[str, bool]]:
    """Compare a remote archive with the copy of it: a line for each file that is not sound on both sides.

    With `repair` the sound one takes the place of the other; the line's second part says whether it did.
    """
    copy, found = Copy(archive), dict[str, tuple[str, bool]]()
    for name in sorted(copy.bucket.names() | copy.names()):
        here, there = copy.sound(name), copy.sound_there(name)
        if here is not None and there is not None:
            if here != there:
                # both are as they were written: which of them holds nobody knows here
                found[name] = f"{archive}/{name}: is another one there than here, {copy.folder}", False
            continue
        side = "here" if here is None else "there"
        mended = repair and (here is not None or there is not None)
        if mended and here is None and there is not None:
            whole_file.replace(copy.folder / name, there)
        elif mended and here is not None:
            copy.bucket.overwrite(name, here)
        found[name] = f"{archive}/{name}: is damaged or missing {side}", mended
    return found
