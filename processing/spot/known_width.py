"""The width that the spot had while its model was chosen, and what a changed one says of the place."""

import math
from statistics import median

from processing.spot.spot import Spot, SpotFlag

_DOUBTFUL = SpotFlag.POOR_FIT | SpotFlag.OUTLIERS | SpotFlag.MULTIPLE | SpotFlag.CUT
_SHIFT = 2.0
"""An obstacle without a sharp edge moves the fitted place by 1.0 to 2.1 times what it takes from the fitted
width, from a cut one sigma before the centre to one two sigmas behind it."""
_OWN = 3.0
"""Changes of the width by fewer of its standard uncertainties are noise."""


class KnownWidth:
    """Widths of the first spots, against which those of doubtful ones are compared.

    Something that takes light away on one side, and that no edge betrays, makes the fitted spot narrower
    (or wider) than the beam is, and moves it by about as much.
    """

    def __init__(self) -> None:
        self._seen: list[tuple[float, float]] = []
        self._x_px = self._y_px = math.nan

    def begin(self) -> None:
        """Forget the beam."""
        self._seen = []
        self._x_px = self._y_px = math.nan

    def see(self, spot: Spot) -> None:
        """A spot of the frames from which the model is chosen."""
        if not spot.flags & (SpotFlag.LOST | SpotFlag.EDGE | SpotFlag.CUT):
            self._seen.append((spot.sigma_x_px, spot.sigma_y_px))

    def settle(self) -> None:
        """The model is chosen: later spots are compared with those seen so far."""
        if self._seen:
            self._x_px, self._y_px = (median(widths) for widths in zip(*self._seen, strict=True))
        self._seen = []

    def widened(self, spot: Spot) -> Spot:
        """The spot with what a changed width adds to its uncertainties, if it is a doubtful one."""
        if not spot.flags & _DOUBTFUL or spot.flags & (SpotFlag.LEARNED | SpotFlag.LOST):
            return spot
        by_x, by_y = abs(spot.sigma_x_px - self._x_px), abs(spot.sigma_y_px - self._y_px)
        if spot.rotation_rad:
            by_x = by_y = max(by_x, by_y)
        # the width of a Gaussian is known as well as its place
        if not max(by_x, by_y) > _OWN * max(spot.u_x_px, spot.u_y_px):
            return spot
        return spot._replace(
            u_x_px=math.hypot(spot.u_x_px, _SHIFT * by_x), u_y_px=math.hypot(spot.u_y_px, _SHIFT * by_y)
        )
