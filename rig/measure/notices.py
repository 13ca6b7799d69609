"""Tells people who are not there of an alarm, the end or the failure of a session, by a command."""

import datetime
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from acquisition.record.events import Severity
from processing.errors import ConfigurationError, RigError
from rig.instrument import RecordContents
from rig.measure.session_file import SessionFile, read_session
from rig.presentation import say
from rig.settings import Configuration, PreflightSettings, SessionSettings
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

    def take(self, told: RecordContents) -> None:
        """Events of a run whose level is an alarm's."""
        for event in told.events:
            if event.level in (Severity.TRIP, Severity.ALARM) and self._alarms < _MOST_ALARMS:
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


Sleep = Callable[[float], None]
_LONG_ENOUGH_S = 60.0
"""Look at rest that holds the eight periods which the ground's drive needs."""


class Waiting:
    """Waits after a no-go as `[preflight]` states; `over` once a run may not be tried any more."""

    def __init__(
        self,
        name: str,
        preflight: PreflightSettings,
        now_s: Callable[[], float] = time.monotonic,
        sleep: Sleep = time.sleep,
    ) -> None:
        self._name, self._now_s, self._sleep = name, now_s, sleep
        self._every_s, self._longest_s = preflight.try_every_s, preflight.wait_max_s
        self._waited_s = self._this_s = 0.0
        self._since = self._last = ""
        self._refused = False
        self.over = False

    def __call__(self, why: str) -> bool:
        """Whether to try again, after a time, what was refused for this reason."""
        left_s = self._longest_s - self._waited_s
        if left_s <= 0:
            self.over = True
            if self._longest_s:
                say(f"{self._name}: not ready within {self._longest_s:g} s: {why}", error=True)
            return False
        if not self._since:
            self._since = f"{datetime.datetime.now().astimezone():%H:%M}"
        self._last, self._refused = why, True
        say(f"{self._name}: waiting since {self._since}: {why}")
        begun_s = self._now_s()
        self._sleep(min(self._every_s, left_s))
        lasted_s = self._now_s() - begun_s
        self._waited_s += lasted_s
        self._this_s += lasted_s
        return True

    def said(self) -> list[str]:
        """What the run that is tried now has waited for; asked at every try."""
        if not self._refused:
            # the run before was made
            self._since, self._this_s = "", 0.0
        self._refused = False
        if not self._since:
            return []
        return [f"waited from {self._since} for {self._this_s / 60:.0f} min: {self._last}"]


def check_waiting(config: Configuration) -> None:
    """Raise ConfigurationError where a session shall wait for conditions that its rig cannot see."""
    asked, usual = config.preflight, PreflightSettings()
    if not asked.wait_max_s:
        return

    def stated(*names: str) -> str:
        return next((name for name in names if getattr(asked, name) != getattr(usual, name)), "")

    who = f"preflight.wait_max_s = {asked.wait_max_s:g}"
    if asked.when == "never":
        raise ConfigurationError(f'{who}: has no effect with preflight.when = "never"')
    of_air = stated("min_humidity_percent", "max_humidity_percent", "min_temperature_c", "max_temperature_c")
    if of_air and config.environment_sensor.kind == "none":
        raise ConfigurationError(
            f"{who}: preflight.{of_air} needs a sensor of the air: see [environment_sensor]"
        )
    of_rest = stated("max_ground_rad_per_s2_rthz", "max_vibration_arcsec")
    if of_rest and (config.start.way == "at once" or config.lever is None):
        raise ConfigurationError(
            f"{who}: preflight.{of_rest} needs a pendulum at rest and [lever]:"
            " set start.way to 'by hand', 'magnet' or 'starter'"
        )
    if asked.max_ground_rad_per_s2_rthz is not None and asked.duration_s < _LONG_ENOUGH_S:
        raise ConfigurationError(
            f"{who}: preflight.max_ground_rad_per_s2_rthz needs eight periods at rest: set "
            f"preflight.duration_s to {_LONG_ENOUGH_S:g} or more, it is {asked.duration_s:g}"
        )
