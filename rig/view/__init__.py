"""The view of a record in Rerun, complete or being written: a separate program, and its starters."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rig.view.scratch import RunningView, ScratchHead, ScratchView
from rig.view.show import show_records
from rig.view.values import LayoutName, Mode

if TYPE_CHECKING:
    from rig.view.record_replay import analyse_replayed, replay_record
    from rig.view.replay_comparison import parameter_changes

_LAZY_MODULES = {
    "parameter_changes": "replay_comparison",
    "analyse_replayed": "record_replay",
    "replay_record": "record_replay",
}
"""Names that are imported at their first use, each with its module."""


if not TYPE_CHECKING:  # a type checker would take any name for one of this room

    def __getattr__(name: str) -> Any:
        if name not in _LAZY_MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_LAZY_MODULES[name]}"), name)
