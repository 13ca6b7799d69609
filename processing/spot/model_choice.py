"""The choice of one model of the beam for a whole run: one Gaussian, two, or the beam's own profile.

A tracker that decided in every frame would change its model with the noise, and the position with it. Here
the first search decides between one spot and two; the frames that follow show how well that fits; if it does
not, the beam's profile is learned from some of them. The choice is kept until the beam has changed.
"""

import math
from collections.abc import Callable, Generator
from enum import StrEnum
from statistics import median

import numpy as np

from processing.arrays import Floats
from processing.spot.fit_values import Image, Spot, SpotFlag, misfit_limit
from processing.spot.profile import ROUNDS, BeamProfile, Sample, Shape, learn
from processing.spot.sensor_model import PixelNoise

_EVERY = 4
_MOST_SAMPLES, _FEWEST_SAMPLES = 32, 16
_SAMPLED_PX = 1_000_000
"""A large spot needs fewer samples: its profile is smoothed over more pixels."""
_PIECE_PX = 50_000
"""Pixels of samples that are worked on in the time of one frame."""
LONGEST_CHOICE_FRAMES = (_EVERY + ROUNDS + 2) * _MOST_SAMPLES + 2
"""The most spots that a choice takes: samples are taken, a Gaussian fitted to each, the profile learned."""
_CHANGED_FRAMES = 256
_CHANGED = 2.0
"""The beam has changed if it fits badly in so many frames in a row, worse by this factor than when chosen."""


class SpotModel(StrEnum):
    """What is fitted to every frame."""

    ONE = "one Gaussian"
    TWO = "two Gaussians"
    LEARNED = "learned profile"


Refit = Callable[[Image, tuple[int, int]], tuple[Floats, Shape] | None]
"""Fits one Gaussian to a window at a place: (x, y, amplitude, background) on the sensor, and its shape."""


class ModelChoice:
    """Watches the first spots of a run, then names the model; later it watches for a change of the beam.

    `model` is None as long as it is not chosen, `profile` the learned profile if that is the model.
    """

    def __init__(self, noise: PixelNoise, refit: Refit) -> None:
        self._noise = noise
        self._refit = refit
        self.begin()

    def begin(self) -> None:
        """Choose again."""
        self.model: SpotModel | None = None
        self.profile: BeamProfile | None = None
        self._frames = 0
        self._two = False
        self._sum = 0.0
        self._misfit = 1.0
        self._pieces = 1
        self._windows: list[tuple[Image, tuple[int, int]]] = []
        self._learning: Generator[None, None, BeamProfile | None] | None = None

    def see(
        self,
        chi2_per_dof: float,
        flags: int,
        pixels: float,
        window: Callable[[], tuple[Image, tuple[int, int]]],
    ) -> None:
        """A spot that was followed while the model was not chosen.

        `pixels` is the number of pixels fitted, `window` gives those to keep and the place of the first.
        """
        if self._learning is not None:
            self._learn()
            return
        two = bool(flags & SpotFlag.MULTIPLE)
        if two != self._two:  # the second spot has vanished, or come with a search
            self._two, self._frames, self._sum = two, 0, 0.0
        if self._frames % _EVERY == 0:
            self._windows.append(window())
        self._frames += 1
        self._sum += chi2_per_dof
        wanted = min(max(_SAMPLED_PX // self._windows[0][0].size, _FEWEST_SAMPLES), _MOST_SAMPLES)
        if self._frames < _EVERY * wanted:
            return
        self._misfit = self._sum / self._frames
        if self._misfit <= misfit_limit(pixels * self._frames):
            self._settle()
            return
        self._pieces = max(1, _PIECE_PX // self._windows[0][0].size)
        self._learning = self._learned(self._windows[-wanted:])
        self._windows = []

    def changed(self, chi2_per_dof: float, poor_frames: float) -> bool:
        """Whether the beam has changed since the choice."""
        return poor_frames >= _CHANGED_FRAMES and chi2_per_dof > _CHANGED * self._misfit

    def _learn(self) -> None:
        assert self._learning is not None
        try:
            for _ in range(self._pieces):
                next(self._learning)
        except StopIteration as end:
            profile: BeamProfile | None = end.value
            # the same test as for a second spot: the excess of chi-square falls by at least half
            if profile is not None and profile.misfit - 1.0 < 0.5 * (self._misfit - 1.0):
                self.profile, self._misfit = profile, max(profile.misfit, 1.0)
            self._settle()

    def _settle(self) -> None:
        self._windows, self._learning = [], None
        gaussian = SpotModel.TWO if self._two else SpotModel.ONE
        self.model = gaussian if self.profile is None else SpotModel.LEARNED

    def _learned(
        self, windows: list[tuple[Image, tuple[int, int]]]
    ) -> Generator[None, None, BeamProfile | None]:
        """Learn the profile; first fit single Gaussians, from which it starts."""
        samples, shapes = [], []
        for pixels, origin_px in windows:
            found = self._refit(pixels, origin_px)
            if found is not None:
                samples.append(Sample(pixels, origin_px, *found[0].tolist()))
                shapes.append(found[1])
            yield
        if len(samples) < _FEWEST_SAMPLES // 2:
            return None
        shape = Shape(*np.median(np.array(shapes), axis=0).tolist())
        return (yield from learn(samples, shape, self._noise))


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
