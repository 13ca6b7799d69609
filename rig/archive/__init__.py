"""The commands `rig archive`: a catalogue of the runs of many sessions."""

from rig.archive.adding import add_sessions
from rig.archive.chosen import remark, show_runs
from rig.archive.listing import Format, list_runs
from rig.archive.plot import plot_runs

__all__ = ["Format", "add_sessions", "list_runs", "plot_runs", "remark", "show_runs"]
