"""The process that fits: half-cycles come in on its standard input, parameters go out on its output.

Messages are pickled. It ends when its input does, and thus with the process that started it.
"""

import os
import pickle
import sys
import time
from contextlib import suppress

from processing.errors import DataError
from processing.fit import FitOfSwings
from rig.posterior.decay import fitted_decay
from rig.posterior.measured_run import MeasuredRun
from rig.posterior.messages import Asked, FittedModel, FittedParameters


def main() -> None:
    """Fit until the input ends."""
    incoming, outgoing = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    # nothing that a library prints may get between the answers
    os.dup2(2, 1)
    if hasattr(os, "nice"):
        os.nice(10)
    of_run, run = -1, MeasuredRun()
    warm = False
    # the end of the input, or of who reads the answers
    with suppress(EOFError, OSError):
        model: FittedModel = pickle.load(incoming)
        while True:
            asked: Asked = pickle.load(incoming)
            if asked.run != of_run:
                of_run, run = asked.run, MeasuredRun()
            run.take(asked.swings, asked.deflections)
            if not warm:
                # the first fit of a process loads its kernels, which says nothing of what a fit costs
                _fitted(run, asked, model)
                warm = True
            pickle.dump(_fitted(run, asked, model), outgoing)
            outgoing.flush()


def _fitted(run: MeasuredRun, asked: Asked, model: FittedModel) -> FittedParameters:
    began_s = time.process_time()
    how = FitOfSwings(model.pendulum, model.clock_rate, model.drag, asked.evidence, model.loss)
    try:
        swings, fit = run.fitted(how)
        decay = fitted_decay(swings, how.points(swings), fit, model.pendulum)
    except DataError as error:
        return FittedParameters({}, str(error), time.process_time() - began_s)
    found = {name: fit.estimate(name) for name in fit.contact_names}
    return FittedParameters(found, "", time.process_time() - began_s, decay)
