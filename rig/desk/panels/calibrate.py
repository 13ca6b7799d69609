"""Calibrate: a form for each kind over `rig calibrate`, and what came out."""

import html
from functools import partial

from nicegui import run, ui

from rig.desk import tables
from rig.desk.calibrating import KINDS, CalibrationKind, file_calibration, use_calibration
from rig.desk.desk import Desk
from rig.desk.tab import Tab, box, text_field
from rig.prepare import CalibrationReport

_DAYS = "90"


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""

    def choose(chosen: str) -> None:
        for name, form in forms.items():
            form.set_visibility(name == chosen)
            buttons[name].props(remove="outline") if name == chosen else buttons[name].props("outline")

    with ui.row().classes("items-center"):
        buttons = {
            name: ui.button(name, on_click=partial(choose, name)).props(
                f'dense aria-label="{name}, calibrate it"'
            )
            for name in KINDS
        }
    forms = {name: _form(desk, tab, name, kind) for name, kind in KINDS.items()}
    choose(next(iter(forms)))


def _form(desk: Desk, tab: Tab, name: str, kind: CalibrationKind) -> ui.element:
    """Add the form of one kind, and the calibration that was filed with it last."""

    made: CalibrationReport | None = None

    async def file() -> None:
        nonlocal made
        stated = {key: str(field.value or "") for key, field in fields.items()}
        ui.notify("the calibration is made …")
        made = await run.io_bound(file_calibration, desk, name, str(given.value or ""), stated)

    def use() -> None:
        if made is not None:
            stated = use_calibration(desk, made)
            words = "used by everything this desk starts; to keep it permanently, state"
            ui.notify(f"{words}: {stated}", multi_line=True)

    def draw(filed: CalibrationReport | None) -> None:
        if filed is not None:
            ui.html(_result(filed), sanitize=False).classes("full-width")

    with box(kind.title, "full-width", head="middle") as form:
        ui.label(kind.do)
        given = text_field("measured values (TOML file)" if kind.is_list else "record", "", f"{name} given")
        given.classes("full-width")
        fields = {key: _choice(name, key, *asked) for key, asked in kind.fields.items()}
        if name == "check" and desk.config.calibration.lever is not None:
            fields["lever"].set_value(str(desk.config.calibration.lever))
        with ui.row().classes("full-width items-center"):
            fields["by"] = text_field("made by", desk.config.session.operator, f"{name} by")
            fields["valid-days"] = text_field("valid for / days", _DAYS, f"{name} days")
            tab.button("File it", file, f'color="positive" size="lg" aria-label="file {name}"')
        props = f'color="positive" size="lg" aria-label="use {name}"'
        tab.button("Use it", use, props, seen=lambda: made is not None)
        tab.drawn(lambda: made, draw)
    return form


def _choice(name: str, key: str, label: str, choices: tuple[str, ...]) -> ui.input | ui.select:
    if not choices:
        return text_field(label, "", f"{name} {key}").classes("full-width")
    return ui.select(list(choices), label=label, value=choices[0]).props(
        f'dense outlined aria-label="{label}"'
    )


def _result(made: CalibrationReport) -> str:
    parts = [
        tables.table(
            [
                ["filed as", str(made.path)],
                ["valid until", f"{made.calibration.valid_until:%Y-%m-%d}"],
                ["for the configuration", made.configuration.replace("\n", "  ")],
                *(["note", note] for note in made.calibration.notes),
            ],
            "where it is filed",
        )
    ]
    for table in made.tables:
        parts.append(f"<div class='title'>{html.escape(table.title)}</div>")
        parts.append(tables.table([list(table.head), *(list(row) for row in table.shown)], table.title))
    return "".join(parts)
