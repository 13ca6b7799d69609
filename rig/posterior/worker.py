"""The process that fits: turning points come in on its standard input, parameters go out on its output.

Messages are pickled. It ends when its input does, and thus with the process that started it.
"""

import os
import pickle
import sys
import time
from contextlib import suppress

from processing.errors import DataError
from processing.fit import FitResult, fit_exact, with_misfit
from rig.posterior.messages import Fitted, FittedModel, FittedParameters


def main() -> None:
    """Fit until the input ends."""
    incoming, outgoing = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    # nothing that a library prints may get between the answers
    os.dup2(2, 1)
    if hasattr(os, "nice"):
        os.nice(10)
    near: FitResult | None = None
    warm = False
    # the end of the input, or of who reads the answers
    with suppress(EOFError, OSError):
        model: FittedModel = pickle.load(incoming)
        while True:
            asked: Fitted = pickle.load(incoming)
            if not warm:
                # the first fit of a process loads its kernels, which says nothing of what a fit costs
                _fitted(asked, model, None)
                warm = True
            near, answer = _fitted(asked, model, near)
            pickle.dump(answer, outgoing)
            outgoing.flush()


def _fitted(
    asked: Fitted, model: FittedModel, near: FitResult | None
) -> tuple[FitResult | None, FittedParameters]:
    began_s = time.process_time()
    try:
        fit = fit_exact(
            asked.points,
            model.pendulum,
            drag=model.drag,
            evidence=asked.evidence,
            loss=model.loss,
            near=near,
        )
        described = with_misfit(asked.points, model.pendulum, fit)
    except DataError as error:
        return near, FittedParameters({}, str(error), time.process_time() - began_s)
    found = {name: described.estimate(name) for name in fit.contact_names}
    return fit, FittedParameters(found, "", time.process_time() - began_s)
