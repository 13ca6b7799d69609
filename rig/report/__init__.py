"""Figures, tables and the HTML page of a session, and of several beside each other."""

from rig.report import figures_contact, figures_laws, figures_motion, html
from rig.report.comparison import compare
from rig.report.drawing import INK, ReportFigure, canvas, png, styled, svg
from rig.report.html import check_report
from rig.report.session_report import (
    draw_run,
    latex_tables,
    make_report,
    make_table_report,
    save_figures,
    save_tables,
)
from rig.report.source import ShownTrajectory, ShownUnit
from rig.report.tables import series_table
from rig.report.tables_instruments import instrument_table
