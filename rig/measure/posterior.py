"""Live parameters and uncertainties of a run, fitted by a process of its own that reads the record."""

import pickle
import subprocess
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue

from processing.deflections import DeflectionUnit
from processing.errors import ConfigurationError
from processing.swing import HalfCycle
from rig.interruption import start_python
from rig.measure.posterior_worker import FIRST_HALF_CYCLES, Posterior, next_fit_half_cycles
from rig.settings import Configuration

_PROGRAM = "from rig.measure.posterior_worker import main; main()"
# one thread: with few columns several would spend a core on waiting for one another
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
_CALL_INTERVAL_S = 1.0


class LivePosterior:
    """Fits of a run while it is measured, by a process that reads its record.

    The process starts once there are enough half-cycles for a fit. A fit in a thread of this program would
    hold the interpreter's lock and delay frames. A thread reads the answers from a pipe, so that a process
    that is stopped in the middle of an answer delays nothing else. All methods are called by the thread that
    processes the frames, `close` by any thread. If the process dies, fits end and `take_remark` says so.
    If `synchronous`, `take` waits for every fit that is due, whatever its share of a core.
    """

    def __init__(self, *, synchronous: bool = False) -> None:
        self._is_synchronous = synchronous
        self._ended = False
        self._remark = ""
        self._process: subprocess.Popen[bytes] | None = None
        self._reader: threading.Thread | None = None
        self.begin(Path())

    @property
    def latest(self) -> Posterior:
        while not self._answers.empty():
            self._take_answer(self._answers.get())
        return self._latest

    @property
    def worker_pid(self) -> int | None:
        """Process identifier of the fitting process; None before it is started."""
        return None if self._process is None else self._process.pid

    def begin(self, record: Path) -> None:
        """Discard all fits: a run begins, or begins again, with this record."""
        self.close()
        self._process = None
        self._record = record
        self._half_cycles, self._due_half_cycles = 0, FIRST_HALF_CYCLES
        self._latest = Posterior()
        self._answers = SimpleQueue[Posterior | None]()

    def take(
        self,
        half_cycles: Sequence[HalfCycle],
        flush: Callable[[], None] = lambda: None,
        keep_alive: Callable[[], None] = lambda: None,
    ) -> None:
        """Count half-cycles, which `flush` brings into the record, and start or await the fit that is due.

        `keep_alive` is called every second while frames wait for a fit, so that the wait is no stall.
        """
        self._half_cycles += sum(not half_cycle.flags for half_cycle in half_cycles)
        if self._ended or self._half_cycles < self._due_half_cycles:
            return
        if self._process is None:
            self._process = self._start_process()
        if self._is_synchronous and self._process is not None:
            self._wait(self._process, flush, keep_alive)

    def _wait(
        self, process: subprocess.Popen[bytes], flush: Callable[[], None], keep_alive: Callable[[], None]
    ) -> None:
        keep_alive()
        flush()
        # an error here is a broken pipe: the process has died, which the end of its answers shows
        with suppress(OSError):
            if process.stdin is not None:
                process.stdin.write(b"\n")
                process.stdin.flush()
        self._due_half_cycles = next_fit_half_cycles(self._half_cycles)
        while True:
            with suppress(Empty):
                self._take_answer(self._answers.get(timeout=_CALL_INTERVAL_S))
                return
            keep_alive()

    def take_remark(self) -> str:
        """Why fits have ended, the first time that it is asked for; else an empty text."""
        remark, self._remark = self._remark, ""
        return remark

    def close(self) -> None:
        """End the process, also in the middle of a fit."""
        if self._process is None:
            return
        self._process.kill()
        with suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        if self._reader is not None:
            # no longer: a thread that waits for a disk that hangs ends only with that disk
            self._reader.join(_CALL_INTERVAL_S)

    def _start_process(self) -> "subprocess.Popen[bytes] | None":
        pipe, synchronous = subprocess.PIPE, ["synchronous"] if self._is_synchronous else []
        arguments = "-c", _PROGRAM, str(self._record), *synchronous
        try:
            process: subprocess.Popen[bytes] = start_python(
                *arguments, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, env=_ONE_THREAD
            )
        except OSError as error:
            self._end(f"the process that fits cannot be started ({error})")
            return None
        self._reader = threading.Thread(
            target=_read_answers, args=(process, self._answers), name="posterior", daemon=True
        )
        self._reader.start()
        return process

    def _take_answer(self, answer: Posterior | None) -> None:
        if answer is None:
            self._end("the process that fits while the run is measured has died")
        elif answer.estimates:
            self._latest = answer

    def _end(self, why: str) -> None:
        self._ended = True
        self._remark = f"{why}: the run continues; its results follow at the end"


def _read_answers(process: "subprocess.Popen[bytes]", queue: "SimpleQueue[Posterior | None]") -> None:
    """Put the answers of a process into the queue, then None; then wait for the process, however long."""
    if process.stdout is not None:
        with process.stdout as answers, suppress(EOFError, OSError, ValueError, pickle.UnpicklingError):
            while True:
                queue.put(pickle.load(answers))
    queue.put(None)
    process.wait()


def live_posterior(config: Configuration) -> LivePosterior | None:
    """The live fit of a run by the model of its final analysis; None if that fits no contact."""
    if _no_fit_reason(config):
        return None
    # frames on demand wait for the fits that decide when the run ends, so that such a run repeats exactly
    return LivePosterior(synchronous=config.on_demand and bool(config.session.stop_when))


def check_stop_when(config: Configuration) -> None:
    """Raise ConfigurationError if `session.stop_when` asks for parameters that this rig does not fit."""
    if config.session.stop_when and (why := _no_fit_reason(config)):
        raise ConfigurationError(f"session.stop_when needs the contact's parameters: {why}")


def _no_fit_reason(config: Configuration) -> str:
    """Why no contact is fitted, with the remedy; empty if it is."""
    if config.instrument.description().report != "contact":
        return f"instrument.kind = {config.instrument.kind!r} reports none; leave stop_when out"
    if config.deflection_unit is not DeflectionUnit.RAD:
        return "without [lever] amplitudes are in px; state it, or make it with rig calibrate lever"
    if config.pendulum is None:
        return "state mass_kg and ball_radius_m in [pendulum]"
    return ""
