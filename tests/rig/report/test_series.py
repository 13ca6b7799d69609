"""What the runs of a series say together is in every format, and read back by libraries that are not ours."""

import math
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from processing.errors import ConfigurationError
from processing.estimate import Determinacy, Estimate
from processing.fit import FitMethod
from processing.instruments import MeanOverPlaces
from rig.analysis import AnalysedRun, InstrumentSeries, Series, read_results, write_results
from rig.analysis.series import session_results
from rig.report.export import export_session, latex_tables
from rig.report.figures_contact import series_figure
from rig.report.tables import series_table


def test_a_run_without_fit_shifts_no_number(analysed_series: Sequence[AnalysedRun], tmp_path: Path) -> None:
    """The report blamed run 2 where run 3 stood apart, as runs that could not be fitted were not counted."""
    first, second = analysed_series
    unfitted = replace(first, fitted={}, fits={}, problem="too short")
    exact = second.fitted[FitMethod.EXACT]
    odd = replace(exact, values=exact.values + 50 * exact.standard_uncertainty)
    apart = replace(second, fitted={**second.fitted, FitMethod.EXACT: odd})
    results = session_results([unfitted, first, first, apart], tmp_path)
    assert results.series is not None
    assert results.series.combined_runs == (2, 3, 4)
    assert {each.run for each in results.series.disagreements} == {4}
    drawn = series_figure(results.series)
    assert drawn.caption.startswith("Exact fit of each run")
    assert [label.get_text() for label in drawn.figure.axes[0].get_xticklabels()] == ["2", "3", "4"]
    # without a combined exact fit it shows the asymptotic one, which it called exact
    alone = {FitMethod.ASYMPTOTIC: results.series.fits[FitMethod.ASYMPTOTIC]}
    assert series_figure(replace(results.series, fits=alone)).caption.startswith("Asymptotic fit of each run")


def test_what_the_runs_only_limit_has_no_mean_in_the_file(
    analysed_series: Sequence[AnalysedRun], tmp_path: Path
) -> None:
    """The table had limits of n, the fits beside it a weighted mean with a standard uncertainty."""
    limited = [
        replace(
            run,
            table=tuple(
                replace(row, verdict=Determinacy.UPPER_BOUND, lower=math.nan, upper=3.0)
                if (row.quantity, row.fit) == ("n", FitMethod.EXACT)
                else row
                for row in run.table
            ),
        )
        for run in analysed_series
    ]
    series = session_results(limited, tmp_path).series
    assert series is not None
    assert series["n"].verdict is not Determinacy.DETERMINED
    for fit in series.fits.values():
        of_n = fit["n"]
        assert len(of_n.runs) == 2
        assert all(math.isnan(number) for number in (*of_n.estimate, of_n.between_runs, of_n.by_air))
        assert fit["period0_s"].value > 0
    assert "nan" not in " ".join(cell for row in series_table(series).shown for cell in row)
    series_figure(series)


KOENIG = InstrumentSeries(
    kind="koenig",
    time_s=MeanOverPlaces(80.8, 0.1, 3, 0.17, 0.43),
    swings=MeanOverPlaces(57.7, 0.08, 3, 0.14, 0.34),
    reference_time_s=Estimate(250.0, 0.5),
    ratio=Estimate(0.323, 0.0008),
)


def test_places_of_a_sample_have_tables(measured_series: Path, tmp_path: Path) -> None:
    """The ratio to the glass was in no table."""
    found = read_results(measured_series)
    write_results(tmp_path / "results.json", replace(found, series=Series(runs=3, instrument=KOENIG)))
    text = latex_tables(tmp_path)["series.tex"]
    assert "ratio of damping times" in text
    assert "0.323" in text


def test_two_names_that_are_one_in_nexus(measured_series: Path, tmp_path: Path) -> None:
    """``a b`` and ``a_b`` ended in h5py's ValueError."""
    pytest.importorskip("h5py")
    found = read_results(measured_series)
    runs = [replace(run, record=n) for n, run in zip(("a b.mcap", "a_b.mcap"), found.runs, strict=True)]
    for number, run in enumerate(runs, start=1):
        shutil.copy(measured_series / f"run-{number}.mcap", tmp_path / run.record)
    write_results(tmp_path / "results.json", replace(found, runs=tuple(runs)))
    with pytest.raises(ConfigurationError, match="several records of one name"):
        export_session(tmp_path, "hdf5", tmp_path / "x.h5")
    assert len(export_session(tmp_path, "csv", tmp_path / "csv")) == 7
