"""Calibrate: what to do, one question after the other; what is recorded, what came out, where it is filed."""

import html
from functools import partial

from nicegui import run, ui

from processing.errors import ConfigurationError, RigError
from rig.calibrate import Filing
from rig.desk import tables
from rig.desk.calibrating import FOLDER, Calibrating
from rig.desk.chart_options import Curve
from rig.desk.charts import Chart
from rig.desk.desk import Desk
from rig.desk.panels.live_picture import LivePicture, no_frame_yet
from rig.desk.tab import DELIBERATE, Tab
from rig.settings import number
from rig.wizards import KINDS, Filed, Progress, Question

_DAYS = 90.0
_SIZE = (480, 240)


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

    def over() -> None:
        calibrating.start_over(kind)
        refresh()

    def use() -> None:
        stated = calibrating.use(kind)
        ui.notify(
            f"used by everything this desk starts; to keep it permanently, state: {stated}", multi_line=True
        )

    async def look() -> None:
        await run.io_bound(desk.begin_aligning)

    with ui.row().classes("items-center"):
        kinds = {name: ui.button(name, on_click=partial(choose, name)) for name in KINDS}
    for name, button in kinds.items():
        button.props(f'dense aria-label="{name}, calibrate it"')
    with ui.element("div").classes("grid halves"):
        with ui.column().classes("box"):
            title = ui.html(tag="h3", sanitize=False).classes("middle")
            steps = ui.html(sanitize=False)
            asked = ui.column().classes("full-width")
            going = ui.label().classes("middle").props('role="status" aria-live="polite"')
            words = ui.label().classes("dim")
            part = ui.linear_progress(show_value=False).props('aria-label="part of the recording done"')
            stopping = tab.button("Cancel the recording", stop).props('color="negative"')
            wrong = ui.label().classes("no").props('role="alert"')
            with ui.row().classes("full-width items-center") as last:
                by = ui.input("made by", value=desk.config.session.operator).props("dense outlined")
                days = ui.input("valid for / days", value=f"{_DAYS:g}").props(
                    'dense outlined data-key="days"'
                )
                tab.button("File it", file).props('color="positive" size="lg"')
                working = ui.spinner().props('aria-label="the calibration is made"')
                working.set_visibility(False)
            with ui.row():
                tab.button("Back", back).props('outline aria-label="Back one question"')
                tab.button("Start over", over).props("outline")
            given = ui.html(sanitize=False).classes("full-width")
        with ui.column().classes("box"):
            ui.html("what the camera sees", tag="h3", sanitize=False).classes("title")
            with ui.element("div").classes("full-width"):
                LivePicture(tab, _SIZE, lambda: _seen(desk), lambda: _why_none(desk))
            lighting = tab.button("Live picture", look).props(f"outline {DELIBERATE}")
            ui.html("result", tag="h3", sanitize=False).classes("title")
            using = tab.button("Use it", use).props('color="positive" size="lg"')
            result = ui.html(sanitize=False).classes("full-width")
            drawn_here = ui.column().classes("full-width")

    def ask(question: Question) -> None:
        """The elements of one question."""
        if question.do:
            ui.label(question.do)
        ui.label(question.text).classes("text-weight-bold")
        if question.recording is not None:
            wanted = question.recording
            what = f"{wanted.frames} frames" if wanted.kind == "frames" else f"{wanted.seconds:g} s"
            tab.button(f"Record {what} now", record).props(
                f'color="positive" aria-label="record what is asked for" {DELIBERATE}'
            )
        for choice in question.choices:
            words = choice.answer + (f": {choice.text}" if choice.text else "")
            tab.button(words, partial(answer, choice.answer)).props("outline no-caps align=left")
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
        tab.button("Answer", typed).props("outline")

    def refresh() -> None:
        nonlocal drawn
        try:
            busy = calibrating.recording(kind)
            found = calibrating.progress(kind)
        except RigError as error:
            wrong.set_text(str(error))
            return
        going.set_text(busy)
        words.set_text(calibrating.last_words(kind))
        stopping.set_visibility(bool(busy))
        done = calibrating.recorded_part(kind)
        part.set_visibility(bool(busy) and done is not None)
        part.set_value(round(done or 0.0, 2))
        lighting.set_visibility(not busy and not _seen(desk))
        wrong.set_text(calibrating.problems.get(kind, ""))
        now = (kind, calibrating.draft(kind), bool(busy), calibrating.made.get(kind))
        if now == drawn:
            return
        drawn = now
        wizard = calibrating.wizard(kind)
        title.set_content(html.escape(wizard.title))
        steps.set_content(_steps(found, bool(busy), calibrating.made.get(kind) is not None))
        using.set_visibility(calibrating.made.get(kind) is not None)
        for name, button in kinds.items():
            button.props(remove="outline") if name == kind else button.props("outline")
        asked.clear()
        last.set_visibility(found.question is None)
        if found.question is not None and not busy:
            with asked:
                ask(found.question)
        given.set_content(_given(calibrating, kind, found))
        result.set_content(_result(calibrating, kind))
        drawn_here.clear()
        with drawn_here:
            _draw(calibrating.made.get(kind))

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
    return tables.table(rows, "answers so far")


def _result(calibrating: Calibrating, kind: str) -> str:
    made = calibrating.made.get(kind)
    if made is None:
        return tables.table([["nothing filed at this desk yet", ""]], "result")
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


def _draw(made: Filed | None) -> None:
    """A chart of what each fit has left over."""
    for left in () if made is None else made.residuals:
        chart = Chart(left.title, left.x_name, (Curve(left.y_name, style="intervals"),), height="200px")
        chart.show([list(zip(left.x, left.y, left.u, strict=True))])


def _steps(found: Progress, busy: bool, made: bool) -> str:
    """Where the wizard stands: answers, recording, filing, use."""
    answered = len(found.asked)
    asking = found.question is not None
    steps = (
        (f"answers ({answered} given)", asking and not busy and not (made and not answered)),
        ("recording", busy),
        ("file it", not asking and not busy),
        ("use it", made and asking and not answered),
    )
    lines = "".join(
        f"<li{' aria-current=step' if current else ''}>{k}. {html.escape(words)}</li>"
        for k, (words, current) in enumerate(steps, 1)
    )
    return f"<ol class='steps'>{lines}</ol>"


def _seen(desk: Desk) -> bool:
    return desk.aligner is not None or desk.following.running or desk.calibrating.watched is not None


def _why_none(desk: Desk) -> str:
    if desk.aligner is not None:
        return "" if desk.aligner.look is not None else "waiting for the first frame"
    if desk.following.running:
        return no_frame_yet(desk.following)
    if desk.calibrating.watched is not None:
        return "" if desk.following.has_picture else "waiting for the first frame of the recording"
    if desk.config.laser.kind == "none":
        return "no picture: a recording brings one"
    return "laser off: a recording switches it on automatically"
