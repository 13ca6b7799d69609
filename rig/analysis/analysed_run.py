"""What an analysis holds of its runs, and what is written of one or more."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from processing.balance import Balance, PlaneOfSwing
from processing.fit import (
    FitResult,
    RigQuantities,
)
from processing.swing import SwingHarmonics, TurningPoints
from rig.analysis.contact_series import combined_series
from rig.analysis.other_instruments import Reduction
from rig.analysis.other_instruments_series import reduce_series
from rig.analysis.results import RunResults, Series, SessionResults
from rig.analysis.results_file import relative_record
from rig.settings import Watched


@dataclass(frozen=True)
class AnalysedRun:
    """The results of one run, and what a series of runs needs beyond them.

    `points` are the turning points that were fitted. `reduction` is there for a pendulum that is not
    described by the contact's laws, `rig` where the contact radius is calculated after Hertz,
    `decay_balances` are those of its decay, `plane` how the plane of swing turned, None where unknown.
    `watched` is the configuration of which keys were changed.
    """

    record: Path
    results: RunResults
    points: TurningPoints
    fits: Mapping[str, FitResult]
    rig: RigQuantities | None = None
    reduction: Reduction | None = None
    harmonics: SwingHarmonics | None = None
    decay_balances: Sequence[Balance] = ()
    plane: PlaneOfSwing | None = None
    watched: Watched | None = None


def session_results(runs: Sequence[AnalysedRun], folder: Path) -> SessionResults:
    """What is written of one or more runs; records are named relative to the folder of the file.

    Raises ConfigurationError for a key that was changed and that nothing has used.
    """
    results = SessionResults(
        runs=tuple(replace(run.results, record=relative_record(run.record, folder)) for run in runs),
        series=_series(runs),
    )
    refuse_unread(runs)
    return results


def instrument_series(runs: Sequence[AnalysedRun], numbers: Sequence[int] = ()) -> Series | None:
    """What runs of another instrument say together: places on the sample, the reference.

    None where there is no such thing. `numbers` are as `reduce_series` has them.
    """
    reductions = [run.reduction for run in runs if run.reduction is not None]
    found = reduce_series(reductions, numbers)
    return None if found is None else Series(runs=len(reductions), instrument=found)


def refuse_unread(runs: Sequence[AnalysedRun]) -> None:
    """Raise ConfigurationError for a changed key that the fits of none of the runs have used."""
    changed = [run.watched for run in runs if run.watched is not None]
    # where nothing could be fitted, that is what is to be said
    if changed and not any(run.results.problem for run in runs):
        changed[0].refuse_unread(changed)


def _series(runs: Sequence[AnalysedRun]) -> Series | None:
    """Parameters of a series, None for fewer than two fitted runs; or that of other instruments."""
    if any(run.reduction is not None for run in runs):
        return instrument_series(runs)
    numbers = [number for number, run in enumerate(runs, start=1) if run.fits]
    fitted = [runs[number - 1] for number in numbers]
    pendulum = fitted[0].results.pendulum if fitted else None
    if len(fitted) < 2 or pendulum is None:
        return None
    joint = combined_series(
        {name: [run.fits[name] for run in fitted] for name in fitted[0].fits},
        [run.points for run in fitted],
        pendulum,
        fitted[0].rig,
        printed_curvature=bool(fitted[0].results.settings.get("printed_055")),
        of_runs=[run.results.budget for run in fitted],
    )
    apart = tuple(replace(each, run=numbers[each.run - 1]) for each in joint.disagreements)
    return replace(joint, combined_runs=tuple(numbers), disagreements=apart)
