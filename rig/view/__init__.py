"""The live view: passes plain values to the Rerun processes without ever blocking the measurement."""

from rig.view.configured import open_view, start_view
from rig.view.recorded import show_records
from rig.view.viewer import Viewer
