"""Figures, tables and HTML pages of a session, one model over many runs, exports, plans."""

from rig.report.campaign import Campaign, fit_model
from rig.report.campaign_input import StatedCampaign, read_campaign, runs_of_archive, runs_of_folders
from rig.report.campaign_page import campaign_tables, decays_table, save_campaign
from rig.report.drawing import styled
from rig.report.export import export_session
from rig.report.html import check_report
from rig.report.paper import reproduce_paper
from rig.report.plan import (
    make_plan,
    plan_table,
    planned_contact,
    planned_contact_of_file,
    planned_contact_of_run,
    planned_contact_of_table,
)
from rig.report.session_report import draw_run, make_report, make_table_report
