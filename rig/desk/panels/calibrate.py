"""Calibrate: a form for each kind over `rig calibrate`, and its result."""

import html
from functools import partial

from nicegui import run, ui

from rig.desk import tables
from rig.desk.calibrating import KINDS, CalibrationKind, file_calibration, use_calibration
from rig.desk.desk import Desk
from rig.desk.tab import Tab, box, text_field
from rig.prepare import CalibrationReport

_VALID_DAYS = "90"


def build(desk: Desk, tab: Tab) -> None:
    def choose(choice: str) -> None:
        for name, form in forms.items():
            form.set_visibility(name == choice)
            buttons[name].props(remove="outline") if name == choice else buttons[name].props("outline")

    with ui.row().classes("items-center"):
        buttons = {
            name: ui.button(name, on_click=partial(choose, name)).props(
                f'dense aria-label="{name}, calibrate it"'
            )
            for name in KINDS
        }
    forms = {name: _build_form(desk, tab, name, kind) for name, kind in KINDS.items()}
    choose(next(iter(forms)))


def _build_form(desk: Desk, tab: Tab, name: str, kind: CalibrationKind) -> ui.element:
    """Build the form of one kind, with the last calibration that was filed by it; returns its element."""
    last_report: CalibrationReport | None = None

    async def file() -> None:
        nonlocal last_report
        options = {key: str(field.value or "") for key, field in fields.items()}
        ui.notify("the calibration is made …")
        last_report = await run.io_bound(file_calibration, desk, name, str(source.value or ""), options)

    def use() -> None:
        if last_report is not None:
            lines = use_calibration(desk, last_report)
            advice = "used by everything this desk starts; to keep it permanently, state"
            ui.notify(f"{advice}: {lines}", multi_line=True)

    def draw(report: CalibrationReport | None) -> None:
        if report is not None:
            ui.html(_result(report), sanitize=False).classes("full-width")

    with box(kind.title, "full-width", head="middle") as form:
        ui.label(kind.instruction)
        source = text_field("measured values (TOML file)" if kind.is_list else "record", "", f"{name} given")
        source.classes("full-width")
        fields = {
            key: _build_field(name, key, label, choices) for key, (label, choices) in kind.fields.items()
        }
        if name == "check" and desk.config.calibration.lever is not None:
            fields["lever"].set_value(str(desk.config.calibration.lever))
        with ui.row().classes("full-width items-center"):
            fields["by"] = text_field("made by", desk.config.session.operator, f"{name} by")
            fields["valid-days"] = text_field("valid for / days", _VALID_DAYS, f"{name} days")
            tab.button("File it", file, f'color="positive" size="lg" aria-label="file {name}"')
        props = f'color="positive" size="lg" aria-label="use {name}"'
        tab.button("Use it", use, props, visible=lambda: last_report is not None)
        tab.column(lambda: last_report, draw)
    return form


def _build_field(name: str, key: str, label: str, choices: tuple[str, ...]) -> ui.input | ui.select:
    if not choices:
        return text_field(label, "", f"{name} {key}").classes("full-width")
    return ui.select(list(choices), label=label, value=choices[0]).props(
        f'dense outlined aria-label="{label}"'
    )


def _result(report: CalibrationReport) -> str:
    rows = [
        ["filed as", str(report.path)],
        ["valid until", f"{report.calibration.valid_until:%Y-%m-%d}"],
        ["for the configuration", report.configuration.replace("\n", "  ")],
        *(["note", note] for note in report.calibration.notes),
    ]
    parts = [tables.table(rows, "where it is filed")]
    for table in report.tables:
        parts.append(f"<div class='title'>{html.escape(table.title)}</div>")
        parts.append(tables.table([table.head, *table.shown], table.title))
    return "".join(parts)
