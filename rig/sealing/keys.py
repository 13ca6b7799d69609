"""Keys of what is sealed: a file each, readable by its owner alone, in no archive and no session's folder."""

import hashlib
import os
import secrets
from pathlib import Path

from acquisition.record import whole_file
from processing.errors import RecordError


def new_key() -> bytes:
    """A key that was never used, kept in the folder of keys. Raises RecordError where it cannot be."""
    key = secrets.token_bytes(32)
    path = key_path(hashlib.sha256(key).hexdigest())
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        whole_file.write_new(path, key.hex().encode(), mode=0o600)
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None
    return key


def stored_key(sha256: str) -> bytes | None:
    """The key of this hash; None where it is not here. Raises RecordError for another one under its name."""
    path = key_path(sha256)
    try:
        key = bytes.fromhex(path.read_text(encoding="ascii"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise RecordError(f"{path}: cannot be read: {error}") from None
    if hashlib.sha256(key).hexdigest() != sha256:
        raise RecordError(f"{path}: is not the key that the archive was sealed with; take it from a backup")
    return key


def key_path(sha256: str) -> Path:
    """Where the key of this hash lies."""
    stated = os.environ.get("XDG_DATA_HOME") or os.environ.get("LOCALAPPDATA")
    data = Path(stated) if stated else Path.home() / ".local" / "share"
    return data / "optical-pendulum-rig" / "keys" / f"{sha256[:32]}.key"
