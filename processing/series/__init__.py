"""Runs of one contact combined, and one model over the runs' compressed likelihoods."""

from processing.series.combined import (
    CombinedValue,
    Disagreement,
    SeriesResult,
    combine,
    combine_runs,
    combined_limits,
)
from processing.series.density import ABSENT, SEEN, ChangePoint, find_change
from processing.series.model import GROWTH, LatentNumber, SeriesModel
from processing.series.posterior import SampledPosterior, SeriesPosterior, fit_series, sample_series
from processing.series.runs import (
    EXPONENT_OF,
    FRICTION,
    ORDER,
    POSITIVE,
    Bound,
    CompressedRun,
    Effect,
    EndSide,
    Form,
    only_bound,
    parameters,
    to_coordinates,
)
