"""Main function of the worker process, the only one that calls Rerun.

It reads batches of messages from its standard input, draws them into a file or a live stream, and answers
each with one line of JSON on its standard output. At the end of the input it completes the file and ends, so
that a session that was killed leaves a readable file and no process.
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
    """Run until the end of the input or a `Finish`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    reports = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)  # what a library prints must not be taken for a report
    try:
        _work(sys.stdin.buffer, reports)
        status = 0
    except Exception:
        traceback.print_exc()
        status = 1
    sys.stderr.flush()
    # An ordinary exit would flush every stream again and wait for a viewer that hangs.
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
    # The session has ended: the process must end too, even if Rerun hangs.
    faulthandler.dump_traceback_later(END_LIMIT_S, exit=True)
    output.finish()


def _read(pipe: IO[bytes]) -> Any:
    """The next pickled value; None at the end of the input, also if it ends within a value."""
    head = pipe.read(LENGTH.size)
    if len(head) < LENGTH.size:
        return None
    (length,) = LENGTH.unpack(head)
    data = pipe.read(length)
    return pickle.loads(data) if len(data) == length else None


def _report(reports: IO[str], **report: Any) -> None:
    # The pipe is broken if the session has ended; the end of the input then follows.
    with contextlib.suppress(OSError):
        reports.write(json.dumps(report) + "\n")
