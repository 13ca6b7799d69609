"""The viewer's worker: the one process that calls Rerun.

Reads batches from its standard input, draws them into the file and the live stream, and answers
each with one line of JSON on its standard output. The end of the input is the order to complete
the file and leave, so a session that was killed leaves a readable file and no process behind.
"""

import contextlib
import faulthandler
import json
import os
import pickle
import signal
import sys
import traceback
from typing import IO, Any

from rig.rerun.messages import LENGTH, Finish, Message, Setup

END_LIMIT_S = 60.0


def main() -> None:
    """Run until the input ends or a `Finish` comes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    reports = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # whatever a library prints must not look like a report
    try:
        _work(sys.stdin.buffer, reports)
        status = 0
    except Exception:
        traceback.print_exc()
        status = 1
    sys.stderr.flush()
    # Leaving the ordinary way flushes every stream once more, for as long as a hung viewer takes.
    os._exit(status)


def _work(orders: IO[bytes], reports: IO[str]) -> None:
    setup = _read(orders)
    if not isinstance(setup, Setup):
        return

    from rig.rerun.output import Output

    output = Output(setup)
    _report(reports, ready=True, notes=output.take_notes(), url=output.url, port=output.port)
    while (batch := _read(orders)) is not None:
        messages: list[Message] = batch
        if any(isinstance(message, Finish) for message in messages):
            faulthandler.dump_traceback_later(END_LIMIT_S, exit=True)
            output.finish()
            _report(reports, finished=True, notes=output.take_notes())
            return
        drawn = output.draw(messages)
        _report(reports, drawn=drawn, notes=output.take_notes())
    # The session has gone: Rerun must not keep this process, which nobody watches any more.
    faulthandler.dump_traceback_later(END_LIMIT_S, exit=True)
    output.finish()


def _read(pipe: IO[bytes]) -> Any:
    """The next pickled value; None at the end of the input, also in the middle of one."""
    head = pipe.read(LENGTH.size)
    if len(head) < LENGTH.size:
        return None
    (length,) = LENGTH.unpack(head)
    data = pipe.read(length)
    return pickle.loads(data) if len(data) == length else None


def _report(reports: IO[str], **report: Any) -> None:
    # Broken where the session has gone; the end of the input says so next.
    with contextlib.suppress(OSError):
        reports.write(json.dumps(report) + "\n")
