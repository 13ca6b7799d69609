"""Live parameters and uncertainties of a run, fitted by a process of its own that reads the record.

The session asks that process for a fit when one is due; it fits the record so far as the final analysis does.
"""

import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue

import numpy as np

from acquisition.record.reader import RecordReader
from acquisition.record.topics import RecordedFittedPoint
from processing.contact import AMPLITUDE, TIME, PendulumOnBall, turning_points_of
from processing.decay_summary import full_periods, mean_period
from processing.deflections import DeflectionUnit
from processing.errors import ConfigurationError, DataError, RecordError
from processing.estimate import Estimate
from processing.fit import (
    DecayFit,
    FitResult,
    LinearisedFit,
    fitted_twice,
    points_in_true_time,
    with_discrepancy,
)
from processing.swing import HalfCycle, HarmonicsMeasurement, TurningPoints
from rig.analysis import (
    PassingDeflections,
    RecordedDeflections,
    clock_rate_of,
    drag_of_fit,
    evidence_of,
    follow_plane,
    loss_of,
    stated_ambient,
)
from rig.instrument import pendulum_on_ball, recorded_configuration
from rig.interruption import start_python
from rig.settings import Configuration

_Answer = tuple["Posterior", float]
"""A fit, and the processor time in s that it took."""
FIRST_HALF_CYCLES = 40
"""Half-cycles before the first fit. With fewer, b and c are less than their u for every pair of the paper."""
_HALF_CYCLE_GROWTH = 1.04
"""Growth of the number of half-cycles from fit to fit; an uncertainty then falls by a tenth at most."""
_MAX_CORE_FRACTION = 0.04
"""Largest fraction of the time of a core that fits may take."""
_LOOK_INTERVAL_S, _CALL_INTERVAL_S = 0.5, 1.0
_PROGRAM = "from rig.measure.posterior import main; main()"
# one thread: with few columns several would spend a core on waiting for one another
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def next_fit_half_cycles(half_cycles: int) -> int:
    """Number of half-cycles of the fit that follows a fit of `half_cycles`."""
    return max(half_cycles + 1, round(_HALF_CYCLE_GROWTH * half_cycles))


@dataclass(frozen=True, slots=True)
class Posterior:
    """Parameters by key, fitted to the first `half_cycles` unflagged half-cycles; empty if no fit was
    possible.

    `points` compare the measured half-cycles with the fit.
    """

    half_cycles: int = 0
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    points: Sequence[RecordedFittedPoint] = ()


_MAX_POINTS = 300
"""Largest number of points in a posterior: a chart has no pixels for more."""


def fitted_points(
    half_cycles: Sequence[HalfCycle], points: TurningPoints, fit: FitResult, pendulum: PendulumOnBall
) -> list[RecordedFittedPoint]:
    """Comparison of the exact fit with its data; `points` are the unflagged `half_cycles` in true time.

    The time of the fit itself is left 0; the recorder sets it.
    """
    times_ns = [swing.turn_time_ns for swing in half_cycles if not swing.flags]
    index = points.index - points.index[0]
    start = fit.estimate(AMPLITUDE.key).value
    amplitude, time_s = turning_points_of(fit.parameters, pendulum, start, int(index[-1]))
    fitted, time_s = amplitude[index], time_s[index] + fit.estimate(TIME.key).value
    residual = (points.amplitude - fitted) / points.u_amplitude
    periods = full_periods(points)
    turning = periods.where
    period_s, period_residual = np.full((2, len(index)), np.nan)
    period_s[turning] = time_s[turning + 1] - time_s[turning - 1]
    period_residual[turning] = (periods.period_s - period_s[turning]) / periods.u_period_s
    # NaN where the fitted law says that friction stops the pendulum: there is no amplitude to compare
    known = np.flatnonzero(np.isfinite(residual))
    table = np.column_stack((fitted, residual, period_s, period_residual)).tolist()
    return [
        RecordedFittedPoint(0, times_ns[k], *table[k]) for k in known[:: -(-len(known) // _MAX_POINTS) or 1]
    ]


class RunSoFar:
    """The unflagged half-cycles in the record of a run so far, and the fit to them.

    Raises RecordError if the record states no pendulum.
    """

    def __init__(self, reader: RecordReader) -> None:
        self._config = config = recorded_configuration(reader)
        pendulum = pendulum_on_ball(config)
        if pendulum is None:
            raise RecordError(f"{reader.path}: states no pendulum on a ball; nothing can be fitted")
        self._pendulum, self._clock_rate = pendulum, clock_rate_of(config)
        self._reader = reader
        self._swings: list[HalfCycle] = []
        self._last_fit: FitResult | None = None

    def wait_for(self, half_cycles: int) -> bool:
        """Read until there are so many; False if the record ends before."""
        for _ in self._reader.follow(_LOOK_INTERVAL_S):
            for piece in self._reader.unread():
                self._swings += [swing for swing in self._reader.swings(piece) if not swing.flags]
            if len(self._swings) >= half_cycles:
                return True
        return False

    def fitted(self) -> Posterior:
        """The fit that the final analysis would make of these half-cycles; no estimates without a fit."""
        with suppress(DataError):
            blocks = PassingDeflections(RecordedDeflections(self._reader), DeflectionUnit.RAD)
            plane = follow_plane(self._swings, blocks, self._config.axes)
            if plane.problem:
                raise DataError(plane.problem)
            fit = self._decay_fit(plane.swings, plane.deflections)
            refined, self._last_fit = fitted_twice(plane.swings, plane.deflections, fit, self._last_fit)
            points = fit.points(refined.swings)
            found = with_discrepancy(LinearisedFit.of(points, self._pendulum, self._last_fit))
            estimates = {name: found.estimate(name) for name in found.contact_names}
            compared = fitted_points(refined.swings, points, found, self._pendulum)
            return Posterior(len(self._swings), estimates, compared)
        return Posterior(len(self._swings))

    def _decay_fit(self, swings: Sequence[HalfCycle], deflections: PassingDeflections) -> DecayFit:
        config, pendulum = self._config, self._pendulum
        period_s = mean_period(points_in_true_time(swings, self._clock_rate))
        drag, _ = drag_of_fit(config, stated_ambient(config), pendulum, period_s)
        waveform = HarmonicsMeasurement(swings)
        for block in deflections:
            waveform.update(block)
        evidence = evidence_of(drag, waveform.harmonics())
        return DecayFit(pendulum, self._clock_rate, config.fit.fits_drag, evidence, loss_of(config.fit))


def main() -> None:
    """Fit the run whose record is the argument; each line on the standard input asks for so many half-cycles.

    An answer is a fit and its processor time in s. The process ends with the record or with the standard
    input, which the session holds.
    """
    outgoing = os.fdopen(os.dup(1), "wb")
    # text that a library prints must not get between the answers
    os.dup2(2, 1)
    if hasattr(os, "nice"):
        os.nice(10)
    # an OSError is the end of the process that reads the answers
    with suppress(OSError), RecordReader(Path(sys.argv[1])) as reader:
        run, is_warm = RunSoFar(reader), False
        for line in sys.stdin.buffer:
            if not run.wait_for(int(line)):
                return
            if not is_warm:
                # the first fit of a process loads its kernels, so its time does not show what a fit costs
                run.fitted()
                is_warm = True
            began_s = time.process_time()
            fitted = run.fitted()
            pickle.dump((fitted, time.process_time() - began_s), outgoing)
            outgoing.flush()


class LivePosterior:
    """Fits of a run while it is measured, by a process that reads its record.

    The process starts once there are enough half-cycles for a fit. A fit in a thread of this process would
    hold the interpreter's lock and delay frames. A thread reads the answers from a pipe, so that a process
    that is stopped in the middle of an answer delays nothing else. All methods are called by the thread that
    processes the frames, `close` by any thread. If the process dies, fits end and `take_remark` says so.

    Parameters
    ----------
    synchronous
        Whether `take` waits for every fit that is due, whatever its share of a core. Frames made on demand
        need that, so that a run which ends by `session.stop_when` repeats exactly.
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
        """The newest fit."""
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
        self._half_cycles, self._due_half_cycles, self._due_s = 0, FIRST_HALF_CYCLES, 0.0
        self._asked = False
        self._latest = Posterior()
        self._answers = SimpleQueue[_Answer | None]()

    def take(
        self,
        half_cycles: Sequence[HalfCycle],
        flush: Callable[[], None] = lambda: None,
        keep_alive: Callable[[], None] = lambda: None,
    ) -> None:
        """Count half-cycles, which `flush` brings into the record, and ask for the fit that is due.

        A `synchronous` one waits for it; `keep_alive` is called every second then, so that this is no stall.
        """
        self._half_cycles += sum(not swing.flags for swing in half_cycles)
        if self._half_cycles < self._due_half_cycles or self._asked or self._ended:
            return
        if not self._is_synchronous and time.monotonic() < self._due_s:
            return
        if self._process is None:
            self._process = self._start_process()
        if self._process is None or self._process.stdin is None:
            return
        if self._is_synchronous:
            keep_alive()
            flush()
        self._asked = True
        # an error here is a broken pipe: the process has died, which the end of its answers shows
        with suppress(OSError):
            self._process.stdin.write(b"%d\n" % self._half_cycles)
            self._process.stdin.flush()
        while self._asked and self._is_synchronous:
            with suppress(Empty):
                self._take_answer(self._answers.get(timeout=_CALL_INTERVAL_S))
                return
            keep_alive()

    def take_remark(self) -> str:
        """The reason for which fits have ended, told once; else an empty text."""
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
        pipe, arguments = subprocess.PIPE, ("-c", _PROGRAM, str(self._record))
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

    def _take_answer(self, answer: _Answer | None) -> None:
        self._asked = False
        if answer is None:
            self._end("the process that fits while the run is measured has died")
            return
        found, cost_s = answer
        self._due_half_cycles = next_fit_half_cycles(found.half_cycles)
        self._due_s = time.monotonic() + cost_s / _MAX_CORE_FRACTION
        if found.estimates:
            self._latest = found

    def _end(self, why: str) -> None:
        self._ended = True
        self._remark = f"{why}: the run continues; its results follow at the end"


def _read_answers(process: "subprocess.Popen[bytes]", queue: "SimpleQueue[_Answer | None]") -> None:
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
