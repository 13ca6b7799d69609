"""`rig archive blind` and `unblind`: hidden offsets on what the archive shows, until the analysis is frozen.

What is sealed and when it was opened are files of `blind/`, each written once. The key that the offsets are
drawn with lies elsewhere, readable by its owner alone; where it is not, what is hidden is not shown at all.
What is added or fitted from then on is stored encrypted for that key, here and in the folders that are blind.
"""

import datetime
import hashlib
import hmac
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError
from rig.archive.proved import has_line, read_file, sha256_hex, with_line, without_line
from rig.archive.remarks import user_name
from rig.presentation import say
from rig.sealing import (
    check_folder,
    check_installed,
    key_path,
    new_key,
    open_folder,
    public_key,
    seal_folder,
    stored_key,
)

_FOLDER = "blind"
_REACH = 3.0
"""Offsets reach to so many times the scatter of a column."""
_LARGEST_FACTOR = 2.0
"""Of a column that had no value when it was sealed: it is multiplied by this at most, or divided."""


class Hidden(NamedTuple):
    """How a value of one rig is hidden: it is multiplied, and moved."""

    factor: float
    offset: float


class Seal(NamedTuple):
    """What is hidden: the scale of the offset by column, None of those that had no value when it was made.

    `key` is what the offsets are drawn with; None where it is not here. `public_key` seals what is stored;
    empty in seals of earlier versions, which hid only what was shown.
    """

    path: Path
    key: bytes | None
    scales: Mapping[str, float | None]
    public_key: str = ""

    def hidden(self, column: str, host: str) -> Hidden:
        """How a column of the runs of one rig is hidden, always the same. Raises ValueError without key."""
        if self.key is None:
            raise ValueError("the key is not here")
        drawn = hmac.digest(self.key, f"{column}\0{host}".encode(), "sha256")
        share = 2 * int.from_bytes(drawn[:8]) / 2**64 - 1
        scale = self.scales[column]
        if scale is None:
            return Hidden(math.exp(share * math.log(_LARGEST_FACTOR)), 0.0)
        return Hidden(1.0, scale * _REACH * share)


def sealed(archive: Path) -> Seal | None:
    """What is hidden now. Raises RecordError for a file that cannot be read, or a key that is another one."""
    folder = archive / _FOLDER
    for path in sorted(folder.glob("[!.]*.sealed.json")):
        if not _opened(path).exists():
            tree = _tree(path)
            try:
                scales = {
                    str(name): None if scale is None else float(scale)
                    for name, scale in tree["scales"].items()
                }
                if "secret" in tree:
                    # of an earlier version, which kept it in the seal
                    return Seal(path, bytes.fromhex(tree["secret"]), scales)
                public = str(tree.get("public_key", ""))
                return Seal(path, stored_key(str(tree["key_sha256"])), scales, public)
            except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
                raise RecordError(f"{path}: cannot be read: {error!r}; take it from a backup") from None
    return None


def opened_keys(archive: Path) -> list[bytes]:
    """Keys of seals that were opened. Raises RecordError for a file that cannot be read."""
    found = []
    for path in sorted((archive / _FOLDER).glob("[!.]*.opened.json")):
        tree = _tree(path)
        try:
            found += [bytes.fromhex(tree["key"])] if "key" in tree else []
        except (ValueError, TypeError) as error:
            raise RecordError(f"{path}: cannot be read: {error!r}; take it from a backup") from None
    return found


def seal(archive: Path, scales: Mapping[str, float | None], folders: Sequence[Path] = ()) -> str:
    """Hide columns, and seal folders before; returns a line with the hash that proves later what was sealed.

    Folders come first: killed in between, they are blind and the archive is not, and the next one goes on
    with the same key, which the archive names before anything is sealed.

    Raises ConfigurationError where something is hidden already, or a folder is blind for another key.
    """
    if sealed(archive) is not None:
        raise ConfigurationError(f"{archive}: is blind already; rig archive unblind comes first")
    check_installed()
    begun = _begun(archive)
    if begun:
        key = stored_key(begun[0]["key_sha256"])
        if key is None:
            raise ConfigurationError(
                f"{archive}: was begun to be blinded with a key that is not here; put it to "
                f"{key_path(begun[0]['key_sha256'])}, or let its owner do it"
            )
    else:
        for folder in folders:
            check_folder(folder.resolve(), "")
        key = new_key()
    earlier = [Path(said["folder"]) for said in begun if said["public_key"] == public_key(key)]
    wanted = dict.fromkeys([*filter(Path.is_dir, earlier), *(folder.resolve() for folder in folders)])
    lines = [
        _seal_folder(archive, folder, key_sha256=sha256_hex(key), public=public_key(key)) for folder in wanted
    ]
    data = _said(key_sha256=sha256_hex(key), public_key=public_key(key), scales=dict(scales))
    _write(archive / _FOLDER / f"{_now()}.sealed.json", data)
    told = (
        f"{', '.join(scales)} hidden; SHA-256 of the seal: {hashlib.sha256(data).hexdigest()}; the key is "
        f"{key_path(sha256_hex(key))}"
    )
    return "\n".join([told, *lines])


def seal_folders(archive: Path, folders: Sequence[Path]) -> str:
    """Seal what is found of records in and below folders, for the key of the archive; a line for each.

    Raises ConfigurationError where a folder is blind for another key, or the archive's seal is too old.
    """
    found = sealed(archive)
    if found is None or not found.public_key:
        raise ConfigurationError(f"{archive}: has no seal with a key for folders; unblind it, then blind")
    key_sha256 = _tree(found.path)["key_sha256"]
    return "\n".join(
        _seal_folder(archive, folder.resolve(), key_sha256=key_sha256, public=found.public_key)
        for folder in folders
    )


def _seal_folder(archive: Path, folder: Path, *, key_sha256: str, public: str) -> str:
    check_folder(folder, public)
    # first, so that no folder is blind of which the archive does not know that it must be opened
    if folder not in _folders(archive, public):
        said = _said(folder=str(folder), public_key=public, key_sha256=key_sha256)
        _write(archive / _FOLDER / f"{_now()}.folder.json", said)
    # what a command left that was killed when its seal had its name
    whole_file.take_away_leftovers(folder)
    seal_folder(folder, public)
    return f"{folder}: blind: fits of the records in it are sealed"


def _folders(archive: Path, public: str) -> list[Path]:
    """Folders that are sealed for a key, or were to be when the command was killed."""
    return [Path(said["folder"]) for said in _said_of_folders(archive) if said["public_key"] == public]


def _begun(archive: Path) -> list[dict[str, str]]:
    """What was said of folders by a command that was killed before it sealed the archive."""
    known = {_tree(path).get("public_key") for path in (archive / _FOLDER).glob("[!.]*.sealed.json")}
    return [said for said in _said_of_folders(archive) if said["public_key"] not in known]


def _said_of_folders(archive: Path) -> list[dict[str, str]]:
    return [_tree(path) for path in sorted((archive / _FOLDER).glob("[!.]*.folder.json"))]


def _tree(path: Path) -> dict[str, Any]:
    """What a file says. Raises RecordError where it is not as it was written."""
    data = read_file(path)
    try:
        tree = json.loads(without_line(path, data) if has_line(data) else data)
        return dict(tree)
    except (ValueError, TypeError) as error:
        raise RecordError(f"{path}: cannot be read: {error!r}; take it from a backup") from None


def unseal(archive: Path, frozen: str) -> str:
    """Show true values again, and keep who asked for it, when, and what he said was frozen.

    It cannot be undone: the key lies in the archive and in its blind folders from then on.

    Raises ConfigurationError where nothing is hidden, nothing was said, or the key is not here.
    """
    found = sealed(archive)
    if found is None and _begun(archive):
        raise ConfigurationError(
            f"{archive}: blinding was begun and not finished; rig archive blind completes it"
        )
    if found is None:
        raise ConfigurationError(f"{archive}: is not blind")
    if not frozen.strip():
        raise ConfigurationError("say which analysis is frozen: rig archive unblind 'commit, cuts, law'")
    said = {"frozen": frozen.strip(), "seal_sha256": hashlib.sha256(found.path.read_bytes()).hexdigest()}
    if found.public_key:
        if found.key is None:
            raise ConfigurationError(
                f"{archive}: the key is not here; put it to {_stated_key_path(found)}, or let its owner do it"
            )
        for folder in _folders(archive, found.public_key):
            if folder.is_dir():
                open_folder(folder, found.key, frozen.strip(), user_name())
            else:
                say(f"{folder}: is not here and stays blind; blind.opened.json of another one opens it")
        said["key"] = found.key.hex()
    # last: where it is killed before, the archive is blind and is opened again
    _write(_opened(found.path), _said(**said))
    return f"{', '.join(found.scales)} shown again; recorded in {_opened(found.path)}"


def _stated_key_path(found: Seal) -> Path:
    return key_path(_tree(found.path)["key_sha256"])


def _now() -> str:
    return f"{datetime.datetime.now(datetime.UTC):%Y%m%dT%H%M%S.%f}"


def _opened(path: Path) -> Path:
    return path.with_name(path.name.replace(".sealed.", ".opened."))


def _said(**what: Any) -> bytes:
    now = datetime.datetime.now(datetime.UTC).isoformat()
    return with_line(json.dumps({"utc": now, "user": user_name(), **what}, indent=1).encode())


def _write(path: Path, data: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        whole_file.take_away_leftovers(path.parent)
        whole_file.write_new(path, data)
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None
