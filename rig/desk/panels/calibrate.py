"""Calibrate: a form for each kind over `rig calibrate`; what is recorded for it, and what came out."""

import html
from functools import partial

from nicegui import run, ui

from rig.calibrate import CalibrationReport
from rig.desk import tables
from rig.desk.calibrating import FOLDER, KINDS, Calibrating
from rig.desk.desk import Desk
from rig.desk.panels.between_runs import as_typed
from rig.desk.tab import DELIBERATE, Tab, at_once, box

_DAYS, _DARK_FRAMES = "90", "16"


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    forms: dict[str, CalibrationForm] = {}

    def choose(chosen: str) -> None:
        for name, form in forms.items():
            form.box.set_visibility(name == chosen)
            buttons[name].props(remove="outline") if name == chosen else buttons[name].props("outline")

    def refresh() -> None:
        busy = desk.calibrating.recording()
        for form in forms.values():
            form.refresh(busy)

    with ui.row().classes("items-center"):
        buttons = {name: ui.button(name, on_click=partial(choose, name)) for name in KINDS}
    for name, button in buttons.items():
        button.props(f'dense aria-label="{name}, calibrate it"')
    for name in KINDS:
        forms[name] = CalibrationForm(desk, tab, name)
    choose(next(iter(KINDS)))
    tab.every(0.5, refresh)
    refresh()


class CalibrationForm:
    """The form of one kind, and the calibration that was filed with it."""

    def __init__(self, desk: Desk, tab: Tab, name: str) -> None:
        self._calibrating: Calibrating = desk.calibrating
        self._name, self._kind = name, KINDS[name]
        self._offered: object = None
        self._drawn: CalibrationReport | None = None
        kind = self._kind
        with box(kind.title, "full-width", head="middle") as self.box:
            ui.label(kind.do)
            with ui.row().classes("items-center"):
                amount = _DARK_FRAMES if kind.seconds is None else f"{kind.seconds:g}"
                what = "frames" if kind.seconds is None else "length / s"
                self._amount = _field(what, amount, f"{name} amount")
                if kind.seconds is None:
                    self._exposure = _field("exposure / us", "", f"{name} exposure")
                tab.button("Record now", self._record).props(
                    f'color="positive" aria-label="record for {name}" {DELIBERATE}'
                )
                self._stopping = tab.button("Cancel the recording", self._calibrating.stop).props(
                    'color="negative"'
                )
            self._going = ui.label().classes("dim").props('role="status" aria-live="polite"')
            if kind.list_text:
                given: ui.input | ui.textarea = ui.textarea(
                    "list of measured values (TOML)", value=kind.list_text
                )
                given.props(f'outlined autogrow data-key="{name} list" input-class="number"')
            else:
                given = ui.input("record").props(f'outlined dense data-key="{name} record"')
            self._given = given.classes("full-width")
            self._fields = {key: _choice(name, key, *asked) for key, asked in kind.fields.items()}
            if name == "check" and desk.config.calibration.lever is not None:
                self._fields["lever"].set_value(str(desk.config.calibration.lever))
            with ui.row().classes("full-width items-center"):
                self._fields["by"] = _field("made by", desk.config.session.operator, f"{name} by")
                self._fields["valid-days"] = _field("valid for / days", _DAYS, f"{name} days")
                tab.button("File it", self._file).props(
                    f'color="positive" size="lg" aria-label="file {name}"'
                )
                self._working = ui.spinner().props('aria-label="the calibration is made"')
                self._working.set_visibility(False)
            self._wrong = ui.label().classes("no").props('role="alert"')
            self._using = tab.button("Use it", self._use).props(
                f'color="positive" size="lg" aria-label="use {name}"'
            )
            self._result = ui.html(sanitize=False).classes("full-width")

    def refresh(self, busy: str) -> None:
        """Show what is recorded, what went wrong and what was filed."""
        self._going.set_text(busy)
        self._stopping.set_visibility(bool(busy))
        self._wrong.set_text(self._calibrating.problems.get(self._name, ""))
        recorded = self._calibrating.recorded.get(self._name)
        if recorded is not None and not busy:
            if self._kind.list_text:
                self._going.set_text(
                    f'recorded: name it in the list as "{recorded.relative_to(FOLDER).as_posix()}"'
                )
            elif recorded != self._offered:
                self._given.set_value(str(recorded))
            self._offered = recorded
        made = self._calibrating.made.get(self._name)
        self._using.set_visibility(made is not None)
        if made is not None and made != self._drawn:
            self._drawn = made
            self._result.set_content(_result(made))

    async def _record(self) -> None:
        exposure = as_typed(self._exposure.value, True) if self._kind.seconds is None else ""
        await run.io_bound(self._calibrating.record, self._name, str(self._amount.value or ""), exposure)

    async def _file(self) -> None:
        stated = {key: str(field.value or "") for key, field in self._fields.items()}
        self._working.set_visibility(True)
        try:
            await run.io_bound(self._calibrating.file, self._name, str(self._given.value or ""), stated)
        finally:
            self._working.set_visibility(False)
            self.refresh(self._calibrating.recording())

    def _use(self) -> None:
        stated = self._calibrating.use(self._name)
        ui.notify(
            f"used by everything this desk starts; to keep it permanently, state: {stated}", multi_line=True
        )


def _field(label: str, value: str, key: str) -> ui.input:
    return ui.input(label, value=value).props(f'dense outlined data-key="{key}" aria-label="{label}"')


def _choice(name: str, key: str, label: str, choices: tuple[str, ...]) -> ui.input | ui.select:
    if not choices:
        return _field(label, "", f"{name} {key}").classes("full-width")
    return at_once(ui.select(list(choices), label=label, value=choices[0])).props(
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
