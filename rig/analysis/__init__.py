"""From a record or a table to results: laws of the contact, other instruments, verdicts, results.json.

Modules that analyse are imported at their first use: a command that only reads results.json loads no fit, no
configuration and no reader of tables.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rig.analysis.decay_values import DECAY, InstrumentSeries
from rig.analysis.encoding import JsonObject
from rig.analysis.fit_tables import (
    instrument_rows,
    instrument_series_rows,
    instrument_series_table,
    instrument_table,
    law_table,
    parameter_table,
    print_results,
    print_series,
    print_table,
    quality_table,
)
from rig.analysis.result_rows import SURFACE_ENERGY, ResultRow, RowsByName, named
from rig.analysis.results import (
    ComparedLaws,
    Correlation,
    Fit,
    ModelFreeMoments,
    RunIdentity,
    RunResults,
    Series,
    SessionResults,
)
from rig.analysis.results_file import (
    RESULTS_NAME,
    encoded,
    free_path,
    read_results,
    recorded_results,
    relative_record,
    results_path,
    results_schema,
    write_results,
)
from rig.analysis.run_remarks import Limit, decay_lines, drive_text, main_result, main_sources, remarks
from rig.analysis.run_values import PositionErrors, StoredTurningPoints, TableDecay

if TYPE_CHECKING:
    from rig.analysis.ambient import drag_of_fit, evidence_of, expected_drag, recorded_ambient, stated_ambient
    from rig.analysis.compared_laws import Curves, ModelCurve, chosen_laws, curves_of, model_curves, with_laws
    from rig.analysis.contact_fits import loss_of, refined_half_cycles
    from rig.analysis.contact_verdicts import TABLE4_AMPLITUDE_ARCSEC, with_contact
    from rig.analysis.half_cycle_fits import clock_rate_of
    from rig.analysis.passing_deflections import PassingDeflections
    from rig.analysis.record_fit import analyse_record, analyse_run
    from rig.analysis.series import AnalysedRun, fitted_series, refuse_copies, session_results
    from rig.analysis.table_fit import AnalysedTable, analyse_trajectory, series_of_runs
    from rig.analysis.turning_plane import PlaneBalances, follow_plane
else:
    _LAZY = {
        name: module
        for module, names in {
            "ambient": "evidence_of expected_drag drag_of_fit recorded_ambient stated_ambient",
            "compared_laws": "Curves ModelCurve chosen_laws curves_of model_curves with_laws",
            "contact_fits": "loss_of refined_half_cycles",
            "contact_verdicts": "TABLE4_AMPLITUDE_ARCSEC with_contact",
            "half_cycle_fits": "clock_rate_of",
            "passing_deflections": "PassingDeflections",
            "record_fit": "analyse_record analyse_run",
            "series": "AnalysedRun fitted_series refuse_copies session_results",
            "table_fit": "AnalysedTable analyse_trajectory series_of_runs",
            "turning_plane": "PlaneBalances follow_plane",
        }.items()
        for name in names.split()
    }

    def __getattr__(name: str) -> Any:
        if name not in _LAZY:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
