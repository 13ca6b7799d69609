"""The worker process of the viewer, connected by three pipes.

Batches are written to its standard input, reports are read line by line from its standard output, and
messages of Rerun from its standard error. Each pipe has a thread, so that a worker that is stopped or
hangs never blocks the caller for longer than the given limit.
"""

import contextlib
import json
import logging
import pickle
import queue
import subprocess
import threading
from collections.abc import Callable
from typing import IO, Any

from rig.rerun import LENGTH, Message, Setup, start_python

logger = logging.getLogger(__name__)


class WorkerProcess:
    """One worker process. `on_report` is called with each of its reports, in another thread."""

    def __init__(self, setup: Setup, on_report: Callable[[dict[str, Any]], None]) -> None:
        # Ctrl-C in the terminal must not reach the worker, which still has to complete the .rrd file.
        # It ends by itself when its standard input does.
        program, pipe = "from rig.rerun.worker import main; main()", subprocess.PIPE
        self._process = start_python("-c", program, stdin=pipe, stdout=pipe, stderr=pipe)
        self._on_report = on_report
        self._reports: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._outgoing: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._threads = [
            threading.Thread(target=target, name=f"view-{name}", daemon=True)
            for name, target in (("write", self._write), ("reports", self._read), ("stderr", self._listen))
        ]
        for thread in self._threads:
            thread.start()
        self._outgoing.put(_packed(setup))

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def wait_ready(self, limit_s: float) -> bool:
        """Whether the worker has opened its file and its server within the limit."""
        return self._answered("ready", limit_s)

    def deliver(self, batch: list[Message], limit_s: float) -> bool | None:
        """Deliver a batch; returns whether it was drawn, None without an answer within the limit."""
        self._outgoing.put(_packed(batch))
        report = self._answer(limit_s)
        return None if report is None else bool(report.get("drawn"))

    def finish(self, batch: list[Message], limit_s: float) -> bool:
        """Deliver the last batch; returns whether the worker completed its file and ended by itself."""
        self._outgoing.put(_packed(batch))
        if not self._answered("finished", limit_s):
            return False
        try:
            return self._process.wait(5.0) == 0
        except subprocess.TimeoutExpired:
            return False

    def kill(self) -> None:
        """Kill the process and wait for it and its threads to end."""
        self._process.kill()
        self._process.wait()
        self._outgoing.put(None)
        for thread in self._threads:
            thread.join(2.0)

    def _answered(self, key: str, limit_s: float) -> bool:
        report = self._answer(limit_s)
        return report is not None and key in report

    def _answer(self, limit_s: float) -> dict[str, Any] | None:
        try:
            return self._reports.get(timeout=limit_s)
        except queue.Empty:
            return None

    def _write(self) -> None:
        pipe = _pipe(self._process.stdin)
        # A broken pipe: the worker has gone, the reports' thread tells. Closing it fails as well, on
        # what was still to be written, but closes.
        with contextlib.suppress(OSError):
            while (data := self._outgoing.get()) is not None:
                pipe.write(data)
                pipe.flush()
        with contextlib.suppress(OSError):
            pipe.close()

    def _read(self) -> None:
        with _pipe(self._process.stdout) as pipe:
            for line in pipe:
                try:
                    report = json.loads(line)
                except ValueError:
                    continue
                self._on_report(report)
                if report.keys() & {"ready", "drawn", "finished"}:
                    self._reports.put(report)
        self._reports.put(None)

    def _listen(self) -> None:
        with _pipe(self._process.stderr) as pipe:
            for line in pipe:
                logger.info("viewer: %s", line.decode(errors="replace").rstrip())


def _packed(value: object) -> bytes:
    data = pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)
    return LENGTH.pack(len(data)) + data


def _pipe(stream: IO[bytes] | None) -> IO[bytes]:
    if stream is None:
        raise RuntimeError("the worker was started without its pipes")
    return stream
