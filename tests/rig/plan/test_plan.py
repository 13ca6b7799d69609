"""`rig plan`: from a record to the table and the picture."""

from pathlib import Path

import pytest

from processing.errors import ConfigurationError, DataError
from rig.commands.physics import plan


def test_a_run_is_planned_from_a_record(
    measured_series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record, folder = measured_series / "run-1.mcap", tmp_path / "plan"
    plan(record, [124.0], [60.0, 15.0], None, folder, None)
    said = " ".join(capsys.readouterr().out.split())
    assert "124 to 15″" in said
    assert "u(γ)" in said
    head, longer, shorter = (line.split(",") for line in (folder / "plan.csv").read_text().splitlines())
    assert head[:4] == ["first_arcsec", "last_arcsec", "duration_s", "half_cycles"]
    by_last = {float(row[1]): dict(zip(head, map(float, row), strict=True)) for row in (longer, shorter)}
    assert by_last[15.0]["duration_s"] > by_last[60.0]["duration_s"]
    assert by_last[15.0]["u_b"] < by_last[60.0]["u_b"]
    assert (folder / "plan.png").stat().st_size > 10_000
    with pytest.raises(ConfigurationError, match=r"plan\.csv exists, and nothing is overwritten"):
        plan(record, [124.0], [15.0], None, folder, None)


def test_amplitudes_that_make_no_run_are_named(measured_series: Path) -> None:
    with pytest.raises(DataError, match="every last amplitude must lie below every first one"):
        plan(measured_series / "run-1.mcap", [10.0], [60.0], None, None, None)
