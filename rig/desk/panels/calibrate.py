"""Calibrate: what to do, one question after the other; what is recorded, what came out, where it is filed."""

import html
from functools import partial

from nicegui import run, ui

from processing.errors import ConfigurationError, RigError
from rig.calibrate import Filing
from rig.desk import drawings
from rig.desk.calibrating import FOLDER, Calibrating
from rig.desk.desk import Desk
from rig.desk.tab import DELIBERATE, Tab
from rig.settings import number
from rig.wizards import KINDS, Progress, Question

_DAYS = 90.0


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    calibrating = desk.calibrating
    kind = KINDS[0]
    drawn: object = None

    def choose(name: str) -> None:
        nonlocal kind
        kind = name
        refresh()

    def answer(text: str) -> None:
        calibrating.answer(kind, text)
        refresh()

    def back() -> None:
        calibrating.back(kind)
        refresh()

    async def record() -> None:
        await run.io_bound(calibrating.record, kind)
        refresh()

    def stop() -> None:
        calibrating.stop(kind)

    async def file() -> None:
        working.set_visibility(True)
        try:
            filing = Filing(FOLDER, _days(days.value), str(by.value or ""))
            await run.io_bound(calibrating.file, kind, filing)
        finally:
            working.set_visibility(False)
            refresh()

    with ui.row().classes("items-center"):
        kinds = {name: ui.button(name, on_click=partial(choose, name)) for name in KINDS}
    for name, button in kinds.items():
        button.props(f'dense aria-label="calibrate {name}"')
    with ui.element("div").classes("two half"):
        with ui.column().classes("box"):
            title = ui.label().classes("middle")
            asked = ui.column().classes("full-width")
            going = ui.label().classes("dim").props('role="status" aria-live="polite"')
            stopping = ui.button("Stop recording", on_click=tab.act(stop)).props('color="negative"')
            wrong = ui.label().classes("no").props('role="alert"')
            with ui.row().classes("full-width items-center") as last:
                by = ui.input("made by", value=desk.config.session.operator).props("dense outlined")
                days = ui.input("valid for / days", value=f"{_DAYS:g}").props(
                    'dense outlined data-key="days"'
                )
                ui.button("File it", on_click=tab.act(file)).props('color="positive" size="lg"')
                working = ui.spinner()
                working.set_visibility(False)
            ui.button("Back", on_click=tab.act(back)).props('outline aria-label="one question back"')
            given = ui.html(sanitize=False).classes("full-width")
        with ui.column().classes("box"):
            ui.label("what came out").classes("title")
            result = ui.html(sanitize=False).classes("full-width")

    def ask(question: Question) -> None:
        """The elements of one question."""
        if question.do:
            ui.label(question.do)
        ui.label(question.text).classes("text-weight-bold")
        if question.recording is not None:
            wanted = question.recording
            what = f"{wanted.frames} frames" if wanted.kind == "frames" else f"{wanted.seconds:g} s"
            ui.button(f"Record {what} now", on_click=tab.act(record)).props(
                f'color="positive" aria-label="record what is asked for" {DELIBERATE}'
            )
        for choice in question.choices:
            words = choice.answer + (f": {choice.text}" if choice.text else "")
            ui.button(words, on_click=tab.act(partial(answer, choice.answer))).props(
                "outline no-caps align=left"
            )
        if question.choices and not question.open_choice:
            return
        field = ui.input(value=question.suggested or "").props(
            f'outlined dense data-key="answer" aria-label="{question.text.replace(chr(34), chr(39))}"'
        )
        field.classes("full-width")

        def typed() -> None:
            try:
                answer(str(field.value or ""))
            except RigError as error:
                field.props(f'error error-message="{str(error).replace(chr(34), chr(39))}"')

        field.on("keydown.enter", tab.act(typed))
        ui.button("Answer", on_click=tab.act(typed)).props("outline")

    def refresh() -> None:
        nonlocal drawn
        try:
            busy = calibrating.recording(kind)
            found = calibrating.progress(kind)
        except RigError as error:
            wrong.set_text(str(error))
            return
        going.set_text(busy)
        stopping.set_visibility(bool(busy))
        wrong.set_text(calibrating.problems.get(kind, ""))
        now = (kind, calibrating.draft(kind), bool(busy), calibrating.made.get(kind))
        if now == drawn:
            return
        drawn = now
        wizard = calibrating.wizard(kind)
        title.set_text(wizard.title)
        for name, button in kinds.items():
            button.props(remove="outline") if name == kind else button.props("outline")
        asked.clear()
        last.set_visibility(found.question is None)
        if found.question is not None and not busy:
            with asked:
                ask(found.question)
        given.set_content(_given(calibrating, kind, found))
        result.set_content(_result(calibrating, kind))

    tab.every(0.5, refresh)
    refresh()


def _days(text: str | None) -> float:
    """Days of validity as typed; raises ConfigurationError for what is no number."""
    try:
        return number()((text or "").strip())
    except ConfigurationError as error:
        raise ConfigurationError(f"valid for / days: {error}") from None


def _given(calibrating: Calibrating, kind: str, found: Progress) -> str:
    answers = dict(calibrating.draft(kind).answers)
    rows = [[question.text, answers[question.name]] for question in reversed(found.asked)]
    return drawings.table(rows, "answers so far")


def _result(calibrating: Calibrating, kind: str) -> str:
    made = calibrating.made.get(kind)
    if made is None:
        return drawings.table([["nothing was filed at this desk yet", ""]], "result")
    parts = [
        drawings.table(
            [
                ["filed as", str(made.path)],
                ["valid until", f"{made.calibration.valid_until:%Y-%m-%d}"],
                ["for the configuration", made.configuration.replace("\n", "  ")],
                *(["note", note] for note in made.calibration.notes),
            ],
            "where it is filed",
        )
    ]
    for left in made.residuals:
        parts.append(f"<div class='title'>{html.escape(left.title)}</div>")
        parts.append(drawings.residuals(left, (480, 150)))
    for table in made.tables:
        parts.append(f"<div class='title'>{html.escape(table.title)}</div>")
        parts.append(drawings.table([list(table.head), *(list(row) for row in table.shown)], table.title))
    return "".join(parts)
