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
from processing.spot.outcome import MAX_REMAINING_EXCESS
from processing.spot.profile import LEARNING_ITERATIONS, BeamProfile, Sample, Shape, learn
from processing.spot.sensor_model import PixelNoise

_SAMPLE_INTERVAL = 4
"""Frames from one sample to the next."""
_MIN_SAMPLES, _MAX_SAMPLES = 16, 32
_SAMPLED_PX = 1_000_000
"""Pixels of all samples: a large spot needs fewer samples, as its profile is smoothed over more pixels."""
_LEARNED_PX_PER_FRAME = 50_000
"""Pixels of the samples that learning processes in each frame."""
MAX_CHOICE_FRAMES = (_SAMPLE_INTERVAL + LEARNING_ITERATIONS + 2) * _MAX_SAMPLES + 2
"""Most frames that a choice takes: for each sample _SAMPLE_INTERVAL, one for its fit by a Gaussian and
LEARNING_ITERATIONS + 1 for its fits by the profile; and two for the first and the last step of learning."""
_MIN_POOR_FRAMES = 256
"""Fewest frames in a row with a poor fit that show a change of the beam."""
_MIN_CHI2_RATIO = 2.0
"""Smallest ratio of chi2/dof to that at the choice that shows a change of the beam."""
_DOUBTFUL_FLAGS = SpotFlag.POOR_FIT | SpotFlag.OUTLIERS | SpotFlag.MULTIPLE | SpotFlag.CUT
_SHIFT_PER_WIDTH_CHANGE = 2.0
"""Shift of the fitted position by an obstacle without a sharp edge, relative to the change of the fitted
width. Calculated: 1.0 if the edge lies 1 sigma before the centre, 2.1 if it lies 2 sigma beyond."""
_SIGNIFICANT_CHANGE = 3.0
"""Change of the width, in its standard uncertainties, below which it is noise."""


class SpotModel(StrEnum):
    """Model of the beam that is fitted to every frame."""

    ONE = "one Gaussian"
    TWO = "two Gaussians"
    LEARNED = "learned profile"


Refit = Callable[[Image, tuple[int, int]], tuple[Floats, Shape] | None]
"""Function that fits one Gaussian to a window, given the sensor coordinates of its first pixel. It returns
(x, y, amplitude, background), with x and y on the sensor, and the shape; None without a spot."""


class ModelChoice:
    """Choice of the model from the first spots of a run, and detection of a later change of the beam.

    `model` is None as long as it is not chosen; `profile` is the learned profile, None for another model.
    Doubtful spots are compared with the median widths of the first ones: an obstacle that hides light on one
    side without a visible edge makes the spot narrower (or wider) than the beam, and shifts it by about as
    much.
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
        self._has_second = False
        self._chi2_sum = 0.0
        self._chi2_per_dof = 1.0
        self._steps_per_frame = 1
        self._windows: list[tuple[Image, tuple[int, int]]] = []
        self._widths: list[tuple[float, float]] = []
        self._width_x_px = self._width_y_px = math.nan
        self._learning: Generator[None, None, BeamProfile | None] | None = None

    def add(self, spot: Spot, sample: Callable[[], tuple[Image, tuple[int, int]]]) -> None:
        """Add a spot that was tracked while the model was not chosen.

        `sample` returns a window of the frame and the sensor coordinates of its first pixel.
        """
        if not spot.flags & (SpotFlag.LOST | SpotFlag.EDGE | SpotFlag.CUT):
            self._widths.append((spot.sigma_x_px, spot.sigma_y_px))
        if self._learning is not None:
            self._advance_learning(self._learning)
            return
        if spot.flags & SpotFlag.LOST:  # an obstacle hides it
            return
        has_second = bool(spot.flags & SpotFlag.MULTIPLE)
        if has_second != self._has_second:  # the second spot has vanished, or a search has found one
            self._has_second, self._frames, self._chi2_sum = has_second, 0, 0.0
        if self._frames % _SAMPLE_INTERVAL == 0:
            self._windows.append(sample())
        self._frames += 1
        self._chi2_sum += spot.chi2_per_dof
        samples = min(max(_SAMPLED_PX // self._windows[0][0].size, _MIN_SAMPLES), _MAX_SAMPLES)
        if self._frames < _SAMPLE_INTERVAL * samples:
            return
        self._chi2_per_dof = self._chi2_sum / self._frames
        fitted_px = (2.0 * REACH) ** 2 * spot.sigma_x_px * spot.sigma_y_px
        if self._chi2_per_dof <= chi2_limit(fitted_px * self._frames):
            self._fix_choice()
            return
        self._steps_per_frame = max(1, _LEARNED_PX_PER_FRAME // self._windows[0][0].size)
        self._learning = self._learning_steps(self._windows[-samples:])
        self._windows = []

    def changed(self, chi2_per_dof: float, poor_frames: float) -> bool:
        """Whether the beam has changed since the choice."""
        return poor_frames >= _MIN_POOR_FRAMES and chi2_per_dof > _MIN_CHI2_RATIO * self._chi2_per_dof

    def with_width_error(self, spot: Spot) -> Spot:
        """The spot, with larger uncertainties if it is doubtful and its width has changed."""
        if not spot.flags & _DOUBTFUL_FLAGS or spot.flags & (SpotFlag.LEARNED | SpotFlag.LOST):
            return spot
        change_x_px = abs(spot.sigma_x_px - self._width_x_px)
        change_y_px = abs(spot.sigma_y_px - self._width_y_px)
        if spot.rotation_rad:
            change_x_px = change_y_px = max(change_x_px, change_y_px)
        # the width of a Gaussian has the same standard uncertainty as its position
        if not max(change_x_px, change_y_px) > _SIGNIFICANT_CHANGE * max(spot.u_x_px, spot.u_y_px):
            return spot
        return spot._replace(
            u_x_px=math.hypot(spot.u_x_px, _SHIFT_PER_WIDTH_CHANGE * change_x_px),
            u_y_px=math.hypot(spot.u_y_px, _SHIFT_PER_WIDTH_CHANGE * change_y_px),
        )

    def _advance_learning(self, learning: Generator[None, None, BeamProfile | None]) -> None:
        try:
            for _ in range(self._steps_per_frame):
                next(learning)
        except StopIteration as end:
            profile: BeamProfile | None = end.value
            # the same test as for a second spot
            limit = MAX_REMAINING_EXCESS * (self._chi2_per_dof - 1.0)
            if profile is not None and profile.chi2_per_dof - 1.0 < limit:
                self.profile, self._chi2_per_dof = profile, max(profile.chi2_per_dof, 1.0)
            self._fix_choice()

    def _fix_choice(self) -> None:
        self._windows, self._learning = [], None
        gaussian = SpotModel.TWO if self._has_second else SpotModel.ONE
        self.model = gaussian if self.profile is None else SpotModel.LEARNED
        if self._widths:
            self._width_x_px, self._width_y_px = map(median, zip(*self._widths, strict=True))
            self._widths = []

    def _learning_steps(
        self, windows: list[tuple[Image, tuple[int, int]]]
    ) -> Generator[None, None, BeamProfile | None]:
        """Learn the profile; it starts from fits of single Gaussians."""
        samples, shapes = [], []
        for pixels, origin_px in windows:
            gaussian = self._refit(pixels, origin_px)
            if gaussian is not None:
                parameters, shape = gaussian
                samples.append(Sample(pixels, origin_px, *parameters.tolist()))
                shapes.append(shape)
            yield
        if len(samples) < _MIN_SAMPLES // 2:
            return None
        median_shape = Shape(*np.median(np.array(shapes), axis=0).tolist())
        return (yield from learn(samples, median_shape, self._noise))
