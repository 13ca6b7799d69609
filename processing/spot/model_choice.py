"""Choice of one model of the beam for a whole run: one Gaussian, two, or the beam's own profile.

A tracker that decided in every frame would change its model with the noise, and the position with it. Instead
the first search decides between one spot and two, and the next frames show how well these fit. If they do
not, the beam's profile is learned from some of the frames. The choice holds until the beam has changed.
"""

import math
from collections.abc import Callable, Generator
from enum import StrEnum
from statistics import median

import numpy as np

from processing.arrays import Floats
from processing.spot.fit_values import REACH, Image, Spot, SpotFlag, chi2_limit
from processing.spot.profile import LEARNING_ITERATIONS, BeamProfile, Sample, Shape, learn
from processing.spot.sensor_model import PixelNoise

_SAMPLE_INTERVAL = 4
"""Frames from one sample to the next."""
_MOST_SAMPLES, _FEWEST_SAMPLES = 32, 16
_SAMPLED_PX = 1_000_000
"""Pixels of all samples: a large spot needs fewer samples, as its profile is smoothed over more pixels."""
_PIECE_PX = 50_000
"""Pixels of samples that are processed in the time of one frame."""
LONGEST_CHOICE_FRAMES = (_SAMPLE_INTERVAL + LEARNING_ITERATIONS + 2) * _MOST_SAMPLES + 2
"""Most frames that a choice takes, from the first sample through the Gaussian fits to the learned profile."""
_CHANGED_FRAMES = 256
_CHANGED_RATIO = 2.0
"""The beam has changed if so many frames in a row fit poorly, with a chi2/dof larger by this factor than when
the model was chosen."""

_DOUBTFUL_FLAGS = SpotFlag.POOR_FIT | SpotFlag.OUTLIERS | SpotFlag.MULTIPLE | SpotFlag.CUT
_SHIFT_PER_WIDTH_CHANGE = 2.0
"""Shift of the fitted position by an obstacle without a sharp edge, relative to the change of the fitted
width: from 1.0 for a cut one sigma before the centre to 2.1 for one two sigmas behind it."""
_SIGNIFICANT_CHANGE = 3.0
"""Change of the width, in its standard uncertainties, below which it is noise."""


class SpotModel(StrEnum):
    """Model of the beam that is fitted to every frame."""

    ONE = "one Gaussian"
    TWO = "two Gaussians"
    LEARNED = "learned profile"


Refit = Callable[[Image, tuple[int, int]], tuple[Floats, Shape] | None]
"""Fit of one Gaussian to a window and the place of its first pixel: (x, y, amplitude, background) with the
place on the sensor, and the shape; None without a spot."""


class ModelChoice:
    """Choice of the model from the first spots of a run, and detection of a later change of the beam.

    `model` is None as long as it is not chosen; `profile` is the learned profile, None for another model. The
    median widths of the first spots are those with which doubtful ones are compared: an obstacle that hides
    light on one side without a visible edge makes the fitted spot narrower (or wider) than the beam, and
    shifts it by about as much.
    """

    def __init__(self, noise: PixelNoise, refit: Refit) -> None:
        self._noise = noise
        self._refit = refit
        self.restart()

    def restart(self) -> None:
        """Forget the choice and begin a new one."""
        self.model: SpotModel | None = None
        self.profile: BeamProfile | None = None
        self._frames = 0
        self._two = False
        self._sum = 0.0
        self._chi2_per_dof = 1.0
        self._pieces = 1
        self._windows: list[tuple[Image, tuple[int, int]]] = []
        self._widths: list[tuple[float, float]] = []
        self._width_x_px = self._width_y_px = math.nan
        self._learning: Generator[None, None, BeamProfile | None] | None = None

    def add(self, spot: Spot, window: Callable[[], tuple[Image, tuple[int, int]]]) -> None:
        """Add a spot that was tracked while the model was not chosen.

        `window` returns a sample and the place of its first pixel.
        """
        if not spot.flags & (SpotFlag.LOST | SpotFlag.EDGE | SpotFlag.CUT):
            self._widths.append((spot.sigma_x_px, spot.sigma_y_px))
        if self._learning is not None:
            self._learn()
            return
        two = bool(spot.flags & SpotFlag.MULTIPLE)
        if two != self._two:  # the second spot has vanished, or a search has found one
            self._two, self._frames, self._sum = two, 0, 0.0
        if self._frames % _SAMPLE_INTERVAL == 0:
            self._windows.append(window())
        self._frames += 1
        self._sum += spot.chi2_per_dof
        wanted = min(max(_SAMPLED_PX // self._windows[0][0].size, _FEWEST_SAMPLES), _MOST_SAMPLES)
        if self._frames < _SAMPLE_INTERVAL * wanted:
            return
        self._chi2_per_dof = self._sum / self._frames
        fitted_px = (2.0 * REACH) ** 2 * spot.sigma_x_px * spot.sigma_y_px
        if self._chi2_per_dof <= chi2_limit(fitted_px * self._frames):
            self._settle()
            return
        self._pieces = max(1, _PIECE_PX // self._windows[0][0].size)
        self._learning = self._learned(self._windows[-wanted:])
        self._windows = []

    def changed(self, chi2_per_dof: float, poor_frames: float) -> bool:
        """Whether the beam has changed since the choice."""
        return poor_frames >= _CHANGED_FRAMES and chi2_per_dof > _CHANGED_RATIO * self._chi2_per_dof

    def with_width_error(self, spot: Spot) -> Spot:
        """The spot, with larger uncertainties if it is doubtful and its width has changed."""
        if not spot.flags & _DOUBTFUL_FLAGS or spot.flags & (SpotFlag.LEARNED | SpotFlag.LOST):
            return spot
        by_x = abs(spot.sigma_x_px - self._width_x_px)
        by_y = abs(spot.sigma_y_px - self._width_y_px)
        if spot.rotation_rad:
            by_x = by_y = max(by_x, by_y)
        # the width of a Gaussian has the same standard uncertainty as its position
        if not max(by_x, by_y) > _SIGNIFICANT_CHANGE * max(spot.u_x_px, spot.u_y_px):
            return spot
        return spot._replace(
            u_x_px=math.hypot(spot.u_x_px, _SHIFT_PER_WIDTH_CHANGE * by_x),
            u_y_px=math.hypot(spot.u_y_px, _SHIFT_PER_WIDTH_CHANGE * by_y),
        )

    def _learn(self) -> None:
        assert self._learning is not None
        try:
            for _ in range(self._pieces):
                next(self._learning)
        except StopIteration as end:
            profile: BeamProfile | None = end.value
            # the same test as for a second spot: the excess of chi-square falls by at least half
            if profile is not None and profile.chi2_per_dof - 1.0 < 0.5 * (self._chi2_per_dof - 1.0):
                self.profile, self._chi2_per_dof = profile, max(profile.chi2_per_dof, 1.0)
            self._settle()

    def _settle(self) -> None:
        self._windows, self._learning = [], None
        gaussian = SpotModel.TWO if self._two else SpotModel.ONE
        self.model = gaussian if self.profile is None else SpotModel.LEARNED
        if self._widths:
            self._width_x_px, self._width_y_px = map(median, zip(*self._widths, strict=True))
            self._widths = []

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
