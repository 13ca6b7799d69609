"""The terminal the program runs in: Ctrl-C and its closing, characters that its encoding lacks."""

from rig.terminal.child_process import LOOPBACK, free_port, own_group, start_python
from rig.terminal.encoding import spell_out_what_is_missing, spelled
from rig.terminal.interruption import (
    BY_USER,
    Terminated,
    reason_of,
    terminated_by_signals,
    told_of_hang_up,
)
