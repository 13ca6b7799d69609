"""Fits of a contact law to a decay, and uncertainties of the results."""

from processing.estimate import FitMethod
from processing.fit.asymptotic import fit_asymptotic
from processing.fit.changes import fit_with_knocks, with_changes
from processing.fit.determination import Determination, identifiability
from processing.fit.drag import Drag, DragFinding, MeasuredAir, VanedRun, air_of_vanes, drag_verdict
from processing.fit.effects import (
    DRIFTS,
    PositionErrorFit,
    TimeAlternation,
    amplitude_error_effects,
    boundary_layer_drag,
    drift_effects,
    drift_term,
    fit_position_errors,
    row_delay,
    sensor_derivatives,
    time_alternation,
    with_boundary_layer_drag,
    with_rest_position,
    without_alternation,
)
from processing.fit.evidence import AIR, NO_EVIDENCE, WAVEFORM, Evidence, waveform_of
from processing.fit.exact import fit_exact
from processing.fit.exact_result import domain_warnings
from processing.fit.ground import GROUND_SEEN, Ground, density_of_step
from processing.fit.known_drive import LEAST_UNEXPLAINED, Seismogram, Signals, plain_signals
from processing.fit.law_comparison import LawComparison, compare_laws, fit_model_free, with_discrepancy
from processing.fit.planning import Conditions, PlannedRun, planned_run
from processing.fit.refinement import (
    DecayFit,
    Refinement,
    describes_as_well,
    fitted_twice,
    judge_refinement,
    known_motion,
    measurement_shift,
    points_in_true_time,
    second_measurement,
    up_to_rest_step,
)
from processing.fit.result import (
    BOUNDARY_LAYER,
    DISCREPANCY,
    FIXED_PATTERN,
    MEASUREMENT,
    REST_POSITION,
    Change,
    ChangeKind,
    DiscrepancySize,
    FitQuality,
    FitResult,
)
from processing.fit.seismometer import Response, SeismometerUse, fit_with_seismometer
from processing.fit.terms import LinearisedFit, Term
from processing.fit.uncertainty import (
    Budget,
    BudgetSource,
    InputQuantity,
    RigQuantities,
    Work,
    budgets,
    reported_quantities,
    rolling_moment_nm,
    standard_uncertainties,
    works_per_cycle_j,
)
from processing.quantity import DerivedQuantity
