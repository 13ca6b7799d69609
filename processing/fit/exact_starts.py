"""Where the search for an exact fit begins."""

from collections.abc import Iterator
from contextlib import suppress
from itertools import islice

import numpy as np

from processing.arrays import Floats
from processing.contact.laws import DRAG
from processing.errors import DataError
from processing.fit.exact_model import ExactModel
from processing.fit.result import FitResult

_DOWN_THE_VALLEY, _PLACES = 6.0, 25
"""How far down from the largest friction starts are looked for, as a logarithm, and how many are tried."""
_MUCH_BETTER = 0.25
"""Chi-square of the evidence, over that where a start lies, for which the start is moved."""


def starts_of(model: ExactModel) -> Iterator[Floats]:
    """Start values for which the map reaches the last half-cycle, the most promising first.

    Where none does, the first of each kind: a driven pendulum may swing for longer than any free one.
    Where the waveform speaks against one, the place along the law's valley of friction and drag that it
    likes best comes before.
    """
    usable: list[Floats] = []
    others: list[Floats] = []
    for attempts in model.columns.starts(model.points):
        inside = [_inside(model, attempt) for attempt in attempts]
        reaching = (columns for columns in inside if np.all(np.isfinite(model(columns)[0])))
        for columns in islice(reaching, 1):
            if not usable:
                yield from _by_waveform(model, columns)
            usable.append(columns)
            yield columns
        others += inside[:1]
    if not usable:
        yield from others


def _by_waveform(model: ExactModel, columns: Floats) -> Iterator[Floats]:
    """The same with as much friction in the place of drag as the evidence says, if it says otherwise."""
    valley = model.columns.valley
    if valley is None or model.evidence.waveform is None:
        return
    down = np.linspace(model.upper[valley] - _DOWN_THE_VALLEY, model.upper[valley], _PLACES)
    found: list[tuple[float, Floats]] = []
    for place in [float(columns[valley]), *down.tolist()]:
        moved = columns.copy()
        moved[valley] = place
        with suppress(DataError):
            if np.all(np.isfinite(model(moved)[0])):
                found.append((float(np.sum(model.of_evidence(moved) ** 2)), moved))
    if not found:
        return
    best = min(found, key=lambda one: one[0])
    if found[0][1] is not best[1] and best[0] < _MUCH_BETTER * found[0][0]:
        yield _inside(model, best[1])


def start_near(model: ExactModel, fit: FitResult | None) -> Iterator[Floats]:
    """The parameters of an earlier fit as a start, where the map then reaches the last half-cycle."""
    if fit is None:
        return
    values = {DRAG.key: 0.0} | {name: fit.estimate(name).value for name in fit.names}
    columns = _inside(model, model.columns.from_physical(values))
    if np.all(np.isfinite(model(columns)[0])):
        yield columns


def _inside(model: ExactModel, columns: Floats) -> Floats:
    return np.clip(columns, model.lower + 1e-9, model.upper - 1e-9)
