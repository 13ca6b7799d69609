"""What draws a record, whole or being written, in Rerun: a program of its own, and what starts it."""

from rig.view.graticule import LayoutName, Mode
from rig.view.scratch import RunningView, ScratchHead, ScratchView
from rig.view.show import show_records
