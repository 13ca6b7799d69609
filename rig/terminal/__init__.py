"""The terminal the program runs in: Ctrl-C and its closing, characters that its encoding lacks."""

from rig.terminal.interruption import (
    BY_USER,
    LOOPBACK,
    Terminated,
    free_port,
    own_group,
    reason_of,
    spell_out_what_is_missing,
    spelled,
    start_python,
    terminated_by_signals,
    told_of_hang_up,
)
