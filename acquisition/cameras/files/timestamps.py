"""Times of recorded frames, from a CSV file or from a frame rate."""

import csv
from collections.abc import Callable, Sequence
from decimal import Decimal, InvalidOperation
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from acquisition.cameras.files.settings import FilesSettings
from processing.errors import DeviceError
from processing.ticks import NS_PER_S

if TYPE_CHECKING:
    from acquisition.cameras.files.frame_source import FrameSource

T = TypeVar("T")
_MOST_DIGITS = 11
_TICKS = 1.5
"""Ticks of a film's clock by which its times may be off a stated rate: both ends are rounded."""
_RATE_WITHIN = 2e-5
"""Parts of the elapsed time as well: what a rate of six digits leaves open."""
_JUMP = 1.75
"""Usual steps of time from which on a longer one is taken for missing frames."""
_LISTED = 5
"""Places that a message names one by one."""


class FrameTimes(NamedTuple):
    """Time of each frame in ns, and its number; a gap in the numbers is a frame lost during recording."""

    time_ns: Sequence[int]
    sequence: Sequence[int]


def frame_times(settings: FilesSettings, source: "FrameSource") -> FrameTimes:
    """Times of the frames of a source: from a CSV file, a stated rate, or the film itself.

    Raises
    ------
    DeviceError
        None of these, a CSV file that does not match the frames, or a rate that the film contradicts.
    """
    if settings.frame_rate_hz is not None:
        return _at_rate(settings, settings.frame_rate_hz, source)
    path = settings.timestamps_csv or timestamps_beside(settings.path)
    if settings.timestamps_csv is None and not path.is_file():
        if source.times is not None:
            return source.times
        raise DeviceError(
            f"{settings.path}: when were the frames taken? State camera.files.frame_rate_hz (rig fit: "
            f"--rate) or write {path}"
        )
    return _read(path, source.count, source.names)


def _at_rate(settings: FilesSettings, rate_hz: float, source: "FrameSource") -> FrameTimes:
    """Times of frames that are taken at a stated rate, those that are missing counted in."""
    numbers: Sequence[int] = range(source.count)
    if settings.numbering == "names" and source.numbers is not None:
        numbers = source.numbers
    if source.times is not None:
        numbers = source.times.sequence
    times_ns = [round(number * NS_PER_S / rate_hz) for number in numbers]
    if source.times is not None and not settings.force_frame_rate:
        _agree(settings, rate_hz, times_ns, source)
    return FrameTimes(times_ns, numbers)


def _agree(settings: FilesSettings, rate_hz: float, times_ns: Sequence[int], source: "FrameSource") -> None:
    """Raise DeviceError where a stated rate puts a frame elsewhere than the film itself does."""
    if source.times is None:
        return
    own_ns = source.times.time_ns
    worst = max(range(source.count), key=lambda i: abs(times_ns[i] - own_ns[i]))
    off_s = abs(times_ns[worst] - own_ns[worst]) / NS_PER_S
    if off_s > max(_TICKS * source.tick_s, _RATE_WITHIN * own_ns[worst] / NS_PER_S):
        raise DeviceError(
            f"{settings.path}: camera.files.frame_rate_hz = {rate_hz:g} puts frame {worst} at "
            f"{times_ns[worst] / NS_PER_S:.4f} s, the film itself at {own_ns[worst] / NS_PER_S:.4f} s; "
            "leave the rate "
            "out, or state camera.files.force_frame_rate = true where the film is wrong"
        )


def timestamps_beside(path: Path) -> Path:
    """Where the times of frames are looked for that are stated nowhere else."""
    return path / "timestamps.csv" if path.is_dir() else path.with_suffix(".csv")


def _read(path: Path, count: int, names: Sequence[str]) -> FrameTimes:
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
    if "time_ns" in header:
        times_ns = _rising(path, "time_ns", _column(path, header, body, "time_ns", int))
    else:
        times_ns = _rising(path, "time_s", _column(path, header, body, "time_s", _ns_of_seconds))
    sequence: Sequence[int] = range(count)
    if "sequence" in header:
        numbers = _rising(path, "sequence", _column(path, header, body, "sequence", int))
        sequence = [number - numbers[0] for number in numbers] if numbers else numbers
    if "file" in header and names:
        stated = _column(path, header, body, "file", str)
        for line, (name, wanted) in enumerate(zip(stated, names, strict=True), start=2):
            if name != wanted:
                raise DeviceError(f"{path}: line {line} names {name!r} where the image is {wanted!r}")
    return FrameTimes(times_ns, sequence)


def _ns_of_seconds(text: str) -> int:
    seconds = Decimal(text)
    if seconds.is_finite() and seconds.adjusted() > _MOST_DIGITS:
        raise OverflowError  # an exponent of a thousand million is a number of as many digits
    return round(seconds * 1_000_000_000)


def _column(
    path: Path, header: list[str], body: list[list[str]], name: str, convert: Callable[[str], T]
) -> list[T]:
    place = header.index(name)
    values = []
    for line, row in enumerate(body, start=2):
        text = row[place].strip() if place < len(row) else ""
        try:
            values.append(convert(text))
        except (ValueError, InvalidOperation, OverflowError):
            raise DeviceError(
                f"{path}: line {line}: {name} = {text!r} is not a number, or is too large"
            ) from None
    return values


def _rising(path: Path, name: str, values: list[int]) -> list[int]:
    for line, (before, after) in enumerate(pairwise(values), start=3):
        if after <= before:
            raise DeviceError(f"{path}: line {line}: {name} does not rise; frames must be in the order taken")
    if values and values[-1] >= 2**63:
        raise DeviceError(f"{path}: {name} holds more than 9.2e18 ns, which cannot be kept")
    if values and values[0] < 0:
        raise DeviceError(f"{path}: line 2: {name} is negative; count from an earlier moment")
    return values


def numbers_by_steps(ticks: Sequence[int]) -> list[int]:
    """Numbers of frames with a varying rate, in which only clearly longer steps count as missing frames."""
    steps = sorted(after - before for before, after in pairwise(ticks))
    usual = steps[len(steps) // 2] if steps else 1
    numbers = [0]
    for before, after in pairwise(ticks):
        step = after - before
        numbers.append(numbers[-1] + (round(step / usual) if step >= _JUMP * usual else 1))
    return numbers


def missing_frames(time_ns: Sequence[int], numbers: Sequence[int], source: str) -> list[str]:
    """What is to be said of frames that are missing between others, by the `source` of their times."""
    gaps = [
        (time_ns[i] / NS_PER_S, numbers[i + 1] - numbers[i] - 1)
        for i in range(len(numbers) - 1)
        if numbers[i + 1] - numbers[i] > 1
    ]
    if not gaps:
        return []
    places = ", ".join(f"{count} after {time_s:.3f} s" for time_s, count in gaps[:_LISTED])
    more = f" and {len(gaps) - _LISTED} more places" if len(gaps) > _LISTED else ""
    return [f"{sum(count for _, count in gaps)} frames are missing by {source}: {places}{more}"]
