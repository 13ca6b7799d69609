"""What a view shows, as plain values: each becomes a message to whatever draws it."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.record.events import Level
from processing.deflections import DeflectionUnit
from processing.estimate import Estimate
from processing.spot import SpotFlag
from processing.swing import Swing
from processing.ticks import seconds
from rig.presentation import Shown, quantity
from rig.rerun import (
    BalanceNumbers,
    ClockDrift,
    Curve,
    Estimates,
    Fits,
    Floats,
    LogLine,
    Losses,
    Message,
    Picture,
    ReferenceSamples,
    Samples,
    State,
    Swings,
)


class ShownValues(ABC):
    """Takes plain values of a run or a record; angles in `unit`, arrays are copied.

    `parameters` are the keys of those that are estimated while a run is measured, `full_scale_dn` the pixel
    value shown white, None for the largest of the image's type. Where the messages go says who derives
    from this.
    """

    def __init__(self, unit: DeflectionUnit, parameters: Sequence[str], full_scale_dn: int | None) -> None:
        self._unit = unit
        self._parameters = {key: _in_panel(key) for key in parameters}
        self._full_scale_dn = full_scale_dn
        self._reference_origin_px: dict[str, tuple[float, float]] = {}

    @abstractmethod
    def _put(self, message: Message) -> None:
        """Pass a message on."""

    @property
    @abstractmethod
    def _dropped(self) -> int:
        """How much of what was passed on was lost."""

    def samples(
        self, times_s: ArrayLike, x: ArrayLike, y: ArrayLike, flags: ArrayLike, *, run: str = ""
    ) -> None:
        """Deflections of one or many frames as shown, arrays of one length; NaN where the spot was lost."""
        # a model that every spot of a run has is nothing that must be seen
        copied_flags = np.array(flags, dtype=np.int64, ndmin=1) & ~int(SpotFlag.MULTIPLE | SpotFlag.LEARNED)
        self._put(Samples(run, _floats(times_s), _floats(x), _floats(y), copied_flags))

    def reference(
        self, times_s: ArrayLike, x_px: ArrayLike, y_px: ArrayLike, lost: ArrayLike, *, run: str = ""
    ) -> None:
        """Positions of the reference spot in one or many frames; shown from where it was first found."""
        gone = np.array(lost, ndmin=1) != 0
        x, y = (np.where(gone, np.nan, _floats(values)) for values in (x_px, y_px))
        found = np.flatnonzero(np.isfinite(x + y))
        if run not in self._reference_origin_px:
            if not len(found):
                return
            self._reference_origin_px[run] = (float(x[found[0]]), float(y[found[0]]))
        origin_x, origin_y = self._reference_origin_px[run]
        self._put(ReferenceSamples(run, _floats(times_s), x - origin_x, y - origin_y))

    def swings(self, swings: Sequence[Swing], start_ns: int, *, run: str = "") -> None:
        """Half-cycles of the slow mode at their turning points: amplitude and (whole) period."""
        size = self._unit.shown_size
        self._put(
            Swings(
                run,
                seconds(np.array([swing.turn_time_ns for swing in swings]) - start_ns),
                _floats([swing.amplitude / size for swing in swings]),
                _floats([swing.u_amplitude / size for swing in swings]),
                _floats([2.0 * swing.half_period_s for swing in swings]),
                _floats([2.0 * swing.u_half_period_s for swing in swings]),
            )
        )

    def balance(
        self, time_s: float, numbers: Mapping[str, tuple[float, float]], *, advice: str = "", run: str = ""
    ) -> None:
        """Balance at one moment: value and standard uncertainty by name (see `balance_numbers`)."""
        plain = {name: (float(value), float(u)) for name, (value, u) in numbers.items()}
        self._put(BalanceNumbers(run, float(time_s), plain, advice))

    def estimates(self, time_s: float, numbers: Mapping[str, Estimate]) -> None:
        """The view's parameters at one moment, value and standard uncertainty by key, as stored."""
        shown = {
            key: (one.factor * numbers[key].value, one.factor * numbers[key].standard_uncertainty)
            for key, one in self._parameters.items()
            if key in numbers
        }
        if shown:
            self._put(Estimates("", float(time_s), shown))

    def clock(self, time_s: float, drift_ppm: float, u_drift_ppm: float, *, run: str = "") -> None:
        """Rate of the camera's clock against the computer's, less 1, with its standard uncertainty."""
        self._put(ClockDrift(run, float(time_s), float(drift_ppm), float(u_drift_ppm)))

    def image(
        self,
        time_s: float,
        image: NDArray[np.uint8] | NDArray[np.uint16],
        spot_px: tuple[float, float] = (math.nan, math.nan),
        *,
        run: str = "",
    ) -> None:
        """Camera image (ny, nx) and the spot (x, y) in it; at most ten a second of the run are drawn."""
        full = self._full_scale_dn or int(np.iinfo(image.dtype).max)
        x_px, y_px = spot_px
        # A camera's frames are read-only and never written to again; anything else is copied.
        held = image.copy() if image.flags.writeable else image
        self._put(Picture(run, float(time_s), held, float(x_px), float(y_px), full))

    def losses(self, time_s: float, counts: Mapping[str, int], *, own: bool = True, run: str = "") -> None:
        """Losses since the start by name, e.g. ``dropped_frames``; with the view's `own`."""
        view = {"view_dropped": self._dropped} if own else {}
        self._put(Losses(run, float(time_s), {**counts, **view}))

    def state(self, text: str, *, time_s: float = math.nan, run: str = "") -> None:
        """State of the session, in Markdown; default of the time: the latest one."""
        self._put(State(run, float(time_s), text))

    def log(self, time_s: float, level: Level, text: str, *, kind: str = "", run: str = "") -> None:
        """One line of the log; `kind` is that of an event."""
        self._put(LogLine(run, float(time_s), level, text, kind))

    def fits(self, curves: Sequence[Curve], text: str = "", *, run: str = "") -> None:
        """Curves of the analysing layout and the report's text (Markdown)."""
        self._put(Fits(run, tuple(curves), text))


def _in_panel(key: str) -> Shown:
    """A parameter as its panel shows it: the viewer's axes have no powers of ten, and c is some 10⁻⁸."""
    shown = quantity(key)
    return replace(shown, symbol="10⁹ c", factor=1e9 * shown.factor) if key == "c" else shown


def _floats(values: ArrayLike) -> Floats:
    return np.array(values, dtype=np.float64, ndmin=1)
