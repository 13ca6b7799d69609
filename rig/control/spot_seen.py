"""Whether the camera's frames show the laser's spot: evidence of light that no device has told of."""

import time
from collections.abc import Callable
from typing import Final

import numpy as np

from acquisition.frame import Image

_EVERY_S = 0.4
_OF_LIT = 0.25
"""Part of the spot's contrast that still counts as the spot: a stuck output gives all of it."""
_LEAST_NOISES = 8.0
"""Of the frame's own noise: what a frame needs to be one with a spot at all."""
_MOST_PIXELS = 500_000
_OF_THEM = 8
"""One pixel of so many tells of background and noise."""
_HOT_PIXELS = 3
_SETTLED_S: Final = 1.0
"""After the laser was told off frames on their way still show it."""
_BEFORE_S: Final = 1.5
"""A spot that was seen no later before the laser was told off may have left the sensor instead."""


class SpotSeen:
    """Compares frames with those that were seen while the laser was lit.

    `frame` is called by who reads the camera, the others by who knows the laser; each from any thread.
    """

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._sampled_s = -np.inf
        self._contrast_dn = 0.0
        self._noise_dn = 0.0
        self._lit_dn = 0.0
        self._looked_s = self._seen_lit_s = -np.inf
        self._lit: bool | None = None
        self._since_s = 0.0
        self.exposure_s = 0.0

    def frame(self, image: Image) -> None:
        """A frame was read; it is looked at if none was for a while."""
        now_s = self._clock_s()
        if now_s - self._sampled_s < _EVERY_S:
            return
        step = max(int(np.ceil(np.sqrt(image.size / _MOST_PIXELS))), 1)
        some = image[::step, ::step].ravel()
        if some.size <= _HOT_PIXELS:
            return
        few = some[::_OF_THEM].astype(np.float32)
        middle = float(np.median(few))
        peak = float(np.partition(some, -_HOT_PIXELS - 1)[-_HOT_PIXELS - 1])
        self._noise_dn = max(1.5 * float(np.median(np.abs(few - middle))), 1.0)
        self._contrast_dn, self._sampled_s = peak - middle, now_s

    def told(self, lit: bool) -> None:
        """What the laser says of itself now."""
        now_s = self._clock_s()
        if lit is not self._lit:
            self._lit, self._since_s = lit, now_s
            if lit:
                self._lit_dn = 0.0
        if lit and self._is_settled and self._contrast_dn > _LEAST_NOISES * self._noise_dn:
            self._lit_dn = max(self._lit_dn, self._contrast_dn)
        if lit:
            self._looked_s = self._sampled_s
            if self.seen:
                self._seen_lit_s = self._sampled_s

    @property
    def age_s(self) -> float:
        """Time since the newest frame that was looked at; infinite without one."""
        return self._clock_s() - self._sampled_s

    @property
    def seen(self) -> bool | None:
        """Whether the spot is in the newest frame; None where it never was while the laser was lit."""
        if not self._lit_dn:
            return None
        return self._contrast_dn >= max(_OF_LIT * self._lit_dn, _LEAST_NOISES * self._noise_dn)

    @property
    def disagrees(self) -> bool:
        """Whether the laser says that it is off, and later frames show it lit."""
        return self._lit is False and self._is_settled and self.seen is True

    @property
    def agrees(self) -> bool:
        """Whether the laser says that it is off, and later frames show no spot that was there until then."""
        was_seen = self._looked_s - self._seen_lit_s <= _BEFORE_S
        return self._lit is False and self._is_settled and was_seen and self.seen is False

    @property
    def _is_settled(self) -> bool:
        return self._sampled_s - self._since_s > _SETTLED_S + 2.0 * self.exposure_s
