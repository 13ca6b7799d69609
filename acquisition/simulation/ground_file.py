"""Recorded ground acceleration from a CSV file, or one line that says why not."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.errors import ConfigurationError

_UNITS_M_PER_S2 = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
_FEWEST = 64
_LARGEST_M_PER_S2 = 10.0
_SMALLEST_M_PER_S2 = 1e-11
_KEY = "simulation.ground.file"


class GroundRecord(NamedTuple):
    """Accelerations at even times: (n, 1) or (n, 2) in m/s^2, each column's mean taken off."""

    rate_hz: float
    accelerations_m_per_s2: NDArray[np.float64]


def read_ground_file(path: Path) -> GroundRecord:
    """Read a CSV file: a header, then time in s and one or two accelerations per line.

    The first column is `time_s`; the names of the others end in their unit, for example
    `acceleration_m_per_s2`. Raises ConfigurationError, in one line with the number of the file's line,
    for a missing unit, a value that is no number, times that are not even (a gap), and accelerations
    too large or too small for the unit stated.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise _fault(path, "no such file; name a CSV file of ground accelerations") from None
    except (OSError, UnicodeDecodeError) as error:
        raise _fault(path, f"cannot be read: {error}") from None
    scales = _scales(path, lines[0] if lines else "")
    columns = 1 + len(scales)
    rows = [(number, line) for number, line in enumerate(lines, 1) if number > 1 and line.strip()]
    values = np.array([_numbers(path, number, line, columns) for number, line in rows]).reshape(-1, columns)
    if len(values) < _FEWEST:
        raise _fault(path, f"has {len(values)} samples; at least {_FEWEST} are needed")
    step_s = float(np.median(np.diff(values[:, 0])))
    uneven = np.flatnonzero(~(np.abs(np.diff(values[:, 0]) - step_s) <= 0.01 * step_s))
    if step_s <= 0 or len(uneven):
        row = int(uneven[0]) if len(uneven) else 0
        raise _fault(
            path,
            f"line {rows[row + 1][0]}: time_s goes from {values[row, 0]:.10g} to {values[row + 1, 0]:.10g}, "
            f"where {step_s:.6g} s is the step; cut the file at its gaps",
        )
    accelerations = values[:, 1:] * scales
    accelerations = accelerations - accelerations.mean(axis=0)
    for column, name in enumerate(lines[0].split(",")[1:]):
        largest = float(np.abs(accelerations[:, column]).max())
        if not _SMALLEST_M_PER_S2 <= largest <= _LARGEST_M_PER_S2:
            raise _fault(
                path,
                f"column {name.strip()} reaches {largest:.3g} m/s^2, which no laboratory's ground does; "
                "correct the unit in its name",
            )
    seconds = float(values[-1, 0] - values[0, 0])
    return GroundRecord((len(values) - 1) / seconds, accelerations)


def _scales(path: Path, header: str) -> NDArray[np.float64]:
    names = [name.strip() for name in header.split(",")]
    wanted = "the header must read time_s,acceleration_m_per_s2 (or _um_per_s2, _nm_per_s2), with a second "
    if names[0] != "time_s" or not 2 <= len(names) <= 3:
        raise _fault(path, f"its first line is {header[:60]!r}; {wanted}acceleration if there is one")
    scales = []
    for name in names[1:]:
        unit = name.removesuffix("_per_s2").rpartition("_")[2] if name.endswith("_per_s2") else ""
        if unit not in _UNITS_M_PER_S2:
            raise _fault(path, f"column {name} has no unit of acceleration; {wanted}acceleration if any")
        scales.append(_UNITS_M_PER_S2[unit])
    return np.array(scales)


def _numbers(path: Path, number: int, line: str, columns: int) -> list[float]:
    try:
        values = [float(word) for word in line.split(",")]
    except ValueError:
        values = []
    if len(values) != columns or not np.all(np.isfinite(values)):
        raise _fault(
            path, f"line {number}: {line[:60]!r} is not {columns} finite numbers; cut the file at its gaps"
        )
    return values


def _fault(path: Path, message: str) -> ConfigurationError:
    return ConfigurationError(f"{_KEY} = {str(path)!r}: {message}")
