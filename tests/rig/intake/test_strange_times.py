"""Times as other clocks and programs write them: read right, or refused in a line that says what to do."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from processing.errors import ConfigurationError, DataError
from rig.intake.cell_text import timestamps_ns
from rig.intake.table import TableColumns
from rig.intake.units import split_name

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


def test_without_a_zone_the_change_of_the_clock_is_refused_and_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"02:00:00.000 follows; where a clock is set back from summer time"):
        TableColumns().read(_table(tmp_path / "autumn.csv", _local(AUTUMN, zone=False)))
    with pytest.raises(DataError, match=r"03:00:00.000' follows .*an hour and one step later.*summer time\?"):
        TableColumns().read(_table(tmp_path / "spring.csv", _local(SPRING, zone=False)))


def test_an_hour_without_rows_is_a_gap_and_its_length_is_said(tmp_path: Path) -> None:
    def time(k: int) -> str:
        return (SPRING + timedelta(hours=k // 200) + k * STEP + timedelta(seconds=7 * (k // 200))).strftime(
            "%Y-%m-%dT%H:%M:%S.%f"
        )

    found = TableColumns().read(_table(tmp_path / "gap.csv", time))
    assert any("unevenly, up to 3607.05 s apart" in line for line in found.understood)


def test_zones_of_some_rows_only_are_refused(tmp_path: Path) -> None:
    """Rows without one would be hours from where they belong."""

    def time(k: int) -> str:
        return (AUTUMN + k * STEP).strftime("%Y-%m-%dT%H:%M:%S.%f") + ("+00:00" if k < 200 else "")

    with pytest.raises(DataError, match=r"has a zone and .* has none; write all times with theirs"):
        TableColumns().read(_table(tmp_path / "decay.csv", time))


@pytest.mark.parametrize("day", ["2024-02-30", "31.04.2024", "2024/13/01"])
def test_a_day_that_there_is_not_is_no_time(tmp_path: Path, day: str) -> None:
    """It was the 1st of January 1970."""
    with pytest.raises(DataError, match="0 rows have a time"):
        TableColumns().read(_table(tmp_path / "decay.csv", lambda k: f"{day} 12:{k // 60:02d}:{k % 60:02d}"))


def test_minutes_and_seconds_that_no_clock_shows_are_left_out_and_counted(tmp_path: Path) -> None:
    def time(k: int) -> str:
        return "12:75:00" if k == 7 else "12:00:99" if k == 8 else f"12:{k // 60:02d}:{k % 60:02d}"

    found = TableColumns().read(_table(tmp_path / "decay.csv", time))
    assert "left out: 2 rows without a readable time (lines 9 to 10)" in found.understood


def test_a_row_that_stands_there_twice_is_not_to_be_sorted(tmp_path: Path) -> None:
    for time in (
        lambda k: f"{0.05 * (k - (k > 200)):.3f}",
        lambda k: f"12:00:{0.05 * (k - (k > 200)):06.3f}",
    ):
        with pytest.raises(DataError, match=r"follows; a row that stands there twice must be removed"):
            TableColumns().read(_table(tmp_path / "decay.csv", time))


def test_days_of_a_spreadsheet_are_not_taken_for_seconds(tmp_path: Path) -> None:
    path = _table(tmp_path / "decay.csv", lambda k: f"{45413.5 + 0.05 * k / 86400:.10f}", "t,x_mm")
    with pytest.raises(
        ConfigurationError, match=r"'t' begins at 45413.5 .* State --time-unit d, or --time-unit s"
    ):
        TableColumns().read(path)
    found = TableColumns(time_unit="d").read(path)
    assert found.times_ns[-1] == pytest.approx(0.05 * (N - 1) * 1e9, rel=1e-5)
    assert found.first_ns == pytest.approx(1_714_564_800_000_000_000, abs=1e6)
    assert TableColumns(time_unit="s").read(path).times_ns[-1] == pytest.approx(231_000, abs=200)


@pytest.mark.parametrize("cell", ["2024-05-01T25:00:05Z", "2024-05-01T12:00:05+99:00"])
def test_an_hour_or_a_zone_that_there_is_not_is_no_moment(tmp_path: Path, cell: str) -> None:
    def time(k: int) -> str:
        return cell if k == 100 else f"2024-05-01T12:00:{0.05 * k:06.3f}Z"

    found = TableColumns().read(_table(tmp_path / "decay.csv", time))
    assert len(found.times_ns) == N - 1
    assert any("102" in line for line in found.understood)


def test_zones_of_half_hours_west_and_east(tmp_path: Path) -> None:
    """Noon in Newfoundland, and in India."""
    for zone, utc_h in (("-03:30", 15.5), ("+0530", 6.5)):
        rows = "".join(f"2024-05-01T12:00:{0.05 * k:06.3f}{zone},{np.cos(k / 8):.4f}\n" for k in range(N))
        (path := tmp_path / "decay.csv").write_text(f"time,x_mm\n{rows}")
        assert TableColumns().read(path).first_ns == (1_714_521_600 + round(3600 * utc_h)) * 10**9


def test_minutes_that_come_first_have_no_limit_but_those_after_an_hour_have() -> None:
    minute_ns = 60 * 10**9
    assert timestamps_ns(["75:00", "1:05:00", "1:75:00"]) == [
        75 * minute_ns,
        65 * minute_ns,
        None,
    ]


def test_twenty_four_o_clock_is_the_next_midnight(tmp_path: Path) -> None:
    midnight = datetime(2024, 5, 2, tzinfo=UTC)

    def time(k: int) -> str:
        moment = midnight + (k - 200) * STEP
        return "2024-05-01T24:00:00.000Z" if k == 200 else moment.strftime("%Y-%m-%dT%H:%M:%S.%fZ")

    found = TableColumns().read(_table(tmp_path / "decay.csv", time))
    assert set(np.diff(found.times_ns).tolist()) == {50_000_000}


@pytest.mark.parametrize("name", ["TIMESTAMP", "TEMPS", "TIMES", "ELAPSED", "UTCS", "DATETIMES"])
def test_a_letter_of_a_name_in_capitals_is_no_unit(name: str) -> None:
    """Times in ms under TIMESTAMP were s by its header, a thousand times too long."""
    assert split_name(name).unit == ""
    assert split_name(f"{name}_MS")[:2] == (name, "ms")
