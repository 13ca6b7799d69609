"""One model over many runs: `rig campaign`."""

from rig.campaigns.answer import Campaign, answer_of
from rig.campaigns.cluster import parts_on_cluster
from rig.campaigns.likelihoods import FoundRun
from rig.campaigns.page import campaign_tables, save_campaign
from rig.campaigns.plan_file import campaign_plan_files, changes_of
from rig.campaigns.planned import (
    PlannedCampaign,
    PlannedKind,
    Within,
    campaign_plan_table,
    kinds_text,
    plan_campaign,
    ready_s,
    reasons,
)
from rig.campaigns.planner import AskedPlan, Planner
from rig.campaigns.results import (
    CampaignEffect,
    CampaignResults,
    CampaignRun,
    CampaignSource,
    CampaignValue,
    SamplerFindings,
)
from rig.campaigns.sources import NamedRuns, runs_of_archive, runs_of_folders
from rig.campaigns.stated import StatedCampaign, read_campaign
from rig.campaigns.targets import read_target
