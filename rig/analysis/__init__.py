"""From a record or a table to results: laws of the contact, other instruments, verdicts, results.json."""

from rig.analysis.contact_laws import points_in_true_time, settled_swings
from rig.analysis.contact_tree import evaluation_tree, series_tree
from rig.analysis.contact_verdicts import evaluate
from rig.analysis.curves import Curves, curves_of, parameters_of, pendulum_of
from rig.analysis.record_fit import analyse_record, analyse_run, combine, fit_records, free_name
from rig.analysis.results import RunResult, fit_tree, results_tree, write_results
from rig.analysis.results_file import (
    RESULTS_NAME,
    Motion,
    Picture,
    ReportSource,
    RunData,
    read_results,
    read_source,
    recorded_results,
    results_path,
)
from rig.analysis.screen import print_results
from rig.analysis.table_fit import fit_trajectory

__all__ = [
    "RESULTS_NAME",
    "Curves",
    "Motion",
    "Picture",
    "ReportSource",
    "RunData",
    "RunResult",
    "analyse_record",
    "analyse_run",
    "combine",
    "curves_of",
    "evaluate",
    "evaluation_tree",
    "fit_records",
    "fit_trajectory",
    "fit_tree",
    "free_name",
    "parameters_of",
    "pendulum_of",
    "points_in_true_time",
    "print_results",
    "read_results",
    "read_source",
    "recorded_results",
    "results_path",
    "results_tree",
    "series_tree",
    "settled_swings",
    "write_results",
]
