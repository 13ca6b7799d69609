"""Places on a sample against the glass plate or reference sample of the same series."""

from collections.abc import Sequence
from typing import Any

from processing.estimate import Estimate
from processing.instruments import Damping, Description, check, over_places, ratio
from rig.analysis.contact_tree import estimate_tree
from rig.analysis.other_instruments import Reduction, check_tree
from rig.presentation import with_uncertainty
from rig.settings import InstrumentSettings


def reduce_series(runs: Sequence[Reduction]) -> tuple[dict[str, Any], list[str]]:
    """Places on the sample against the reference: values under their names and lines; both may be empty."""
    if not runs or runs[0].settings.description().report not in ("damping", "decay"):
        return {}, []
    settings, description = runs[0].settings, runs[0].settings.description()
    numbered = list(enumerate((run.damping for run in runs), start=1))
    places = [d for number, d in numbered if d is not None and number not in settings.reference_runs]
    glass = [d for number, d in numbered if d is not None and number in settings.reference_runs]
    values: dict[str, Any] = {"kind": description.kind}
    lines: list[str] = []
    if places:
        for name in ("time_s", "swings"):
            mean = over_places([getattr(place, name) for place in places])
            values[name] = {
                **estimate_tree(*mean.mean),
                "places": mean.number,
                "spread": mean.spread,
                "expanded_uncertainty_95": mean.expanded_95,
            }
            lines.append(
                f"{'damping time' if name == 'time_s' else 'swings'} over {mean.number} "
                f"place{'s' if mean.number > 1 else ''}: {with_uncertainty(*mean.mean)}"
                + (f", spread {mean.spread:.3g}" if mean.number > 1 else "")
            )
    reference = _reference(settings, glass)
    if reference is None:
        values["problem"] = (
            "no reference was measured: name its runs (instrument.reference_runs) or its time "
            "(instrument.reference_time_s) for a ratio"
        )
        lines.append(values["problem"])
        return values, lines
    values["reference_time_s"] = estimate_tree(*reference)
    if glass:
        values["acceptance"] = _acceptance(description, glass, lines)
    if places:
        relative = ratio(over_places([place.time_s for place in places]).mean, reference)
        values["ratio"] = estimate_tree(*relative)
        lines.append(f"ratio of damping times, sample to reference: {with_uncertainty(*relative)}")
        if glass:
            counted = ratio(
                over_places([place.swings for place in places]).mean,
                over_places([plate.swings for plate in glass]).mean,
            )
            values["ratio_of_swings"] = estimate_tree(*counted)
            lines.append(f"ratio of swings, sample to reference: {with_uncertainty(*counted)}")
    return values, lines


def _reference(settings: InstrumentSettings, glass: Sequence[Damping]) -> Estimate | None:
    if glass:
        return over_places([plate.time_s for plate in glass]).mean
    if settings.reference_time_s is not None:
        return Estimate(settings.reference_time_s, settings.u_reference_time_s)
    return None


def _acceptance(description: Description, glass: Sequence[Damping], lines: list[str]) -> list[dict[str, Any]]:
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
    return [check_tree(item) for item in checks]
