"""Parameters and uncertainties while a run is measured, in a process of its own."""

import pickle
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing, suppress

from processing.decay_summary import mean_period
from processing.deflections import Deflections, DeflectionUnit, joined
from processing.errors import ConfigurationError
from processing.fit import Evidence, points_in_true_time
from processing.swing import HalfCycle, HarmonicsWatch, SwingHarmonics
from rig.analysis import clock_rate_of, evidence_of, known_drag, loss_of, stated_surroundings
from rig.instrument import pendulum_on_ball
from rig.measure.posterior_worker import Answer, FittedModel, Posterior, PosteriorInput
from rig.settings import Configuration
from rig.terminal import start_python


class FittingProcess:
    """One process; raises OSError where it cannot be started.

    A process, because a fit in a thread would hold the interpreter's lock, for which the frames would wait.
    """

    def __init__(self, model: FittedModel) -> None:
        # one thread: those of linear algebra would wait for one another, busily, on few columns
        one = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
        program, pipe = "from rig.measure.posterior_worker import main; main()", subprocess.PIPE
        self._process = start_python(
            "-c", program, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, env=one
        )
        self._send(model)

    @property
    def pid(self) -> int:
        return self._process.pid

    def fit(self, asked: PosteriorInput) -> Answer | None:
        """Fit, and wait for the answer; None if the process has died."""
        self._send(asked)
        if self._process.stdout is None:
            return None
        try:
            found: Answer = pickle.load(self._process.stdout)
        except (EOFError, OSError, ValueError, pickle.UnpicklingError):
            return None
        return found

    def kill(self) -> None:
        """End it at once; a `fit` that waits returns None. May be called from any thread."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """End it; afterwards it can no longer be asked."""
        self.kill()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                if pipe is not None:
                    pipe.close()

    def _send(self, message: object) -> None:
        # a broken pipe: the process has died, which the answer tells
        with suppress(OSError, ValueError):
            if self._process.stdin is not None:
                pickle.dump(message, self._process.stdin)
                self._process.stdin.flush()


FIRST_HALF_CYCLES = 40
"""Fewer determine nothing: u of b and c is then larger than their values for every pair of the paper."""
_GROWTH = 1.04
"""So many times more half-cycles are worth another fit: u falls by a tenth where it falls fastest."""
_SHARE = 0.02
"""Largest part of a core that fits may have."""
_WAITING_S = 1.0
_EARLY_NS = 120_000_000_000
"""Deflections that are kept until the first half-cycles are found in them."""


def following(half_cycles: int) -> int:
    """How many half-cycles are worth a fit after one of so many."""
    return max(half_cycles + 1, round(_GROWTH * half_cycles))


class LivePosterior:
    """Fits the half-cycles of a run again and again in a process of its own, at most in 2 % of its time.

    `begin`, `take` and `latest` return at once and are called by the thread that processes the frames. A fit
    that fails changes nothing; a process that dies ends the fits, and `take_remark` says so.

    Parameters
    ----------
    model
        What is fitted.
    evidence_of
        What restrains the fit of half-cycles beside them, from these and their harmonics.
    in_step
        Frames are made on demand: `take` waits for every fit that is due, whatever its share of a core, so
        that a run that ends by what it knows repeats exactly.
    """

    def __init__(
        self,
        model: FittedModel,
        evidence_of: Callable[[Sequence[HalfCycle], SwingHarmonics], Evidence],
        *,
        in_step: bool = False,
    ) -> None:
        self._model, self._evidence_of, self._in_step = model, evidence_of, in_step
        self._changed = threading.Condition()
        self._swings: list[HalfCycle] = []
        self._sent = 0
        self._unsent: list[Deflections] = []
        self._waveform = HarmonicsWatch()
        self._run = 0
        self._due_half_cycles = FIRST_HALF_CYCLES
        self._due_s = 0.0
        self._latest = Posterior()
        self._remark = ""
        self._over = False
        self._process: FittingProcess | None = None
        self._thread = threading.Thread(target=self._fit_all, name="posterior", daemon=True)

    @property
    def latest(self) -> Posterior:
        """What is known now."""
        return self._latest

    @property
    def worker_pid(self) -> int | None:
        """Process number of the process that fits; None before the first fit."""
        return None if self._process is None else self._process.pid

    def begin(self) -> None:
        """Forget all half-cycles: a run begins, or is begun again."""
        with self._changed:
            self._run += 1
            self._swings = []
            self._sent = 0
            self._unsent = []
            self._waveform = HarmonicsWatch()
            self._due_half_cycles = FIRST_HALF_CYCLES
            self._latest = Posterior()

    def take(
        self,
        swings: Sequence[HalfCycle],
        deflections: Deflections,
        waiting: Callable[[], None] = lambda: None,
    ) -> None:
        """Deflections that follow, and the half-cycles that end with them.

        `waiting` is called every second while frames on demand wait for a fit, which is no stall.
        """
        good = [swing for swing in swings if not swing.flags]
        if self._over:
            return
        with self._changed:
            self._waveform.update(deflections)
            self._waveform.add(swings)
            self._keep(deflections)
            self._swings += good
            if not good:
                return
            if len(self._swings) < self._due_half_cycles:
                return
            if self._thread.ident is None:
                self._thread.start()
            self._changed.notify_all()
            while self._in_step and not self._over and len(self._swings) >= self._due_half_cycles:
                waiting()
                self._changed.wait(_WAITING_S)

    def _keep(self, deflections: Deflections) -> None:
        if not len(deflections):
            return
        self._unsent.append(deflections)
        if not self._swings:
            # where nothing swings, what half-cycles may need that are found late
            early_ns = int(deflections.times_ns[-1]) - _EARLY_NS
            while int(self._unsent[0].times_ns[-1]) < early_ns:
                self._unsent.pop(0)

    def take_remark(self) -> str:
        """Why there are no fits any more; once, else an empty text."""
        remark, self._remark = self._remark, ""
        return remark

    def close(self) -> None:
        """End the process, also in the middle of a fit."""
        with self._changed:
            self._over = True
            process = self._process
            self._changed.notify_all()
        if process is not None:
            process.kill()
        if self._thread.is_alive():
            self._thread.join(5.0)

    def _fit_all(self) -> None:
        try:
            process = FittingProcess(self._model)
        except OSError as error:
            self._end(f"the process that fits cannot be started ({error})")
            return
        with self._changed:
            self._process = process
        with closing(process):
            while (asked := self._next()) is not None:
                answer = process.fit(asked)
                if answer is None:
                    self._end("the process that fits while the run is measured has died")
                    return
                with self._changed:
                    self._due_s = time.monotonic() + answer.cpu_s / _SHARE
                    if asked.run == self._run:
                        self._due_half_cycles = following(asked.half_cycles)
                        if answer.fit.estimates:
                            self._latest = answer.fit
                    self._changed.notify_all()

    def _next(self) -> PosteriorInput | None:
        """What is to be fitted once it is due; None at the end."""
        with self._changed:
            while not self._over:
                left_s = 0.0 if self._in_step else self._due_s - time.monotonic()
                if len(self._swings) < self._due_half_cycles:
                    self._changed.wait()
                elif left_s > 0:
                    self._changed.wait(left_s)
                else:
                    break
            else:
                return None
            run, swings, harmonics = self._run, list(self._swings), self._waveform.found()
            new, self._sent = swings[self._sent :], len(swings)
            unsent, self._unsent = self._unsent, []
        samples = joined(unsent, DeflectionUnit.RAD)
        return PosteriorInput(run, len(swings), new, samples, self._evidence_of(swings, harmonics))

    def _end(self, why: str) -> None:
        with self._changed:
            self._over = True
            self._remark = f"{why}: the run continues; its results follow at the end"
            self._changed.notify_all()


def live_posterior(config: Configuration) -> LivePosterior | None:
    """What fits the half-cycles of a run as its final analysis will; None where that fits no contact."""
    pendulum = pendulum_on_ball(config)
    if pendulum is None or _why_not(config):
        return None
    clock_rate = clock_rate_of(config)

    def evidence(swings: Sequence[HalfCycle], harmonics: SwingHarmonics) -> Evidence:
        period_s = mean_period(points_in_true_time(swings, clock_rate))
        drag, _ = known_drag(config, stated_surroundings(config), pendulum, period_s)
        return evidence_of(drag, harmonics)

    model = FittedModel(pendulum, config.fit.fits_drag, loss_of(config.fit), clock_rate, config.axes)
    # frames on demand wait for what decides over the end, so that such a run repeats exactly
    in_step = config.on_demand and bool(config.session.stop_when)
    return LivePosterior(model, evidence, in_step=in_step)


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
