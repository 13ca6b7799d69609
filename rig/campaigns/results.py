"""What a campaign answers: the content of campaign.json."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan
from typing import Annotated

from processing.estimate import NOT_DETERMINED, Estimate
from processing.quantity import PART
from processing.series import ChangePoint, CompressedRun
from rig.analysis import JsonObject

SCHEMA = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignValue:
    """A quantity of a contact, where all effects are nought.

    `without_priors` is the answer of the data alone. Ends are of the 95 % band.
    """

    value: Annotated[float, PART]
    standard_uncertainty: Annotated[float, PART]
    lower_95: Annotated[float, PART] = nan
    upper_95: Annotated[float, PART] = nan
    without_priors: Annotated[Estimate, PART] = NOT_DETERMINED

    @property
    def estimate(self) -> Estimate:
        return Estimate(self.value, self.standard_uncertainty)


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignSource:
    """What one source adds to the uncertainty of a contact's quantity, and its share of the variance."""

    source: str
    contribution: float
    share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignEffect:
    """One effect: slope in its coordinate (of b, c and gamma the logarithm) per unit of its form.

    `over_span` is what it moves over the campaign. `chance` is that of one as large where there is none
    (`chance_is_limit`: at most, because there are no more draws), `seen` whether that is below 5 % shared by
    all that were tried. `log_bayes_factor` is that of the form against none, `probability` after it, with the
    choice among those that were tried charged; `margin` is what would not matter, `equivalent` the
    probability that the effect over the span is smaller.
    """

    label: str
    parameter: str
    covariate: str
    form: str
    reference: float
    slope: Estimate = NOT_DETERMINED
    slope_without_priors: Estimate = NOT_DETERMINED
    lower_95: float = nan
    upper_95: float = nan
    over_span: Estimate = NOT_DETERMINED
    chance: float = nan
    chance_is_limit: bool = False
    seen: bool = False
    log_bayes_factor: float = nan
    probability: float = nan
    margin: float | None = None
    equivalent: float = nan


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignDifference:
    """Two contacts where all effects are zero: the first's coordinate less the second's, with the ends of its
    95 % band. The coordinate of b, c and gamma is the logarithm, of b and gamma at the reference amplitude.

    What runs share cancels. `chance` is that of a difference as large where there is none, `seen` whether it
    is below 5 %, shared by all differences of the campaign.
    """

    first: str
    second: str
    parameter: str
    difference: Estimate
    lower_95: float
    upper_95: float
    chance: float
    seen: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignRun:
    """One run: what it says alone, what the campaign says of it, and how likely it is a bad one.

    `likelihood` is what entered, in coordinates; `results_sha256` the hash of the results it was made of.
    `residuals` are deviations from the model over what run and scatter leave.
    """

    label: str
    contact: str
    record: str
    sha256: str
    results_sha256: str
    likelihood: JsonObject
    alone: Annotated[Mapping[str, Estimate], PART] = field(default_factory=dict)
    together: Annotated[Mapping[str, Estimate], PART] = field(default_factory=dict)
    residuals: Mapping[str, float] = field(default_factory=dict)
    bad: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplerFindings:
    """What the sampler's chains say of themselves: the worst R-hat, the fewest independent draws."""

    worst_r_hat: float
    fewest_draws: float
    settled: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignResults:
    """campaign.json.

    `between_runs` and `between_contacts` are standard deviations, of b, c and gamma as fractions. `shared`
    are inputs that runs have in common, in their standard uncertainties: what the runs say of them.
    `nothing` is the probability that no candidate holds. `draws_that_count` says how well Laplace's method
    describes the posterior, `predictive_p` how probable it is
    that runs of the model scatter as much as the real ones. `stated` is what the configuration states.
    """

    schema: int = SCHEMA
    parameters: tuple[str, ...]
    reference_arcsec: float
    runs: tuple[CampaignRun, ...]
    contacts: Annotated[Mapping[str, Mapping[str, CampaignValue]], PART]
    differences: tuple[CampaignDifference, ...] = ()
    between_runs: Mapping[str, Estimate] = field(default_factory=dict)
    between_contacts: Mapping[str, Estimate] = field(default_factory=dict)
    effects: tuple[CampaignEffect, ...] = ()
    candidates: tuple[CampaignEffect, ...] = ()
    nothing: float = nan
    changes: tuple[ChangePoint, ...] = ()
    shared: Mapping[str, Estimate] = field(default_factory=dict)
    budgets: Mapping[str, Mapping[str, tuple[CampaignSource, ...]]] = field(default_factory=dict)
    draws: int = 0
    draws_that_count: float = nan
    predictive_p: float = nan
    sampler: SamplerFindings | None = None
    left_out: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    simulated: bool = False
    stated: JsonObject = field(default_factory=dict)


def likelihood_tree(run: CompressedRun) -> JsonObject:
    """What entered of a run, as it stands in the file."""
    return {
        "names": list(run.names),
        "values": run.values.tolist(),
        "covariance": run.covariance.tolist(),
        "shared": {key: moved.tolist() for key, moved in run.shared.items()},
        "asymmetry": dict(run.asymmetry),
        "bounds": {
            key: {"limit": b.limit, "side": str(b.side), "softness": b.softness}
            for key, b in run.bounds.items()
        },
        "covariates": {key: list(found) for key, found in run.covariates.items()},
        "by_growth": None if run.by_growth is None else run.by_growth.tolist(),
        "duration_s": run.duration_s,
    }
