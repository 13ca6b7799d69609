"""`rig view`: plots a record, complete or being written, into a window, a page or a Rerun file."""

import os
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.record.digest import is_being_written
from acquisition.record.events import EventKind, end_of
from acquisition.record.reader import RecordReader
from acquisition.record.topics import KIND_OF, REFERENCE, RecordedHealth
from processing.contact.laws import DEFAULT_LAW
from processing.deflections import DeflectionUnit
from processing.errors import ConfigurationError, RecordError
from rig.instrument import pendulum_on_ball
from rig.settings import Configuration
from rig.terminal import say
from rig.view.running_view import LayoutName, ShowMode

if TYPE_CHECKING:
    from rig.view.layout import Setup
    from rig.view.rerun_program import ViewerProgram

_POLL_INTERVAL_S = 0.05
"""Interval at which a record that is being written is read."""
_MAX_FLUSH_S = 5.0
_LIVE_LIMIT_S, _LIVE_LIMIT_ROWS = 0.2, 2000
_FILE_LIMIT_S, _FILE_LIMIT_ROWS, _FILE_PICTURE_S = 10.0, 8000, 10.0
"""Limits of `SendBuffer` for a viewer and for a file, and interval of pictures in a file."""
_VIEW_NICENESS = 5
_Identity = tuple[int, int]


def show_record(
    path: Path,
    *,
    mode: ShowMode = "spawn",
    rrd: Path | None = None,
    layout: LayoutName = "measuring",
    follow: bool = False,
    ports: tuple[int, int] | None = None,
) -> None:
    """Show a record; returns when the viewer is closed.

    A record that is being written is followed to its end.

    Parameters
    ----------
    rrd
        Rerun file to write instead of opening a viewer; must not exist yet.
    follow
        Follow a run: its record may not exist yet, another follows it if its start is rejected, and the
        process ends with the run. A window stays open.
    ports
        Ports of stream and page.

    Raises
    ------
    RecordError
        The file is missing, is not a record, or contains no spots; nothing has been written then. Or the
        Rerun file could not be written.
    ConfigurationError
        No screen for a window, or `rrd` exists already.
    """
    if follow:
        # the measuring program has precedence
        with suppress(AttributeError, OSError):
            os.nice(_VIEW_NICENESS)
    if rrd is not None:
        _check_new(rrd)
    if not follow:
        _check(path)
    identity = None
    with _viewer(mode, ports) if rrd is None else nullcontext() as viewer:
        while not follow or _await_record(path, identity, viewer):
            with _complete_output(rrd):
                identity, is_rejected = _plot_record(path, layout, rrd, viewer)
            if not (follow and is_rejected):
                break
        if viewer is not None and not follow:
            viewer.wait()


def _viewer(mode: ShowMode, ports: tuple[int, int] | None) -> "ViewerProgram":
    # imported here, because a Rerun file needs no viewer
    from rig.view.rerun_program import ViewerProgram

    return ViewerProgram(mode, ports)


@contextmanager
def _complete_output(rrd: Path | None) -> Iterator[None]:
    """A context for writing a Rerun file, which raises RecordError if the file is not complete."""
    try:
        yield
    except (RuntimeError, TimeoutError) as error:
        if rrd is None:
            raise
        reason = str(error)
    else:
        if rrd is None or rrd.exists():
            return
        reason = "it was removed while it was written"
    raise RecordError(f"the Rerun file {rrd} is not whole: {reason}; make it again elsewhere")


def _plot_record(
    path: Path, layout_name: LayoutName, rrd: Path | None, viewer: "ViewerProgram | None"
) -> tuple[_Identity | None, bool]:
    """Plot a record into a recording of Rerun, in a viewer or else a file, with constant memory.

    Returns the identity of the record's file, and whether its start was rejected.
    """
    import rerun as rr

    from rig.view import layout
    from rig.view.follower import RecordPlotter, configuration_of
    from rig.view.plotting import RunPlot

    with _open_reader(path) as reader:
        identity = _identity(reader.files[0].file.fileno())
        setup = setup_of(reader, layout_name)
        stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=str(uuid.uuid4()))
        sink = rr.FileSink(str(rrd)) if viewer is None else rr.GrpcSink(viewer.url)
        stream.set_sinks(sink, default_blueprint=layout.blueprint(setup))
        stream.send_recording_name(setup.title)
        config = configuration_of(reader)
        interval_s = 0.0 if config is None else config.view.image_interval_s
        limit_s, limit_rows = _LIVE_LIMIT_S, _LIVE_LIMIT_ROWS
        if viewer is None:
            limit_s, limit_rows, interval_s = _FILE_LIMIT_S, _FILE_LIMIT_ROWS, _FILE_PICTURE_S
        plot = RunPlot(stream, setup, limit_s=limit_s, limit_rows=limit_rows)
        plotter = RecordPlotter(reader, plot, picture_interval_s=interval_s)
        for _ in reader.follow(_POLL_INTERVAL_S):
            plotter.take()
            if viewer is not None:
                plot.send(now=True)
                # a stalled viewer is not waited for
                with suppress(RuntimeError, TimeoutError):
                    stream.flush(timeout_sec=_MAX_FLUSH_S)
                if not viewer.is_open:
                    return identity, False
        plotter.finish()
        if reader.truncated:
            say(reader.cut_notice)
        if layout_name == "analysing":
            from rig.view.analysis import analysis_curves, plot_fits, report_text, run_analysis

            run = run_analysis(path)
            plot_fits(stream, analysis_curves(run), report_text(run), setup.unit)
        with suppress(RuntimeError, TimeoutError) if viewer is not None else nullcontext():
            stream.flush(timeout_sec=_MAX_FLUSH_S)
        end = end_of(reader.events())
        stream.disconnect()
        return identity, end is not None and end.kind == EventKind.REJECTED


def setup_of(reader: RecordReader, layout: LayoutName) -> "Setup":
    """The setup of the plot of a record."""
    from rig.view.follower import configuration_of
    from rig.view.layout import Setup
    from rig.view.plotting import parameter_display

    config = configuration_of(reader)
    title = reader.path.stem
    return Setup(
        title=f"SIMULATED {title}" if config is not None and config.simulated else title,
        layout=layout,
        # the axes adapt to the first deflections
        amplitude=1.0,
        unit=reader.deflection_unit.shown,
        parameters={key: parameter_display(key).label for key in _parameters(reader, config)},
        has_reference=REFERENCE.topic in reader.counts
        or (config is not None and config.reference is not None),
    )


def _parameters(reader: RecordReader, config: Configuration | None) -> tuple[str, ...]:
    """Keys of the contact's parameters that are fitted while a run is measured."""
    if config is None:
        return ()
    is_fitted = (
        config.deflection_unit is DeflectionUnit.RAD
        and config.instrument.description().report == "contact"
        and pendulum_on_ball(config) is not None
    )
    if not is_fitted or (reader.numbers.is_complete and KIND_OF[RecordedHealth].topic not in reader.counts):
        return ()
    return DEFAULT_LAW.fit_names(drag=config.fit.fits_drag)[:-2]


def _check(path: Path) -> None:
    """Raise RecordError for a record without spots, before anything is opened."""
    with RecordReader(path) as reader:
        if not is_being_written(path) and next(reader.spot_blocks(), None) is None:
            raise RecordError(f"{path}: contains no spots; nothing can be shown")


def _check_new(rrd: Path) -> None:
    if rrd.is_file():
        raise ConfigurationError(f"the Rerun file {rrd} exists already; choose another name")
    if rrd.is_dir():
        raise ConfigurationError(f"the Rerun file {rrd} is a folder; name a file in it")
    if not os.access(rrd.parent, os.W_OK | os.X_OK):
        problem = "cannot be written to" if rrd.parent.is_dir() else "is not there"
        raise ConfigurationError(f"the Rerun file {rrd}: the folder {rrd.parent} {problem}")


def _identity(file: Path | int) -> _Identity | None:
    """Device and inode of a file, which distinguish it from a later one at its path; None without a file."""
    try:
        state = os.stat(file)
    except OSError:
        return None
    return state.st_dev, state.st_ino


def _await_record(path: Path, previous: _Identity | None, viewer: "ViewerProgram | None") -> bool:
    """Wait for another record at this path; returns False if measurement or viewer has ended."""
    parent = os.getppid()
    while (identity := _identity(path)) is None or identity == previous:
        if os.getppid() != parent or (viewer is not None and not viewer.is_open):
            return False
        time.sleep(_POLL_INTERVAL_S)
    return True


def _open_reader(path: Path) -> RecordReader:
    """The reader of a record; waits while the head of the record is being written."""
    while True:
        try:
            return RecordReader(path)
        except RecordError:
            if not is_being_written(path):
                raise
            time.sleep(_POLL_INTERVAL_S)
