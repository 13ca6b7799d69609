"""Tells people who are not there of an alarm, the end or the failure of a session, by a command."""

import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from acquisition.record.events import Level
from processing.errors import RigError
from rig.instrument import Told
from rig.measure.session_file import SessionFile, read_session
from rig.presentation import say
from rig.settings import SessionSettings
from rig.terminal import reason_of

_CALL_S = 20.0
_LAST_WAIT_S = 10.0
_MOST_ALARMS = 20
"""Of one session; a contact that bounces must not call somebody a thousand times."""


class Notices:
    """Calls `session.notify_command` with the kind, the text and the folder as its last arguments.

    Each call has a thread of its own, so that one that hangs delays nothing. As a watcher of runs it tells
    of events at error level. `against` collects the causes that a failure states.
    """

    def __init__(self, settings: SessionSettings, folder: Path) -> None:
        self._command = settings.notify_command
        self._folder = folder
        self.calls: list[threading.Thread] = []
        self._heard = threading.Event()
        self.against: list[str] = []
        self._alarms = 0

    @property
    def last_was_heard(self) -> bool:
        """Whether what was told last has reached the command for certain."""
        return self._heard.is_set()

    def tell(self, kind: Literal["alarm", "end", "failure"], text: str) -> None:
        """Tell it; returns at once."""
        # of this message: what was told before, and answers later, does not count for it
        heard = self._heard = threading.Event()
        if self._command:
            words = (kind, text, str(self._folder.absolute()))
            name = f"session.notify_command: {self._command[0]}"
            thread = threading.Thread(target=self._run, args=(words, heard), name=name, daemon=True)
            thread.start()
            self.calls.append(thread)

    def wait(self) -> None:
        """Until all is sent, or for some seconds: the program is about to end."""
        end_s = time.monotonic() + _LAST_WAIT_S
        for thread in self.calls:
            thread.join(max(0.0, end_s - time.monotonic()))
        for who in {thread.name for thread in self.calls if thread.is_alive()}:
            say(
                f"{who} did not answer within {_LAST_WAIT_S:g} s: it is unknown whether the message arrived",
                error=True,
            )

    def take(self, told: Told) -> None:
        """Events of a run whose level is an alarm's."""
        for event in told.events:
            if event.level in (Level.TRIP, Level.ALARM) and self._alarms < _MOST_ALARMS:
                self._alarms += 1
                self.tell("alarm", event.line)

    def _run(self, words: tuple[str, ...], heard: threading.Event) -> None:
        try:
            done = subprocess.run(
                [*self._command, *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=_CALL_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            say(f"session.notify_command: {self._command[0]} was ended after {_CALL_S:g} s", error=True)
        except (OSError, ValueError) as error:
            say(f"session.notify_command: {error}", error=True)
        else:
            if done.returncode:
                say(f"session.notify_command: {self._command[0]} ended with {done.returncode}", error=True)
            else:
                heard.set()


@dataclass
class Outcome:
    """How a session ended, set in the block of `announced`, and what reports it."""

    notices: Notices
    status: int = 1


@contextmanager
def announced(settings: SessionSettings, folder: Path, file: SessionFile | None = None) -> Iterator[Outcome]:
    """Report the end or the failure of what is done in the block, as its exit status or its error says.

    A session that goes on, and has nothing to make, ends as it did: that is not told twice, unless it has
    reached nobody. `file` is the session's, where it is open already.
    """
    outcome, told = Outcome(Notices(settings, folder)), ""
    try:
        yield outcome
    except BaseException as error:
        why = reason_of(error) if isinstance(error, KeyboardInterrupt) else str(error)
        outcome.notices.tell("failure", why or type(error).__name__)
        _note_told(folder, file, outcome.notices, "")
        raise
    else:
        kind: Literal["end", "failure"] = "end"
        text = "every run was measured and fitted"
        if outcome.status:
            kind = "failure"
            text = "not every run was measured and fitted under its conditions"
            text = ": ".join([text, *filter(None, ["; ".join(outcome.notices.against)])])
        if _told(folder) != f"{kind}: {text}":
            outcome.notices.tell(kind, text)
            told = f"{kind}: {text}"
    finally:
        outcome.notices.wait()
        if told and outcome.notices.last_was_heard:
            _note_told(folder, file, outcome.notices, told)


def _told(folder: Path) -> str:
    with suppress(RigError):
        return read_session(folder).told
    return ""


def _note_told(folder: Path, file: SessionFile | None, notices: Notices, words: str) -> None:
    """Note in the session's file what its end was told as, if anybody was told; it may not have begun."""
    if notices.calls and _told(folder) != words:
        with suppress(RigError), nullcontext(file) if file else closing(SessionFile.opened(folder)) as held:
            held.note_told(words)
