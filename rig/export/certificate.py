"""Writes results as a digital calibration certificate: those of runs, or those of a calibration file."""

import dataclasses
import datetime
import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from acquisition.record.whole_file import write_new
from calibration import (
    CertificateFacts,
    CertifiedMeasurement,
    ResultGroup,
    ResultNumber,
    certificate_bytes,
    parse_calibration,
)
from processing.errors import ConfigurationError, RecordError
from processing.estimate import Determinacy, Estimate
from processing.fit import Budget, FitMethod
from processing.units import size, unit_of_name
from rig.analysis import OverPlaces, RunResults, Series, series_verdicts
from rig.export.run import ExportedRun
from rig.instrument import versions
from rig.presentation import quantity, unit_of

_SOFTWARE = "optical-pendulum-rig"


def write_certificate_of_calibration(source: Path, output: Path) -> None:
    """A calibration file as a certificate; raises ConfigurationError for another file."""
    try:
        data = source.read_bytes()
    except OSError as error:
        raise ConfigurationError(f"{source}: cannot be read: {error.strerror or error}") from None
    found = parse_calibration(data, str(source))
    numbers = [*_numbers_of(found.values), *_numbers_of(found.details, only_with_u=True)]
    if not numbers:
        raise ConfigurationError(f"{source}: a calibration of {found.kind} has no numbers to certify")
    facts = CertificateFacts(
        identifier=_identifier(data),
        software=_SOFTWARE,
        release=found.software.removeprefix(_SOFTWARE).strip(),
        item=f"optical pendulum: {found.kind}",
        item_identifier=source.name,
        made_by=found.made_by,
        began=found.measured_at.date(),
        ended=found.measured_at.date(),
        valid_until=found.valid_until.date(),
    )
    measured = CertifiedMeasurement(
        f"calibration of the {found.kind}",
        found.method,
        [ResultGroup(found.kind, numbers)],
        {source.name: hashlib.sha256(data).hexdigest()} | {each.name: each.sha256 for each in found.sources},
        found.notes,
    )
    _write(output, facts, [measured])


def write_certificate_of_runs(
    runs: Sequence[tuple[ExportedRun, RunResults]], output: Path, series: Series | None = None
) -> None:
    """The results of runs, and of their series, as one certificate; raises RecordError where none has any."""
    measured = [_measured(run, results) for run, results in runs]
    if series is not None:
        measured.append(_measured_together(series, [results for _, results in series.combined(runs)]))
    measured = [one for one in measured if one.groups]
    if not measured:
        problem = next((results.problem for _, results in runs if results.problem), "")
        raise RecordError(
            f"{runs[0][1].record}: has no results to certify"
            + (f": {problem}" if problem else "; rig fit makes some")
        )
    days = [
        datetime.date.fromisoformat(text[:10]) for run, _ in runs for text in (run.began, run.ended) if text
    ]
    if not days:
        raise RecordError(
            f"{runs[0][1].record}: a table does not say when it was measured, and a certificate must; export "
            "its results in another format"
        )
    about = runs[0][0].provenance
    content = "".join(results.sha256 for _, results in runs).encode()
    facts = CertificateFacts(
        identifier=_identifier(content),
        software=_SOFTWARE,
        release=about.get(f"versions.{_SOFTWARE}") or versions()[_SOFTWARE],
        item=about.get("session.sample") or "contact of an optical pendulum",
        item_identifier=runs[0][1].sha256,
        made_by=about.get("session.operator", ""),
        began=min(days),
        ended=max(days),
        simulated=any(results.simulated for _, results in runs),
    )
    _write(output, facts, measured)


def _measured(run: ExportedRun, results: RunResults) -> CertifiedMeasurement:
    verdicts = {each.name: each.verdict for each in results.identifiability}
    open_ends = _open_ends(verdicts, results.budget)
    groups = []
    if results.budget:
        groups.append(("whole uncertainty, of swings and apparatus", _of_budget(results.budget, open_ends)))
    for name, fit in results.fits.items():
        numbers = [
            _number(key, one.value, one.standard_uncertainty)
            for key, one in fit.parameters.items()
            if key not in open_ends
        ]
        groups.append((f"{name} fit, uncertainty of the swings alone", numbers))
    plain = {"period_s": results.period_s, "log_decrement": results.log_decrement}
    if results.quality_factor is not None:
        plain["quality_factor"] = results.quality_factor
    groups.append(("the decay", [_number(key, *_pair(one)) for key, one in plain.items()]))
    if (kind := results.instrument) is not None:
        groups.append((f"evaluation as {kind.kind}", list(_estimates(kind))))
    return CertifiedMeasurement(
        run.name,
        "free decay of a pendulum that rolls on a ball",
        _groups(groups, open_ends),
        {results.record: results.sha256},
        run.notes,
    )


def _measured_together(series: Series, runs: Sequence[RunResults]) -> CertifiedMeasurement:
    groups = []
    open_ends = set[str]()
    for name, fit in series.fits.items():
        verdicts = {key: each.verdict for key, each in series_verdicts(fit).items()}
        of_fit = _open_ends(verdicts, series.budget)
        if name == FitMethod.EXACT:
            open_ends = of_fit
        numbers = [
            _number(key, one.value, one.standard_uncertainty, dof=one.degrees_of_freedom)
            for key, one in fit.items()
            if key not in of_fit
        ]
        groups.append((f"{name} fit, uncertainty of the swings and of the scatter between runs", numbers))
    if series.budget:
        whole = ("whole uncertainty, of swings and apparatus", _of_budget(series.budget, open_ends))
        groups.insert(0, whole)
    if (kind := series.instrument) is not None:
        groups.append((f"evaluation as {kind.kind}", list(_estimates(kind))))
    return CertifiedMeasurement(
        f"series of {series.runs} runs",
        "free decays of a pendulum that rolls on a ball, combined",
        _groups(groups, open_ends),
        {run.record: run.sha256 for run in runs},
        series.problems,
    )


def _open_ends(verdicts: Mapping[str, Determinacy], budget: Mapping[str, Budget]) -> set[str]:
    """What the data do not determine, and what follows from it."""
    found = {name for name, verdict in verdicts.items() if verdict is not Determinacy.DETERMINED}
    return found | {name for name in budget if "c" in found and name.startswith("surface_energy")}


def _of_budget(budget: Mapping[str, Budget], open_ends: set[str]) -> list[ResultNumber]:
    return [
        _number(name, item.value, item.standard_uncertainty, item.unit, item.degrees_of_freedom)
        for name, item in budget.items()
        if name not in open_ends
    ]


def _groups(groups: Sequence[tuple[str, list[ResultNumber]]], open_ends: set[str]) -> list[ResultGroup]:
    """Those with numbers."""
    return [
        ResultGroup(name, known, sorted(quantity(key).symbol for key in open_ends))
        for name, numbers in groups
        if (known := [one for one in numbers if math.isfinite(one.value) and math.isfinite(one.u)])
    ]


def _estimates(values: Any) -> Iterator[ResultNumber]:
    """Every value with an uncertainty of a pendulum that has no contact's law, and of its parts."""
    for each in dataclasses.fields(values):
        one = getattr(values, each.name)
        if isinstance(one, Estimate | OverPlaces):
            yield _number(each.name, one.value, one.standard_uncertainty)
        elif dataclasses.is_dataclass(one):
            yield from _estimates(one)


def _pair(one: Estimate) -> tuple[float, float]:
    return one.value, one.standard_uncertainty


def _number(key: str, value: float, u: float, unit: str = "", dof: float = math.inf) -> ResultNumber:
    shown = quantity(key)
    unit = unit or unit_of(key)
    try:
        size(unit or "1")
        said = ""
    except ConfigurationError:
        # a power that is a parameter itself: of dimension one, as the radian is
        said, unit = f", in {unit}", "1"
    dof = dof if dof > 0 else math.inf
    named = f"{shown.symbol}: {shown.name}"
    if shown.symbol == shown.name:
        named = key.removesuffix(f"_{unit_of_name(key)}").replace("_", " ")
    return ResultNumber(key, f"{named}{said}", value, unit, u, dof)


def _numbers_of(values: Mapping[str, object], *, only_with_u: bool = False) -> Iterator[ResultNumber]:
    for key, value in values.items():
        if key.startswith("u_") or isinstance(value, bool) or not isinstance(value, int | float):
            continue
        u, dof = values.get(f"u_{key}"), values.get(f"{key.removesuffix('_' + unit_of_name(key))}_dof")
        known = isinstance(u, int | float) and math.isfinite(u)
        if not math.isfinite(value) or (only_with_u and not known):
            continue
        unit = unit_of_name(key)
        yield ResultNumber(
            key,
            key.replace("_", " "),
            float(value),
            unit or "1",
            float(u) if isinstance(u, int | float) and known else math.nan,
            float(dof) if isinstance(dof, int | float) else math.inf,
        )


def _identifier(content: bytes) -> str:
    return f"sha256:{hashlib.sha256(content).hexdigest()}"


def _write(output: Path, facts: CertificateFacts, measured: Sequence[CertifiedMeasurement]) -> None:
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        write_new(output, certificate_bytes(facts, measured))
    except OSError as error:
        raise RecordError(f"{output}: cannot be written: {error.strerror or error}") from None
