"""`rig view`: draws records into a window, a page or a Rerun file, and follows one that is being written."""

import os
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from rig.view.values import LayoutName, Setup, ShowMode

if TYPE_CHECKING:
    from rig.view.drawing import Drawing
    from rig.view.follower import RecordDrawer
    from rig.view.rerun_program import ViewerProgram

_LOOK_INTERVAL_S = 0.05
"""Interval of looks at a record that is being written."""
_MAX_FLUSH_S = 5.0
_LIVE_GATHER_S, _LIVE_GATHER_ROWS = 0.2, 2000
_FILE_GATHER_S, _FILE_GATHER_ROWS, _FILE_PICTURE_S = 10.0, 8000, 10.0
_NICE = 5


def show_records(
    paths: Sequence[Path],
    *,
    mode: ShowMode = "spawn",
    rrd: Path | None = None,
    layout: LayoutName = "measuring",
    follow: bool = False,
    ports: tuple[int, int] | None = None,
) -> None:
    """Show records (.mcap) or Rerun files (.rrd); returns when the viewer is closed.

    A record that is being written is followed to its end.

    Parameters
    ----------
    paths
        Records or Rerun files; several are overlaid in different colours, each from time 0 on.
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
    from rig.view.rerun_program import ViewerProgram

    if paths and all(path.suffix == ".rrd" for path in paths):
        for path in paths:
            if not path.is_file():
                raise RecordError(f"{path}: no such Rerun file")
        with ViewerProgram(mode, ports, [str(path) for path in paths]) as program:
            program.wait()
        return
    if follow:
        # the measuring program has precedence
        with suppress(AttributeError, OSError):
            os.nice(_NICE)
    if rrd is not None:
        if not follow or _await_record(paths[0], None):
            write_rrd(paths, rrd, layout=layout, follow=follow)
        return
    import rerun as rr

    if not follow:
        _check(paths)
    with ViewerProgram(mode, ports) as program:
        is_watched = not follow or _await_record(paths[0], None, program)
        while is_watched:
            records = _Records(paths, layout, live=True, is_watched=lambda: program.is_open)
            rejected = records.draw(rr.GrpcSink(program.url))
            is_watched = follow and rejected and _await_record(paths[0], records.shown, program)
        if not follow:
            program.wait()


def write_rrd(
    paths: Sequence[Path], rrd: Path, *, layout: LayoutName = "measuring", follow: bool = False
) -> None:
    """Draw records into one Rerun file, with constant memory. See `show_records`."""
    _check_new(rrd)
    if not follow:
        _check(paths)
    attempt = 0
    while True:
        records = _Records(paths, layout, live=False)
        if not _draw_into(records, rrd) or not follow:
            return
        attempt += 1
        rrd.rename(rrd.with_stem(f"{rrd.stem}-start-{attempt}"))
        if not _await_record(paths[0], records.shown):
            return


def _draw_into(records: "_Records", rrd: Path) -> bool:
    """Draw records into a file; returns whether the start of the last was rejected. Raises RecordError."""
    import rerun as rr

    try:
        rejected = records.draw(rr.FileSink(rrd))
    except (RuntimeError, TimeoutError) as error:
        why = str(error)
    else:
        if rrd.exists():
            return rejected
        why = "it was removed while it was written"
    raise RecordError(f"the Rerun file {rrd} is not whole: {why}; make it again elsewhere")


class _Records:
    """Records to be drawn into one recording of Rerun; `shown` identifies the file of the first."""

    def __init__(
        self,
        paths: Sequence[Path],
        layout: LayoutName,
        *,
        live: bool,
        is_watched: Callable[[], bool] = lambda: True,
    ) -> None:
        self._paths, self._layout, self._live, self._is_watched = paths, layout, live, is_watched
        self._names = run_names(paths)
        self.shown: tuple[int, int] | None = None

    def draw(self, sink: Any) -> bool:
        """Draw all records into a sink of Rerun; returns whether the start of the last was rejected."""
        import rerun as rr

        from rig.view import layout
        from rig.view.drawing import Drawing
        from rig.view.follower import RecordDrawer

        with ExitStack() as stack:
            readers = [stack.enter_context(_open_reader(path)) for path in self._paths]
            self.shown = _identity(readers[0].files[0].file.fileno())
            setup = setup_of(readers, self._names, self._layout)
            stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=str(uuid.uuid4()))
            stream.set_sinks(sink, default_blueprint=layout.blueprint(setup))
            stream.send_recording_name(setup.title)
            gather_s, rows = _LIVE_GATHER_S, _LIVE_GATHER_ROWS
            interval_s = _picture_interval_s(readers[0])
            if not self._live:
                gather_s, rows, interval_s = _FILE_GATHER_S, _FILE_GATHER_ROWS, _FILE_PICTURE_S
            drawing = Drawing(stream, setup, gather_s=gather_s, gather_rows=rows)
            followers = []
            for reader, name in zip(readers, self._names, strict=True):
                follower = RecordDrawer(reader, drawing, name, picture_interval_s=interval_s)
                followers.append(follower)
                if not self._draw_to_end(reader, follower, drawing):
                    return False
                if reader.truncated:
                    say(reader.cut_notice)
            self._draw_ends(followers, drawing)
            with suppress(RuntimeError, TimeoutError) if self._live else nullcontext():
                stream.flush(timeout_sec=_MAX_FLUSH_S)
            end = end_of(readers[-1].events())
            stream.disconnect()
            return end is not None and end.kind == EventKind.REJECTED

    def _draw_to_end(self, reader: RecordReader, follower: "RecordDrawer", drawing: "Drawing") -> bool:
        """Draw a record to its end; returns False if the viewer was closed before."""
        for _ in reader.follow(_LOOK_INTERVAL_S):
            follower.take()
            if self._live:
                drawing.send(now=True)
                # a stalled viewer is not waited for
                with suppress(RuntimeError, TimeoutError):
                    drawing.stream.flush(timeout_sec=_MAX_FLUSH_S)
                if not self._is_watched():
                    return False
        follower.finish()
        return True

    def _draw_ends(self, followers: Sequence["RecordDrawer"], drawing: "Drawing") -> None:
        """Draw what only complete records have: summaries, and their fits."""
        from rig.view import layout
        from rig.view.analysis import analysis_curves, draw_fits, report_text, run_analysis

        if len(followers) > 1:
            text = "\n".join(follower.summary for follower in followers)
            drawing.text(self._names[0], layout.STATE, 0.0, text)
        if self._layout == "analysing":
            runs = {name: run_analysis(path) for path, name in zip(self._paths, self._names, strict=True)}
            unit = drawing.setup.unit
            draw_fits(drawing.stream, analysis_curves(runs), report_text(runs), self._names[0], unit)


def setup_of(readers: Sequence[RecordReader], names: Sequence[str], layout: LayoutName) -> Setup:
    """The setup of a drawing of these records; raises RecordError if their units differ."""
    from rig.view.drawing import parameter_shown
    from rig.view.follower import configuration_of

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
    return DEFAULT_LAW.fit_names(calibrated=True, drag=config.fit.fits_drag)[:-2]


def _picture_interval_s(reader: RecordReader) -> float:
    from rig.view.follower import configuration_of

    config = configuration_of(reader)
    return 0.0 if config is None else config.view.image_interval_s


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


def _identity(file: Path | int) -> tuple[int, int] | None:
    """Device and inode of a file, which distinguish it from a later one at its path; None without a file."""
    try:
        state = os.stat(file)
    except OSError:
        return None
    return state.st_dev, state.st_ino


def _await_record(path: Path, shown: tuple[int, int] | None, program: "ViewerProgram | None" = None) -> bool:
    """Wait for a record at this path other than the one that was shown.

    Returns False if the measuring program or the viewer has ended.
    """
    parent = os.getppid()
    while (found := _identity(path)) is None or found == shown:
        if os.getppid() != parent or (program is not None and not program.is_open):
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
