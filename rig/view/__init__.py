"""What draws a record, whole or being written, in Rerun: a program of its own, and what starts it."""

from rig.view.launch import RunningView
from rig.view.scratch import ScratchHead, ScratchView
from rig.view.show import show_records
from rig.view.values import LayoutName, Mode
