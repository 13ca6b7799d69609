"""Fits of records and of tables, and one model over many runs."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from acquisition.record import resolve_records
from processing.contact import DEFAULT_LAW, Law, StatedLaw, StatedMoment
from processing.errors import ConfigurationError
from rig.analysis import (
    ModelCurve,
    RunResults,
    SessionResults,
    analyse_record,
    analyse_trajectory,
    model_curves,
    refuse_copies,
    session_results,
    with_laws,
)
from rig.intake import FilmOptions, TableColumns, film_trajectory, read_seismometer
from rig.report import Campaign, StatedCampaign, fit_model, read_campaign, runs_of_folders, save_campaign
from rig.scripting.session import Record, Session, overrides_of, several
from rig.settings import Configuration, load_configuration

RecordSource = str | Path | Record | Session


def fit(
    source: RecordSource | Sequence[RecordSource],
    overrides: Mapping[str, object] | None = None,
    *,
    seismometer: str | Path | None = None,
    law: StatedMoment | None = None,
    elastic: StatedMoment | None = None,
) -> SessionResults:
    """Fit the contact laws to records; records of other pendulums give the quantities of their kind.

    Parameters
    ----------
    source
        A record, a session, the path of a record or of a session's folder, or a sequence of these, which are
        combined as a series.
    overrides
        Changes of the recorded configuration for this fit, by dotted key: ``{"fit.drag": "open"}``.
    seismometer
        What a seismometer or tiltmeter recorded beside the runs: CSV, miniSEED or SAC.
    law
        A friction of your own, ``f(phi_rad, c=1e-8, k=6e-3)``: its moment against the motion over m g R at
        angles above 0 (an array), and parameters whose defaults are where the fit begins. It is fitted beside
        the paper's law, with the same drag and ground, and compared with it: ``results.runs[0].laws``.
    elastic
        With `law`: the elastic moment in the direction of phi, likewise; None: that of Eq. 3, whose n and
        gamma are fitted.

    Returns
    -------
    SessionResults
        The content of results.json. Nothing is written; `rig.write_results` does that. If a run could not be
        fitted, its `problem` is the reason. ``results["b"]`` is a row of its table of results.

    Raises
    ------
    RigError
        A record cannot be read, or a key is unknown.
    """
    changes = overrides_of(overrides)
    paths = [path for one in several(source, Record, Session) for path in _paths(one)]
    refuse_copies(paths)
    ground = None if seismometer is None else read_seismometer(Path(seismometer))
    runs = [analyse_record(path, changes, seismometer=ground) for path in paths]
    if laws := _laws(law, elastic):
        runs = [with_laws(run, laws) for run in runs]
    return session_results(runs, Path.cwd())


def curves(
    run: RunResults, law: StatedMoment | None = None, elastic: StatedMoment | None = None
) -> Mapping[str, ModelCurve]:
    """Measured and fitted amplitudes and times of every turning point, by fit and law.

    Parameters
    ----------
    run
        A run of results, of a record or of a table; nothing is fitted again.
    law, elastic
        Those with which `fit` was called: results hold the values of their parameters, not the functions.

    Raises
    ------
    RigError
        The run was not fitted, or not with this law.
    """
    if not isinstance(run, RunResults):
        raise ConfigurationError(
            f"run: a run of results is needed (results.runs[0]), not a {type(run).__name__}"
        )
    stated = _laws(law, elastic)
    return model_curves(run, StatedLaw(law, elastic) if stated and law is not None else None)


def fit_film(
    path: str | Path,
    *,
    pixel: str = "",
    rate_hz: float | None = None,
    dark: bool | None = None,
    begin_s: float | None = None,
    end_s: float | None = None,
    configuration: str | Path | None = None,
) -> SessionResults:
    """Follow what swings through a film, and determine decay and period as of a table.

    Parameters
    ----------
    path
        A film, a folder of images, or a stack of them in one file.
    pixel
        Size of a pixel with its unit, ``"0.142 mm"`` or ``"3.2 arcsec"``; empty: px.
    rate_hz
        Frames a second, of images; a film has its own times.
    dark
        Whether what swings is darker than its background; None: the first frame tells.
    begin_s, end_s
        The stretch that is used.
    configuration
        TOML file with [pendulum] and [fit], which fits the contact laws where the pixel is an angle.

    Raises
    ------
    RigError
        The file is no film, cannot be read as it was recorded, or shows no free decay.
    """
    asked = FilmOptions(rate_hz=rate_hz, dark=dark, size=pixel, begin_s=begin_s, end_s=end_s)
    return analyse_trajectory(Path(path), film_trajectory(Path(path), asked), _configuration(configuration))


def _configuration(path: str | Path | None) -> Configuration | None:
    return None if path is None else load_configuration(Path(path), needs_camera=False)


def _laws(law: StatedMoment | None, elastic: StatedMoment | None) -> tuple[Law | StatedLaw, ...]:
    for name, moment in (("law", law), ("elastic", elastic)):
        if moment is not None and not callable(moment):
            raise ConfigurationError(f"{name}: a function of the angle is needed, not {moment!r}")
    if law is None:
        if elastic is not None:
            raise ConfigurationError("elastic: has no effect without law, the friction beside it")
        return ()
    return DEFAULT_LAW, StatedLaw(law, elastic)


def _paths(source: RecordSource) -> list[Path]:
    match source:
        case Session():
            return [record.path for record in source.records]
        case Record():
            return [source.path]
        case _:
            return resolve_records(Path(source))


def fit_table(
    path: str | Path,
    unit: str,
    *,
    configuration: str | Path | None = None,
    time: str | int | None = None,
    positions: str | int | Sequence[str | int] = (),
    time_unit: str = "",
    run: str = "",
    seismometer: str | Path | None = None,
    law: StatedMoment | None = None,
    elastic: StatedMoment | None = None,
) -> SessionResults:
    """Determine decay and period from a table of positions of any instrument, and fit the contact laws.

    Parameters
    ----------
    path
        Text file with a table, such as CSV.
    unit
        Unit of the positions: rad, mrad, urad, arcsec, arcmin or deg. With any other unit the contact laws
        are not fitted.
    configuration
        TOML file with [pendulum] and [fit], which the contact laws require; None: they are not fitted.
    time, positions
        Columns by name or by number from 1; by default the first column is the time, the second the position.
    time_unit
        ns, us, ms, s, min or h; empty: the one with which the column's
        name ends (time_ms), else s. Times may be absolute.
    run
        Which of the runs, where the file holds several.
    seismometer
        What a seismometer or tiltmeter recorded beside the decays, as for `fit`; needs a configuration.
    law, elastic
        Moments of your own, as for `fit`; need a configuration.

    Returns
    -------
    SessionResults
        Half-cycles, decay, period and fits of every decay, in `runs`.

    Raises
    ------
    RigError
        The table has no numbers or lacks a column, or the samples are not a free decay; a seismometer
        without a configuration.
    """
    for name, stated in (("seismometer", seismometer), ("law", law)):
        if stated is not None and configuration is None:
            raise ConfigurationError(f"{name}: has no effect without configuration, which gives the pendulum")
    ground = None if seismometer is None else read_seismometer(Path(seismometer))
    config = _configuration(configuration)
    columns = TableColumns(
        None if time is None else str(time),
        (str(positions),) if isinstance(positions, str | int) else tuple(map(str, positions)),
        unit,
        time_unit,
        run=run,
    )
    return analyse_trajectory(Path(path), columns.read(Path(path)), config, _laws(law, elastic), ground)


def campaign(
    sessions: Sequence[str | Path | Session],
    stated: str | Path | None = None,
    *,
    sample: bool = False,
    output: str | Path | None = None,
) -> Campaign:
    """Fit one model over the runs of several sessions, as `rig compare` does.

    Parameters
    ----------
    sessions
        Folders of sessions, results files, or sessions, in the order in which they were measured. Each is a
        contact.
    stated
        TOML file with parameters, effects and priors; None: all parameters, no effects.
    sample
        The full posterior by a sampler (emcee) in the place of Laplace's method.
    output
        Folder for campaign.json, page, figures and tables; None: nothing is written.

    Returns
    -------
    Campaign
        ``results`` is the content of campaign.json, ``posterior`` has the draws.

    Raises
    ------
    RigError
        Results cannot be read, a run is there twice, or the file names a key, parameter or covariate that
        does not exist.
    """
    folders = [one.folder if isinstance(one, Session) else Path(one) for one in several(sessions, Session)]
    known = StatedCampaign() if stated is None else read_campaign(Path(stated))
    found = fit_model(runs_of_folders(folders), known, sample=sample)
    if output is not None:
        save_campaign(found, Path(output))
    return found
