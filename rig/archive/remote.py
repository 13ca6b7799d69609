"""An archive that lies elsewhere (`s3://bucket/name`): a copy of its files here, and what is new sent there.

All files of an archive are written once, whole, and never changed, so that names alone tell what is missing
on which side; each is proved when it is brought or sent. What follows from nothing else is never taken away
here because it is gone there, and a place where the archive is gone is refused. Commands read and write the
copy, as they would an archive on a disk; it lies in the user's cache, and a command that was killed leaves in
it what the next one sends.
"""

import contextlib
import hashlib
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError, RigError
from rig.archive.facts import FOLDER as FACTS
from rig.archive.facts import FactLog
from rig.archive.manifest import MANIFEST, identity, identity_in
from rig.archive.proved import prove, read_file
from rig.presentation import say

_SEEN = ".seen"
"""File of the copy that names what was there when it was last looked at: the rest is new here."""
_AT_ONCE = 256
_DERIVED = ("merged/", "quarantine/")
"""What may be taken away on one side: it follows from the rest, or is taken away to try again."""


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
    copy = _Copy(archive)
    if not believed:
        yield copy.folder
        return
    copy.fetch()
    try:
        yield copy.folder
    finally:
        copy.send()


def write_new(archive: str, name: str, data: bytes) -> None:
    """Write one file of a remote archive, whole or not at all; one that is there already stays as it is."""
    with _said_in_a_line(archive):
        system, root = _system(archive)
        with contextlib.suppress(FileExistsError):
            system.pipe_file(f"{root}/{name}", data, mode="create")


def restored(archive: str, *, repair: bool) -> dict[str, tuple[str, bool]]:
    """Compare a remote archive with the copy of it: a line for each file that is not sound on both sides.

    With `repair` the sound one takes the place of the other; the line's second part says whether it did.
    """
    copy, found = _Copy(archive), dict[str, tuple[str, bool]]()
    names = sorted(copy.names_there() | copy.names_here())
    for name in names:
        here, there = copy.sound_here(name), copy.sound_there(name)
        if here is not None and there is not None:
            continue
        side = "here" if here is None else "there"
        mended = repair and (here is not None or there is not None)
        if mended and here is None and there is not None:
            whole_file.replace(copy.folder / name, there)
        elif mended and here is not None:
            copy.overwrite(name, here)
        found[name] = f"{archive}/{name}: is damaged or missing {side}", mended
    return found


class _Copy:
    """The copy in the user's cache of an archive that is named by a URL."""

    def __init__(self, url: str) -> None:
        self._url = url.rstrip("/")
        self._keeps = True
        with _said_in_a_line(url):
            self._system, self._root = _system(self._url)
        self.folder = _cache() / hashlib.sha256(self._url.encode()).hexdigest()[:16]
        self.folder.mkdir(parents=True, exist_ok=True)

    def fetch(self) -> None:
        """Bring what is missing here, proved; take away here what follows from the rest and is gone there.

        Raises RecordError where another archive, or none, has taken the place of the one that was there.
        """
        with _said_in_a_line(self._url):
            self._system.invalidate_cache()
            there = {path.removeprefix(f"{self._root}/") for path in self._system.find(self._root)}
        here, seen = self._here(), self._seen()
        self._check_identity(there, seen)
        lost = []
        for name in sorted((here & seen) - there):
            if name.startswith(_DERIVED):
                (self.folder / name).unlink(missing_ok=True)
            else:
                lost.append(name)
        if lost:
            say(f"{self._url}: {len(lost)} files are gone there, the first is {lost[0]}; they are sent again")
        self._bring(sorted(there - here))
        self._remember(there)

    def _check_identity(self, there: set[str], seen: set[str]) -> None:
        known = identity(self.folder)
        if MANIFEST in there:
            found = identity_in(self.folder / MANIFEST, self._read([MANIFEST])[MANIFEST])
            # one that was never sent is given up for the one that was there first
            if known and found != known and MANIFEST in seen:
                raise RecordError(
                    f"{self._url}: holds another archive ({found[:8]}) than before ({known[:8]}); "
                    f"check address and bucket; a copy of the one before lies in {self.folder}"
                )
            if known and found != known:
                (self.folder / MANIFEST).unlink()
            return
        if MANIFEST in seen or (seen and not there):
            raise RecordError(
                f"{self._url}: the archive that was there is gone ({MANIFEST} is missing); check address, "
                f"bucket and AWS_ENDPOINT_URL; a copy of it lies in {self.folder} and was not touched"
            )

    def _bring(self, names: Sequence[str]) -> None:
        for first in range(0, len(names), _AT_ONCE):
            for name, data in self._read(names[first : first + _AT_ONCE]).items():
                target = self.folder / name
                prove(Path(f"{self._url}/{name}"), name, data)
                target.parent.mkdir(parents=True, exist_ok=True)
                with contextlib.suppress(FileExistsError):
                    whole_file.write_new(target, data)

    def _read(self, names: Sequence[str]) -> dict[str, bytes]:
        """The content of files there; one that somebody takes away meanwhile is left out if it is derived."""
        with _said_in_a_line(self._url):
            found = self._system.cat([f"{self._root}/{name}" for name in names], on_error="return")
        read: dict[str, bytes] = {}
        for path, data in found.items():
            name = path.removeprefix(f"{self._root}/")
            if isinstance(data, bytes):
                read[name] = data
            elif not (isinstance(data, FileNotFoundError) and name.startswith(_DERIVED)):
                raise RecordError(f"{self._url}/{name}: is listed there and cannot be read: {data!r}")
        if missing := {name for name in names if name not in read and not name.startswith(_DERIVED)}:
            raise RecordError(f"{self._url}/{min(missing)}: is listed there and cannot be read")
        return read

    def send(self) -> None:
        """Write there what is new here; of what was taken away here only merged files, which are derived."""
        here, seen = self._here(), self._seen()
        new = sorted(here - seen, key=_order_of_sending)
        sent: list[str] = []
        if new and MANIFEST not in new:
            self._keeps = self._keeps_what_is_there()
        while new:
            name = new.pop(0)
            if self._create(name):
                sent.append(name)
                continue
            if name.startswith(f"{FACTS}/"):
                again = self._after_theirs([name, *(other for other in new if other.startswith(f"{FACTS}/"))])
                new = sorted({*new, *again} & self._here(), key=_order_of_sending)
            else:
                # who was there first is right
                (self.folder / name).unlink()
                self._bring([name])
        self._prove_sent(sent)
        with _said_in_a_line(self._url):
            for name in seen - here:
                if name.startswith("merged/"):
                    with contextlib.suppress(FileNotFoundError):
                        self._system.rm_file(f"{self._root}/{name}")
        self._remember(self._here())

    def _prove_sent(self, names: Sequence[str]) -> None:
        """Raise RecordError where a file that was taken is not there as it was sent."""
        for first in range(0, len(names), _AT_ONCE):
            part = names[first : first + _AT_ONCE]
            found = self._read(part)
            for name in part:
                if name in found and found[name] != (self.folder / name).read_bytes():
                    raise RecordError(
                        f"{self._url}/{name}: was sent, and is not there as it was sent; somebody wrote over "
                        "it, or the server keeps it not as it says; rig archive check --repair puts it right"
                    )

    def _create(self, name: str) -> bool:
        """Write a file there; False where another one has its name."""
        data = (self.folder / name).read_bytes()
        prove(self.folder / name, name, data)
        with _said_in_a_line(self._url):
            try:
                if not self._keeps:
                    self._system.invalidate_cache()
                    if self._system.exists(f"{self._root}/{name}"):
                        raise FileExistsError
                self._system.pipe_file(f"{self._root}/{name}", data, mode="create")
            except FileExistsError:
                return self._read([name]).get(name) == data
        return True

    def _keeps_what_is_there(self) -> bool:
        """Whether the server refuses to write over a file where it is asked to; that it does not is said."""
        # its own content: where it is written over, it stays as it is
        data = (self.folder / MANIFEST).read_bytes()
        with _said_in_a_line(self._url):
            try:
                self._system.pipe_file(f"{self._root}/{MANIFEST}", data, mode="create")
            except FileExistsError:
                return True
        say(
            f"{self._url}: the server writes over what is there, asked not to (If-None-Match): two who "
            "write in the same moment may lose what one of them says; use it one after the other"
        )
        return False

    def _after_theirs(self, names: Sequence[str]) -> set[str]:
        """Give facts that were not sent numbers behind those that somebody else has sent meanwhile.

        So the copies of two users of one computer tell one history, in the order in which they were sent.
        """
        log = FactLog(self.folder)
        ours = log.entries(name.rpartition("/")[2] for name in names)
        for entry in ours:
            (log.folder / entry.name).unlink()
        with _said_in_a_line(self._url):
            self._system.invalidate_cache()
            there = self._system.find(f"{self._root}/{FACTS}")
        names_there = {path.removeprefix(f"{self._root}/") for path in there}
        self._bring(sorted(names_there - self._here()))
        log = FactLog(self.folder)
        return {f"{FACTS}/{log.write(entry.facts)}" for entry in ours}

    def names_there(self) -> set[str]:
        """Names of all files there."""
        with _said_in_a_line(self._url):
            self._system.invalidate_cache()
            return {path.removeprefix(f"{self._root}/") for path in self._system.find(self._root)}

    def names_here(self) -> set[str]:
        """Names of all files of the copy."""
        return self._here()

    def sound_here(self, name: str) -> bytes | None:
        """A file of the copy; None where it is missing or not as it was written."""
        try:
            data = read_file(self.folder / name)
            prove(self.folder / name, name, data)
        except RecordError:
            return None
        return data

    def sound_there(self, name: str) -> bytes | None:
        """The same of a file there."""
        try:
            data = self._read([name])[name]
            prove(Path(f"{self._url}/{name}"), name, data)
        except (RecordError, KeyError):
            return None
        return data

    def overwrite(self, name: str, data: bytes) -> None:
        """Put a sound file in the place of a damaged one there."""
        with _said_in_a_line(self._url):
            self._system.pipe_file(f"{self._root}/{name}", data)

    def _here(self) -> set[str]:
        return {
            path.relative_to(self.folder).as_posix()
            for path in self.folder.rglob("*")
            if path.is_file() and not path.name.startswith(".")
        }

    def _seen(self) -> set[str]:
        try:
            return set((self.folder / _SEEN).read_text(encoding="utf-8").splitlines())
        except FileNotFoundError:
            return set()

    def _remember(self, names: set[str]) -> None:
        whole_file.replace(self.folder / _SEEN, "\n".join(sorted(names)).encode())


def _order_of_sending(name: str) -> tuple[int, str]:
    """What others follow from first: no state without the first fact, no fact without its state."""
    if name == MANIFEST:
        return 0, name
    if name.startswith(f"{FACTS}/"):
        return (1 if name.endswith("-00000001.facts") else 3), name
    return (4 if name.startswith("merged/") else 2), name


def _system(url: str) -> tuple[Any, str]:
    """The file system that fsspec has for a URL, and the path in it."""
    try:
        import fsspec

        system, root = fsspec.core.url_to_fs(url)
    except ImportError as error:
        raise ConfigurationError(
            f"{url}: {str(error).rstrip('.')}: pip install 'optical-pendulum-rig[remote]'"
        ) from None
    return system, root.rstrip("/")


@contextlib.contextmanager
def _said_in_a_line(url: str) -> Iterator[None]:
    try:
        yield
    except RigError:
        raise
    except Exception as error:
        # the libraries behind fsspec have no error in common
        text = (str(error).splitlines() or [type(error).__name__])[0]
        raise RecordError(f"{url}: cannot be read or written: {text or type(error).__name__}") from None


def _cache() -> Path:
    stated = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return (Path(stated) if stated else Path.home() / ".cache") / "optical-pendulum-rig" / "archives"
