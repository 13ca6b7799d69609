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
from rig.intake import TableColumns, read_seismometer
from rig.intake.film import FilmOptions, film_trajectory
from rig.report import Campaign, StatedCampaign, fit_model, read_campaign, runs_of_folders, save_campaign
from rig.scripting.session import Record, Session, as_list, setting_texts
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
    """Fit the contact laws to records; a record of another kind of pendulum is evaluated as its kind is.

    Parameters
    ----------
    source
        A record, a session, the path of a record or of a session's folder, or a sequence of these, which are
        combined as a series.
    overrides
        Changes of the recorded configuration for this fit, by dotted key: ``{"fit.drag": "open"}``.
    seismometer
        File of an auxiliary seismometer or tiltmeter, recorded during the runs: CSV, miniSEED or SAC.
    law
        A friction of your own: a function such as ``f(phi_rad, c=1e-8, k=6e-3)`` that returns the moment
        against the motion, divided by m g R, for an array of angles above 0. Its other arguments are the
        fitted parameters; their defaults are the start values. The law is compared with the paper's, with
        the same drag and ground, in ``results.runs[0].laws``.
    elastic
        With `law`: such a function for the elastic moment in the direction of phi; None: that of Eq. 3, whose
        n and gamma are fitted.

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
    settings = setting_texts(overrides)
    paths = [path for item in as_list(source, Record, Session) for path in _paths(item)]
    refuse_copies(paths)
    ground = None if seismometer is None else read_seismometer(Path(seismometer))
    runs = [analyse_record(path, settings, seismometer=ground) for path in paths]
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
        raise ConfigurationError(f"run: an item of results.runs is needed, not a {type(run).__name__}")
    laws = _laws(law, elastic)
    return model_curves(run, next((item for item in laws if isinstance(item, StatedLaw)), None))


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
    """Track a swinging object through a film, and determine decay and period as of a table.

    Parameters
    ----------
    path
        A film, a folder of images, or a stack of them in one file.
    pixel
        Size of a pixel with its unit, ``"0.142 mm"`` or ``"3.2 arcsec"``; empty: px.
    rate_hz
        Frames a second, of images; a film has its own times.
    dark
        Whether the object is darker than its background; None: the first frame decides.
    begin_s, end_s
        Begin and end of the used part of the film, in s since its first frame; None: all of it.
    configuration
        TOML file with [pendulum] and [fit], which fits the contact laws where the pixel is an angle.

    Raises
    ------
    RigError
        The file is no film, cannot be read as it was recorded, or shows no free decay.
    """
    options = FilmOptions(rate_hz=rate_hz, dark=dark, size=pixel, begin_s=begin_s, end_s=end_s)
    return analyse_trajectory(Path(path), film_trajectory(Path(path), options), _configuration(configuration))


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
        Unit of the positions: rad, mrad, urad, nrad, mas, arcsec, arcmin or deg. With any other unit the
        contact laws are not fitted.
    configuration
        TOML file with [pendulum] and [fit], which the contact laws require; None: they are not fitted.
    time, positions
        Columns by name or by number from 1; by default the first column is the time, the second the position.
    time_unit
        ns, us, ms, s, min, h or d; empty: the unit in the column's name (time_ms), else s. Times may be
        absolute.
    run
        Name of the run to be read from a file of several.
    seismometer
        File of an auxiliary seismometer or tiltmeter, as for `fit`; needs a configuration.
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
    for name, value in (("seismometer", seismometer), ("law", law)):
        if value is not None and configuration is None:
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
    model: str | Path | None = None,
    *,
    sample: bool = False,
    output: str | Path | None = None,
) -> Campaign:
    """Fit one model over the runs of several sessions, as `rig compare` does.

    Parameters
    ----------
    sessions
        Folders of sessions, results files, or sessions, in the order in which they were measured. Each is
        one contact, with its own values of the contact's parameters.
    model
        TOML file with parameters, effects and priors; None: all parameters, no effects.
    sample
        Whether to sample the full posterior (emcee), in place of Laplace's method.
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
    folders = [
        item.folder if isinstance(item, Session) else Path(item) for item in as_list(sessions, Session)
    ]
    stated = StatedCampaign() if model is None else read_campaign(Path(model))
    result = fit_model(runs_of_folders(folders), stated, sample=sample)
    if output is not None:
        save_campaign(result, Path(output))
    return result
