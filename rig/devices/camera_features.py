"""A camera's features as lines for a terminal: value, unit, allowed values."""

from collections.abc import Iterable, Iterator

from acquisition.cameras.usb3vision.node_map import READ_WRITE, WRITE_ONLY, FeatureReading

# Cameras report the largest number of the type for a feature without a limit.
_NO_LIMIT = 2.0**62


def feature_lines(readings: Iterable[FeatureReading]) -> Iterator[str]:
    """One line for each feature: name, value with its unit, range or choices, access."""
    shown = [(reading.name, _value(reading), _remark(reading)) for reading in readings]
    names = max((len(name) for name, _, _ in shown), default=0)
    values = min(max((len(value) for _, value, _ in shown), default=0), 24)
    for name, value, remark in shown:
        yield f"{name:<{names}}  {value:<{values}}  {remark}".rstrip()


def _value(reading: FeatureReading) -> str:
    value = reading.value
    if reading.kind == "Command":
        return "command"
    if value is None:
        return "-"
    if isinstance(value, bytes):
        return value.hex(" ") or "empty"
    text = f"{value:.9g}" if isinstance(value, float) else str(value)
    return f"{text} {reading.unit}".strip()


def _remark(reading: FeatureReading) -> str:
    if reading.problem:
        return reading.problem
    if reading.kind == "Command":
        return "" if reading.access == WRITE_ONLY else reading.access
    if reading.access != READ_WRITE:
        return reading.access
    if reading.choices:
        return "one of " + ", ".join(reading.choices)
    low, high = reading.minimum, reading.maximum
    if isinstance(reading.value, bool | str | bytes) or low is None or high is None:
        return ""
    if abs(low) >= _NO_LIMIT and abs(high) >= _NO_LIMIT:
        return ""
    return f"{low:.9g} to {high:.9g} {reading.unit}".strip()
