"""A session whose preflight says no-go waits, with the laser dark, and tries again."""

import datetime
import time
from collections.abc import Callable

from processing.errors import ConfigurationError
from rig.presentation import say
from rig.settings import Configuration, PreflightSettings

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
