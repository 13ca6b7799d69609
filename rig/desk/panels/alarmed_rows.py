"""The rows of a run's state beside an alarm: what it contradicts says so instead of its last value."""

from collections.abc import Mapping, Sequence

from rig.alarms import AlarmKey

_OF_DISK = (AlarmKey.OUTPUT, AlarmKey.DISK_FULL, AlarmKey.DISK_HANGS, AlarmKey.DISK_FORECAST)


def as_alarmed(
    rows: Sequence[Sequence[str]], causes: Mapping[AlarmKey, str], no_frame_s: float, *, is_dark: bool = False
) -> list[list[str]]:
    """The rows (name, text); `causes` are those of the alarms that hold now."""
    instead: dict[str, str] = {}
    if AlarmKey.CAMERA in causes:
        instead |= {"camera": f"no frame for {no_frame_s:.0f} s", "beam": "not seen: no frames"}
    elif is_dark:
        instead["beam"] = "not seen: the laser is dark"
    elif AlarmKey.SPOT in causes:
        instead["beam"] = "no spot now"
    for key in _OF_DISK:
        if key in causes:
            instead["disk"] = causes[key]
            break
    return [[name, instead.get(name, text)] for name, text, *_ in rows]
