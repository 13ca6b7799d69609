"""Waits for the conditions of a run, says what for, and gives up at the stated end."""

import datetime
from collections.abc import Callable

from processing.errors import ConfigurationError
from rig.presentation import say
from rig.settings import Configuration, PlannedSeries

Sleep = Callable[[float], None]
_LONG_ENOUGH_S = 60.0
"""Look at rest that holds the eight periods which the ground's drive needs."""


def check_conditions(asked: PlannedSeries, config: Configuration) -> None:
    """Raise ConfigurationError for conditions that a configuration cannot see."""
    who, source = f"series {asked.name}", asked.config
    if asked.asks_the_air and config.environment_sensor.kind == "none":
        what = "temperature_c needs a thermometer"
        if asked.humidity_percent is not None:
            what = "humidity_percent needs a sensor of the air"
        raise ConfigurationError(f"{who}: {what}: see [environment_sensor] in {source}")
    if asked.asks_the_rest and (config.start.way == "at once" or config.lever is None):
        what = "quiet_arcsec" if asked.quiet_arcsec is not None else "ground_rad_per_s2_rthz"
        raise ConfigurationError(
            f"{who}: {what} needs a pendulum at rest and [lever]:"
            f" set start.way to 'by hand', 'magnet' or 'starter' in {source}"
        )
    if asked.ground_rad_per_s2_rthz is not None and config.preflight.duration_s < _LONG_ENOUGH_S:
        raise ConfigurationError(
            f"{who}: ground_rad_per_s2_rthz needs eight periods at rest: set preflight.duration_s to "
            f"{_LONG_ENOUGH_S:g} or more, it is {config.preflight.duration_s:g} in {source}"
        )


class Waiting:
    """Waits until a run may be tried again; `over` once it must not any more."""

    def __init__(self, asked: PlannedSeries, now_s: Callable[[], float], sleep: Sleep) -> None:
        self._who, self._now_s, self._sleep = f"series {asked.name}", now_s, sleep
        self._every_s, self._longest_s = asked.try_every_s, asked.wait_max_s
        self._waited_s = self._this_s = 0.0
        self._since = self._last = ""
        self._refused = False
        self.over = False

    def __call__(self, why: str) -> bool:
        """Whether to try again, after a time, what was refused for this reason."""
        left_s = self._longest_s - self._waited_s
        if not self._since:
            self._since = f"{datetime.datetime.now().astimezone():%H:%M}"
        if left_s <= 0:
            self.over = True
            say(f"{self._who} is left out: not ready within {self._longest_s:g} s: {why}", error=True)
            return False
        self._last, self._refused = why, True
        say(f"{self._who}: waiting since {self._since}: {why}")
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
