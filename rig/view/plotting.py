"""The plot of a run: its values as curves, tables, lanes and pictures in a Rerun stream."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from acquisition.record.events import Event, EventKind, Severity
from processing.arrays import Floats
from processing.estimate import Estimate
from processing.spot import SpotFlag
from processing.units import ARCSEC_RAD
from rig.terminal import QuantityDisplay, balance_style, balance_table, palette, quantity
from rig.view import layout
from rig.view.graticule import spot_cross
from rig.view.layout import Setup
from rig.view.transverse import Decimator, GapBreaker, Lissajous, SendBuffer, TransverseCurves

_MAX_SAMPLE_RATE_HZ, _MAX_REFERENCE_RATE_HZ = 100.0, 10.0
"""Largest rates of plotted samples; of the reference spot only drift is of interest."""
_MAX_SAMPLE_GAP, _MAX_POINT_GAP = 1.0, 4.0
"""Largest gaps, in periods of the slow mode, that a curve crosses: of samples; and of half-cycles and
balances, which come at least once in a period."""
_LOG_LEVELS = {
    Severity.INFORMATION: rr.TextLogLevel.INFO,
    Severity.WARNING: rr.TextLogLevel.WARN,
    Severity.ALARM: rr.TextLogLevel.ERROR,
    Severity.TRIP: rr.TextLogLevel.CRITICAL,
}

_GOOD, _BAD = palette.BLUISH_GREEN, palette.VERMILLION
_STATE_COLOURS: Final = {
    "measuring": _GOOD,
    "ended": palette.GREY,
    "followed": _GOOD,
    "lost": _BAD,
    "arriving": _GOOD,
    "silent": palette.ORANGE,
    "camera lost": _BAD,
    "lit": _GOOD,
    "dark": _BAD,
    "unknown": palette.ORANGE,
}
_STATES_AFTER_EVENT: Final[dict[str, dict[str, str]]] = {
    EventKind.START: {"run": "measuring", "spot": "followed", "frames": "arriving"},
    EventKind.STOP: {"run": "ended"},
    EventKind.REJECTED: {"run": "ended"},
    EventKind.SPOT_LOST: {"spot": "lost"},
    EventKind.SPOT_FOUND: {"spot": "followed"},
    EventKind.CAMERA_SILENT: {"frames": "silent"},
    EventKind.CAMERA_SPEAKS: {"frames": "arriving"},
    EventKind.CAMERA_LOST: {"frames": "camera lost"},
    EventKind.CAMERA_BACK: {"frames": "arriving"},
    EventKind.TRIP: {"laser": "dark"},
    EventKind.LASER_DARK: {"laser": "dark"},
    EventKind.LASER_UNKNOWN: {"laser": "unknown"},
    EventKind.LASER_LIT: {"laser": "lit"},
}


def _scalar_columns(values: Floats) -> Any:
    return rr.Scalars.columns(scalars=values)


def _measurement_columns(values: Floats, u: Floats) -> Any:
    return rr.Measurements.columns(values=values, variances=u**2)


class RunLanes:
    """Plots the lanes, which show states of a run against time."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._styled_lanes: set[str] = set()

    def plot(self, kind: str) -> None:
        """Change the lanes by an event of this kind; the stream's time must be set."""
        for lane, state in _STATES_AFTER_EVENT.get(kind, {}).items():
            entity = f"/{lane}"
            if entity not in self._styled_lanes:
                self._styled_lanes.add(entity)
                colours = [palette.rgba(colour) for colour in _STATE_COLOURS.values()]
                style = rr.StateConfiguration(values=list(_STATE_COLOURS), colors=colours)
                self._stream.log(entity, style, static=True)
            self._stream.log(entity, rr.StateChange(state=state))


class RunPlot:
    """Plots the values of a run into one stream; curves are buffered and sent in blocks.

    Times are seconds since the start of the run. The sinks of `stream` must be set; `limit_s` and
    `limit_rows` are those of `SendBuffer`.
    """

    def __init__(self, stream: rr.RecordingStream, setup: Setup, *, limit_s: float, limit_rows: int) -> None:
        self.setup = setup
        self.stream = stream
        self._buffer = SendBuffer(stream, limit_s, limit_rows)
        self._lanes = RunLanes(stream)
        self._lissajous = Lissajous(stream, self._buffer, setup.unit, setup.amplitude, setup.period_s)
        self._breaks = GapBreaker()
        self._decimator = Decimator(_MAX_SAMPLE_RATE_HZ)
        self._reference_decimator = Decimator(_MAX_REFERENCE_RATE_HZ)
        self._styled_curves: set[str] = set()
        self._transverse = TransverseCurves()
        self._reference_origin_px: tuple[float, float] | None = None

    def send(self, *, now: bool = False) -> None:
        """Send the buffered values if a limit is reached, or in any case if `now`."""
        self._buffer.send(now=now)

    def samples(self, time_s: Floats, x: Floats, y: Floats, flags: NDArray[np.int64]) -> None:
        """Plot deflections (n,) in the unit of the setup, NaN if the spot was lost, with flags."""
        # flags of the beam's model, which all spots of a run have, do not force a sample to be plotted
        chosen = self._decimator.choose(time_s, flags & ~int(SpotFlag.MULTIPLE | SpotFlag.LEARNED))
        if not chosen.any():
            return
        gap_s, unit = _MAX_SAMPLE_GAP * self.setup.period_s, self.setup.unit
        columns = time_s[chosen], x[chosen], y[chosen]
        curve_s, curve_x, curve_y = self._breaks.break_at_gaps(layout.X, gap_s, *columns)
        self._curve(layout.X, f"X / {unit}", palette.GREY, curve_s, curve_x)
        self._plot_transverse(curve_s, curve_x, curve_y)
        self._curve(layout.Y, f"Y / {unit}", palette.Y_COLOUR, curve_s, curve_y)
        self._lissajous.plot(curve_s, curve_x, curve_y)
        self._lissajous.follow(time_s, x, y)

    def _plot_transverse(self, time_s: Floats, x: Floats, y: Floats) -> None:
        """Plot the two parts of X: the fast mode, and the leakage of the slow mode."""
        separated = self._transverse.samples(time_s, x, y)
        if separated is not None:
            time_s, fast, leakage = separated
            self._curve(layout.LEAKAGE, "slow mode's leakage", palette.BLUE, time_s, leakage)
            self._curve(layout.FAST, "fast mode", palette.X_COLOUR, time_s, fast)

    def reference(self, time_s: Floats, x_px: Floats, y_px: Floats) -> None:
        """Plot the reference spot (n,) relative to its first position; NaN if it was lost."""
        if self._reference_origin_px is None:
            finite = np.flatnonzero(np.isfinite(x_px + y_px))
            if not len(finite):
                return
            self._reference_origin_px = float(x_px[finite[0]]), float(y_px[finite[0]])
        origin_x, origin_y = self._reference_origin_px
        chosen = self._reference_decimator.choose(time_s, np.zeros(len(time_s), dtype=np.int64))
        if not chosen.any():
            return
        gap_s = _MAX_SAMPLE_GAP * self.setup.period_s
        x, y = x_px[chosen] - origin_x, y_px[chosen] - origin_y
        curve_s, x, y = self._breaks.break_at_gaps(layout.REFERENCE, gap_s, time_s[chosen], x, y)
        for path, values, colour in (("x", x, palette.X_COLOUR), ("y", y, palette.Y_COLOUR)):
            self._curve(f"{layout.REFERENCE}/{path}", f"{path} / px", colour, curve_s, values)

    def half_cycles(
        self, time_s: Floats, amplitudes: tuple[Floats, Floats], periods_s: tuple[Floats, Floats]
    ) -> None:
        """Plot amplitude (shown unit) and full period in s at turning points (n,), each with its u."""
        for path, (value, u), colour, unit in (
            (layout.AMPLITUDE, amplitudes, palette.AMPLITUDE_COLOUR, self.setup.unit),
            (layout.PERIOD, periods_s, palette.PERIOD_COLOUR, "s"),
        ):
            is_finite = np.isfinite(value)
            if is_finite.any():
                columns = time_s[is_finite], value[is_finite], u[is_finite]
                self._curve(path, f"{path[1:]} / {unit}", colour, *columns, max_gap=_MAX_POINT_GAP)

    def balance(self, time_s: float, numbers: Mapping[str, tuple[float, float]]) -> None:
        """Plot the balance at one moment (see `balance_numbers`), as curves and as a table."""
        unit = self.setup.unit
        size = ARCSEC_RAD if unit == "arcsec" else 1.0
        self._transverse.balance(time_s, numbers, size)
        # plot the samples that have waited for the first balance
        self._plot_transverse(*[np.empty(0)] * 3)
        for name, (value, u) in numbers.items():
            display, style = quantity(name, unit), balance_style(name)
            if np.isfinite(value):
                path = f"{layout.BALANCE_ROOT}/{style.entity}"
                columns = time_s, display.factor * value, display.factor * u
                self._curve(path, display.label, style.colour, *columns, max_gap=_MAX_POINT_GAP)
        self.text(layout.BALANCE_TABLE, time_s, balance_table(numbers, unit))

    def estimates(self, time_s: float, numbers: Mapping[str, Estimate]) -> None:
        """Plot parameters of the contact that `is_plotted` accepts, by key, in the stored unit."""
        for number, (key, label) in enumerate(self.setup.parameters.items()):
            factor = parameter_display(key).factor
            value, u = (factor * number for number in numbers.get(key, Estimate(np.nan, np.nan)))
            if is_plotted(value, u):
                path, colour = f"{layout.PARAMETERS_ROOT}/{key}", palette.SEQUENCE[number]
                self._curve(path, label, colour, time_s, value, u)

    def clock(self, time_s: float, drift_ppm: float, u_drift_ppm: float) -> None:
        """Plot the rate of the camera's clock against the computer's, minus 1."""
        label = "camera's clock / ppm"
        self._curve(layout.CLOCK, label, palette.SKY_BLUE, time_s, drift_ppm, u_drift_ppm)

    def picture(
        self, time_s: float, jpeg: bytes, shape: tuple[int, int], spot_px: tuple[float, float]
    ) -> None:
        """Show a camera image (ny, nx) and the spot (x, y) in it, NaN if it was lost."""
        self._set_time(time_s)
        encoded = rr.EncodedImage(contents=jpeg, media_type="image/jpeg")
        self.stream.log(layout.IMAGE, encoded)
        mark = spot_cross(*spot_px, shape) if np.isfinite(spot_px).all() else rr.Clear(recursive=False)
        self.stream.log(layout.SPOT, mark)

    def losses(self, time_s: float, counts: Mapping[str, int]) -> None:
        """Plot counts since the start of the run, by name."""
        for index, (name, count) in enumerate(sorted(counts.items())):
            colour = palette.LOSSES[index % len(palette.LOSSES)]
            path, label = f"{layout.LOSSES_ROOT}/{name}", name.replace("_", " ")
            self._curve(path, label, colour, time_s, float(count), steps=True)

    def event(self, time_s: float, event: Event) -> None:
        """Show an event: a line of the log, and its changes of the lanes."""
        self._set_time(time_s)
        log = rr.TextLog(event.line, level=_LOG_LEVELS[event.level])
        self.stream.log(layout.EVENTS, log)
        self._lanes.plot(event.kind)

    def text(self, path: str, time_s: float, text: str) -> None:
        """Show a text in Markdown, the contents of a panel."""
        self._set_time(time_s)
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        self.stream.log(path, document)

    def _curve(
        self,
        path: str,
        label: str,
        colour: str,
        time_s: Floats | float,
        value: Floats | float,
        u: Floats | float | None = None,
        *,
        max_gap: float = np.inf,
        steps: bool = False,
    ) -> None:
        """Buffer values (n,) of a curve, with `u` in a band of one standard uncertainty on either side.

        `max_gap` is in periods of the slow mode.
        """
        if path not in self._styled_curves:
            self._styled_curves.add(path)
            colours = [palette.rgba(colour)]
            style: rr.AsComponents = rr.Measurements.from_fields(names=label, colors=colours, widths=[1.5])
            if u is None:
                mode = rr.components.InterpolationMode.StepAfter if steps else None
                style = rr.SeriesLines(colors=colours, names=label, widths=1.5, interpolation_mode=mode)
            self.stream.log(path, style, static=True)
        values = (np.atleast_1d(column) for column in (time_s, value, u) if column is not None)
        columns = self._breaks.break_at_gaps(path, max_gap * self.setup.period_s, *values)
        self._buffer.add(path, _scalar_columns if u is None else _measurement_columns, *columns)

    def _set_time(self, time_s: float) -> None:
        self.stream.set_time(layout.TIMELINE, duration=time_s)


def parameter_display(key: str) -> QuantityDisplay:
    """Display of a parameter in its panel: c, about 10⁻⁸, is scaled, because axes show no powers of ten."""
    display = quantity(key)
    return replace(display, symbol="10⁹ c", factor=1e9 * display.factor) if key == "c" else display


_MAX_RELATIVE_U = 0.5
"""Largest relative uncertainty of a parameter that is plotted."""


def is_plotted(value: float, u: float) -> bool:
    """Whether a parameter is known well enough to be plotted: the first values would hide all later ones."""
    return u <= _MAX_RELATIVE_U * abs(value)
