"""Messages from a session to the processes that draw with Rerun: plain values.

Times are seconds since the start of the run. `run` is the name of the run if several are overlaid, empty for
a single one.
"""

import struct
from collections.abc import Mapping
from enum import StrEnum
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.record.events import Level

ShowMode = Literal["spawn", "web"]
"""In a window, in a browser."""
Mode = Literal["none", ShowMode]
"""How the live stream is shown; none: not at all."""
LayoutName = Literal["balancing", "measuring", "analysing"]
Panel = Literal["decay", "residuals", "period", "period_residuals"]

Floats = NDArray[np.float64]


class Setup(NamedTuple):
    """First message to a worker.

    The worker writes the file `rrd_path`; if that is None it serves a live stream on `port` of a loopback
    address, which buffers up to `memory_limit` (such as "500MB"). `period_s` (slow mode) and `amplitude` are
    expected values, `unit` is that of all deflections. If the worker replaces another one, `viewer_url` is
    the address of the viewer, which must connect to the new stream; otherwise it is empty. `parameters`, with
    their labels, are estimated while the run is measured, and each has a panel of the measuring layout.
    With `has_reference` there is a panel for the spot of a mirror on the base.
    """

    title: str
    recording_id: str
    rrd_path: str | None
    layout: LayoutName
    runs: tuple[str, ...]
    period_s: float
    amplitude: float
    unit: str
    port: int
    memory_limit: str
    viewer_url: str
    parameters: Mapping[str, str] = {}
    has_reference: bool = False


class Samples(NamedTuple):
    """Deflections (n,) in the unit of the setup, NaN where the spot was lost, and flags of the spots."""

    run: str
    time_s: Floats
    x: Floats
    y: Floats
    flags: NDArray[np.int64]


class ReferenceSamples(NamedTuple):
    """Path of the reference spot in px from where it was first found, arrays (n,), NaN where it was lost."""

    run: str
    time_s: Floats
    x_px: Floats
    y_px: Floats


class Swings(NamedTuple):
    """Half-cycles of the slow mode: amplitude and full period at each turning point, arrays (n,)."""

    run: str
    time_s: Floats
    amplitude: Floats
    u_amplitude: Floats
    period_s: Floats
    u_period_s: Floats


class BalanceNumbers(NamedTuple):
    """Quantities of the balance by name, each with its standard uncertainty, and advice as Markdown.

    Names and units are those of `processing.balance.Balance`; its `unit` is that of the setup.
    """

    run: str
    time_s: float
    numbers: Mapping[str, tuple[float, float]]
    advice: str


class Estimates(NamedTuple):
    """Parameters of the setup at one moment, each with its standard uncertainty, as shown."""

    run: str
    time_s: float
    numbers: Mapping[str, tuple[float, float]]


class ClockDrift(NamedTuple):
    """Rate of the camera's clock against the computer's, less 1, and its standard uncertainty."""

    run: str
    time_s: float
    drift_ppm: float
    u_drift_ppm: float


_DRAWN_FROM = 0.5
"""Relative uncertainty from which on a parameter is drawn."""


def is_drawn(value: float, u: float) -> bool:
    """Whether a parameter is known well enough to be drawn: the first values would hide all later ones."""
    return u <= _DRAWN_FROM * abs(value)


class Picture(NamedTuple):
    """One camera image (ny, nx) in DN and the position of the spot in it (NaN if it was lost)."""

    run: str
    time_s: float
    image: NDArray[np.uint8] | NDArray[np.uint16]
    x_px: float
    y_px: float
    full_scale_dn: int


class Losses(NamedTuple):
    """Counts since the start of the run by name: lost frames, lost spots, messages dropped by the view."""

    run: str
    time_s: float
    counts: Mapping[str, int]


class State(NamedTuple):
    """State of the session as Markdown."""

    run: str
    time_s: float
    text: str


class LogLine(NamedTuple):
    """One line of the log panel; `kind` is that of an event, empty for any other line."""

    run: str
    time_s: float
    level: Level
    text: str
    kind: str = ""


class Curve(NamedTuple):
    """One curve of the analysing layout, drawn as points (data) or as a line (fit); arrays (n,).

    Axes of the panels: ``decay`` time in s, amplitude; ``residuals`` time in s, residual of the amplitude;
    ``period`` amplitude, period in s; ``period_residuals`` amplitude, residual in ms. Amplitudes are in
    the unit of the setup. NaN interrupts a line. `u_y` is drawn as error bars of one standard uncertainty.
    """

    panel: Panel
    name: str
    x: Floats
    y: Floats
    u_y: Floats | None = None
    style: Literal["points", "line"] = "line"


class Fits(NamedTuple):
    """Curves of the analysing layout, and the report's text as Markdown."""

    run: str
    curves: tuple[Curve, ...]
    text: str


class Finish(NamedTuple):
    """Last message: complete the file and end."""


Message = (
    Samples
    | ReferenceSamples
    | Swings
    | BalanceNumbers
    | Estimates
    | ClockDrift
    | Picture
    | Losses
    | State
    | LogLine
    | Fits
    | Finish
)


def rows(message: Message) -> int:
    """Number of samples or swings in a message; 1 for any other message."""
    return len(message.time_s) if isinstance(message, Samples | ReferenceSamples | Swings) else 1


def size_bytes(message: Message) -> int:
    """Approximate size of a message: its arrays and texts, and 200 bytes for the rest."""
    held: list[object] = list(message)
    if isinstance(message, Fits):
        held = [value for curve in message.curves for value in curve]
    return 200 + sum(
        value.nbytes if isinstance(value, np.ndarray) else len(value) if isinstance(value, str) else 0
        for value in held
    )


class Trouble(StrEnum):
    """What a note of a worker is about."""

    NONE = "none"
    NOT_DRAWN = "not drawn"
    FILE_ENDED = "file ended"
    """The Rerun file is no longer written."""
    LIVE_ENDED = "live ended"
    """The same of the live view."""


LENGTH = struct.Struct("<Q")
"""Header of each pickled batch: its number of bytes."""
