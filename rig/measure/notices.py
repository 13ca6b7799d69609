"""Notices to absent people by a command, and the wait for better conditions after a no-go."""

import datetime
import shutil
import subprocess
import time
from concurrent import futures
from pathlib import Path
from typing import Literal, Self

from acquisition.record.events import Severity
from processing.errors import ConfigurationError
from rig.control import run_in_thread
from rig.instrument import RecordContents
from rig.interruption import reason_of
from rig.measure.preflight import rest_checks
from rig.settings import Configuration, PreflightSettings, SessionSettings
from rig.terminal import say

_AIR_KEYS = "min_humidity_percent", "max_humidity_percent", "min_temperature_c", "max_temperature_c"
_REST_KEYS = "max_ground_rad_per_s2_rthz", "max_vibration_arcsec"
_MAX_CALL_S = 20.0
_MAX_LAST_WAIT_S = 10.0
_MAX_ALARMS = 20
"""Most alarms that one session sends: a contact that bounces must not call somebody a thousand times."""


class Notices:
    """Sends notices: calls `session.notify_command` with kind, text and folder as its last arguments.

    Each call has a thread of its own, so that one that hangs delays nothing. `failures` holds the causes that
    a notice of failure states. As a context manager it sends the error that ends the context, and waits until
    all notices are sent.
    """

    def __init__(self, settings: SessionSettings, folder: Path) -> None:
        self._command = settings.notify_command
        self._folder = folder
        self.calls: list[futures.Future[None]] = []
        self.failures: list[str] = []
        self._alarms = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        if error is not None:
            why = reason_of(error) if isinstance(error, KeyboardInterrupt) else str(error)
            self.tell("failure", why or type(error).__name__)
        self.wait()

    def tell(self, kind: Literal["alarm", "end", "failure"], text: str) -> None:
        """Send a notice; returns at once."""
        if self._command:
            self.calls.append(run_in_thread(self._run, kind, text, str(self._folder.absolute())))

    def tell_end(self, status: int) -> None:
        """Send the end of a session by its exit status."""
        if not status:
            self.tell("end", "every run was measured and fitted")
            return
        what = "not every run was measured and fitted under its conditions"
        self.tell("failure", ": ".join(filter(None, (what, "; ".join(self.failures)))))

    def wait(self) -> None:
        """Wait until all notices are sent, at most `_MAX_LAST_WAIT_S`: the program is about to end."""
        if futures.wait(self.calls, _MAX_LAST_WAIT_S).not_done:
            silence = f"{self._command[0]} did not answer within {_MAX_LAST_WAIT_S:g} s"
            say(f"session.notify_command: {silence}: it is unknown whether the message arrived", error=True)

    def take(self, recorded: RecordContents) -> None:
        """Send the events of a run, which this object watches, whose level is an alarm or a trip."""
        for event in recorded.events:
            if event.level in (Severity.TRIP, Severity.ALARM) and self._alarms < _MAX_ALARMS:
                self._alarms += 1
                self.tell("alarm", event.line)

    def _run(self, *arguments: str) -> None:
        null, fault = subprocess.DEVNULL, ""
        command = [*self._command, *arguments]
        try:
            done = subprocess.run(
                command, stdin=null, stdout=null, stderr=null, timeout=_MAX_CALL_S, check=False
            )
            if done.returncode:
                fault = f"{self._command[0]} ended with {done.returncode}"
        except subprocess.TimeoutExpired:
            fault = f"{self._command[0]} was ended after {_MAX_CALL_S:g} s"
        except (OSError, ValueError) as error:
            fault = str(error)
        if fault:
            say(f"session.notify_command: {fault}", error=True)


class PreflightWait:
    """Waits after a no-go of the preflight, as `[preflight]` states; `name` says what waits, in messages."""

    def __init__(self, name: str, preflight: PreflightSettings) -> None:
        self._name, self._waited_s = name, 0.0
        self._interval_s, self._max_s = preflight.try_every_s, preflight.wait_max_s
        self.first_no_go = ""
        """Time of day of the first no-go of the present run; the session empties it after the run."""
        self.is_used_up = False
        """Whether a run was given up because the longest wait is over."""

    def __call__(self, why: str) -> bool:
        """Wait before the next try of a run refused for the reason `why`; returns whether to try again."""
        left_s = self._max_s - self._waited_s
        if left_s <= 0:
            self.is_used_up = True
            if self._max_s:
                say(f"{self._name}: not ready within {self._max_s:g} s: {why}", error=True)
            return False
        self.first_no_go = self.first_no_go or f"{datetime.datetime.now().astimezone():%H:%M}"
        say(f"{self._name}: waiting since {self.first_no_go}: {why}")
        began_s = time.monotonic()
        time.sleep(min(self._interval_s, left_s))
        self._waited_s += time.monotonic() - began_s
        return True


def check_notices(config: Configuration) -> None:
    """Raise ConfigurationError for a notice command that is no program, before an alarm needs it."""
    command = config.session.notify_command
    if command and shutil.which(command[0]) is None:
        raise ConfigurationError(
            f"session.notify_command: no program {command[0]!r} is found; state its whole path, and make it "
            "executable"
        )


def check_waiting(config: Configuration) -> None:
    """Raise ConfigurationError if a session shall wait for conditions that its rig cannot measure."""
    preflight, defaults, fault = config.preflight, PreflightSettings(), ""
    changed = [name for name, value in preflight if value != getattr(defaults, name)]
    air_key = next((key for key in changed if key in _AIR_KEYS), "")
    rest_key = next((key for key in changed if key in _REST_KEYS), "")
    min_s = rest_checks.MIN_GROUND_S
    if preflight.when == "never":
        fault = 'has no effect with preflight.when = "never"'
    elif air_key and config.environment_sensor.kind == "none":
        fault = f"preflight.{air_key} needs a sensor of the air: see [environment_sensor]"
    elif rest_key and (config.start.way == "at once" or config.lever is None):
        fault = f"preflight.{rest_key} needs a pendulum at rest and [lever]: set start.way to 'by hand', "
        fault += "'magnet' or 'starter'"
    elif preflight.max_ground_rad_per_s2_rthz is not None and preflight.duration_s < min_s:
        fault = "preflight.max_ground_rad_per_s2_rthz needs eight periods at rest: set "
        fault += f"preflight.duration_s to {min_s:g} or more, it is {preflight.duration_s:g}"
    if preflight.wait_max_s and fault:
        raise ConfigurationError(f"preflight.wait_max_s = {preflight.wait_max_s:g}: {fault}")
