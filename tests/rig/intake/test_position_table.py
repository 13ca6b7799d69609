"""Tables of positions from other instruments are read, and faulty ones are rejected."""

from pathlib import Path

import numpy as np
import pytest

from processing.errors import ConfigurationError, DataError
from processing.units import _OTHERS, conversion, size
from rig.intake.table import TableColumns
from tests.rig.intake.table_cases import judged, table_matrix


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.parametrize("separator", ["\t", ",", ";", "  "])
def test_columns_by_name_and_number_give_the_same(tmp_path: Path, separator: str) -> None:
    lines = [separator.join(["t", "x", "y"])] + [
        separator.join([f"{0.1 * i:.3f}", f"{i}", f"{-i}"]) for i in range(5)
    ]
    path = write(tmp_path / "table.csv", "\n".join(lines))
    by_name = TableColumns("t", ("y", "x"), "arcsec").read(path)
    by_number = TableColumns("1", ("3", "2"), "arcsec").read(path)
    assert by_name.names == ("y", "x")
    np.testing.assert_array_equal(by_name.positions[0], [0, -1, -2, -3, -4])
    np.testing.assert_array_equal(by_name.positions[0], by_number.positions[0])
    np.testing.assert_array_equal(by_name.times_ns, [0, 100_000_000, 200_000_000, 300_000_000, 400_000_000])


def test_every_angle_of_the_table_of_units_is_one(tmp_path: Path) -> None:
    """A table in mas was refused the laws: they need an angle."""
    path = write(tmp_path / "tilt.txt", "0 1\n1 2\n2 1\n")
    for unit in (one for one in _OTHERS if size(one).powers == size("rad").powers):
        assert TableColumns(None, (), unit).read(path).scale_rad == conversion(unit, "rad")
    in_volts = TableColumns(None, (), "V").read(path)
    assert (in_volts.unit, in_volts.scale_rad) == ("V", None)


def test_real_table_with_two_header_lines(shared_data: Path) -> None:
    trajectory = TableColumns(None, (), "V").read(shared_data / "ringdown" / "seismometer-11mm.txt")
    assert len(trajectory.times_ns) == 1873
    assert trajectory.names == ("Voltage ( V )",)


@pytest.mark.slow
def test_real_table_compressed_and_with_words_in_it(shared_data: Path) -> None:
    path = shared_data / "ringdown" / "torsion-balance-laser-spot.csv.gz"
    trajectory = TableColumns("Time_Sec", ("X", "Y"), "px").read(path)
    assert len(trajectory.times_ns) == 58406
    assert len(trajectory.positions) == 2


def test_missing_file_and_missing_column(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        TableColumns(None, (), "").read(tmp_path / "none.csv")
    path = write(tmp_path / "t.csv", "time,volts\n0,1\n1,2\n")
    with pytest.raises(ConfigurationError, match=r"no column 'angle'; columns: time, volts"):
        TableColumns("time", ("angle",), "").read(path)


CASES = {case.name: case for case in table_matrix()}


@pytest.mark.parametrize("name", CASES)
def test_a_table_is_understood_right_or_refused_and_lost_rows_are_counted(tmp_path: Path, name: str) -> None:
    outcome = judged(CASES[name], tmp_path)
    assert outcome.kind == ("refused" if CASES[name].refused else "counted" if CASES[name].lost else "right")


def test_rows_left_out_are_placed(tmp_path: Path) -> None:
    said = judged(CASES["times that are words"], tmp_path).said
    assert "left out: 3 rows without a readable time (lines 21 to 22, 91)" in said


def test_a_time_without_header_that_is_first_is_not_taken_from_a_sequence(tmp_path: Path) -> None:
    """The program's own tables begin with a number of each frame."""
    path = write(tmp_path / "run-1-spots.csv", "sequence,time_s,x_px\n0,0.0,5\n1,0.1,6\n2,0.2,7\n")
    found = TableColumns(None, (), "").read(path)
    assert (found.time_name, found.names, found.unit) == ("time_s", ("x_px",), "px")
    assert found.times_ns.tolist() == [0, 100_000_000, 200_000_000]
