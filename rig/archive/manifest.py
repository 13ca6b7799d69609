"""`archive.json`: which archive a folder or a bucket holds, and that it is one."""

import contextlib
import json
import secrets
from pathlib import Path

from acquisition.record import whole_file
from processing.errors import RecordError
from rig.archive.proved import read_file, with_line, without_line

MANIFEST = "archive.json"
_SCHEMA = 2
"""1 had no such file and no facts."""


def write_manifest(folder: Path) -> None:
    """Say that a folder is an archive, which it is from then on; one that is one already stays as it is."""
    path = folder / MANIFEST
    text = json.dumps({"schema": _SCHEMA, "id": secrets.token_hex(16)}).encode()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):
            whole_file.write_new(path, with_line(text))
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None


def identity(folder: Path) -> str:
    """Which archive a folder holds; empty of earlier versions of the program, and where there is none.

    Raises RecordError where the file is damaged, or of a newer version.
    """
    path = folder / MANIFEST
    return identity_in(path, read_file(path)) if path.exists() else ""


def identity_in(path: Path, data: bytes) -> str:
    """The same of the content of such a file."""
    try:
        tree = json.loads(without_line(path, data))
        schema, known = int(tree["schema"]), str(tree["id"])
    except (ValueError, KeyError, TypeError) as error:
        raise RecordError(f"{path}: cannot be understood ({error!r}); take it from a backup") from None
    if schema > _SCHEMA:
        raise RecordError(f"{path}: has schema {schema}; update optical-pendulum-rig")
    return known
