"""From a record or a table to results: laws of the contact, other instruments, verdicts, results.json."""

from rig.analysis.analysed_run import AnalysedRun, refuse_unread, session_results
from rig.analysis.compared_laws import chosen_laws, law_table, laws_of, moments_table, waveform_table
from rig.analysis.contact_results import ComparedLaws, Correlation, Fit, MomentsWithoutLaw
from rig.analysis.contact_series import combined_series
from rig.analysis.contact_verdicts import TABLE4_AMPLITUDE_ARCSEC, base_motion, evaluate, fit_results
from rig.analysis.curves import Curves, ModelCurve, curves_of, model_curves
from rig.analysis.decay_values import decay_lines
from rig.analysis.encoding import JsonObject, units_of
from rig.analysis.fit_remarks import drive_text, remarks
from rig.analysis.fit_tables import parameter_table, quality_table
from rig.analysis.fitted_drag import evidence_of, known_drag
from rig.analysis.headline import Limit, dominant_text, has_apparatus, whole_result
from rig.analysis.instrument_results import (
    DampingResults,
    DecrementTable,
    InstrumentResults,
    InstrumentSeries,
    PeriodTable,
    SwingPlane,
)
from rig.analysis.less_reference import less_beam_motion
from rig.analysis.passing_deflections import PassingDeflections
from rig.analysis.record_fit import analyse_record, analyse_run
from rig.analysis.recorded_witness import taken
from rig.analysis.result_rows import SURFACE_ENERGY, ResultRow, WithRows, named
from rig.analysis.results import AveragedCurves, RunResults, Series, SessionResults, TableDecay, TableResults
from rig.analysis.results_file import (
    RESULTS_NAME,
    decoded,
    encoded,
    free_path,
    read_any_results,
    read_results,
    recorded_results,
    results_path,
    results_schema,
    write_results,
)
from rig.analysis.screen import print_results
from rig.analysis.settled import loss_of, settled_swings
from rig.analysis.stored_turning_points import PositionErrors, StoredTurningPoints
from rig.analysis.surroundings import expected_drag, recorded_surroundings, stated_surroundings
from rig.analysis.swings_fit import clock_rate_of
from rig.analysis.table_fit import AnalysedTable, analyse_table, analyse_trajectory
from rig.analysis.table_screen import fit_envelope_table, fit_several, fit_trajectory
from rig.analysis.turning_plane import PlaneBalances, follow_plane
from rig.analysis.witness_file import StatedWitness
