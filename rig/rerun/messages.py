"""What is told to the view: plain values that travel from the session to the viewer's process.

Times are seconds since the start of the run. `run` tells runs laid over each other apart; a single
run has the empty name.
"""

import struct
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Mode = Literal["none", "spawn", "web"]
"""Where the live stream is shown: nowhere, in a window of its own, in a browser."""
LayoutName = Literal["balancing", "measuring", "analysing"]
LogLevel = Literal["debug", "info", "warning", "error"]
Panel = Literal["decay", "residuals", "period", "period_residuals", "loops"]

Floats = NDArray[np.float64]


class Setup(NamedTuple):
    """What a worker is told before anything else.

    It draws into `rrd_path`, or, where that is None, into a live stream on `port` of 127.0.0.1.
    `viewer_url` is set for a worker that replaces another: the viewer that has to connect anew.
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


class Samples(NamedTuple):
    """Deflections in the unit of the setup; NaN where the spot was lost."""

    run: str
    time_s: Floats
    x: Floats
    y: Floats
    flags: NDArray[np.int64]


class Swings(NamedTuple):
    """Half-cycles of the slow mode: amplitude and full period at each turning point."""

    run: str
    time_s: Floats
    amplitude: Floats
    u_amplitude: Floats
    period_s: Floats
    u_period_s: Floats


class BalanceNumbers(NamedTuple):
    """Numbers of the balance by name, each a value with its standard uncertainty, and advice.

    Names and units are those of `processing.balance.Balance`; its `unit` is that of the setup.
    """

    run: str
    time_s: float
    numbers: Mapping[str, tuple[float, float]]
    advice: str


class Picture(NamedTuple):
    """One camera image (ny, nx) and where the spot was found in it (NaN where it was not)."""

    run: str
    time_s: float
    image: NDArray[np.uint8] | NDArray[np.uint16]
    x_px: float
    y_px: float
    full_scale_dn: int


class Losses(NamedTuple):
    """Counts since the start by name: lost frames, lost spots, what the view itself dropped."""

    run: str
    time_s: float
    counts: Mapping[str, int]


class State(NamedTuple):
    """State of the session as Markdown."""

    run: str
    time_s: float
    text: str


class LogLine(NamedTuple):
    """One line of the log panel."""

    run: str
    time_s: float
    level: LogLevel
    text: str


class Curve(NamedTuple):
    """One curve of the analysing layout, as points (data) or as a line (a fit).

    The panels' axes: ``decay`` time s, amplitude; ``residuals`` time s, residual of the amplitude;
    ``period`` amplitude, period s; ``period_residuals`` amplitude, ms; ``loops`` angle, moment µN m.
    Amplitudes and angles are in the unit of the setup. NaN breaks a line. `u_y`, where given, is drawn
    as bars of one standard uncertainty to either side.
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
    """Nothing follows: complete the file and end."""


Message = Samples | Swings | BalanceNumbers | Picture | Losses | State | LogLine | Fits | Finish


def rows(message: Message) -> int:
    """How many things a message tells: samples and swings one by one, anything else counts once."""
    return len(message.time_s) if isinstance(message, Samples | Swings) else 1


def size_bytes(message: Message) -> int:
    """Bytes of the arrays that a message holds, and a little for the rest."""
    held: list[object] = list(message)
    if isinstance(message, Fits):
        held = [value for curve in message.curves for value in curve]
    return 200 + sum(
        value.nbytes if isinstance(value, np.ndarray) else len(value) if isinstance(value, str) else 0
        for value in held
    )


LENGTH = struct.Struct("<Q")
"""Before each pickled batch: how many bytes it has."""
