"""The live view as the session sees it: plain values are handed on, nothing waits."""

from rig.view.recorded import show_records
from rig.view.watcher import LiveView, open_view, start_view

__all__ = ["LiveView", "open_view", "show_records", "start_view"]
