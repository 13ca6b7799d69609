"""What a run was in at each time, as coloured lanes: measuring or ended, spot, frames and laser.

They follow from the events, which are drawn as text as well.
"""

from typing import Final

import rerun as rr

from acquisition.record.events import EventKind
from rig.presentation import palette
from rig.rerun import layout

_GOOD, _BAD, _OVER = palette.BLUISH_GREEN, palette.VERMILLION, palette.GREY
_STATES: Final = {
    "measuring": _GOOD,
    "ended": _OVER,
    "followed": _GOOD,
    "lost": _BAD,
    "arriving": _GOOD,
    "silent": palette.ORANGE,
    "camera lost": _BAD,
    "lit": _GOOD,
    "dark": _BAD,
}
_CHANGES: Final[dict[str, dict[str, str]]] = {
    EventKind.START: {"run": "measuring", "spot": "followed", "frames": "arriving"},
    EventKind.STOP: {"run": "ended"},
    EventKind.REJECTED: {"run": "ended"},
    EventKind.SPOT_LOST: {"spot": "lost"},
    EventKind.SPOT_FOUND: {"spot": "followed"},
    EventKind.CAMERA_SILENT: {"frames": "silent"},
    EventKind.CAMERA_SPEAKS: {"frames": "arriving"},
    EventKind.CAMERA_LOST: {"frames": "camera lost"},
    EventKind.CAMERA_BACK: {"frames": "arriving"},
    EventKind.LASER_DARK: {"laser": "dark"},
    EventKind.LASER_LIT: {"laser": "lit"},
}


class Lanes:
    """Draws the lanes of all runs into one stream."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._known: set[str] = set()

    def draw(self, run: str, kind: str) -> None:
        """Change the lanes as an event of this kind says; its time is set already."""
        for lane, state in _CHANGES.get(kind, {}).items():
            entity = layout.entity(run, lane)
            if entity not in self._known:
                self._known.add(entity)
                colours = [palette.rgba(colour) for colour in _STATES.values()]
                shown = rr.StateConfiguration(values=list(_STATES), colors=colours)
                self._stream.log(entity, shown, static=True)
            self._stream.log(entity, rr.StateChange(state=state))
