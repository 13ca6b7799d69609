"""Draws messages into one Rerun stream."""

from typing import Final

import cv2
import numpy as np
import rerun as rr

from acquisition.record.events import EventKind, Level
from processing.angle import ARCSEC_RAD
from rig.presentation import balance_drawn, balance_table, palette, quantity
from rig.rerun import layout
from rig.rerun.across import AcrossTheSwing
from rig.rerun.analysis_panels import draw_fits
from rig.rerun.gathering import Breaks, Decimator, Gathering
from rig.rerun.lissajous import Lissajous
from rig.rerun.marks import spot_cross
from rig.rerun.messages import (
    BalanceNumbers,
    ClockDrift,
    Estimates,
    Fits,
    Floats,
    LogLine,
    Losses,
    Message,
    Picture,
    ReferenceSamples,
    Samples,
    Setup,
    State,
    Swings,
    is_drawn,
)

DRAWN_RATE_HZ, REFERENCE_RATE_HZ = 100.0, 10.0
"""Largest rates of the samples that are drawn; the reference spot is watched for what drifts."""
JPEG_QUALITY = 90
SAMPLES_GAP, POINTS_GAP = 1.0, 4.0
"""Periods of the slow mode without a value after which a curve is broken: that of the samples, and those of
half-cycles and balance, which have a value at least every period."""
LEVELS = {
    Level.INFORMATION: rr.TextLogLevel.INFO,
    Level.WARNING: rr.TextLogLevel.WARN,
    Level.ALARM: rr.TextLogLevel.ERROR,
    Level.TRIP: rr.TextLogLevel.CRITICAL,
}

_GOOD, _BAD, _OVER = palette.BLUISH_GREEN, palette.VERMILLION, palette.GREY
_STATES: Final = {
    "measuring": _GOOD,
    "ended": _OVER,
    "followed": _GOOD,
    "lost": _BAD,
    "arriving": _GOOD,
    "silent": palette.ORANGE,
    "camera lost": _BAD,
    "lit": _GOOD,
    "dark": _BAD,
}
_CHANGES: Final[dict[str, dict[str, str]]] = {
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
    EventKind.LASER_LIT: {"laser": "lit"},
}


class Lanes:
    """Draws the lanes of all runs into one stream."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._known: set[str] = set()

    def draw(self, run: str, kind: str) -> None:
        """Change the lanes as an event of this kind says; its time is set already."""
        for lane, state in _CHANGES.get(kind, {}).items():
            entity = layout.entity(run, lane)
            if entity not in self._known:
                self._known.add(entity)
                colours = [palette.rgba(colour) for colour in _STATES.values()]
                shown = rr.StateConfiguration(values=list(_STATES), colors=colours)
                self._stream.log(entity, shown, static=True)
            self._stream.log(entity, rr.StateChange(state=state))


class Drawing:
    """Draws into one stream; curves are gathered and sent in blocks.

    Parameters
    ----------
    stream
        A Rerun recording whose sinks are set.
    setup
        Names and units, expected period and amplitude.
    gather_s, gather_rows
        Limits of `Gathering`.
    picture_interval_s
        Shortest interval of pictures in run time; pictures between are left out.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        setup: Setup,
        *,
        gather_s: float,
        gather_rows: int,
        picture_interval_s: float,
    ) -> None:
        self._stream = stream
        self._setup = setup
        self._gathered = Gathering(stream, gather_s, gather_rows)
        self._lanes = Lanes(stream)
        self._lissajous = Lissajous(
            stream,
            self._gathered,
            setup.unit,
            setup.amplitude,
            setup.period_s if len(setup.runs) < 2 else None,
        )
        self._picture_interval_s = picture_interval_s
        self._last_picture_s: dict[str, float] = {}
        self._latest_s = 0.0
        self._breaks = Breaks()
        self._decimators: dict[str, Decimator] = {}
        self._named: set[str] = set()
        self._across: dict[str, AcrossTheSwing] = {}

    def draw(self, message: Message) -> None:
        """Draw one message, or gather it for the next block."""
        match message:
            case Samples():
                self._draw_samples(message)
            case ReferenceSamples():
                self._draw_reference(message)
            case Swings():
                self._draw_swings(message)
            case BalanceNumbers():
                self._draw_balance(message)
            case Estimates():
                self._draw_estimates(message)
            case ClockDrift():
                self._draw_clock(message)
            case Picture():
                self._draw_picture(message)
            case Losses():
                self._draw_losses(message)
            case State():
                self._draw_text(message.run, layout.STATE, message.time_s, message.text)
            case LogLine():
                self._draw_log_line(message)
            case Fits():
                draw_fits(self._stream, message, self._setup.unit)

    def send(self, *, now: bool = False) -> None:
        """Send what was gathered if a limit of `Gathering` is reached, or in any case if `now`."""
        self._gathered.send(now=now)

    def _draw_samples(self, message: Samples) -> None:
        decimator = self._decimators.setdefault(message.run, Decimator(DRAWN_RATE_HZ))
        chosen = decimator.choose(message.time_s, message.flags)
        if not chosen.any():
            return
        gap_s = SAMPLES_GAP * self._setup.period_s
        time_s, x, y = self._breaks.in_gaps(
            layout.entity(message.run, layout.X),
            gap_s,
            message.time_s[chosen],
            message.x[chosen],
            message.y[chosen],
        )
        alone = len(self._setup.runs) < 2
        colour = palette.GREY if alone else palette.X_COLOUR
        self._gather(message.run, layout.X, time_s, x, f"X / {self._setup.unit}", colour)
        if alone:
            self._draw_across(message.run, time_s, x, y)
        self._gather(message.run, layout.Y, time_s, y, f"Y / {self._setup.unit}", palette.Y_COLOUR)
        colour = self._run_colour(message.run, palette.TRAJECTORY_COLOUR)
        self._lissajous.draw(message.run, time_s, x, y, colour)
        self._lissajous.follow(message.time_s, message.x, message.y)

    def _draw_across(self, run: str, time_s: Floats, x: Floats, y: Floats) -> None:
        """What of X is the fast mode, and what the slow one leaks into it."""
        parts = self._across.setdefault(run, AcrossTheSwing()).samples(time_s, x, y)
        if parts is not None:
            self._gather(
                run, layout.LEAKAGE, parts.time_s, parts.leakage, "slow mode's leakage", palette.BLUE
            )
            self._gather(run, layout.FAST, parts.time_s, parts.fast, "fast mode", palette.X_COLOUR)

    def _draw_reference(self, message: ReferenceSamples) -> None:
        name = f"{message.run}/{layout.REFERENCE}"
        decimator = self._decimators.setdefault(name, Decimator(REFERENCE_RATE_HZ))
        chosen = decimator.choose(message.time_s, np.zeros(len(message.time_s), dtype=np.int64))
        if not chosen.any():
            return
        time_s, x, y = self._breaks.in_gaps(
            layout.entity(message.run, layout.REFERENCE),
            SAMPLES_GAP * self._setup.period_s,
            message.time_s[chosen],
            message.x_px[chosen],
            message.y_px[chosen],
        )
        for path, values, colour in (("x", x, palette.X_COLOUR), ("y", y, palette.Y_COLOUR)):
            self._gather(message.run, f"{layout.REFERENCE}/{path}", time_s, values, f"{path} / px", colour)

    def _draw_swings(self, message: Swings) -> None:
        for path, value, u, colour, unit in (
            (
                layout.AMPLITUDE,
                message.amplitude,
                message.u_amplitude,
                palette.AMPLITUDE_COLOUR,
                self._setup.unit,
            ),
            (layout.PERIOD, message.period_s, message.u_period_s, palette.PERIOD_COLOUR, "s"),
        ):
            good = np.isfinite(value)
            if good.any():
                self._gather_uncertain(
                    message.run, path, message.time_s[good], value[good], u[good], f"{path} / {unit}", colour
                )

    def _draw_balance(self, message: BalanceNumbers) -> None:
        at = np.array([message.time_s])
        size = ARCSEC_RAD if self._setup.unit == "arcsec" else 1.0
        self._across.setdefault(message.run, AcrossTheSwing()).balance(message.time_s, message.numbers, size)
        for name, (value, u) in message.numbers.items():
            shown, drawn = quantity(name, self._setup.unit), balance_drawn(name)
            if np.isfinite(value):
                self._gather_uncertain(
                    message.run,
                    f"{layout.BALANCE_ROOT}/{drawn.entity}",
                    at,
                    np.array([shown.factor * value]),
                    np.array([shown.factor * u]),
                    shown.label,
                    drawn.colour,
                )
        table = balance_table(message.numbers, self._setup.unit)
        self._draw_text(message.run, layout.BALANCE_TABLE, message.time_s, table)
        if message.advice:
            self._draw_text(message.run, layout.ADVICE, message.time_s, message.advice)

    def _draw_estimates(self, message: Estimates) -> None:
        """What is known to a half of its value: the first values would hide all later ones."""
        at = np.array([message.time_s])
        for number, (key, label) in enumerate(self._setup.parameters.items()):
            value, u = message.numbers.get(key, (np.nan, np.nan))
            if is_drawn(value, u):
                path, colour = f"{layout.PARAMETERS_ROOT}/{key}", palette.SEQUENCE[number]
                self._gather_uncertain(
                    message.run, path, at, np.array([value]), np.array([u]), label, colour, gap_periods=np.inf
                )

    def _draw_clock(self, message: ClockDrift) -> None:
        at = np.array([message.time_s])
        drift_ppm, u_ppm = np.array([message.drift_ppm]), np.array([message.u_drift_ppm])
        label = "camera's clock / ppm"
        self._gather_uncertain(
            message.run, layout.CLOCK, at, drift_ppm, u_ppm, label, palette.SKY_BLUE, gap_periods=np.inf
        )

    def _draw_picture(self, message: Picture) -> None:
        last = self._last_picture_s.get(message.run, -np.inf)
        if message.time_s - last < self._picture_interval_s * 0.999:
            return
        self._last_picture_s[message.run] = message.time_s
        self._set_time(message.time_s)
        image = message.image
        if image.dtype != np.uint8 or message.full_scale_dn != 255:
            image = np.clip(image * (255.0 / message.full_scale_dn), 0, 255).astype(np.uint8)
        done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        if done:
            encoded = rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg")
            self._stream.log(layout.entity(message.run, layout.IMAGE), encoded)
        spot = layout.entity(message.run, layout.SPOT)
        if np.isfinite(message.x_px) and np.isfinite(message.y_px):
            cross = spot_cross(message.x_px, message.y_px, (image.shape[0], image.shape[1]))
            self._stream.log(spot, cross)
        else:
            self._stream.log(spot, rr.Clear(recursive=False))

    def _draw_losses(self, message: Losses) -> None:
        at = np.array([message.time_s])
        for index, (name, count) in enumerate(sorted(message.counts.items())):
            colour = palette.LOSSES[index % len(palette.LOSSES)]
            label = name.replace("_", " ")
            path = f"{layout.LOSSES_ROOT}/{name}"
            self._gather(message.run, path, at, np.array([float(count)]), label, colour, steps=True)

    def _draw_log_line(self, message: LogLine) -> None:
        self._set_time(message.time_s)
        log = rr.TextLog(message.text, level=LEVELS[message.level])
        self._stream.log(layout.entity(message.run, layout.EVENTS), log)
        self._lanes.draw(message.run, message.kind)

    def _draw_text(self, run: str, path: str, time_s: float, text: str) -> None:
        self._set_time(time_s if np.isfinite(time_s) else self._latest_s)
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        self._stream.log(layout.entity(run, path), document)

    def _gather_uncertain(
        self,
        run: str,
        path: str,
        time_s: Floats,
        value: Floats,
        u: Floats,
        label: str,
        colour: str,
        gap_periods: float = POINTS_GAP,
    ) -> None:
        """A value with a band of one standard uncertainty on either side."""
        full = layout.entity(run, path)
        if full not in self._named:
            self._named.add(full)
            style = rr.Measurements.from_fields(
                names=f"{run} {label}".strip(),
                colors=[palette.rgba(self._run_colour(run, colour))],
                widths=[1.5],
            )
            self._stream.log(full, style, static=True)
        self._gathered.measurements(
            full, *self._breaks.in_gaps(full, gap_periods * self._setup.period_s, time_s, value, u)
        )
        self._latest_s = max(self._latest_s, float(time_s[-1]))

    def _gather(
        self,
        run: str,
        path: str,
        time_s: Floats,
        values: Floats,
        label: str,
        colour: str,
        steps: bool = False,
    ) -> None:
        full = layout.entity(run, path)
        if full not in self._named:
            self._named.add(full)
            name = f"{run} {label}".strip()
            colours = [palette.rgba(self._run_colour(run, colour))]
            mode = rr.components.InterpolationMode.StepAfter if steps else None
            style = rr.SeriesLines(colors=colours, names=name, widths=1.5, interpolation_mode=mode)
            self._stream.log(full, style, static=True)
        self._gathered.scalars(full, time_s, values)
        self._latest_s = max(self._latest_s, float(time_s[-1]))

    def _run_colour(self, run: str, colour: str) -> str:
        """The colour of the run if several are overlaid, otherwise that of the quantity."""
        runs = self._setup.runs
        if len(runs) < 2 or run not in runs or colour == palette.GREY:
            return colour
        return palette.SEQUENCE[runs.index(run) % len(palette.SEQUENCE)]

    def _set_time(self, time_s: float) -> None:
        self._stream.set_time(layout.TIMELINE, duration=time_s)
        self._latest_s = max(self._latest_s, time_s)
