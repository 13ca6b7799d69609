"""The copy of a remote archive in the user's cache: what lies in it, and how what is missing is brought."""

import contextlib
import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from acquisition.record import whole_file
from processing.errors import RecordError
from rig.archive.bucket import DERIVED, Bucket
from rig.archive.facts import FOLDER as FACTS
from rig.archive.facts import file_name, newest_numbers
from rig.archive.manifest import MANIFEST, identity, identity_in
from rig.archive.proved import prove, read_file
from rig.presentation import say

AT_ONCE = 256
"""Files that are read together."""
_SEEN = ".seen"
"""File of the copy that names what was there when it was last looked at: the rest is new here."""


class Copy:
    """The folder in the cache that is the copy of what lies in a bucket."""

    def __init__(self, url: str) -> None:
        self.bucket = Bucket(url)
        self.folder = _cache() / hashlib.sha256(self.bucket.url.encode()).hexdigest()[:16]
        self.folder.mkdir(parents=True, exist_ok=True)
        for place in (self.folder, *(path for path in self.folder.iterdir() if path.is_dir())):
            whole_file.take_away_leftovers(place)

    def names(self) -> set[str]:
        """Names of all files of the copy."""
        return {
            path.relative_to(self.folder).as_posix()
            for path in self.folder.rglob("*")
            if path.is_file() and not path.name.startswith(".")
        }

    def seen(self) -> set[str]:
        """Names of what was there when it was last looked at."""
        try:
            return set((self.folder / _SEEN).read_text(encoding="utf-8").splitlines())
        except FileNotFoundError:
            return set()

    def remember(self, names: set[str]) -> None:
        """Write down what is there."""
        whole_file.replace(self.folder / _SEEN, "\n".join(sorted(names)).encode())

    def sound(self, name: str) -> bytes | None:
        """A file of the copy; None where it is missing or not as it was written."""
        try:
            data = read_file(self.folder / name)
            prove(self.folder / name, name, data)
        except RecordError:
            return None
        return data

    def sound_there(self, name: str, read: Mapping[str, bytes] | None = None) -> bytes | None:
        """The same of a file there, which was read already or is read now."""
        try:
            data = (self.bucket.read([name]) if read is None else read)[name]
            prove(Path(f"{self.bucket.url}/{name}"), name, data)
        except (RecordError, KeyError):
            return None
        return data

    def bring(self, names: Sequence[str]) -> None:
        """Write files that are there into the copy, each proved. Raises RecordError."""
        for first in range(0, len(names), AT_ONCE):
            for name, data in self.bucket.read(names[first : first + AT_ONCE]).items():
                target = self.folder / name
                prove(Path(f"{self.bucket.url}/{name}"), name, data)
                target.parent.mkdir(parents=True, exist_ok=True)
                with contextlib.suppress(FileExistsError):
                    whole_file.write_new(target, data)


def fetch(copy: Copy) -> None:
    """Bring what is missing here, proved; take away here what follows from the rest and is gone there.

    Raises RecordError where another archive, or none, has taken the place of the one that was there.
    """
    there, here, seen = copy.bucket.names(), copy.names(), copy.seen()
    _check_identity(copy, there, seen)
    _check_history(copy, there & here & seen)
    lost = []
    for name in sorted((here & seen) - there):
        if name.startswith(DERIVED):
            (copy.folder / name).unlink(missing_ok=True)
        else:
            lost.append(name)
    if lost:
        gone = f"{len(lost)} files are gone there, the first is {lost[0]}"
        say(f"{copy.bucket.url}: {gone}; they are sent again")
    copy.bring(sorted(there - here))
    copy.remember(there)


def _check_identity(copy: Copy, there: set[str], seen: set[str]) -> None:
    known, url = identity(copy.folder), copy.bucket.url
    if MANIFEST in there:
        found = identity_in(copy.folder / MANIFEST, copy.bucket.read([MANIFEST])[MANIFEST])
        # one that was never sent is given up for the one that was there first
        if known and found != known and MANIFEST in seen:
            raise RecordError(
                f"{url}: holds another archive ({found[:8]}) than before ({known[:8]}); "
                f"check address and bucket; a copy of the earlier one is in {copy.folder}"
            )
        if known and found != known:
            (copy.folder / MANIFEST).unlink()
        return
    if MANIFEST in seen or (seen and not there):
        raise RecordError(
            f"{url}: the archive that was there is gone ({MANIFEST} is missing); check address, "
            f"bucket and AWS_ENDPOINT_URL; the copy in {copy.folder} was not touched"
        )


def _check_history(copy: Copy, names: set[str]) -> None:
    """Raise RecordError where a computer's log went on there otherwise than here.

    Each file of the log states the hash of the one before: the last that is on both sides is enough.
    """
    logs = {name.rpartition("/")[2] for name in names if name.startswith(f"{FACTS}/")}
    last = [f"{FACTS}/{file_name(*newest)}" for newest in newest_numbers(logs).items()]
    found = copy.bucket.read(last) if last else {}
    for name in last:
        here = copy.sound(name)
        # what is damaged is named when it is read
        if here is not None and copy.sound_there(name, found) not in (None, here):
            raise RecordError(
                f"{copy.bucket.url}/{name}: differs from the copy here: the archive was restored from a "
                "backup, and a computer without its copy added to it; move "
                f"{copy.folder} away, then rig archive add records again what this computer sees"
            )


def _cache() -> Path:
    stated = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return (Path(stated) if stated else Path.home() / ".cache") / "optical-pendulum-rig" / "archives"
