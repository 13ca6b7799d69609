"""`rig archive blind` and `unblind`: hidden offsets on what the archive shows, until the analysis is frozen.

What is sealed and when it was opened are files of `blind/`, each written once. The key that the offsets are
drawn with lies elsewhere, readable by its owner alone; where it is not, what is hidden is not shown at all.
"""

import datetime
import hashlib
import hmac
import json
import math
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError
from rig.archive.proved import has_line, read_file, sha256_hex, with_line, without_line
from rig.archive.remarks import user_name

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

    `key` is what the offsets are drawn with; None where it is not here.
    """

    path: Path
    key: bytes | None
    scales: Mapping[str, float | None]

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
            data = read_file(path)
            try:
                tree = json.loads(without_line(path, data) if has_line(data) else data)
                scales = {
                    str(name): None if scale is None else float(scale)
                    for name, scale in tree["scales"].items()
                }
                if "secret" in tree:
                    # of an earlier version, which kept it in the seal
                    return Seal(path, bytes.fromhex(tree["secret"]), scales)
                return Seal(path, _key(str(tree["key_sha256"])), scales)
            except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
                raise RecordError(f"{path}: cannot be read: {error!r}; take it from a backup") from None
    return None


def seal(archive: Path, scales: Mapping[str, float | None]) -> str:
    """Hide columns; returns a line with the hash that proves later that nothing was exchanged.

    Raises ConfigurationError where something is hidden already.
    """
    if sealed(archive) is not None:
        raise ConfigurationError(f"{archive}: is blind already; rig archive unblind comes first")
    key = secrets.token_bytes(32)
    key_path = _key_path(sha256_hex(key))
    try:
        key_path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        whole_file.write_new(key_path, key.hex().encode(), mode=0o600)
    except OSError as error:
        raise RecordError(f"{key_path}: cannot be written: {error.strerror or error}") from None
    data = _said(key_sha256=sha256_hex(key), scales=dict(scales))
    path = archive / _FOLDER / f"{datetime.datetime.now(datetime.UTC):%Y%m%dT%H%M%S.%f}.sealed.json"
    _write(path, data)
    return (
        f"{', '.join(scales)} hidden; SHA-256 of the seal: {hashlib.sha256(data).hexdigest()}; the key is "
        f"{key_path}"
    )


def _key(sha256: str) -> bytes | None:
    path = _key_path(sha256)
    try:
        key = bytes.fromhex(path.read_text())
    except FileNotFoundError:
        return None
    if sha256_hex(key) != sha256:
        raise RecordError(f"{path}: is not the key that the archive was sealed with; take it from a backup")
    return key


def _key_path(sha256: str) -> Path:
    stated = os.environ.get("XDG_DATA_HOME") or os.environ.get("LOCALAPPDATA")
    data = Path(stated) if stated else Path.home() / ".local" / "share"
    return data / "optical-pendulum-rig" / "keys" / f"{sha256[:32]}.key"


def unseal(archive: Path, frozen: str) -> str:
    """Show true values again, and keep who asked for it, when, and what he said was frozen.

    Raises ConfigurationError where nothing is hidden, or nothing was said.
    """
    found = sealed(archive)
    if found is None:
        raise ConfigurationError(f"{archive}: is not blind")
    if not frozen.strip():
        raise ConfigurationError("say which analysis is frozen: rig archive unblind 'commit, cuts, law'")
    digest = hashlib.sha256(found.path.read_bytes()).hexdigest()
    _write(_opened(found.path), _said(frozen=frozen.strip(), seal_sha256=digest))
    return f"{', '.join(found.scales)} shown again; recorded in {_opened(found.path)}"


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
