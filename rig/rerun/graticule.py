"""Axes for panels that have none: ticks, lines and labels in the plane of a Spatial2DView.

Rerun draws no XY plots. A `Graticule` maps values onto the plane (y downward there, so values are
negated) and holds the grid's lines and the labels' places.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PLANE_REACH = 100.0
"""Half the side of the trajectory's axes in the plane."""
BOX = (126.0, 100.0)
"""Width and height of other axes in the plane."""


def ticks(low: float, high: float, about: int = 6) -> Floats:
    """Round values (1, 2 or 5 times a power of ten apart) within [low, high], about so many."""
    span = high - low
    if not (math.isfinite(span) and span > 0):
        return np.array([low])
    raw = span / max(about, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= raw * 0.999)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return np.arange(first, last + 1, dtype=np.float64) * float(step)


def tick_label(value: float, step: float) -> str:
    """The value with as many decimals as the step needs, minus sign and all."""
    decimals = max(0, -math.floor(math.log10(step) + 1e-9)) if step > 0 else 3
    text = f"{value:.{decimals}f}"
    return text.replace("-", "\N{MINUS SIGN}") if float(text) != 0 else f"{0:.{decimals}f}"


@dataclass(frozen=True, slots=True)
class Label:
    """Text at a point of the plane."""

    x: float
    y: float
    text: str


@dataclass(frozen=True, slots=True)
class Graticule:
    """Axes over [x_low, x_high] x [y_low, y_high] with titles, and the way into the plane.

    A value (x, y) lies at ``((x - x_zero) * x_scale, -(y - y_zero) * y_scale)``: with zeros of 0
    and scales of 1 the plane is the values' own, y negated.
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

    @classmethod
    def boxed(cls, x: Floats, y: Floats, x_title: str, y_title: str, *, trimmed: bool = False) -> Self:
        """Axes a little wider than the finite values, filling BOX in the plane.

        `trimmed`: the lowest and highest 2 % of y do not widen the axes, because a few uncertain
        points would hide the rest.
        """
        x_low, x_high = _padded(x, 0.0)
        y_low, y_high = _padded(y, 0.02 if trimmed else 0.0)
        width, height = BOX
        scales = width / (x_high - x_low), height / (y_high - y_low)
        return cls(x_low, x_high, y_low, y_high, x_title, y_title, x_low, y_low, *scales, titles_outside=True)

    def inside(self, x: Floats, y: Floats) -> NDArray[np.bool_]:
        """Which of the values lie within the axes; not those that are NaN."""
        return (x >= self.x_low) & (x <= self.x_high) & (y >= self.y_low) & (y <= self.y_high)

    def place(self, x: Floats, y: Floats) -> Floats:
        """Points (n, 2) of the plane for values x, y; y upward becomes y downward."""
        across = (np.asarray(x, dtype=np.float64) - self.x_zero) * self.x_scale
        up = (np.asarray(y, dtype=np.float64) - self.y_zero) * self.y_scale
        return np.column_stack((across, -up))

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in the plane."""
        return (self.x_high - self.x_low) * self.x_scale, (self.y_high - self.y_low) * self.y_scale

    def lines(self) -> tuple[list[Floats], list[Floats]]:
        """Grid lines, and the axes proper (through zero where it is inside, and the frame)."""
        grid = [self._across(y) for y in ticks(self.y_low, self.y_high)]
        grid += [self._up(x) for x in ticks(self.x_low, self.x_high)]
        axes = [
            self._across(self.y_low),
            self._across(self.y_high),
            self._up(self.x_low),
            self._up(self.x_high),
        ]
        if self.y_low < 0 < self.y_high:
            axes.append(self._across(0.0))
        if self.x_low < 0 < self.x_high:
            axes.append(self._up(0.0))
        return grid, axes

    def labels(self) -> list[Label]:
        """Tick labels below and to the left, the titles at the axes' ends."""
        width, height = self.size
        x_ticks, y_ticks = ticks(self.x_low, self.x_high), ticks(self.y_low, self.y_high)
        labels = [
            self._label(x, self.y_low, tick_label(x, _step(x_ticks)), 0.0, 0.03 * height) for x in x_ticks
        ]
        labels += [
            # Rerun writes a label below its point: these are lifted to the height of their lines.
            self._label(self.x_low, y, tick_label(y, _step(y_ticks)), -0.075 * width, -0.03 * height)
            for y in y_ticks
        ]
        # Curves begin and end in corners, a trajectory does not: its frame has room for the titles inside.
        x_down, y_down = (0.105, -0.095) if self.titles_outside else (-0.07, 0.03)
        labels.append(self._label(self.x_high, self.y_low, self.x_title, -0.17 * width, x_down * height))
        labels.append(self._label(self.x_low, self.y_high, self.y_title, 0.17 * width, y_down * height))
        return labels

    def _label(self, x: float, y: float, text: str, right: float, down: float) -> Label:
        (across, along) = self.place(np.array([x]), np.array([y]))[0]
        return Label(across + right, along + down, text)

    def _across(self, y: float) -> Floats:
        return self.place(np.array([self.x_low, self.x_high]), np.array([y, y]))

    def _up(self, x: float) -> Floats:
        return self.place(np.array([x, x]), np.array([self.y_low, self.y_high]))


def reach_beyond(amplitude: float) -> float:
    """The next of 1, 1.5, 2, 3, 5, 7 times a power of ten beyond the amplitude: half an axis' length."""
    if not (math.isfinite(amplitude) and amplitude > 0):
        return 1.0
    power = 10.0 ** math.floor(math.log10(amplitude))
    return next(
        power * step for step in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0) if power * step > 1.02 * amplitude
    )


def trajectory_graticule(reach: float, unit: str, x_stretch: float = 1.0) -> Graticule:
    """Axes of the trajectory from -reach to reach, X in a range `x_stretch` times smaller.

    Whatever the reach, the plane's part is -PLANE_REACH to PLANE_REACH: the view need not move.
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


def _padded(values: Floats, trim: float) -> tuple[float, float]:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 1.0
    low, high = (float(edge) for edge in np.quantile(finite, (trim, 1.0 - trim)))
    part = 0.05 if trim == 0.0 else 0.5
    margin = part * (high - low) if high > low else 0.5 * abs(high) or 1.0
    return low - margin, high + margin


def _step(values: Floats) -> float:
    return float(values[1] - values[0]) if len(values) > 1 else 0.0
