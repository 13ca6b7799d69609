"""Fits of a contact law to a decay, and uncertainties of the results."""

from processing.derived import Derived
from processing.fit.apparatus import InputQuantity, RigQuantities
from processing.fit.asymptotic import fit_asymptotic
from processing.fit.boundary_layer import steeper_drag, with_steeper_drag
from processing.fit.changes import DRIFTS, changes_of, drifts_of, with_changes, with_drifts
from processing.fit.determination import Determination, identifiability, strong_correlations
from processing.fit.domain import domain_warnings
from processing.fit.drag import Drag, DragFinding, drag_verdict
from processing.fit.errors_of_place import (
    PlaceErrors,
    by_amplitude_errors,
    by_common_amplitude,
    by_row_time,
    place_errors,
    with_place_errors,
)
from processing.fit.evidence import NO_EVIDENCE, WAVEFORM, Evidence, sine_covariance, waveform_of
from processing.fit.exact import fit_exact
from processing.fit.ground import GROUND_SEEN, BaseMotion, Ground, density_of_step
from processing.fit.known_drive import Signals
from processing.fit.law_comparison import LawComparison, compare_laws
from processing.fit.law_errors import Change, ChangeKind, Misfit
from processing.fit.misfit import with_misfit, with_misfit_of
from processing.fit.planning import Conditions, PlannedRun, PlannedSeries, planned_run, planned_series
from processing.fit.remeasure import describes_as_well, known_motion, measured_again, shift_of
from processing.fit.reported import (
    FittedContact,
    Work,
    fitted_contact,
    reported_quantities,
    work_per_cycle_j,
)
from processing.fit.result import FitQuality, FitResult
from processing.fit.row_times import alternation_of, delay_of_rows, without_alternation
from processing.fit.settling import FitOfSwings, fitted_twice, points_in_true_time, settlement
from processing.fit.smoothing import super_smooth
from processing.fit.uncertainty import Budget, BudgetSource, budgets, standard_uncertainties
from processing.fit.vanes import MeasuredAir, VanedRun, air_of_vanes
from processing.fit.waveform import CONTRADICTED, predicted_harmonics, waveform_chances
from processing.fit.without_law import fit_without_law
from processing.fit.witness.fitting import fit_with_witness
from processing.fit.witness.signals import Witness, plain_signals
from processing.fit.witness.spectra import WitnessSpectra
from processing.fit.witness.use import Response, WitnessUse
from processing.fit.witnessed_columns import LEAST_LEFT
from processing.fit_method import FitMethod
