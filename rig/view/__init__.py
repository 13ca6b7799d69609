"""The view of a record in Rerun, complete or being written: a separate program, and its starters."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rig.view.scratch import RunningView, ScratchHead, ScratchView
from rig.view.show import show_records
from rig.view.values import LayoutName, Mode

if TYPE_CHECKING:
    from rig.view.record_replay import analyse_replayed, replay_record

_LAZY = ("analyse_replayed", "replay_record")
"""Names that are imported at their first use."""


if not TYPE_CHECKING:  # a type checker would take any name for one of this room

    def __getattr__(name: str) -> Any:
        if name not in _LAZY:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.record_replay"), name)
