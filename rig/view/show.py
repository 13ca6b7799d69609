"""`rig view`: draws records into a window, a page or a Rerun file, and follows one that is being written."""

import os
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

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
    from rig.view.drawing import Drawing
    from rig.view.follower import RecordDrawer
    from rig.view.layout import Setup
    from rig.view.rerun_program import ViewerProgram

_LOOK_INTERVAL_S = 0.05
"""Interval of looks at a record that is being written."""
_MAX_FLUSH_S = 5.0
_LIVE_GATHER_S, _LIVE_GATHER_ROWS = 0.2, 2000
_FILE_GATHER_S, _FILE_GATHER_ROWS, _FILE_PICTURE_S = 10.0, 8000, 10.0
_ANALYSIS_NICENESS = 5
_Identity = tuple[int, int]


def show_records(
    paths: Sequence[Path],
    *,
    mode: ShowMode = "spawn",
    rrd: Path | None = None,
    layout: LayoutName = "measuring",
    follow: bool = False,
    ports: tuple[int, int] | None = None,
) -> None:
    """Show records; returns when the viewer is closed.

    A record that is being written is followed to its end.

    Parameters
    ----------
    paths
        Records; several are overlaid in different colours, each from time 0 on.
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
        A file is missing, is not a record, or contains no spots; nothing has been written then. Or the Rerun
        file could not be written.
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
        _check(paths)
    shown = None
    with _viewer(mode, ports) if rrd is None else nullcontext() as viewer:
        while not follow or _await_record(paths[0], shown, viewer):
            with _written_whole(rrd):
                shown, rejected = _draw(paths, layout, rrd, viewer)
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
    paths: Sequence[Path], name: LayoutName, rrd: Path | None, viewer: "ViewerProgram | None"
) -> tuple[_Identity | None, bool]:
    """Draw records into one recording of Rerun, in a viewer or else a file, with constant memory.

    Returns the identity of the first record's file, and whether the start of the last was rejected.
    """
    import rerun as rr

    from rig.view import layout
    from rig.view.drawing import Drawing
    from rig.view.follower import RecordDrawer, configuration_of

    names = run_names(paths)
    with ExitStack() as stack:
        readers = [stack.enter_context(_open_reader(path)) for path in paths]
        shown = _identity(readers[0].files[0].file.fileno())
        setup = setup_of(readers, names, name)
        stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=str(uuid.uuid4()))
        sink = rr.FileSink(str(rrd)) if viewer is None else rr.GrpcSink(viewer.url)
        stream.set_sinks(sink, default_blueprint=layout.blueprint(setup))
        stream.send_recording_name(setup.title)
        config = configuration_of(readers[0])
        interval_s = 0.0 if config is None else config.view.image_interval_s
        gather_s, rows = _LIVE_GATHER_S, _LIVE_GATHER_ROWS
        if viewer is None:
            gather_s, rows, interval_s = _FILE_GATHER_S, _FILE_GATHER_ROWS, _FILE_PICTURE_S
        drawing = Drawing(stream, setup, gather_s=gather_s, gather_rows=rows)
        drawers = []
        for reader, run in zip(readers, names, strict=True):
            drawer = RecordDrawer(reader, drawing, run, picture_interval_s=interval_s)
            drawers.append(drawer)
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
        _draw_ends(paths, names, drawers, drawing)
        with suppress(RuntimeError, TimeoutError) if viewer is not None else nullcontext():
            stream.flush(timeout_sec=_MAX_FLUSH_S)
        end = end_of(readers[-1].events())
        stream.disconnect()
        return shown, end is not None and end.kind == EventKind.REJECTED


def _draw_ends(
    paths: Sequence[Path], names: Sequence[str], drawers: Sequence["RecordDrawer"], drawing: "Drawing"
) -> None:
    """Draw what only complete records have: summaries, and their fits."""
    from rig.view import layout
    from rig.view.analysis import analysis_curves, draw_fits, report_text, run_analysis

    if len(drawers) > 1:
        text = "\n".join(drawer.summary for drawer in drawers)
        drawing.text(names[0], layout.STATE, 0.0, text)
    if drawing.setup.layout == "analysing":
        runs = {name: run_analysis(path) for path, name in zip(paths, names, strict=True)}
        draw_fits(drawing.stream, analysis_curves(runs), report_text(runs), names[0], drawing.setup.unit)


def setup_of(readers: Sequence[RecordReader], names: Sequence[str], layout: LayoutName) -> "Setup":
    """The setup of a drawing of these records; raises RecordError if their units differ."""
    from rig.view.drawing import parameter_shown
    from rig.view.follower import configuration_of
    from rig.view.layout import Setup

    units = {reader.deflection_unit for reader in readers}
    if len(units) > 1:
        raise RecordError(
            f"{', '.join(str(reader.path) for reader in readers)}: some are in px (no calibration) and some "
            "in arcsec; they cannot be overlaid, show them separately"
        )
    config = configuration_of(readers[0])
    title = ", ".join(reader.path.stem for reader in readers)
    return Setup(
        title=f"SIMULATED {title}" if config is not None and config.simulated else title,
        layout=layout,
        runs=tuple(names),
        # the axes adapt to a single run; for several runs they are fixed
        amplitude=1.0 if len(readers) == 1 else max(map(_amplitude, readers)),
        unit=readers[0].deflection_unit.shown,
        parameters={key: parameter_shown(key).label for key in _parameters(readers, config)},
        has_reference=any(REFERENCE.topic in reader.counts for reader in readers)
        or (config is not None and config.reference is not None),
    )


def run_names(paths: Sequence[Path]) -> list[str]:
    """A short unique name for each record; an empty name for a single record."""
    if len(paths) == 1:
        return [""]
    names = [path.stem for path in paths]
    if len(set(names)) < len(names):
        names = [f"{path.resolve().parent.name} {path.stem}" for path in paths]
    return [
        f"{name} ({names[:n].count(name) + 1})" if name in names[:n] else name for n, name in enumerate(names)
    ]


def _amplitude(reader: RecordReader) -> float:
    """The largest deflection among the first spots, in the shown unit."""
    head = next(reader.spot_blocks(), None)
    if head is None:
        return 1.0
    deflections = reader.deflections(head)
    with np.errstate(invalid="ignore"):
        reach = np.fmax(np.abs(deflections.shown_x), np.abs(deflections.shown_y))
    return max(float(np.nanmax(reach)), 1e-3) if np.isfinite(reach).any() else 1.0


def _parameters(readers: Sequence[RecordReader], config: Configuration | None) -> tuple[str, ...]:
    """Keys of the contact's parameters that are fitted while a run is measured."""
    if len(readers) > 1 or config is None:
        return ()
    fitted = (
        config.deflection_unit is DeflectionUnit.RAD
        and config.instrument.description().report == "contact"
        and pendulum_on_ball(config) is not None
    )
    if not fitted or (readers[0].numbers.whole and KIND_OF[RecordedHealth].topic not in readers[0].counts):
        return ()
    return DEFAULT_LAW.fit_names(drag=config.fit.fits_drag)[:-2]


def _check(paths: Sequence[Path]) -> None:
    """Raise RecordError for a record without spots, before anything is opened."""
    for path in paths:
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
