"""`rig archive blind` and `unblind`: hidden offsets on what the archive shows, until the analysis is frozen.

What is sealed and when it was opened are files of `blind/`, each written once. The secret lies beside them:
it keeps an honest eye from a value, nothing from somebody who wants to know it.
"""

import datetime
import hashlib
import hmac
import json
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError
from rig.archive.proved import has_line, read_file, with_line, without_line
from rig.archive.remarks import user_name

_FOLDER = "blind"
_REACH = 3.0
"""Offsets reach to so many times the scatter of a column."""


class Seal(NamedTuple):
    """What is hidden: the scale of the offset by column, and the secret that they are drawn with."""

    path: Path
    secret: str
    scales: Mapping[str, float]

    def offset(self, column: str, host: str) -> float:
        """The offset of a column on the runs of one rig, the same each time."""
        drawn = hmac.digest(bytes.fromhex(self.secret), f"{column}\0{host}".encode(), "sha256")
        return self.scales[column] * _REACH * (2 * int.from_bytes(drawn[:8]) / 2**64 - 1)


def sealed(archive: Path) -> Seal | None:
    """What is hidden now. Raises RecordError for a file that cannot be read."""
    folder = archive / _FOLDER
    for path in sorted(folder.glob("[!.]*.sealed.json")):
        if not _opened(path).exists():
            try:
                data = read_file(path)
                tree = json.loads(without_line(path, data) if has_line(data) else data)
                scales = {str(name): float(scale) for name, scale in tree["scales"].items()}
                bytes.fromhex(tree["secret"])
                return Seal(path, tree["secret"], scales)
            except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
                raise RecordError(f"{path}: cannot be read: {error!r}; take it from a backup") from None
    return None


def seal(archive: Path, scales: Mapping[str, float]) -> str:
    """Hide columns; returns a line with the hash that proves later that nothing was exchanged.

    Raises ConfigurationError where something is hidden already.
    """
    if sealed(archive) is not None:
        raise ConfigurationError(f"{archive}: is blind already; rig archive unblind comes first")
    data = _said(secret=secrets.token_hex(32), scales=dict(scales))
    path = archive / _FOLDER / f"{datetime.datetime.now(datetime.UTC):%Y%m%dT%H%M%S.%f}.sealed.json"
    _write(path, data)
    return f"{', '.join(scales)} hidden; SHA-256 of the seal: {hashlib.sha256(data).hexdigest()}"


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


def offsets(found: Seal, hosts: Sequence[str | None]) -> list[dict[str, Any]]:
    """A row for each rig with its offsets by column."""
    return [
        {"of_host": host} | {name: found.offset(name, host or "") for name in found.scales} for host in hosts
    ]


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
