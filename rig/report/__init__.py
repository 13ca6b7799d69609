"""Figures, tables and HTML pages of a session, and of several sessions compared; exports; run plans."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rig.report import figures_contact, figures_laws, figures_motion, html
from rig.report.comparison import compare
from rig.report.drawing import INK, ReportFigure, canvas, png, styled, svg, three_columns
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
from rig.report.tables import instrument_table, series_table

if TYPE_CHECKING:
    from rig.report.paper_tables import reproduce_paper
    from rig.report.plan import ageing_table, make_plan, plan_figure, plan_table, save_plan
    from rig.report.planned_run import (
        PlannedContact,
        planned_contact,
        planned_contact_of_file,
        planned_contact_of_run,
        planned_contact_of_table,
    )
    from rig.report.session_export import export_session

_LAZY_MODULES = {
    name: module
    for module, names in {
        "session_export": "export_session",
        "planned_run": "PlannedContact planned_contact planned_contact_of_file planned_contact_of_run "
        "planned_contact_of_table",
        "plan": "ageing_table make_plan plan_figure plan_table save_plan",
        "paper_tables": "reproduce_paper",
    }.items()
    for name in names.split()
}
"""Names that are imported at their first use, each with its module."""


if not TYPE_CHECKING:  # a type checker would take any name for one of this room

    def __getattr__(name: str) -> Any:
        if name not in _LAZY_MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_LAZY_MODULES[name]}"), name)
