"""Where curves are broken: between values that are far apart in time."""

import numpy as np

from rig.rerun.messages import Floats


class Breaks:
    """Puts NaN into the gaps of curves, also between one block of values and the next."""

    def __init__(self) -> None:
        self._last_s: dict[str, float] = {}

    def in_gaps(self, path: str, most_s: float, time_s: Floats, *columns: Floats) -> tuple[Floats, ...]:
        """Times (n,) and columns (n,) of the curve at the entity `path`, NaN amid gaps above `most_s`."""
        steps_s = np.diff(time_s, prepend=self._last_s.get(path, np.nan))
        self._last_s[path] = float(time_s[-1])
        gaps = np.flatnonzero(steps_s > most_s)
        if not len(gaps):
            return time_s, *columns
        middles_s = time_s[gaps] - 0.5 * steps_s[gaps]
        return np.insert(time_s, gaps, middles_s), *(np.insert(values, gaps, np.nan) for values in columns)
