"""One model over many runs: `rig compare --model`."""

from rig.campaigns.answer import Campaign, fit_model
from rig.campaigns.campaign_file import StatedCampaign, read_campaign
from rig.campaigns.likelihoods import FoundRun
from rig.campaigns.page import save_campaign
from rig.campaigns.sources import NamedRuns, runs_of_folders
from rig.campaigns.tables import campaign_tables
