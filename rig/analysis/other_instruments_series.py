"""Places on a sample against the glass plate or reference sample of the same series."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from processing.instruments import Check, Description, Reading, check, over_places, ratio
from rig.analysis.instrument_results import InstrumentSeries, OverPlaces
from rig.analysis.other_instruments import Reduction
from rig.presentation import with_uncertainty
from rig.settings import InstrumentSettings

_Readings = Sequence[Mapping[str, Reading]]


def reduce_series(runs: Sequence[Reduction], numbers: Sequence[int] = ()) -> InstrumentSeries | None:
    """Places on the sample against the reference; None for a kind that has no such comparison.

    `numbers` are those by which `reference_runs` names the runs, default: they count from 1. Several decays
    of one run have its number.
    """
    if not runs or runs[0].settings.description().report not in ("damping", "decay"):
        return None
    settings, description = runs[0].settings, runs[0].settings.description()
    numbers = numbers or range(1, len(runs) + 1)
    numbered = list(zip(numbers, (run.readings for run in runs), strict=True))
    places = [one for number, one in numbered if one and number not in settings.reference_runs]
    glass = [one for number, one in numbered if one and number in settings.reference_runs]
    lines: list[str] = []
    found = InstrumentSeries(kind=description.kind)
    if places:
        time_s = _over_places(places, "time_s", "damping time", " s", lines)
        swings = _over_places(places, "swings", "swings", "", lines)
        found = replace(found, time_s=time_s, swings=swings)
    reference = _reference(settings, glass)
    problem = _of_the_reference(settings, numbered)
    if reference is None:
        problem += ": no ratio"
        return replace(found, problem=problem, text=(*lines, problem))
    lines += [problem] if problem else []
    found = replace(found, reference_time_s=reference.estimate)
    if glass:
        found = replace(found, acceptance=_acceptance(description, glass, lines))
    if places:
        relative = ratio(_mean(places, "time_s"), reference)
        found = replace(found, ratio=relative)
        lines.append(f"ratio of damping times, sample to reference: {with_uncertainty(*relative)}")
        if glass:
            counted = ratio(_mean(places, "swings"), _mean(glass, "swings"))
            found = replace(found, ratio_of_swings=counted)
            lines.append(f"ratio of swings, sample to reference: {with_uncertainty(*counted)}")
    return replace(found, text=tuple(lines))


def _mean(readings: _Readings, name: str) -> Reading:
    return over_places([one[name] for one in readings]).mean


def _over_places(readings: _Readings, name: str, what: str, unit: str, lines: list[str]) -> OverPlaces:
    places = over_places([one[name] for one in readings])
    mean = places.mean.estimate
    of = f"{places.number} place{'s' if places.number > 1 else ''}"
    line = f"{what} over {of}: {with_uncertainty(*mean)}{unit}"
    if places.number > 1:
        line += f", spread {places.spread:.3g}{unit}"
        if places.mean.u_shared > places.mean.own:
            line += f"; {places.mean.u_shared:.2g}{unit} of the uncertainty is common to all (scale, clock)"
    lines.append(line)
    return OverPlaces(
        mean.value,
        mean.standard_uncertainty,
        places.number,
        places.spread,
        places.expanded_95,
        places.mean.u_shared,
    )


def _reference(settings: InstrumentSettings, glass: _Readings) -> Reading | None:
    if glass:
        return _mean(glass, "time_s")
    if settings.reference_time_s is not None and not settings.reference_runs:
        return Reading(settings.reference_time_s, settings.u_reference_time_s)
    return None


def _of_the_reference(
    settings: InstrumentSettings, numbered: Sequence[tuple[int, Mapping[str, Reading]]]
) -> str:
    """What is wrong with the reference that is stated; empty: nothing."""
    stated = f"instrument.reference_runs = {list(settings.reference_runs)}"
    there = list(dict.fromkeys(number for number, _ in numbered))
    if absent := [number for number in settings.reference_runs if number not in there]:
        return f"{stated}: there is no run {absent[0]}, only {', '.join(map(str, there))}"
    if failed := [number for number, one in numbered if number in settings.reference_runs and not one]:
        return f"{stated}: run {failed[0]} has no damping time, as its own line says"
    if not settings.reference_runs and settings.reference_time_s is None:
        return (
            "no reference was measured, which instrument.reference_runs names by its runs, or "
            "instrument.reference_time_s by its time"
        )
    return ""


def _acceptance(description: Description, glass: _Readings, lines: list[str]) -> tuple[Check, ...]:
    """The apparatus on glass against the standard."""
    checks = []
    for name, key, limits in (
        ("period on glass", "period_s", description.period_s),
        ("damping time on glass", "time_s", description.glass_time_s),
    ):
        if limits is not None:
            checks.append(check(name, _mean(glass, key).estimate, limits, "s"))
    lines += [item.text for item in checks]
    if description.note and checks:
        lines.append(f"note: {description.note}")
    return tuple(checks)
