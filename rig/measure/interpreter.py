"""How Python behaves while frames arrive: its lock is passed on soon, no search for garbage takes long."""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_TURN_S = 0.0005
"""After so long a thread passes Python's lock on. Each numerical kernel lays it down, and would wait Python's
5 ms to get it back from a busy thread: a loop over many small kernels would hold frames up for seconds."""


@contextmanager
def ready_for_frames(*, live: bool) -> Iterator[None]:
    """Within this context threads wait for one another only shortly.

    For a `live` camera, what is there when it begins is left out of every later search for unreachable
    objects: those of the libraries are so many that one search stops all threads for some tenths of a
    second, in which the buffers of a camera run over. Frames made on demand would wait.
    """
    usual_turn_s = sys.getswitchinterval()
    sys.setswitchinterval(_TURN_S)
    if live:
        gc.collect()
        gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(usual_turn_s)
