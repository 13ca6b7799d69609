"""Folders that are blind: `blind.json` seals what is found of all records in and below its folder."""

import datetime
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError

SEAL_NAME = "blind.json"
OPENED_NAME = "blind.opened.json"
"""Beside the seal, once it is opened: the key, and who asked for it."""


@dataclass(frozen=True)
class FolderSeal:
    """A blind folder: `public_key` seals values, and `key` reads them once it was opened."""

    folder: Path
    public_key: str
    key: bytes | None

    @property
    def is_blind(self) -> bool:
        """Whether it was not opened."""
        return self.key is None


def seal_over(path: Path) -> FolderSeal | None:
    """The seal of the nearest folder above a path, or of itself, that has one.

    Raises RecordError for a seal that cannot be read: a folder that was blind is never taken for an open one.
    """
    place = path.resolve()
    for folder in (place, *place.parents):
        seal = folder / SEAL_NAME
        try:
            data = seal.read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            raise RecordError(f"{seal}: cannot be read: {error.strerror or error}") from None
        try:
            tree = json.loads(data)
            public, digest = str(tree["public_key"]), str(tree["public_key_sha256"])
            if hashlib.sha256(public.encode()).hexdigest() != digest:
                raise ValueError("its key is not the one that was written")
        except (ValueError, KeyError, TypeError) as error:
            raise RecordError(f"{seal}: cannot be read: {error!r}; take it from a backup") from None
        return FolderSeal(folder, public, _opened_key(folder, public))
    return None


def _opened_key(folder: Path, public: str) -> bytes | None:
    # what is not sealed must not wait for the library that seals
    from rig.sealing.envelopes import public_key

    path = folder / OPENED_NAME
    try:
        key = bytes.fromhex(json.loads(path.read_bytes())["key"])
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RecordError(f"{path}: cannot be read: {error!r}; take it from a backup") from None
    if public_key(key) != public:
        raise RecordError(f"{path}: holds the key of another seal")
    return key


def check_folder(folder: Path, public_key: str) -> None:
    """Raise ConfigurationError where a folder cannot be sealed for a key: it has another, or was opened."""
    found = seal_over(folder)
    if found is not None and found.is_blind and found.public_key != public_key:
        raise ConfigurationError(f"{folder}: is blind already, by {found.folder / SEAL_NAME}")
    if (folder / SEAL_NAME).exists() and found is not None and not found.is_blind:
        raise ConfigurationError(
            f"{folder / SEAL_NAME}: was opened; a folder is sealed once, take another one for new sessions"
        )


def seal_folder(folder: Path, public_key: str) -> None:
    """Make a folder blind; one that is for this key stays as it is. Raises as `check_folder`."""
    check_folder(folder, public_key)
    if not is_blind(folder):
        digest = hashlib.sha256(public_key.encode()).hexdigest()
        _write(folder / SEAL_NAME, {"public_key": public_key, "public_key_sha256": digest})


def open_folder(folder: Path, key: bytes, frozen: str, user: str) -> None:
    """Open a folder for good: the key lies beside its seal, with who asked and what was frozen.

    One that has no seal of its own, because its sealing was killed or it lies in another, stays as it is.
    """
    if (folder / SEAL_NAME).exists() and not (folder / OPENED_NAME).exists():
        _write(folder / OPENED_NAME, {"key": key.hex(), "frozen": frozen, "user": user})


def is_blind(path: Path) -> bool:
    """Whether something lies in a folder that is blind."""
    found = seal_over(path)
    return found is not None and found.is_blind


def refuse_blind(path: Path, what: str) -> None:
    """Raise ConfigurationError where something lies in a blind folder; `what` would tell its values."""
    found = seal_over(path)
    if found is not None and found.is_blind:
        raise ConfigurationError(
            f"{path}: is blind ({found.folder / SEAL_NAME}), and {what} tells what is sealed; "
            "rig archive unblind comes first"
        )


def _write(path: Path, said: dict[str, str]) -> None:
    now = datetime.datetime.now(datetime.UTC).isoformat()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        whole_file.take_away_leftovers(path.parent, path.name)
        whole_file.write_new(path, f"{json.dumps({'utc': now, **said}, indent=1)}\n".encode())
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None
