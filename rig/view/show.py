"""`rig view`: draws a record into a window, a page or a Rerun file, and follows one that is being written."""

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

_LOOK_INTERVAL_S = 0.05
"""Interval of looks at a record that is being written."""
_MAX_FLUSH_S = 5.0
_LIVE_GATHER_S, _LIVE_GATHER_ROWS = 0.2, 2000
_FILE_GATHER_S, _FILE_GATHER_ROWS, _FILE_PICTURE_S = 10.0, 8000, 10.0
_ANALYSIS_NICENESS = 5
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
    path
        The record.
    mode
        A window, or a page for a browser on this machine.
    rrd
        Rerun file to write instead of opening a viewer; must not exist yet.
    layout
        The layout to open.
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
    processing.errors.ConfigurationError
        No screen for a window, or `rrd` exists already.
    """
    if follow:
        # the measuring program has precedence
        with suppress(AttributeError, OSError):
            os.nice(_ANALYSIS_NICENESS)
    if rrd is not None:
        _check_new(rrd)
    if not follow:
        _check(path)
    shown = None
    with _viewer(mode, ports) if rrd is None else nullcontext() as viewer:
        while not follow or _await_record(path, shown, viewer):
            with _written_whole(rrd):
                shown, rejected = _draw(path, layout, rrd, viewer)
            if not (follow and rejected):
                break
        if viewer is not None and not follow:
            viewer.wait()


def _viewer(mode: ShowMode, ports: tuple[int, int] | None) -> "ViewerProgram":
    # it imports what a Rerun file does not need
    from rig.view.rerun_program import ViewerProgram

    return ViewerProgram(mode, ports)


@contextmanager
def _written_whole(rrd: Path | None) -> Iterator[None]:
    """Raises RecordError if a Rerun file could not be written whole."""
    try:
        yield
    except (RuntimeError, TimeoutError) as error:
        if rrd is None:
            raise
        why = str(error)
    else:
        if rrd is None or rrd.exists():
            return
        why = "it was removed while it was written"
    raise RecordError(f"the Rerun file {rrd} is not whole: {why}; make it again elsewhere")


def _draw(
    path: Path, name: LayoutName, rrd: Path | None, viewer: "ViewerProgram | None"
) -> tuple[_Identity | None, bool]:
    """Draw a record into a recording of Rerun, in a viewer or else a file, with constant memory.

    Returns the identity of the record's file, and whether its start was rejected.
    """
    import rerun as rr

    from rig.view import layout
    from rig.view.drawing import Drawing
    from rig.view.follower import RecordDrawer, configuration_of

    with _open_reader(path) as reader:
        shown = _identity(reader.files[0].file.fileno())
        setup = setup_of(reader, name)
        stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=str(uuid.uuid4()))
        sink = rr.FileSink(str(rrd)) if viewer is None else rr.GrpcSink(viewer.url)
        stream.set_sinks(sink, default_blueprint=layout.blueprint(setup))
        stream.send_recording_name(setup.title)
        config = configuration_of(reader)
        interval_s = 0.0 if config is None else config.view.image_interval_s
        gather_s, rows = _LIVE_GATHER_S, _LIVE_GATHER_ROWS
        if viewer is None:
            gather_s, rows, interval_s = _FILE_GATHER_S, _FILE_GATHER_ROWS, _FILE_PICTURE_S
        drawing = Drawing(stream, setup, gather_s=gather_s, gather_rows=rows)
        drawer = RecordDrawer(reader, drawing, picture_interval_s=interval_s)
        for _ in reader.follow(_LOOK_INTERVAL_S):
            drawer.take()
            if viewer is not None:
                drawing.send(now=True)
                # a stalled viewer is not waited for
                with suppress(RuntimeError, TimeoutError):
                    stream.flush(timeout_sec=_MAX_FLUSH_S)
                if not viewer.is_open:
                    return shown, False
        drawer.finish()
        if reader.truncated:
            say(reader.cut_notice)
        if name == "analysing":
            from rig.view.analysis import analysis_curves, draw_fits, report_text, run_analysis

            run = run_analysis(path)
            draw_fits(stream, analysis_curves(run), report_text(run), setup.unit)
        with suppress(RuntimeError, TimeoutError) if viewer is not None else nullcontext():
            stream.flush(timeout_sec=_MAX_FLUSH_S)
        end = end_of(reader.events())
        stream.disconnect()
        return shown, end is not None and end.kind == EventKind.REJECTED


def setup_of(reader: RecordReader, layout: LayoutName) -> "Setup":
    """The setup of the drawing of a record."""
    from rig.view.drawing import parameter_shown
    from rig.view.follower import configuration_of
    from rig.view.layout import Setup

    config = configuration_of(reader)
    title = reader.path.stem
    return Setup(
        title=f"SIMULATED {title}" if config is not None and config.simulated else title,
        layout=layout,
        # the axes adapt
        amplitude=1.0,
        unit=reader.deflection_unit.shown,
        parameters={key: parameter_shown(key).label for key in _parameters(reader, config)},
        has_reference=REFERENCE.topic in reader.counts
        or (config is not None and config.reference is not None),
    )


def _parameters(reader: RecordReader, config: Configuration | None) -> tuple[str, ...]:
    """Keys of the contact's parameters that are fitted while a run is measured."""
    if config is None:
        return ()
    fitted = (
        config.deflection_unit is DeflectionUnit.RAD
        and config.instrument.description().report == "contact"
        and pendulum_on_ball(config) is not None
    )
    if not fitted or (reader.numbers.is_complete and KIND_OF[RecordedHealth].topic not in reader.counts):
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
        what = "cannot be written to" if rrd.parent.is_dir() else "is not there"
        raise ConfigurationError(f"the Rerun file {rrd}: the folder {rrd.parent} {what}")


def _identity(file: Path | int) -> _Identity | None:
    """Device and inode of a file, which distinguish it from a later one at its path; None without a file."""
    try:
        state = os.stat(file)
    except OSError:
        return None
    return state.st_dev, state.st_ino


def _await_record(path: Path, shown: _Identity | None, viewer: "ViewerProgram | None") -> bool:
    """Wait for a record at this path other than the one that was shown.

    Returns False if the measuring program or the viewer has ended.
    """
    parent = os.getppid()
    while (found := _identity(path)) is None or found == shown:
        if os.getppid() != parent or (viewer is not None and not viewer.is_open):
            return False
        time.sleep(_LOOK_INTERVAL_S)
    return True


def _open_reader(path: Path) -> RecordReader:
    """The reader of a record; waits while the head of the record is being written."""
    while True:
        try:
            return RecordReader(path)
        except RecordError:
            if not is_being_written(path):
                raise
            time.sleep(_LOOK_INTERVAL_S)
