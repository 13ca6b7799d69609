"""Rows of the archive from a session's folder: its records, and the newest results of each."""

import hashlib
from collections.abc import Iterable, Mapping
from math import isfinite
from pathlib import Path
from typing import Any, Final

from acquisition.record import records_in_folder, recovery_path
from acquisition.record.digest import cached_sha256, sha256_of, utc
from acquisition.record.events import EARLY_ENDS, end_of
from acquisition.record.reader import RecordReader
from acquisition.record.topics import WINDOW
from processing.errors import RecordError
from processing.estimate import Estimate
from processing.fit import FitMethod
from processing.quantity import DerivedQuantity, quantities_of
from processing.units import seconds
from rig.analysis import RunIdentity, RunResults, TableDecay, read_results, recorded_ambient, results_path

PARAMETERS: Final = ("b", "p", "c", "n", "period0_s", "gamma_pa", "drag_s")
"""Parameters of the contact's laws, as far as results hold them."""
DERIVED: Final = quantities_of(DerivedQuantity)
"""Quantities derived from the parameters."""
INSTRUMENT_QUANTITIES: Final = (
    "scale_hardness",
    "time_hardness_s",
    "time_hardness_first_swing_s",
    "log_decrement",
    "rolling_friction_coefficient",
)
"""Quantities of other kinds of pendulum."""


def _text_columns(text: str) -> dict[str, str]:
    words = text.replace(",", " ").split()
    return dict(zip(words[::2], words[1::2], strict=True))


def _estimate_columns(names: Iterable[str]) -> dict[str, str]:
    return {column: "double" for name in names for column in (name, f"u_{name}")}


def row_columns(name: str) -> tuple[str, ...]:
    """The columns of a row of the table of results: value, u, u_total, and both ends of the interval."""
    return (name, f"u_{name}", f"u_total_{name}", f"lower_{name}", f"upper_{name}")


COLUMNS: Final[Mapping[str, str]] = {
    **_text_columns("""
        sha256 varchar, session varchar, run varchar, folder varchar, record varchar, record_bytes bigint,
        state varchar, flaw varchar, windows varchar, results varchar, results_sha256 varchar,
        added_utc timestamp, began_utc timestamp, duration_s double,
        sample varchar, operator varchar, contact_history varchar, noted varchar, host varchar,
        temperature_c double, humidity_percent double, pressure_pa double, dwell_s double, age_s double,
        camera varchar, camera_serial varchar, code_version varchar, code_commit varchar,
        configuration_sha256 varchar, frames bigint, dropped_frames bigint, half_cycles bigint,
        amplitude_unit varchar, initial_amplitude double, final_amplitude double,
        conditions_met boolean, problem varchar, law varchar
    """),
    **{column: "double" for name in PARAMETERS for column in row_columns(name)},
    **{f"verdict_{name}": "varchar" for name in PARAMETERS},
    **_text_columns(
        "seismometer varchar, seismometer_explained double, chi2_per_dof double, degrees_of_freedom bigint"
    ),
    **_estimate_columns(("mean_period_s",)),
    **{column: "double" for name in DERIVED for column in row_columns(name)},
    **{f"verdict_{name}": "varchar" for name in DERIVED},
    **_text_columns("mass_kg double, ball_radius_m double, instrument varchar"),
    **_estimate_columns(INSTRUMENT_QUANTITIES),
}
SHORT_NAMES: Final[Mapping[str, str]] = {"temperature": "temperature_c", "humidity": "humidity_percent"}
"""Short names of columns, for conditions."""
NARROW_COLUMNS: Final = ("run", "sample", "began_utc", "b", "c", "state")
"""Columns that `list` shows on a narrow terminal."""
WIDE_COLUMNS: Final = (*NARROW_COLUMNS[:3], "humidity_percent", "temperature_c", "b", "p", "c", "n", "state")
IS_SIMULATED: Final = "coalesce(camera = 'simulated rig', false)"
"""SQL expression for a run of the simulated rig."""
Row = dict[str, Any]


def session_rows(folder: Path) -> tuple[list[Row], list[str]]:
    """One row for each record of a folder, or run of its results, and lines on flaws of its files.

    Raises RecordError if a file cannot be read.
    """
    rows, flaws = list[Row](), list[str]()
    source, results, identities = results_path(folder), tuple[RunResults, ...](), tuple[RunIdentity, ...]()
    source_columns: Row = {"results_sha256": sha256_of(source) if source.is_file() else ""}
    if source.is_file():
        try:
            session_results = read_results(source)
            results, identities = session_results.runs, session_results.identities
        except RecordError as error:
            flaws.append(str(error))
    by_record = {folder / run.record: run for run in results if run.decay is None}
    records = set(records_in_folder(folder))
    # a recovered copy takes the place of its record
    replaced = {path for path in records if recovery_path(path) in records}
    for path in sorted((records - replaced) | (by_record.keys() - records)):
        run = by_record.get(path)
        name = str(path.relative_to(folder) if path.is_relative_to(folder) else path)
        row = {"run": path.stem, "record": name, "flaw": "", **_record_row(path, run)}
        if run is not None and run.sha256 and run.sha256 != row["sha256"]:
            flaws.append(
                f"{source}: its results of {path} are of an earlier record of that name (other hash) and are "
                "left out; rig fit makes new ones"
            )
            if path.parent != folder:
                # that record belongs to the session of its own folder
                continue
        elif run is not None:
            row |= results_row(run)
        rows.append(row | source_columns | {"results": source.name if run is not None else None})
    for run, identity in zip(results, identities, strict=True):
        if run.decay is not None:
            columns = _table_row(folder, run, run.decay, identity)
            rows.append(columns | source_columns | {"results": source.name})
    flaws += [f"{folder / row['record']}: {row['state']}: {row['flaw']}" for row in rows if row["flaw"]]
    session = hashlib.sha256("".join(sorted({row["sha256"] for row in rows})).encode()).hexdigest()
    return [row | {"session": session} for row in rows], flaws


def _table_row(folder: Path, run: RunResults, decay: TableDecay, identity: RunIdentity) -> Row:
    """The row of a decay of a table or a film."""
    path = folder / run.record
    row: Row = {
        "run": identity.name,
        "record": run.record,
        "sha256": identity.sha256,
        "record_bytes": path.stat().st_size if path.is_file() else None,
        "duration_s": _number(decay.ended_s - decay.began_s),
        "state": "whole",
        "flaw": "",
    }
    row |= {name: text for name, text in decay.session.items() if name != "notes"}
    row |= run.ambient.known() if run.ambient is not None else {}
    if not path.exists():
        row |= {"state": "missing", "flaw": "results name a table that is not there"}
    elif cached_sha256(path) != run.sha256:
        row |= {"state": "damaged", "flaw": "the table has changed since the results were made"}
    return row | results_row(run)


def _record_row(path: Path, run: RunResults | None) -> Row:
    """The columns read from a record, and its state."""
    if run is not None and not path.exists():
        flaw = "results name a record that is not there"
        return {"sha256": run.sha256, "state": "missing", "flaw": flaw}
    row: Row = {"sha256": sha256_of(path), "record_bytes": path.stat().st_size, "state": "whole"}
    try:
        with RecordReader(path) as reader:
            if reader.truncated:
                flaw = "no footer: it is being measured, or was cut short (rig record recover completes it)"
                row |= {"state": "cut", "flaw": flaw}
            elif not reader.is_sound:
                row |= {"state": "damaged", "flaw": "; ".join(reader.damages) or "its bytes have changed"}
            elif (end := end_of(reader.events())) is None or end.kind in EARLY_ENDS:
                flaw = "it has no end" if end is None else f"{end.kind}: {end.text}"
                row |= {"state": "cut short", "flaw": flaw}
            if not reader.truncated:
                # a truncated record lacks the counts
                row["windows"] = "recorded" if reader.counts.get(WINDOW.topic) else "none"
            if reader.numbers.start_ns:
                row["began_utc"] = utc(reader.numbers.start_ns).replace(tzinfo=None)
                row["duration_s"] = seconds(reader.numbers.end_ns - reader.numbers.start_ns)
            session, camera, versions = (
                reader.metadata.get(name, {}) for name in ("session", "camera", "versions")
            )
            row |= {name: session.get(name) for name in ("sample", "operator", "contact_history", "host")}
            row |= {"camera": camera.get("model"), "camera_serial": camera.get("serial")}
            row["code_version"] = versions.get("optical-pendulum-rig")
            row["code_commit"] = versions.get("commit")
            row["noted"] = "; ".join(note.event.text for note in reader.notes()) or None
            row |= recorded_ambient(reader).known()
    except RecordError as error:
        row |= {"state": "unreadable", "flaw": str(error).removeprefix(f"{path}: ")}
    return row


def results_row(run: RunResults) -> Row:
    """The columns read from the results of a run."""
    names = ("frames", "dropped_frames", "half_cycles", "amplitude_unit", "problem")
    row: Row = {name: getattr(run, name) for name in names}
    row |= {name: _number(run.number(name).value) for name in ("initial_amplitude", "final_amplitude")}
    row["configuration_sha256"] = run.inputs_sha256.get("configuration.json")
    row["conditions_met"] = all(verdict.ok for verdict in run.conditions) if run.conditions else None
    if run.pendulum is not None:
        row |= {"mass_kg": run.pendulum.mass_kg, "ball_radius_m": run.pendulum.ball_radius_m}
    if (fit := run.fits.get(FitMethod.EXACT)) is not None:
        row |= {"law": fit.law, "chi2_per_dof": _number(fit.chi2_per_dof)}
        row["degrees_of_freedom"] = fit.degrees_of_freedom
    for name in ("mean_period_s", "log_decrement"):
        estimate = run.number(name)
        row |= _estimate(name, estimate) if estimate.value > 0 else {}
    if (use := run.seismometer) is not None:
        row |= {"seismometer": use.verdict.value, "seismometer_explained": _number(use.explained)}
    for result in run.contact:
        if result.quantity in (*PARAMETERS, *DERIVED):
            numbers = (result.value, result.u, result.u_total, result.lower, result.upper)
            row |= dict(zip(row_columns(result.quantity), map(_number, numbers), strict=True))
            row[f"verdict_{result.quantity}"] = result.verdict.value
    if run.instrument is not None:
        row["instrument"] = run.instrument.kind
        for result in run.table:
            if result.quantity in INSTRUMENT_QUANTITIES:
                row |= _estimate(result.quantity, Estimate(*result))
    return row


def _estimate(name: str, estimate: Estimate) -> Row:
    return {name: _number(estimate.value), f"u_{name}": _number(estimate.standard_uncertainty)}


def _number(value: float) -> float | None:
    return float(value) if isfinite(value) else None
