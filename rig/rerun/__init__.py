"""The programs of the Rerun viewer, which run in processes of their own: messages to them, drawing, start."""

from rig.rerun.cookies import cookies_of
from rig.rerun.messages import (
    LENGTH,
    BalanceNumbers,
    ClockDrift,
    Curve,
    Estimates,
    Finish,
    Fits,
    Floats,
    LayoutName,
    LogLine,
    Losses,
    Message,
    Mode,
    Picture,
    ReferenceSamples,
    Samples,
    Setup,
    ShowMode,
    State,
    Swings,
    Trouble,
    is_drawn,
    rows,
    size_bytes,
)
from rig.rerun.page_server import name_stream, page_address, start_page_server
from rig.rerun.ports import LOOPBACK, free_port, hidden_loopback
from rig.rerun.process_group import start_python
from rig.rerun.rerun_program import display_missing, open_window, start_program
