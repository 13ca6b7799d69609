"""Interface of the sources of recorded frames: settings, times of the frames, and their pixels."""

import csv
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from decimal import Decimal, InvalidOperation
from itertools import accumulate, pairwise
from pathlib import Path
from statistics import median_high
from typing import Any, Literal, NamedTuple, Self, TypeVar

from numpy.typing import NDArray
from pydantic import BaseModel, Field, model_validator

from processing.errors import DeviceError
from processing.units import NS_PER_S

Colour = Literal["refuse", "mean", "red", "green", "blue", "brightness"]


class FilesSettings(BaseModel, frozen=True, extra="forbid"):
    """Location and times of the frames.

    Times come from either a CSV file or a stated frame rate. If neither is given, a CSV file beside the
    frames is used: ``timestamps.csv`` in a folder of images, otherwise the name of the frames' file with the
    suffix ``.csv``; without one a film's own times are used. A stated rate that a film's own times contradict
    is refused, unless `force_frame_rate` is true.

    The CSV file has one header line and one row per frame, in the order of the frames. Columns, in any order
    (others are ignored): ``time_ns`` (integer) or ``time_s`` (decimal, any number of digits), not negative
    and rising; optionally ``sequence`` (integer, rising; a gap is a frame lost by the recording program);
    optionally ``file`` (name of the image, which is checked).
    """

    path: Path = Field(description="folder of images, film, TIFF stack, or .npy stack (n, ny, nx)")
    timestamps_csv: Path | None = None
    frame_rate_hz: float | None = Field(default=None, gt=0, le=1e6)
    force_frame_rate: bool = Field(
        default=False,
        description="use frame_rate_hz even if the film's own times contradict it, as in a film stored for "
        "slow playback",
    )
    numbering: Literal["names", "order"] = Field(
        default="names",
        description="with frame_rate_hz: images count by the numbers in their names, so that a missing one "
        "leaves a gap, or by their order alone",
    )
    bit_depth: int | None = Field(
        default=None, ge=8, le=16, description="bits really used; None: all 8 or 16 (PGM states its own)"
    )
    colour: Colour = Field(
        default="refuse",
        description="how colour pictures become grey, or refuse: for RGB the mean of the channels or one of "
        "them; brightness: the stored luma, for RGB the mean. Equal channels, and luma without chroma, count "
        "as grey",
    )

    @model_validator(mode="after")
    def _refuse_two_clocks(self) -> Self:
        if self.timestamps_csv is not None and self.frame_rate_hz is not None:
            raise ValueError("state timestamps_csv or frame_rate_hz, not both")
        if self.force_frame_rate and self.frame_rate_hz is None:
            raise ValueError("force_frame_rate needs frame_rate_hz, the rate to enforce")
        return self


_Value = TypeVar("_Value")
_MAX_DIGITS = 11
"""Largest decimal exponent of a time in s that is computed; a larger time does not fit into 64 bits of ns."""
_MAX_OFF_TICKS = 1.5
"""Largest difference of a film's times from a stated rate, in ticks of its clock; both ends are rounded."""
_MAX_OFF_FRACTION = 2e-5
"""The same as a fraction of the elapsed time, because a rate may be stated to six digits only."""
_MIN_GAP_STEPS = 1.75
"""Minimum length of a step of time, in usual steps, in which frames are missing."""
_MAX_LISTED = 5
"""Largest number of gaps that a message lists one by one."""


class FrameTimes(NamedTuple):
    """Time of each frame in ns, and its number; a gap in the numbers is a frame lost during recording."""

    time_ns: Sequence[int]
    sequence: Sequence[int]


def frame_times(settings: FilesSettings, source: "FrameSource") -> FrameTimes:
    """Times of the frames of a source: from a CSV file, a stated rate, or the film itself.

    Raises DeviceError where all are missing, the file does not match, or the film contradicts the rate.
    """
    if settings.frame_rate_hz is not None:
        return _times_at_rate(settings, settings.frame_rate_hz, source)
    frames = settings.path
    default_path = frames / "timestamps.csv" if frames.is_dir() else frames.with_suffix(".csv")
    if settings.timestamps_csv is not None or default_path.is_file():
        return _times_from_csv(settings.timestamps_csv or default_path, source.count, source.names)
    if source.times is not None:
        return source.times
    raise DeviceError(
        f"{settings.path}: when were the frames taken? State camera.files.frame_rate_hz (rig fit: "
        f"--rate) or write {default_path}"
    )


def _times_at_rate(settings: FilesSettings, rate_hz: float, source: "FrameSource") -> FrameTimes:
    """Times at a stated rate, missing frames counted; DeviceError where the film's own times differ."""
    numbers: Sequence[int] = range(source.count)
    if settings.numbering == "names" and source.numbers is not None:
        numbers = source.numbers
    if source.times is not None:
        numbers = source.times.sequence
    times_ns = [round(number * NS_PER_S / rate_hz) for number in numbers]
    if source.times is not None and not settings.force_frame_rate:
        own_ns = source.times.time_ns
        worst = max(range(source.count), key=lambda i: abs(times_ns[i] - own_ns[i]))
        by_rate_s, by_film_s = times_ns[worst] / NS_PER_S, own_ns[worst] / NS_PER_S
        if abs(by_rate_s - by_film_s) > max(_MAX_OFF_TICKS * source.tick_s, _MAX_OFF_FRACTION * by_film_s):
            raise DeviceError(
                f"{settings.path}: camera.files.frame_rate_hz = {rate_hz:g} puts frame {worst} at "
                f"{by_rate_s:.4f} s, the film itself at {by_film_s:.4f} s; leave the rate "
                "out, or state camera.files.force_frame_rate = true where the film is wrong"
            )
    return FrameTimes(times_ns, numbers)


def _times_from_csv(path: Path, count: int, names: Sequence[str]) -> FrameTimes:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DeviceError(f"{path}: timestamps cannot be read: {error}") from None
    if not rows:
        raise DeviceError(f"{path}: is empty; one header line and one row a frame are needed")
    header = [cell.strip().lower() for cell in rows[0]]
    body = rows[1:]
    if "time_ns" not in header and "time_s" not in header:
        raise DeviceError(
            f"{path}: the header has no column time_ns or time_s; it reads {','.join(rows[0])!r}"
        )
    if len(body) != count:
        raise DeviceError(
            f"{path}: has {len(body)} rows of times for {count} frames; one row a frame is needed"
        )
    name, convert = ("time_ns", int) if "time_ns" in header else ("time_s", _ns_of_seconds)
    times_ns = _require_rising(path, name, _column(path, header, body, name, convert))
    sequence: Sequence[int] = range(count)
    if "sequence" in header:
        numbers = _require_rising(path, "sequence", _column(path, header, body, "sequence", int))
        sequence = [number - numbers[0] for number in numbers]
    if "file" in header and names:
        file_cells = _column(path, header, body, "file", str)
        for line, (cell, name) in enumerate(zip(file_cells, names, strict=True), start=2):
            if cell != name:
                raise DeviceError(f"{path}: line {line} names {cell!r} where the image is {name!r}")
    return FrameTimes(times_ns, sequence)


def _ns_of_seconds(text: str) -> int:
    seconds = Decimal(text)
    if seconds.is_finite() and seconds.adjusted() > _MAX_DIGITS:
        raise OverflowError  # a mistyped exponent could make an integer of a thousand million digits
    return round(seconds * 1_000_000_000)


def _column(
    path: Path, header: list[str], body: list[list[str]], name: str, convert: Callable[[str], _Value]
) -> list[_Value]:
    column = header.index(name)
    values = []
    for line, row in enumerate(body, start=2):
        text = row[column].strip() if column < len(row) else ""
        try:
            values.append(convert(text))
        except (ValueError, InvalidOperation, OverflowError):
            raise DeviceError(
                f"{path}: line {line}: {name} = {text!r} is not a number, or is too large"
            ) from None
    return values


def _require_rising(path: Path, name: str, values: list[int]) -> list[int]:
    for line, (earlier, later) in enumerate(pairwise(values), start=3):
        if later <= earlier:
            raise DeviceError(f"{path}: line {line}: {name} does not rise; frames must be in the order taken")
    if values and values[-1] >= 2**63:
        raise DeviceError(f"{path}: {name} rises above 9.2e18, which cannot be stored")
    if values and values[0] < 0:
        raise DeviceError(f"{path}: line 2: {name} is negative; count from an earlier moment")
    return values


def numbers_by_steps(ticks: Sequence[int]) -> list[int]:
    """Numbers of frames at a varying rate; only clearly longer steps of time count as missing frames."""
    steps = [later - earlier for earlier, later in pairwise(ticks)]
    usual = median_high(steps) if steps else 1
    increments = (round(step / usual) if step >= _MIN_GAP_STEPS * usual else 1 for step in steps)
    return list(accumulate(increments, initial=0))


def missing_frames(time_ns: Sequence[int], numbers: Sequence[int], source: str) -> list[str]:
    """Warning (none or one line) about gaps in the frames' numbers; `source` says where these come from."""
    gaps = [
        (time_ns[i] / NS_PER_S, later - earlier - 1)
        for i, (earlier, later) in enumerate(pairwise(numbers))
        if later - earlier > 1
    ]
    if not gaps:
        return []
    listed = listed_gaps([f"{count} after {time_s:.3f} s" for time_s, count in gaps])
    return [f"{sum(count for _, count in gaps)} frames are missing by {source}: {listed}"]


def listed_gaps(gaps: Sequence[str]) -> str:
    """The first gaps in words, and the number of the others."""
    more = f" and {len(gaps) - _MAX_LISTED} more places" if len(gaps) > _MAX_LISTED else ""
    return ", ".join(gaps[:_MAX_LISTED]) + more


ONE_IMAGE = "is one image; name the folder that holds the images, or a film"


class UnreadableFrame(Exception):
    """One frame cannot be read; the message gives the reason."""


class StoredImage(NamedTuple):
    """Pixels as stored."""

    pixels: NDArray[Any]
    """Shape (ny, nx) or (ny, nx, channels)."""
    full_scale: int
    """Largest possible value of a pixel."""
    coloured: bool = False
    """Whether the pixels are the luminance of a picture that also stores colour."""


class FrameSource(ABC):
    """A source of frames."""

    count: int
    """Number of frames."""
    names: Sequence[str] = ()
    """Name of each frame's file; empty if the frames have no files of their own."""
    numbers: Sequence[int] | None = None
    """Number of each frame by its file's name, from 0; a gap is a missing file. None without numbers."""
    times: FrameTimes | None = None
    """Times that the source itself states, in ns from the first frame, and the frames' numbers."""
    tick_s: float = 0.0
    """Resolution of these times in s."""
    warnings: Sequence[str] = ()
    """Lines on faults of the source: missing frames, a cut-off file, a wrong order."""
    summary: str = ""
    """One line that describes the source, for a person; may be empty."""
    pixel_aspect: float = 1.0
    """Width of a pixel over its height, as the source itself states it."""
    lossy: str = ""
    """Name of the codec if it is lossy, otherwise empty."""

    def __init__(self, path: Path) -> None:
        self._path = path

    @abstractmethod
    def read(self, index: int) -> StoredImage:
        """Frame `index`. Raises UnreadableFrame for a damaged one, OSError if the source is out of reach."""

    def label(self, index: int) -> str:
        """Name of the frame in messages."""
        return f"{self._path}, frame {index}"

    def close(self) -> None:  # noqa: B027 most sources hold no file open
        """Close the files; a later `read` opens them again."""
