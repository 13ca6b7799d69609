"""Times of two fields, ``12:30``, are minutes and seconds."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from processing.errors import ConfigurationError, DataError
from rig.intake.cell_text import is_timestamp
from rig.intake.table import TableColumns


def _m_ss(tenths: int) -> str:
    return f"{tenths // 600}:{tenths // 10 % 60:02d}.{tenths % 10}"


def _whole(seconds: int) -> str:
    return f"{seconds // 60}:{seconds % 60:02d}"


def _with_hours(seconds: int) -> str:
    return (
        _whole(seconds)
        if seconds < 3600
        else f"{seconds // 3600}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
    )


def _table(path: Path, header: str, times: Sequence[str]) -> Path:
    rows = "".join(f"{time};{k % 7}\n" for k, time in enumerate(times))
    path.write_text(f"{header};x\n{rows}")
    return path


@pytest.mark.parametrize(
    ("header", "write", "ticks", "step_s"),
    [
        ("t", _m_ss, range(0, 1300, 2), 0.2),
        ("t", lambda k: _m_ss(k).replace(".", ","), range(0, 1300, 2), 0.2),
        ("t", _whole, range(300), 1.0),
        ("t", _whole, range(6000, 6100), 1.0),  # 100:00 and more
        ("t", _with_hours, range(3500, 3700), 1.0),  # 59:59 is followed by 1:00:00
        ("Zeit (mm:ss)", _whole, range(300), 1.0),
        ("t [min]", _whole, range(300), 1.0),
    ],
)
def test_they_are_minutes_and_seconds(
    tmp_path: Path, header: str, write: Callable[[int], str], ticks: range, step_s: float
) -> None:
    found = TableColumns().read(_table(tmp_path / "decay.csv", header, [write(k) for k in ticks]))
    assert set(np.diff(found.times_ns).tolist()) == {round(step_s * 1e9)}
    assert len(found.times_ns) == len(ticks)
    assert any("minutes and seconds" in line for line in found.understood)


@pytest.mark.parametrize(
    ("header", "times", "time_unit", "said"),
    [
        ("t [h:mm]", [_whole(k) for k in range(300)], "", "'0:00' in 't [h:mm]' has no seconds"),
        ("t [h]", [_whole(k) for k in range(300)], "", "'0:00' in 't [h]' has no seconds"),
        ("t", [f"0:0{k // 60}:{k % 60:02d}" for k in range(300)], "min", "times like '0:00:00'"),
        ("t", [str(k) for k in range(300)], "m:ss", "--time-unit 'm:ss' is not a unit of time"),
    ],
)
def test_what_contradicts_is_refused_in_one_line(
    tmp_path: Path, header: str, times: list[str], time_unit: str, said: str
) -> None:
    path = _table(tmp_path / "decay.csv", header, times)
    with pytest.raises((ConfigurationError, DataError)) as refused:
        TableColumns(time_unit=time_unit).read(path)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_date_leaves_nothing_open(tmp_path: Path) -> None:
    times = [f"2024-05-01 12:{k:02d}" for k in range(60)]
    found = TableColumns().read(_table(tmp_path / "decay.csv", "t", times))
    assert set(np.diff(found.times_ns).tolist()) == {60_000_000_000}
    assert not is_timestamp("2024-05-01 12:30.5")
