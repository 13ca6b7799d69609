"""Axes of XY plots: ticks, grid lines and labels in the plane of a Spatial2DView.

Rerun has no XY plots. A `Graticule` maps values to points of the plane (whose y axis points down, so that y
is negated) and gives the lines of the grid and the positions of the labels. The last functions convert it,
and the cross at the spot, to Rerun's archetypes.
"""

import math
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from processing.arrays import Floats
from rig.terminal import palette

PLANE_REACH = 100.0
"""Half the side of the trajectory's axes, in units of the plane."""
BOX = (126.0, 100.0)
"""Width and height of all other axes, in units of the plane."""
BACKGROUND: Final = (18, 20, 24)
GRID_COLOUR: Final = (48, 52, 60)
AXIS_COLOUR: Final = (110, 116, 126)
LABEL_COLOUR: Final = (235, 238, 242)
CROSS_INNER: Final = 0.06
CROSS_OUTER: Final = 0.14
"""Distances from the spot at which the arms of the cross begin and end, over the image's smaller side."""


def ticks(low: float, high: float) -> Floats:
    """Round values within [low, high], about six, in steps of 1, 2 or 5 times a power of ten."""
    span = high - low
    if not (math.isfinite(span) and span > 0):
        return np.array([low])
    rough_step = span / 6
    power = 10.0 ** math.floor(math.log10(rough_step))
    step = next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= rough_step * 0.999)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return np.arange(first, last + 1, dtype=np.float64) * float(step)


def tick_label(value: float, step: float) -> str:
    """The value with as many decimals as the step needs, and a typographic minus sign."""
    decimals = max(0, -math.floor(math.log10(step) + 1e-9)) if step > 0 else 3
    text = f"{value:.{decimals}f}"
    return text.replace("-", "\N{MINUS SIGN}") if float(text) != 0 else f"{0:.{decimals}f}"


@dataclass(frozen=True, slots=True)
class Graticule:
    """Axes over [x_low, x_high] x [y_low, y_high] with titles, and the mapping into the plane.

    A value (x, y) is at ``((x - x_zero) * x_scale, -(y - y_zero) * y_scale)`` in the plane.
    """

    x_low: float
    x_high: float
    y_low: float
    y_high: float
    x_title: str
    y_title: str
    x_zero: float = 0.0
    y_zero: float = 0.0
    x_scale: float = 1.0
    y_scale: float = 1.0
    titles_outside: bool = False
    """Whether the titles are beside the axes, not within them."""

    @classmethod
    def boxed(cls, x: Floats, y: Floats, x_title: str, y_title: str, *, trims_y: bool = False) -> Self:
        """Axes a little wider than the range of the finite values, of the size BOX in the plane.

        If it `trims_y`, the lowest and highest 2 % of y are ignored, because a few uncertain points would
        make the range so large that the others could not be distinguished.
        """
        x_low, x_high = _padded_range(x, 0.0)
        y_low, y_high = _padded_range(y, 0.02 if trims_y else 0.0)
        width, height = BOX
        scales = width / (x_high - x_low), height / (y_high - y_low)
        return cls(x_low, x_high, y_low, y_high, x_title, y_title, x_low, y_low, *scales, titles_outside=True)

    def inside(self, x: Floats, y: Floats) -> NDArray[np.bool_]:
        """Which of the values (n,) lie within the axes; False for NaN."""
        return (x >= self.x_low) & (x <= self.x_high) & (y >= self.y_low) & (y <= self.y_high)

    def to_plane(self, x: Floats, y: Floats) -> Floats:
        """Points (n, 2) of the plane for values x, y (n,)."""
        across = (np.asarray(x, dtype=np.float64) - self.x_zero) * self.x_scale
        up = (np.asarray(y, dtype=np.float64) - self.y_zero) * self.y_scale
        return np.column_stack((across, -up))

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in the plane."""
        return (self.x_high - self.x_low) * self.x_scale, (self.y_high - self.y_low) * self.y_scale

    def lines(self) -> tuple[list[Floats], list[Floats]]:
        """Grid lines, and the frame with the lines through zero if zero is inside."""
        grid = [self._horizontal(y) for y in ticks(self.y_low, self.y_high)]
        grid += [self._vertical(x) for x in ticks(self.x_low, self.x_high)]
        axes = [self._horizontal(y) for y in (self.y_low, self.y_high)]
        axes += [self._vertical(x) for x in (self.x_low, self.x_high)]
        if self.y_low < 0 < self.y_high:
            axes.append(self._horizontal(0.0))
        if self.x_low < 0 < self.x_high:
            axes.append(self._vertical(0.0))
        return grid, axes

    def labels(self) -> list[tuple[float, float, str]]:
        """Points (x, y) of the plane with tick labels below and to the left, and titles at the axes' ends."""
        width, height = self.size
        x_ticks, y_ticks = ticks(self.x_low, self.x_high), ticks(self.y_low, self.y_high)
        labels = [
            self._label(x, self.y_low, tick_label(x, _step(x_ticks)), 0.0, 0.03 * height) for x in x_ticks
        ]
        labels += [
            # Rerun draws a label below its point: these are moved up to the height of their lines.
            self._label(self.x_low, y, tick_label(y, _step(y_ticks)), -0.075 * width, -0.03 * height)
            for y in y_ticks
        ]
        # A trajectory leaves the corners free for its titles; other curves do not.
        x_down, y_down = (0.105, -0.095) if self.titles_outside else (-0.07, 0.03)
        labels.append(self._label(self.x_high, self.y_low, self.x_title, -0.17 * width, x_down * height))
        labels.append(self._label(self.x_low, self.y_high, self.y_title, 0.17 * width, y_down * height))
        return labels

    def _label(self, x: float, y: float, text: str, right: float, down: float) -> tuple[float, float, str]:
        plane_x, plane_y = self.to_plane(np.array([x]), np.array([y]))[0]
        return plane_x + right, plane_y + down, text

    def _horizontal(self, y: float) -> Floats:
        return self.to_plane(np.array([self.x_low, self.x_high]), np.array([y, y]))

    def _vertical(self, x: float) -> Floats:
        return self.to_plane(np.array([x, x]), np.array([self.y_low, self.y_high]))


def reach_beyond(amplitude: float) -> float:
    """Half the length of an axis for an amplitude: 1, 1.5, 2, 3, 5 or 7 times a power of ten above it."""
    if not (math.isfinite(amplitude) and amplitude > 0):
        return 1.0
    power = 10.0 ** math.floor(math.log10(amplitude))
    return next(
        power * step for step in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0) if power * step > 1.02 * amplitude
    )


def trajectory_graticule(reach: float, unit: str, x_stretch: float = 1.0) -> Graticule:
    """Axes of the trajectory from -reach to reach, with a range of X that is `x_stretch` times smaller.

    They always extend from -PLANE_REACH to PLANE_REACH in the plane, so that the view does not change.
    """
    scale = PLANE_REACH / reach
    return Graticule(
        x_low=-reach / x_stretch,
        x_high=reach / x_stretch,
        y_low=-reach,
        y_high=reach,
        x_title=f"X / {unit}",
        y_title=f"Y / {unit}",
        x_scale=x_stretch * scale,
        y_scale=scale,
    )


def _padded_range(values: Floats, trim: float) -> tuple[float, float]:
    """Range of the finite values with a margin; the fraction `trim` of them at either end is ignored."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 1.0
    low, high = (float(edge) for edge in np.quantile(finite, (trim, 1.0 - trim)))
    relative_margin = 0.05 if trim == 0.0 else 0.5
    margin = relative_margin * (high - low) if high > low else 0.5 * abs(high) or 1.0
    return low - margin, high + margin


def _step(values: Floats) -> float:
    return float(values[1] - values[0]) if len(values) > 1 else 0.0


def graticule_marks(graticule: Graticule) -> dict[str, rr.AsComponents]:
    """Grid, axes and labels of a graticule, by entity name."""
    grid, axes = graticule.lines()
    *positions, texts = zip(*graticule.labels(), strict=True)
    return {
        "grid": rr.LineStrips2D(grid, colors=GRID_COLOUR, radii=rr.Radius.ui_points(0.3), draw_order=-20.0),
        "axes": rr.LineStrips2D(axes, colors=AXIS_COLOUR, radii=rr.Radius.ui_points(0.5), draw_order=-10.0),
        "labels": rr.Points2D(
            np.column_stack(positions),
            labels=texts,
            show_labels=True,
            colors=LABEL_COLOUR,
            radii=rr.Radius.ui_points(0.0),
        ),
    }


def spot_cross(x_px: float, y_px: float, shape: tuple[int, int]) -> rr.LineStrips2D:
    """Four lines that point at the spot without covering it; `shape` is (ny, nx) of the image."""
    inner, outer = CROSS_INNER * min(shape), CROSS_OUTER * min(shape)
    # In Rerun, (0, 0) is the corner of the first pixel; positions of the spot count from its centre.
    x, y = x_px + 0.5, y_px + 0.5
    arms = [
        [(x + dx * inner, y + dy * inner), (x + dx * outer, y + dy * outer)]
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))
    ]
    colour = palette.rgba(palette.VERMILLION)
    return rr.LineStrips2D(arms, colors=[colour], radii=rr.Radius.ui_points(1.0), draw_order=30.0)


def faded(colour: str, fraction: float) -> tuple[int, int, int]:
    """A fraction of a colour over the background; opaque, because lines would brighten at crossings."""
    channels = zip(palette.rgba(colour)[:3], BACKGROUND, strict=True)
    red, green, blue = (round(fraction * c + (1 - fraction) * background) for c, background in channels)
    return red, green, blue
