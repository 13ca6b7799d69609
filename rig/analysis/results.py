"""results.json: values, uncertainties, provenance. Fixed names, so that other programs can rely on them."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from acquisition.frame_losses import FrameLosses
from processing.errors import RecordError
from processing.fit import FitResult
from processing.swing import KnownMotion, TurningPoints
from rig.analysis.contact_tree import estimate_tree, evaluation_tree
from rig.analysis.contact_verdicts import Evaluation
from rig.analysis.other_instruments import Reduction
from rig.presentation import plain_values

SCHEMA = 1


@dataclass(frozen=True, slots=True)
class RunResult:
    """What is reported of one run; `problem` says why a fit is missing.

    Amplitudes are in `unit`: arcsec, as their names say, or px where nothing is calibrated.
    `losses` says who lost the frames that are missing; None where an older record does not.
    `motion` is that on which the fitted turning points were measured again (see `processing.fit.remeasure`);
    None: they are those that were detected while the record was made.
    """

    record: Path
    sha256: str
    frames: int
    dropped_frames: int
    half_cycles: int
    initial_amplitude_arcsec: float
    final_amplitude_arcsec: float
    fits: Mapping[str, FitResult]
    surface_energy_j_per_m2: Mapping[str, Any]
    problem: str = ""
    warnings: Sequence[str] = ()
    points: TurningPoints | None = None
    evaluation: Evaluation | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    calibration: Mapping[str, Any] = field(default_factory=dict)
    reduction: Reduction | None = None
    losses: FrameLosses | None = None
    motion: KnownMotion | None = None
    unit: str = "arcsec"


def results_tree(runs: Sequence[RunResult], folder: Path, series: Mapping[str, Any]) -> dict[str, Any]:
    """The whole file as plain values; paths of records are relative to the folder where they can be."""
    return {"schema": SCHEMA, "runs": [_run_tree(run, folder) for run in runs], "series": dict(series)}


def write_results(path: Path, tree: Mapping[str, Any]) -> None:
    """Write results.json; never over an existing one. Raises RecordError."""
    try:
        with path.open("x", encoding="utf-8") as file:
            json.dump(plain_values(tree), file, indent=2)
            file.write("\n")
    except FileExistsError:
        raise RecordError(f"{path}: exists already and is not overwritten; choose another folder") from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None


def fit_tree(fit: FitResult) -> dict[str, Any]:
    """One fit as plain values."""
    tree: dict[str, Any] = {name: estimate_tree(*estimate) for name, estimate in fit.estimates().items()}
    tree["mean_period_s"] = estimate_tree(*fit.mean_period_s)
    tree["arae_decay"] = fit.arae_decay
    tree["arae_period"] = fit.arae_period
    tree["chi2_per_dof"] = fit.chi2_per_dof
    tree["degrees_of_freedom"] = fit.dof
    tree["correlation"] = {"names": list(fit.names), "matrix": fit.correlation.tolist()}
    tree["outliers"] = list(fit.outliers)
    tree["warnings"] = list(fit.warnings)
    return tree


def _run_tree(run: RunResult, folder: Path) -> dict[str, Any]:
    try:
        record = run.record.resolve().relative_to(folder.resolve())
    except ValueError:
        record = run.record.resolve()
    return {
        "record": record.as_posix(),
        "sha256": run.sha256,
        "frames": run.frames,
        "dropped_frames": run.dropped_frames,
        "losses": None if run.losses is None else run.losses._asdict(),
        "half_cycles": run.half_cycles,
        "measured_again_on": asdict(run.motion) if run.motion is not None else None,
        "initial_amplitude_arcsec": run.initial_amplitude_arcsec,
        "final_amplitude_arcsec": run.final_amplitude_arcsec,
        "fits": {name: fit_tree(fit) for name, fit in run.fits.items()},
        "surface_energy_j_per_m2": dict(run.surface_energy_j_per_m2),
        "problem": run.problem,
        "warnings": list(run.warnings),
        "settings": dict(run.settings),
        "calibration": dict(run.calibration),
        **(evaluation_tree(run.evaluation) if run.evaluation is not None else {}),
        **({"instrument": dict(run.reduction.values)} if run.reduction is not None else {}),
    }
