"""The commands `rig archive`: a catalogue of the runs of many sessions."""

from typing import TYPE_CHECKING, Any

from rig.archive.adding import add_sessions
from rig.archive.chosen import remark, show_runs
from rig.archive.listing import Format, list_runs
from rig.archive.plot import plot_runs

if TYPE_CHECKING:
    from rig.archive.refitting import refit_runs

__all__ = ["Format", "add_sessions", "list_runs", "plot_runs", "refit_runs", "remark", "show_runs"]

_LATER = {"refit_runs": "refitting"}
"""What takes seconds to import, for which `list` must not wait, by module."""


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_LATER[name]}"), name)
