"""The terminal and the processes of the program: interrupts, hang-up, encoding, child processes, ports."""

from rig.terminal.interruption import (
    BY_USER,
    LOOPBACK,
    Terminated,
    call_on_hang_up,
    free_port,
    own_group,
    reason_of,
    replace_missing_characters,
    spelled,
    start_python,
    terminated_by_signals,
)
