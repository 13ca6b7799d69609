"""From a closed record to fits: the record alone is read, results stand beside it."""

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.record.digest import sha256_of
from acquisition.record.reader import RecordReader
from acquisition.record.topics import ENVIRONMENT
from processing.angle import ARCSEC_RAD
from processing.deflections import Deflections, DeflectionUnit
from processing.fit import FitMethod, FitResult
from processing.swing import Swing
from rig.analysis.contact_laws import DecayFits, fit_decay, points_in_true_time, settled_swings
from rig.analysis.contact_tree import series_tree
from rig.analysis.contact_verdicts import Evaluation, evaluate, fast_ratio, rig_quantities
from rig.analysis.other_instruments import Air, reduce_run
from rig.analysis.other_instruments_series import reduce_series
from rig.analysis.results import RunResult, results_tree, write_results
from rig.instrument import judge_calibration, pendulum_on_ball, recorded_configuration
from rig.settings import Configuration


def analyse_record(path: Path, overrides: Sequence[str] = ()) -> RunResult:
    """Fit one closed record; `overrides` change its configuration (fit settings, pendulum) for this fit."""
    with RecordReader(path) as reader:
        config = recorded_configuration(reader, overrides)
        spots = reader.spots()
        missing = int(spots["sequence"][-1]) + 1 - len(spots) if len(spots) else 0
        return analyse_run(reader, config, reader.swings(), reader.deflections(spots), dropped_frames=missing)


def analyse_run(
    reader: RecordReader,
    config: Configuration,
    swings: Sequence[Swing],
    deflections: Deflections,
    *,
    dropped_frames: int,
) -> RunResult:
    """Fit half-cycles and deflections that came from a record: those in it, or what a replay made of it."""
    times_ns = deflections.times_ns
    began, ended = (_utc(reader, times_ns[at]) if len(times_ns) else _utc(reader, 0) for at in (0, -1))
    calibration, doubts = judge_calibration(config, reader.attachments, began, ended)
    result = _analyse_swings(reader.path, swings, config, deflections, recorded_air(reader, config))
    warnings = [*result.warnings, *doubts]
    if reader.truncated:
        warnings.append(reader.cut_notice)
    warnings += [f"damaged chunk: {damage.what}" for damage in reader.damages]
    return replace(
        result,
        frames=len(times_ns),
        dropped_frames=dropped_frames,
        losses=reader.losses(),
        warnings=tuple(warnings),
        calibration=calibration,
    )


def recorded_air(reader: RecordReader, config: Configuration) -> Air:
    """Means over a record of what its sensor read; what it did not read, as the user stated it."""
    stated = config.environment
    table = reader.table(ENVIRONMENT.topic)
    means = []
    for name, value in (
        ("temperature_c", stated.temperature_c),
        ("humidity_percent", stated.humidity_percent),
    ):
        read = table[name][np.isfinite(table[name])] if len(table) else np.empty(0)
        means.append(float(np.mean(read)) if len(read) else math.nan if value is None else value)
    return Air(*means)


def _analyse_swings(
    path: Path, swings: Sequence[Swing], config: Configuration, deflections: Deflections, air: Air
) -> RunResult:
    """Reduce the half-cycles of one run as its kind of pendulum asks.

    `path` is the record that they come from, `deflections` and `air` what it holds beside them.
    """
    unit = deflections.unit
    if config.instrument.description().report != "contact" and unit is DeflectionUnit.RAD:
        return _reduced(path, swings, config, deflections, air)
    pendulum, clock_rate = pendulum_on_ball(config), _clock_rate(config)
    settled = settled_swings(swings, deflections, pendulum, config.fit, clock_rate)
    points = points_in_true_time(settled.swings, clock_rate)
    if unit is DeflectionUnit.RAD:
        decay = fit_decay(points, pendulum, config.fit)
    else:
        decay = DecayFits(
            {}, {}, "the record has no calibration (no [lever]): amplitudes are in px, the laws need rad"
        )
    warnings = _fit_warnings(decay.fits)
    sha256 = sha256_of(path)
    evaluation: Evaluation | None = None
    if decay.fits and pendulum is not None:
        seed = int(sha256[:12], 16)
        quantities = rig_quantities(config, fast_ratio(deflections.x, deflections.y))
        evaluation = evaluate(points, pendulum, decay.fits[FitMethod.EXACT], quantities, seed)
    return RunResult(
        record=path,
        sha256=sha256,
        frames=0,
        dropped_frames=0,
        half_cycles=len(points),
        initial_amplitude_arcsec=float(points.amplitude[0]) / unit.shown_size if len(points) else math.nan,
        final_amplitude_arcsec=float(points.amplitude[-1]) / unit.shown_size if len(points) else math.nan,
        fits=decay.fits,
        surface_energy_j_per_m2=decay.surface_energy,
        problem=decay.problem,
        warnings=tuple(dict.fromkeys(warnings)),
        points=points,
        evaluation=evaluation,
        settings=config.fit.model_dump(),
        motion=settled.motion,
        unit=unit.shown,
    )


def _reduced(
    path: Path, swings: Sequence[Swing], config: Configuration, deflections: Deflections, air: Air
) -> RunResult:
    """A run of a pendulum that is not described by the contact's laws."""
    u_scale = config.lever.u_scale_relative if config.lever is not None else 0.0
    reduction = reduce_run(config.instrument, swings, deflections, air, u_scale)
    points = reduction.points
    return RunResult(
        record=path,
        sha256=sha256_of(path),
        frames=0,
        dropped_frames=0,
        half_cycles=len(points),
        initial_amplitude_arcsec=float(points.amplitude[0]) / ARCSEC_RAD if len(points) else math.nan,
        final_amplitude_arcsec=float(points.amplitude[-1]) / ARCSEC_RAD if len(points) else math.nan,
        fits={},
        surface_energy_j_per_m2={},
        problem=reduction.problem,
        points=points,
        settings=config.instrument.model_dump(mode="json"),
        reduction=reduction,
    )


def _clock_rate(config: Configuration) -> float:
    """True seconds in one of the camera's clock, as its calibration has it."""
    return config.timebase.camera_rate if config.timebase is not None else 1.0


def _utc(reader: RecordReader, time_ns: int) -> datetime.datetime:
    return datetime.datetime.fromtimestamp((int(time_ns) + reader.epoch_offset_ns) * 1e-9, datetime.UTC)


def _fit_warnings(fits: Mapping[str, FitResult]) -> list[str]:
    """What every fit says once; what only one of them says with its name."""
    found: dict[str, list[str]] = {}
    for name, fit in fits.items():
        for warning in fit.warnings:
            found.setdefault(warning, []).append(name)
    return [
        warning if len(names) == len(fits) else f"{names[0]} fit: {warning}"
        for warning, names in found.items()
    ]


def combine(runs: Sequence[RunResult]) -> dict[str, Any]:
    """Parameters of a series: see `processing.fit.series`; empty for fewer than two fitted runs.

    Of other instruments, what their runs say together: places on the sample, the reference.
    """
    reductions = [run.reduction for run in runs if run.reduction is not None]
    if reductions:
        values, _ = reduce_series(reductions)
        return {"instrument": values} if values else {}
    fitted = [run for run in runs if run.fits and run.points is not None and run.evaluation is not None]
    first = fitted[0].evaluation if fitted else None
    if len(fitted) < 2 or first is None:
        return {}
    return series_tree(
        {name: [run.fits[name] for run in fitted] for name in fitted[0].fits},
        [run.points for run in fitted if run.points is not None],
        first.pendulum,
        first.rig,
        printed_curvature=bool(fitted[0].settings.get("printed_055")),
    )


def fit_records(paths: Sequence[Path], output: Path | None, overrides: Sequence[str]) -> int:
    """`rig fit` on records: results.json in `output` or beside the first record; exit status."""
    from rig.analysis.screen import print_results

    results = [analyse_record(path, overrides) for path in paths]
    folder = output or paths[0].parent
    target = folder / "results.json"
    if target.exists() and output is None:
        target = free_name(folder, "results", ".json")
    folder.mkdir(parents=True, exist_ok=True)
    write_results(target, results_tree(results, folder, combine(results)))
    print_results(results, [("results", target)])
    return 1 if any(result.problem for result in results) else 0


def free_name(folder: Path, stem: str, suffix: str) -> Path:
    """First of stem-2, stem-3... that does not exist: a fit made again stands beside the earlier one."""
    number = 2
    while (folder / f"{stem}-{number}{suffix}").exists():
        number += 1
    return folder / f"{stem}-{number}{suffix}"
