"""Times as other clocks and programs write them: read right, or refused in a line that says what to do."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from processing.errors import ConfigurationError, DataError
from rig.intake.table import TableColumns

N = 400
STEP = timedelta(seconds=0.05)
AUTUMN = datetime(2024, 10, 27, 0, 59, 50, tzinfo=UTC)
SPRING = datetime(2024, 3, 31, 0, 59, 50, tzinfo=UTC)


def _table(path: Path, time: Callable[[int], str], header: str = "time,x_mm") -> Path:
    path.write_text(f"{header}\n" + "".join(f"{time(k)},{10 * np.cos(k / 8):.4f}\n" for k in range(N)))
    return path


def _local(began: datetime, *, zone: bool) -> Callable[[int], str]:
    def time(k: int) -> str:
        moment = (began + k * STEP).astimezone(ZoneInfo("Europe/Berlin"))
        return (moment if zone else moment.replace(tzinfo=None)).isoformat(timespec="milliseconds")

    return time


@pytest.mark.parametrize("began", [AUTUMN, SPRING])
def test_with_their_zone_times_go_on_through_the_change_of_the_clock(tmp_path: Path, began: datetime) -> None:
    found = TableColumns().read(_table(tmp_path / "decay.csv", _local(began, zone=True)))
    assert set(np.diff(found.times_ns).tolist()) == {50_000_000}
    assert found.first_ns == int(began.timestamp()) * 10**9


def test_without_a_zone_the_change_of_the_clock_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"time does not increase after .* 2024-10-27T02:00:00.000 follows"):
        TableColumns().read(_table(tmp_path / "autumn.csv", _local(AUTUMN, zone=False)))
    with pytest.raises(DataError, match=r"03:00:00.000' follows .*an hour and one step later.*summer time\?"):
        TableColumns().read(_table(tmp_path / "spring.csv", _local(SPRING, zone=False)))


def test_a_date_that_no_clock_had_set_is_refused(tmp_path: Path) -> None:
    """64 bits of nanoseconds do not reach from the year 1 to today: an OverflowError came out."""
    begin = datetime(2024, 5, 1, 12)
    table = _table(tmp_path / "decay.csv", lambda k: f"{begin + k * STEP}" if k else "0001-01-01 00:00:00")
    with pytest.raises(DataError, match=r"the times span 6\.\d+e\+10 s, which no decay lasts"):
        TableColumns().read(table)


def test_a_step_back_is_named_by_its_line(tmp_path: Path) -> None:
    """A row without a time and the header were not counted."""
    times = ["0", "no", "0.1", "0.2", "0.15", *(f"{0.1 * k:.1f}" for k in range(3, N - 2))]
    table = _table(tmp_path / "decay.csv", times.__getitem__, "time_s,x_mm")
    with pytest.raises(DataError, match=r"time does not increase after 0\.2 \(line 5\): 0\.15 follows"):
        TableColumns().read(table)


def test_zones_of_some_rows_only_are_refused(tmp_path: Path) -> None:
    """Rows without one would be hours from where they belong."""

    def time(k: int) -> str:
        return (AUTUMN + k * STEP).strftime("%Y-%m-%dT%H:%M:%S.%f") + ("+00:00" if k < 200 else "")

    with pytest.raises(DataError, match=r"has a zone and .* has none; write all times with theirs"):
        TableColumns().read(_table(tmp_path / "decay.csv", time))


@pytest.mark.parametrize(
    ("write", "said"),
    [
        (
            lambda k: f"{1200 + k // 1200}{0.05 * (k % 1200):05.2f}",
            r"goes from 120059.8 to 120100 .*\(HHMMSS\)",
        ),
        (lambda k: f"{k // 1200 + 0.0005 * (k % 1200):.4f}", r"to 1 as the digits of a clock do \(MM.SS\)"),
        (lambda k: f"{1_486_566_000_123 + 50 * k}", r"begins at 1486566000123 s, beyond the year 9999"),
    ],
)
def test_a_clock_of_other_digits_or_another_unit_is_no_time_in_s(
    tmp_path: Path, write: Callable[[int], str], said: str
) -> None:
    path = _table(tmp_path / "decay.csv", lambda k: write(4 * k), "t_s,x_mm")
    with pytest.raises(ConfigurationError, match=said):
        TableColumns().read(path)


@pytest.mark.parametrize("day", ["2024-02-30", "31.04.2024", "2024/13/01"])
def test_a_day_that_there_is_not_is_no_time(tmp_path: Path, day: str) -> None:
    """It was the 1st of January 1970."""
    with pytest.raises(DataError, match="0 rows have a time"):
        TableColumns().read(_table(tmp_path / "decay.csv", lambda k: f"{day} 12:{k // 60:02d}:{k % 60:02d}"))


def test_moments_that_no_clock_shows_are_left_out_and_counted(tmp_path: Path) -> None:
    wrong = {7: "12:75:00", 8: "12:00:99", 9: "25:00:05", 10: "12:00:10+99:00"}
    found = TableColumns().read(
        _table(tmp_path / "decay.csv", lambda k: wrong.get(k, f"12:{k // 60:02d}:{k % 60:02d}"))
    )
    assert "left out: 4 rows without a readable time (lines 9 to 12)" in found.understood


def test_minutes_and_seconds_alone_are_no_time_and_a_unit_does_not_fit_a_clock(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"holds 0 rows of numbers; .*, dates or h:mm:ss"):
        TableColumns().read(_table(tmp_path / "a.csv", lambda k: f"{k // 60}:{k % 60:02d}"))
    path = _table(tmp_path / "b.csv", lambda k: f"0:{k // 60:02d}:{k % 60:02d}")
    assert set(np.diff(TableColumns().read(path).times_ns).tolist()) == {10**9}
    with pytest.raises(ConfigurationError, match="times like '0:00:00', which --time-unit min does not fit"):
        TableColumns(time_unit="min").read(path)


def test_a_row_that_stands_there_twice_is_refused(tmp_path: Path) -> None:
    for time in (
        lambda k: f"{0.05 * (k - (k > 200)):.3f}",
        lambda k: f"12:00:{0.05 * (k - (k > 200)):06.3f}",
    ):
        with pytest.raises(DataError, match=r"10.000 follows; sort the rows, remove one that stands there"):
            TableColumns().read(_table(tmp_path / "decay.csv", time))


def test_zones_of_half_hours_west_and_east(tmp_path: Path) -> None:
    """Noon in Newfoundland, and in India."""
    for zone, utc_h in (("-03:30", 15.5), ("+0530", 6.5)):
        path = _table(tmp_path / "decay.csv", lambda k, zone=zone: f"2024-05-01T12:00:{0.05 * k:06.3f}{zone}")
        assert TableColumns().read(path).first_ns == (1_714_521_600 + round(3600 * utc_h)) * 10**9
