"""Reads single keys from the terminal while a program runs, without Enter and without blocking."""

import contextlib
import os
import select
import sys
import time
from types import TracebackType
from typing import IO, Any, Final, Self

_SEQUENCES: Final = {b"[A": "up", b"[B": "down", b"[C": "right", b"[D": "left", b"OC": "right", b"OD": "left"}
_ESCAPE: Final = 0x1B
_LONGEST_SEQUENCE: Final = 8


class KeyParser:
    """Converts bytes from a terminal to names of keys: a character, or ``right`` and so on for arrows.

    The bytes of a key may arrive in pieces. ``enter``, ``backspace``, ``space`` and ``escape`` have
    names; escape sequences of other keys are ignored.
    """

    def __init__(self) -> None:
        self._waiting = b""

    def feed(self, data: bytes) -> list[str]:
        """The keys that these bytes complete."""
        self._waiting += data
        keys: list[str] = []
        while self._waiting:
            if self._waiting[0] == _ESCAPE:
                length = _sequence_length(self._waiting)
                if not length:
                    break
                name = "escape" if length == 1 else _SEQUENCES.get(self._waiting[1:length])
                keys += [name] if name else []
                self._waiting = self._waiting[length:]
                continue
            character, self._waiting = self._waiting[:1].decode("latin-1"), self._waiting[1:]
            keys.append(_name(character))
        return keys

    def flush(self) -> list[str]:
        """Complete the last key if nothing follows: a single escape character is the key ``escape``."""
        alone = self._waiting == bytes([_ESCAPE])
        self._waiting = b""
        return ["escape"] if alone else []


class Keys:
    """Context manager that reads keys from the terminal at the standard input, if there is one.

    `there` is True if keys can be read: this process is in the foreground of a terminal. The settings
    of the terminal are restored at the end.
    """

    def __init__(self, stream: IO[Any] | None = None) -> None:
        stream = sys.stdin if stream is None else stream
        self._number = -1
        with contextlib.suppress(OSError, ValueError, AttributeError):
            number = stream.fileno()
            if os.isatty(number) and _in_foreground(number):
                self._number = number
        self._parser = KeyParser()
        self._before: list[Any] | None = None

    @property
    def there(self) -> bool:
        return self._number >= 0

    def __enter__(self) -> Self:
        if self.there:
            import termios
            import tty

            self._before = termios.tcgetattr(self._number)
            tty.setcbreak(self._number)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._before is not None:
            import termios

            with contextlib.suppress(termios.error):
                termios.tcsetattr(self._number, termios.TCSADRAIN, self._before)

    def pressed(self, wait_s: float) -> list[str]:
        """Keys pressed since the last call; waits at most `wait_s` for the first one."""
        if not self.there:
            time.sleep(max(wait_s, 0.0))
            return []
        ready, _, _ = select.select([self._number], [], [], max(wait_s, 0.0))
        if not ready:
            return self._parser.flush()
        try:
            data = os.read(self._number, 1024)
        except OSError:
            data = b""
        if not data:
            # the terminal was closed; no more keys
            self._number = -1
        return self._parser.feed(data)


def _sequence_length(data: bytes) -> int:
    """Length in bytes of the escape sequence at the start of `data`; 0 if it is incomplete."""
    if len(data) > 1 and data[1:2] not in (b"[", b"O"):
        return 1
    for end in range(2, min(len(data), _LONGEST_SEQUENCE)):
        if 0x40 <= data[end] <= 0x7E:
            return end + 1
    return len(data) if len(data) >= _LONGEST_SEQUENCE else 0


def _name(character: str) -> str:
    names = {"\n": "enter", "\r": "enter", "\x7f": "backspace", "\b": "backspace", " ": "space"}
    return names.get(character, character)


def _in_foreground(number: int) -> bool:
    """Whether this process may change the terminal; a background process would be stopped."""
    if os.name != "posix":
        return False
    try:
        return os.tcgetpgrp(number) == os.getpgrp()
    except OSError:
        # not the controlling terminal of this process, which therefore cannot stop it
        return True
