"""Fields of the configuration on a panel: what is typed is judged by the models, and said at the field."""

from collections.abc import Mapping

from nicegui import ui

from rig.desk.desk import Desk


def text_field(desk: Desk, key: str, label: str, value: str = "") -> ui.input:
    """A field for text."""
    field = ui.input(label, value=value).props(f'dense outlined data-key="{key}" aria-label="{label}"')
    field.classes("full-width")
    return _judged(desk, key, field)


def number_field(desk: Desk, key: str, label: str, value: float | None) -> ui.input:
    """A field for a number; empty means that nothing is stated."""
    shown = "" if value is None else f"{value:.10g}"
    field = ui.input(label, value=shown).props(f'dense outlined data-key="{key}" aria-label="{label}"')
    return _judged(desk, key, field, is_number=True)


def _judged(desk: Desk, key: str, field: ui.input, *, is_number: bool = False) -> ui.input:
    def fault(text: str | None) -> str | None:
        typed = as_typed(text, is_number)
        # an empty number is not stated
        return None if is_number and typed == "" else desk.fault(key, typed) or None

    field.validation = fault
    return field


def as_typed(text: str | None, is_number: bool) -> object:
    """A number where one was typed; anything else as text, which the model judges."""
    text = (text or "").strip() if is_number else (text or "")
    if not is_number:
        return text
    try:
        return int(text)
    except ValueError:
        pass
    try:
        return float(text)
    except ValueError:
        return text


def stated(fields: Mapping[str, tuple[ui.input, bool]]) -> dict[str, object]:
    """Values by key of all fields, (field, whether it is a number); an empty number is left out."""
    values = {key: as_typed(field.value, number) for key, (field, number) in fields.items()}
    return {key: value for key, value in values.items() if not (value == "" and fields[key][1])}
