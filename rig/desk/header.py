"""Head of the page: alarms and their list, light that waits for a person, an instruction, errors."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from nicegui import ui

from rig.control import TripCause
from rig.desk.alarm_list import AlarmKey, AlarmRow, AlarmState
from rig.desk.desk import Desk
from rig.desk.dialogs import trip_dialog
from rig.desk.lighting import refusal
from rig.desk.run_reader import clock
from rig.desk.tab import DELIBERATE, Tab, in_background
from rig.terminal import loud


def build_header(desk: Desk, tab: Tab) -> Callable[[], None]:
    """Build the head; returns the action that unfolds or folds the list of alarms."""

    def instruction() -> str:
        return loud(str(desk.follower.state.get("instruction") or ""))

    with ui.element("div").classes("cries"):
        toggle = _build_alarms(desk, tab)
        _build_relight(desk, tab)
        tab.label(instruction, "instruction", 'role="alert"')
        tab.errors = ui.element("div").classes("errors full-width")
    return toggle


def _build_relight(desk: Desk, tab: Tab) -> None:
    """Build the reason why it is dark, and the buttons for the acknowledgement and for light."""
    lighting = desk.lighting

    def why_dark() -> str:
        trip, cause = desk.safety.trip, "The laser is dark, and waits for a person"
        if trip is not None:
            # the text of a press of LIGHT OFF needs no number
            cause = sentence(trip.why if trip.cause is TripCause.PERSON else trip.text)
        return f"{cause}. Check that nobody is in the beam path."

    def acknowledge() -> str:
        trip, refused = desk.safety.trip, refusal(desk.safety.now)
        return "" if trip is None else f"Acknowledge trip {trip.number}{f': {refused}' if refused else ' …'}"

    with ui.element("div").classes("waits") as waits:
        tab.label(why_dark)
        tab.button(
            acknowledge,
            trip_dialog(desk, tab),
            'color="negative"',
            visible=lambda: desk.safety.trip is not None,
            enabled=lambda: not refusal(desk.safety.now),
        )
        # the remedy of the alarm names it, so it is visible before it may be pressed
        tab.button(
            lambda: "Light again" if lighting.awaits_light else "Light again: once the trip is acknowledged",
            in_background(lighting.relight),
            f'color="positive" {DELIBERATE}',
            visible=lambda: (
                lighting.awaits_light or (desk.safety.trip is not None and desk.picture_source is not None)
            ),
            enabled=lambda: lighting.awaits_light,
        )
    tab.on_refresh(lambda: waits.set_visibility(lighting.awaits_light or desk.safety.trip is not None))


def _build_alarms(desk: Desk, tab: Tab) -> Callable[[], None]:
    """Build the gravest alarm in a line, and the list; returns the action that unfolds or folds the list."""
    alarms = desk.alarming.alarms

    def toggle() -> None:
        fold.set_value(not fold.value)

    def gravest(text: Callable[[AlarmRow], str]) -> str:
        return next((sentence(text(row)) for row in alarms.rows() if row.is_loud), "")

    with ui.element("div").classes("alarm").props('role="alert" aria-live="assertive"') as banner:
        title = tab.label(lambda: gravest(lambda row: f"{row.key}: {row.cause}"), "text-weight-bold")
        tab.label(lambda: gravest(lambda row: row.key.remedy), "alarm-remedy")
        ui.button("All", on_click=toggle).props('dense flat aria-label="All alarms, key a"')
    tab.on_refresh(lambda: banner.set_visibility(bool(title.text)))
    with ui.expansion().classes("full-width alarms").props("dense") as fold:
        with fold.add_slot("header"):
            tab.label(lambda: _counts(alarms.rows()), props='role="status" aria-live="polite"')
        _build_list(desk, tab)
    return toggle


def _counts(rows: Sequence[AlarmRow]) -> str:
    counts = [(state, sum(row.state is state for row in rows)) for state in AlarmState]
    return f"Alarms: {', '.join(f'{count} {state}' for state, count in counts if count) or 'none'}"


def _build_list(desk: Desk, tab: Tab) -> None:
    alarms = desk.alarming.alarms
    causes: dict[AlarmKey, ui.label] = {}

    def draw(rows: Sequence[AlarmRow]) -> None:
        causes.clear()
        for row in rows:
            causes[row.key] = _build_row(tab, row, alarms.acknowledge)
        if not rows:
            ui.label("nothing is wrong").classes("dim")

    def refresh_causes() -> None:
        for row in alarms.rows():
            if row.key in causes:
                causes[row.key].set_text(row.cause)

    # a cause may change every second, and a button that is replaced while it is pressed does nothing
    tab.column(lambda: [replace(row, cause="") for row in alarms.rows()], draw)
    tab.on_refresh(refresh_causes)


def _build_row(tab: Tab, row: AlarmRow, acknowledge: Callable[[AlarmKey], None]) -> ui.label:
    """Build a row of the list; returns the label of its cause, which is still empty."""
    cleared_s = row.cleared_s if row.state is AlarmState.CLEARED else None
    times = (("since", row.raised_s), ("cleared", cleared_s), ("seen", row.acknowledged_s))
    with ui.element("div").classes(f"alarm-row {row.state}").props(f'data-alarm="{row.key}"'):
        with ui.element("div"):
            count = f" ({row.count} times)" if row.count > 1 else ""
            ui.label(f"{row.key}{count}").classes("text-weight-bold")
            times_text = ", ".join(f"{name} {clock(time_s)}" for name, time_s in times if time_s is not None)
            ui.label(f"{row.state}; {times_text}").classes("dim")
        cause = ui.label().props('aria-label="cause"')
        ui.label(row.key.remedy).props('aria-label="remedy"')
        # a trip is acknowledged beside the state of the light
        if row.key is not AlarmKey.TRIP and row.state is not AlarmState.ACKNOWLEDGED:
            props = f'dense outline aria-label="acknowledge {row.key}" {DELIBERATE}'
            tab.button("Seen", partial(acknowledge, row.key), props)
    return cause


def sentence(text: str) -> str:
    """The text with a capital first letter."""
    return text[:1].upper() + text[1:]
