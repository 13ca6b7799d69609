"""Places on a sample against the glass plate or reference sample of the same series."""

from collections.abc import Sequence
from dataclasses import replace

from processing.estimate import Estimate
from processing.instruments import Check, Damping, Description, check, over_places, ratio
from rig.analysis.instrument_results import InstrumentSeries, OverPlaces
from rig.analysis.other_instruments import Reduction
from rig.presentation import with_uncertainty
from rig.settings import InstrumentSettings


def reduce_series(runs: Sequence[Reduction]) -> InstrumentSeries | None:
    """Places on the sample against the reference; None for a kind that has no such comparison."""
    if not runs or runs[0].settings.description().report not in ("damping", "decay"):
        return None
    settings, description = runs[0].settings, runs[0].settings.description()
    numbered = list(enumerate((run.damping for run in runs), start=1))
    places = [d for number, d in numbered if d is not None and number not in settings.reference_runs]
    glass = [d for number, d in numbered if d is not None and number in settings.reference_runs]
    lines: list[str] = []
    found = InstrumentSeries(kind=description.kind)
    if places:
        time_s = _over_places([place.time_s for place in places], "damping time", " s", lines)
        swings = _over_places([place.swings for place in places], "swings", "", lines)
        found = replace(found, time_s=time_s, swings=swings)
    reference = _reference(settings, glass)
    if reference is None:
        problem = (
            "no reference was measured: name its runs (instrument.reference_runs) or its time "
            "(instrument.reference_time_s) for a ratio"
        )
        return replace(found, problem=problem, text=(*lines, problem))
    found = replace(found, reference_time_s=reference)
    if glass:
        found = replace(found, acceptance=_acceptance(description, glass, lines))
    if places:
        relative = ratio(over_places([place.time_s for place in places]).mean, reference)
        found = replace(found, ratio=relative)
        lines.append(f"ratio of damping times, sample to reference: {with_uncertainty(*relative)}")
        if glass:
            counted = ratio(
                over_places([place.swings for place in places]).mean,
                over_places([plate.swings for plate in glass]).mean,
            )
            found = replace(found, ratio_of_swings=counted)
            lines.append(f"ratio of swings, sample to reference: {with_uncertainty(*counted)}")
    return replace(found, text=tuple(lines))


def _over_places(values: Sequence[Estimate], what: str, unit: str, lines: list[str]) -> OverPlaces:
    mean = over_places(values)
    places = f"{mean.number} place{'s' if mean.number > 1 else ''}"
    lines.append(
        f"{what} over {places}: {with_uncertainty(*mean.mean)}{unit}"
        + (f", spread {mean.spread:.3g}{unit}" if mean.number > 1 else "")
    )
    return OverPlaces(
        mean.mean.value, mean.mean.standard_uncertainty, mean.number, mean.spread, mean.expanded_95
    )


def _reference(settings: InstrumentSettings, glass: Sequence[Damping]) -> Estimate | None:
    if glass:
        return over_places([plate.time_s for plate in glass]).mean
    if settings.reference_time_s is not None:
        return Estimate(settings.reference_time_s, settings.u_reference_time_s)
    return None


def _acceptance(description: Description, glass: Sequence[Damping], lines: list[str]) -> tuple[Check, ...]:
    """The apparatus on glass against the standard."""
    time_s = over_places([plate.time_s for plate in glass]).mean
    period_s = over_places([plate.period_s for plate in glass]).mean
    checks = []
    if description.period_s is not None:
        checks.append(check("period on glass", period_s, description.period_s, "s"))
    if description.glass_time_s is not None:
        checks.append(check("damping time on glass", time_s, description.glass_time_s, "s"))
    lines += [item.text for item in checks]
    if description.note and checks:
        lines.append(f"note: {description.note}")
    return tuple(checks)
