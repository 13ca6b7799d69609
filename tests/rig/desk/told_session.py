"""A session that tells what it is told: a process with a channel, for faults that no simulated rig has.

`python -m tests.rig.desk.told_session FOLDER`. A line on standard input is a JSON object: `state` and
`news` are kept until they are told otherwise. Frames come all the time, unless `frames` is false; `lost` says
that the spot is not in them. `hang`: it says nothing more and hears nothing, for ever.
"""

import ctypes
import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.camera import Frame
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot, SpotFlag
from rig.devices import OrderSocket, SessionNews
from rig.instrument import Block

_EACH_S = 0.1
BEGUN = {"phase": "measuring", "temperature_c": 20.0, "elapsed_s": 1.0}


def main(folder: Path) -> None:
    """Until standard input is closed."""
    told = SessionNews()
    told.begin_run("run 1", 255, None)
    state: dict[str, Any] = dict(BEGUN)
    more: dict[str, Any] = {}
    how = {"frames": True, "lost": False}
    told.state(state, [])

    def listen() -> None:
        for line in sys.stdin:
            values = json.loads(line)
            if values.get("hang"):
                # a call that keeps the interpreter: no thread runs any more, and no signal wakes them
                ctypes.PyDLL(None).pause()
            state.update(values.get("state", {}))
            more.update(values.get("news", {}))
            how.update({key: values[key] for key in how if key in values})
            told.state(dict(state), [])
        ended.set()

    ended = threading.Event()
    empty = np.zeros(0)
    none = Deflections(np.zeros(0, np.int64), empty, empty, empty, empty, DeflectionUnit.PX)
    with OrderSocket(folder, told, {}, lambda: more):
        print("begun", flush=True)
        threading.Thread(target=listen, daemon=True).start()
        while not ended.wait(_EACH_S):
            if how["frames"]:
                now_ns = time.monotonic_ns()
                frame = Frame(np.full((64, 32), 40, np.uint8), 1, now_ns, now_ns)
                flags = SpotFlag.LOST if how["lost"] else SpotFlag(0)
                spot = Spot(16.0, 32.0, 0.01, 0.01, 2.0, 2.0, 0.0, 100.0, 4.0, 1.0, flags)
                told.look([frame], Block([spot], none, [], []))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
