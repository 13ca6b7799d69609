"""Parameters and uncertainties while a run is measured, from a process of its own that reads the record."""

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
from rig.measure.posterior_worker import FIRST_HALF_CYCLES, Posterior, following
from rig.settings import Configuration
from rig.terminal import start_python

_PROGRAM = "from rig.measure.posterior_worker import main; main()"
# one thread: those of linear algebra would wait for one another, busily, on few columns
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
_WAITING_S = 1.0


class LivePosterior:
    """Fits of a run while it is measured, by a process that reads its record.

    A process, because a fit in a thread would hold the interpreter's lock, for which the frames would wait.
    It begins with the first half-cycles that are worth a fit. Its answers come through a pipe that a thread
    of its own reads, so that a process that is stopped in the middle of one holds up nothing else. All
    methods are called by the thread that processes the frames, `close` by any. A process that dies ends the
    fits, and `take_remark` says so.

    Parameters
    ----------
    in_step
        Frames are made on demand: `take` waits for every fit that is due, whatever its share of a core, so
        that a run that ends by what it knows repeats exactly.
    """

    def __init__(self, *, in_step: bool = False) -> None:
        self._in_step = in_step
        self._over = False
        self._remark = ""
        self._process: subprocess.Popen[bytes] | None = None
        self._listening: threading.Thread | None = None
        self.begin(Path())

    @property
    def latest(self) -> Posterior:
        """What is known now."""
        while not self._answers.empty():
            self._note(self._answers.get())
        return self._latest

    @property
    def worker_pid(self) -> int | None:
        """Process number of the process that fits; None before the first fit."""
        return None if self._process is None else self._process.pid

    def begin(self, record: Path) -> None:
        """Forget what is known: a run begins, or is begun again, with this record."""
        self.close()
        self._process = None
        self._record = record
        self._half_cycles, self._due_half_cycles = 0, FIRST_HALF_CYCLES
        self._latest = Posterior()
        self._answers = SimpleQueue[Posterior | None]()

    def take(
        self,
        swings: Sequence[HalfCycle],
        flush: Callable[[], None] = lambda: None,
        waiting: Callable[[], None] = lambda: None,
    ) -> None:
        """Half-cycles that have been recorded, or, once `flush` is called, will have been.

        `waiting` is called every second while frames on demand wait for a fit, which is no stall.
        """
        self._half_cycles += sum(not swing.flags for swing in swings)
        if self._over or self._half_cycles < self._due_half_cycles:
            return
        if self._process is None:
            self._process = self._started()
        if self._in_step and self._process is not None:
            self._wait(self._process, flush, waiting)

    def _wait(
        self, process: subprocess.Popen[bytes], flush: Callable[[], None], waiting: Callable[[], None]
    ) -> None:
        waiting()
        flush()
        # a broken pipe: the process has died, which the end of its answers tells
        with suppress(OSError):
            if process.stdin is not None:
                process.stdin.write(b"\n")
                process.stdin.flush()
        self._due_half_cycles = following(self._half_cycles)
        while True:
            with suppress(Empty):
                self._note(self._answers.get(timeout=_WAITING_S))
                return
            waiting()

    def take_remark(self) -> str:
        """Why there are no fits any more; once, else an empty text."""
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
        if self._listening is not None:
            # not longer: one that reads from a disk that hangs ends with that
            self._listening.join(_WAITING_S)

    def _started(self) -> "subprocess.Popen[bytes] | None":
        words, pipe = [str(self._record), *(["in step"] if self._in_step else [])], subprocess.PIPE
        try:
            process: subprocess.Popen[bytes] = start_python(
                "-c", _PROGRAM, *words, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, env=_ONE_THREAD
            )
        except OSError as error:
            self._end(f"the process that fits cannot be started ({error})")
            return None
        self._listening = threading.Thread(
            target=_listen, args=(process, self._answers), name="posterior", daemon=True
        )
        self._listening.start()
        return process

    def _note(self, answer: Posterior | None) -> None:
        if answer is None:
            self._end("the process that fits while the run is measured has died")
        elif answer.estimates:
            self._latest = answer

    def _end(self, why: str) -> None:
        self._over = True
        self._remark = f"{why}: the run continues; its results follow at the end"


def _listen(process: "subprocess.Popen[bytes]", found: "SimpleQueue[Posterior | None]") -> None:
    """Read the answers of a process, and None once they end; then wait for the process, however long."""
    if process.stdout is not None:
        with process.stdout as answers, suppress(EOFError, OSError, ValueError, pickle.UnpicklingError):
            while True:
                found.put(pickle.load(answers))
    found.put(None)
    process.wait()


def live_posterior(config: Configuration) -> LivePosterior | None:
    """What fits the half-cycles of a run as its final analysis will; None where that fits no contact."""
    if _why_not(config):
        return None
    # frames on demand wait for what decides over the end, so that such a run repeats exactly
    return LivePosterior(in_step=config.on_demand and bool(config.session.stop_when))


def check_stop_when(config: Configuration) -> None:
    """Raise ConfigurationError if `session.stop_when` asks for parameters that this rig does not fit."""
    if config.session.stop_when and (why := _why_not(config)):
        raise ConfigurationError(f"session.stop_when needs the contact's parameters: {why}")


def _why_not(config: Configuration) -> str:
    if config.instrument.description().report != "contact":
        return f"instrument.kind = {config.instrument.kind!r} reports none; leave stop_when out"
    if config.deflection_unit is not DeflectionUnit.RAD:
        return "without [lever] amplitudes are in px; state it, or make it with rig calibrate lever"
    if config.pendulum is None:
        return "state mass_kg and ball_radius_m in [pendulum]"
    return ""
