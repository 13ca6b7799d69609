"""Many runs, one answer: a hierarchical model over the runs' compressed likelihoods."""

from processing.campaign.compressed import Bound, CompressedRun, Side
from processing.campaign.coordinates import POSITIVE, parameters, to_coordinates
from processing.campaign.design import CampaignModel, Level, span_of
from processing.campaign.evidence import (
    ALIKE,
    ChangePoint,
    chance,
    compare_forms,
    find_change,
    is_limit,
    is_seen,
    within,
)
from processing.campaign.forms import FRICTION, ORDER, Effect, Form
from processing.campaign.parts import InParts, here
from processing.campaign.posterior import CampaignPosterior, fit_campaign, moved_by
from processing.campaign.sampling import Sampled, predictive_check, sample_campaign
