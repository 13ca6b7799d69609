"""Keys pressed at the terminal while a program runs: read one by one, without Enter and without waiting."""

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
    """Bytes of a terminal in, names of keys out: characters as they are, arrows as ``right`` and so on.

    A key's bytes may come in pieces. ``enter``, ``backspace``, ``space`` and ``escape`` have names;
    sequences of other keys are swallowed.
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
        """Nothing follows what came last: an escape that stands alone is the key of that name."""
        alone = self._waiting == bytes([_ESCAPE])
        self._waiting = b""
        return ["escape"] if alone else []


class Keys:
    """Context manager over the terminal at the standard input; without one there are simply no keys.

    `there` says whether keys can come: a terminal that this process is in the foreground of. The
    terminal is as it was when the context ends.
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
        """Keys pressed since the last call; waits so long for the first one."""
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
            # the terminal has gone; from now on there are no keys
            self._number = -1
        return self._parser.feed(data)


def _sequence_length(data: bytes) -> int:
    """Bytes of the escape sequence that `data` begins with; 0 where its end has not come yet."""
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
    """Whether the terminal may be changed: a program in its background is stopped when it tries."""
    if os.name != "posix":
        return False
    try:
        return os.tcgetpgrp(number) == os.getpgrp()
    except OSError:
        # not the terminal that starts and stops this program, so that it cannot stop it
        return True
