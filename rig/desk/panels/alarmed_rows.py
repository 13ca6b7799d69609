"""The rows of a run's state beside an alarm: what it contradicts says so instead of its last value."""

from collections.abc import Mapping, Sequence

from rig.alarms import AlarmKey

_OF_DISK = (AlarmKey.OUTPUT, AlarmKey.DISK_FULL, AlarmKey.DISK_HANGS, AlarmKey.DISK_FORECAST)


def as_alarmed(
    rows: Sequence[Sequence[str]],
    causes: Mapping[AlarmKey, str],
    no_frame_s: float,
    *,
    spot_lost_s: float = 0.0,
    is_dark: bool = False,
) -> list[list[str]]:
    """The rows (name, text); `causes` are those of the alarms that hold now.

    Losses are counted where they can be: the row says first what is being lost at this moment.
    """
    instead: dict[str, str] = {}
    losing = ""
    if AlarmKey.CAMERA in causes:
        instead |= {"camera": f"no frame for {no_frame_s:.0f} s", "beam": "not seen: no frames"}
        losing = "frames that do not come are counted when they come again"
    elif is_dark:
        instead["beam"] = "not seen: the laser is dark"
        losing = "no spot: the laser is dark"
    elif AlarmKey.SPOT in causes:
        instead["beam"] = "no spot now"
        losing = f"no spot for {spot_lost_s:.0f} s"
    for key in _OF_DISK:
        if key in causes:
            instead["disk"] = causes[key]
            break
    told = [[name, instead.get(name, text)] for name, text, *_ in rows]
    return [
        [name, f"{losing}; {text}"] if losing and name == "losses" else [name, text] for name, text in told
    ]
