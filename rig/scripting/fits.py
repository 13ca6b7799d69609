"""Fits of records and of tables."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from rig.analysis import SessionResults, TableResults, analyse_record, analyse_table, session_results
from rig.scripting.record import Record
from rig.scripting.session import Session
from rig.settings import load_configuration

Recorded = str | Path | Record | Session


def fit(
    source: Recorded | Sequence[Recorded], overrides: Mapping[str, object] | None = None
) -> SessionResults:
    """Fit the laws of the contact, or what the kind of pendulum asks for, to one or more records.

    Parameters
    ----------
    source
        A record, a session, a path of a record, or several of them, which are a series.
    overrides
        Changes of the recorded configuration for this fit, by dotted key: ``{"fit.drag": True}``.

    Returns
    -------
    What results.json holds; nothing is written (`rig.write_results` does that). A run that could not
    be fitted says why in `problem`.

    Raises
    ------
    RigError
        A record that cannot be read, an unknown key.
    """
    changes = [f"{key}={json.dumps(value)}" for key, value in (overrides or {}).items()]
    several = [source] if isinstance(source, str | Path | Record | Session) else source
    return session_results(
        [analyse_record(path, changes) for one in several for path in _paths(one)], Path.cwd()
    )


def _paths(source: Recorded) -> list[Path]:
    match source:
        case Session():
            return [record.path for record in source.records]
        case Record():
            return [source.path]
        case _:
            return [Path(source)]


def fit_table(
    path: str | Path,
    unit: str,
    *,
    configuration: str | Path | None = None,
    time: str | None = None,
    positions: Sequence[str] = (),
) -> TableResults:
    """Decay and period of a table of positions from any instrument, and the laws of the contact.

    Parameters
    ----------
    path
        Text table, CSV or the like.
    unit
        Of the positions: rad, mrad, urad, arcsec, arcmin, deg; with any other word there are no laws.
    configuration
        TOML file with [pendulum] and [fit], which the laws need.
    time, positions
        Columns by name or by number from 1; without them the first two.

    Raises
    ------
    RigError
        A table without numbers, a column that is not there, samples without a free decay.
    """
    config = load_configuration(Path(configuration)) if configuration is not None else None
    return analyse_table(Path(path), config, time, positions, unit).results
