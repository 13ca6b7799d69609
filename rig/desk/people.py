"""Who may enter the desk, and as what: here by the key of an address, from elsewhere by name and password."""

import base64
import hashlib
import hmac
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from processing.errors import ConfigurationError

_N, _R, _P = 2**14, 8, 1
_LEAST_CHARACTERS = 10
_TRIES, _TRIES_S = 5, 60.0
_LOGINS_KEPT = 64


class Role(StrEnum):
    """What somebody may do."""

    ACT = "act"
    WATCH = "watch"
    """See everything, and press LIGHT OFF."""


@dataclass(frozen=True, slots=True)
class Person:
    """Somebody who was let in; without a name where a key was enough."""

    role: Role
    name: str = ""


@dataclass(frozen=True, slots=True)
class _Entry:
    person: Person
    salt: bytes
    digest: bytes


class People:
    """Judges keys, passwords and cookies; may be used from any thread.

    `passwords` is a file of lines as `password_line` makes them. Raises ConfigurationError for one that
    cannot be read.
    """

    def __init__(
        self,
        key: str,
        watch_key: str,
        passwords: Path | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._keys = ((key, Person(Role.ACT)), (watch_key, Person(Role.WATCH)))
        self._entries: Mapping[str, _Entry] = {} if passwords is None else _read(passwords)
        self._clock = clock
        self._logins: dict[str, Person] = {}
        self._failures: deque[float] = deque(maxlen=_TRIES)
        self._lock = threading.Lock()

    @property
    def by_password(self) -> bool:
        """Whether somebody can enter with a password."""
        return bool(self._entries)

    def by_key(self, key: str) -> Person | None:
        """Who has this key."""
        found = None
        for known, person in self._keys:
            if hmac.compare_digest(key.encode(), known.encode()):
                found = person
        return found

    def by_login(self, cookie: str) -> Person | None:
        """Who has entered with a password, and got this cookie."""
        with self._lock:
            return self._logins.get(_of_cookie(cookie)) if cookie else None

    def leave(self, cookie: str) -> None:
        """End a login: its cookie is worth nothing any more, and no page that it has opened."""
        with self._lock:
            self._logins.pop(_of_cookie(cookie), None)

    def is_in(self, person: Person) -> bool:
        """Whether who was let in has not left since; by a key one is in as long as the desk is there."""
        with self._lock:
            return not person.name or any(one is person for one in self._logins.values())

    def enter(self, name: str, password: str) -> str | None:
        """The cookie of who states a name and its password; None for a wrong one. Takes a while.

        After five wrong ones within a minute everybody waits: raises ConfigurationError meanwhile.
        """
        now_s = self._clock()
        with self._lock:
            if len(self._failures) == _TRIES and now_s - self._failures[0] < _TRIES_S:
                raise ConfigurationError("too many wrong passwords: wait a minute, then try again")
        entry = self._entries.get(name)
        salt = b"nobody" if entry is None else entry.salt
        digest = _digest(password, salt)
        with self._lock:
            if entry is None or not hmac.compare_digest(digest, entry.digest):
                self._failures.append(now_s)
                return None
            cookie = secrets.token_urlsafe(24)
            # one of its own: it is this login that ends
            self._logins[_of_cookie(cookie)] = replace(entry.person)
            while len(self._logins) > _LOGINS_KEPT:
                del self._logins[next(iter(self._logins))]
            return cookie


def password_line(name: str, role: Role, password: str) -> str:
    """The line of a person for the file; raises ConfigurationError for a name or password that is none."""
    if not name or ":" in name or name != name.strip() or not name.isprintable():
        raise ConfigurationError(f"name {name!r}: should be printable, without a colon")
    if len(password) < _LEAST_CHARACTERS:
        raise ConfigurationError(f"a password of {len(password)} characters: at least {_LEAST_CHARACTERS}")
    salt = secrets.token_bytes(16)
    shown = (base64.b64encode(one).decode() for one in (salt, _digest(password, salt)))
    return ":".join((name, role, *shown))


def _of_cookie(cookie: str) -> str:
    return hashlib.sha256(cookie.encode()).hexdigest()


def _digest(password: str, salt: bytes) -> bytes:
    return hashlib.scrypt(password.encode(), salt=salt, n=_N, r=_R, p=_P, maxmem=2**26, dklen=32)


def _read(path: Path) -> dict[str, _Entry]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or type(error).__name__
        raise ConfigurationError(f"--passwords {path}: cannot be read: {why}") from None
    if path.stat().st_mode & 0o077:
        raise ConfigurationError(f"--passwords {path}: others may read it; chmod 600 {path}")
    found = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            name, role, salt, digest = line.split(":")
            entry = _Entry(Person(Role(role), name), base64.b64decode(salt), base64.b64decode(digest))
        except ValueError:
            raise ConfigurationError(
                f"--passwords {path}: line {number} was not written by rig desk-password"
            ) from None
        found[name] = entry
    if not found:
        raise ConfigurationError(f"--passwords {path}: is empty; rig desk-password writes its lines")
    return found
