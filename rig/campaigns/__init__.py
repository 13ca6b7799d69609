"""One model over many runs: `rig campaign`."""

from rig.campaigns.answer import Campaign, answer_of
from rig.campaigns.page import campaign_tables, save_campaign
from rig.campaigns.plan_file import campaign_plan_files
from rig.campaigns.planned import PlannedCampaign, Within, campaign_plan_table, plan_campaign, ready_s
from rig.campaigns.results import (
    CampaignEffect,
    CampaignResults,
    CampaignRun,
    CampaignSource,
    CampaignValue,
    SamplerFindings,
)
from rig.campaigns.sources import runs_of_archive, runs_of_folders
from rig.campaigns.stated import StatedCampaign, read_campaign
from rig.campaigns.targets import read_target
