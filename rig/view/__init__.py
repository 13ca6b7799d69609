"""The live view as the session sees it: plain values are handed on, nothing waits."""

from rig.view.configured import open_view, start_view
from rig.view.recorded import show_records
from rig.view.viewer import Viewer

__all__ = ["Viewer", "open_view", "show_records", "start_view"]
