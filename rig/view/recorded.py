"""Shows one or several recorded runs in the live layout; several runs are overlaid."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.record.reader import RecordReader
from acquisition.record.topics import REFERENCE
from processing.balance import Balance
from processing.deflections import DeflectionUnit
from processing.errors import RecordError
from processing.spot import SpotFlag
from processing.ticks import nanoseconds, seconds
from rig.devices import ClockRate
from rig.instrument import CameraClock, advice_for, recorded_configuration
from rig.presentation import balance_numbers, say
from rig.rerun import LayoutName, ShowMode
from rig.view.analysis_curves import analysis_curves, report_text, run_analysis
from rig.view.viewer import Viewer
from rig.view.viewer_program import show_rrd

BLOCK_ROWS = 1024
PICTURE_INTERVAL_S = 10.0


def show_records(
    paths: Sequence[Path],
    *,
    mode: ShowMode = "spawn",
    rrd: Path | None = None,
    layout: LayoutName = "measuring",
) -> None:
    """Show records (.mcap) or Rerun files (.rrd); returns when the viewer is closed.

    Parameters
    ----------
    paths
        Several records are overlaid in different colours, each from time 0 on.
    mode
        A window, or a page for a browser on this machine.
    rrd
        Rerun file to write instead of opening a viewer; must not exist yet.
    layout
        The layout to open.

    Raises
    ------
    RecordError
        A file is missing, is not a record, or contains no spots; nothing has been written then.
    processing.errors.ConfigurationError
        No screen for a window, or `rrd` exists already.
    """
    if paths and all(path.suffix == ".rrd" for path in paths):
        for path in paths:
            if not path.is_file():
                raise RecordError(f"{path}: no such Rerun file")
        show_rrd(paths, mode)
        return
    if rrd is not None:
        write_rrd(paths, rrd, layout=layout)
        return
    with tempfile.TemporaryDirectory(prefix="rig-view-") as folder:
        path = Path(folder) / "records.rrd"
        write_rrd(paths, path, layout=layout)
        show_rrd([path], mode)


def write_rrd(paths: Sequence[Path], rrd: Path, *, layout: LayoutName = "measuring") -> None:
    """Draw records into one Rerun file, with constant memory. See `show_records`."""
    names = run_names(paths)
    overviews = [overview(path) for path in paths]
    units = {each.unit for each in overviews}
    if len(units) > 1:
        raise RecordError(
            f"{', '.join(map(str, paths))}: some are in px (no calibration) and some in arcsec; "
            "they cannot be overlaid, show them separately"
        )
    runs = (
        {name: run_analysis(path) for path, name in zip(paths, names, strict=True)}
        if layout == "analysing"
        else {}
    )
    viewer = Viewer(
        rrd,
        "none",
        layout,
        ", ".join(path.stem for path in paths),
        runs=names,
        amplitude=max(each.amplitude for each in overviews),
        unit=units.pop(),
        has_reference=any(each.has_reference for each in overviews),
    )
    lines = []
    with viewer:
        for path, name, each in zip(paths, names, overviews, strict=True):
            with RecordReader(path) as reader:
                if reader.truncated:
                    say(reader.cut_notice)
                spots, swings = _draw(viewer, reader, name, each.start_ns)
                start = datetime.fromtimestamp(seconds(each.start_utc_ns), UTC)
                end = "truncated" if reader.truncated else "damaged" if reader.damages else "complete"
            lines.append(f"**{path.stem}**: {end}\n")
            lines.append(f"- start {start:%Y-%m-%d %H:%M:%S} UTC\n- {spots} spots\n- {swings} half-cycles\n")
        viewer.state("\n".join(lines), time_s=0.0, run=names[0])
        if runs:
            viewer.fits(analysis_curves(runs), report_text(runs), run=names[0])
    viewer.check_file()


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


class Overview(NamedTuple):
    """Values of a record that are needed before it is drawn."""

    unit: DeflectionUnit
    start_ns: int
    start_utc_ns: int
    amplitude: float
    has_reference: bool


def overview(path: Path) -> Overview:
    """Unit, start and the largest deflection among the first spots."""
    with RecordReader(path) as reader:
        head = next(spot_tables(reader), None)
        if head is None:
            raise RecordError(f"{path}: contains no spots; nothing can be shown")
        deflections = reader.deflections(head)
        with np.errstate(invalid="ignore"):
            reach = np.fmax(np.abs(deflections.shown_x), np.abs(deflections.shown_y))
        amplitude = float(np.nanmax(reach)) if np.isfinite(reach).any() else 1.0
        start_ns = int(head["time_ns"][0])
        return Overview(
            deflections.unit,
            start_ns,
            start_ns + reader.epoch_offset_ns,
            max(amplitude, 1e-3),
            reader.has(REFERENCE.topic),
        )


def spot_tables(reader: RecordReader) -> Iterator[NDArray[Any]]:
    """Yield the record's spots, a thousand at a time."""
    for table in reader.spot_blocks():
        for begin in range(0, len(table), BLOCK_ROWS):
            yield table[begin : begin + BLOCK_ROWS]


def _draw(viewer: Viewer, reader: RecordReader, run: str, start_ns: int) -> tuple[int, int]:
    """Draw one record; returns the numbers of its spots and half-cycles."""
    # their times and amplitudes tell the period and the decay at a glance
    swings = reader.swings()
    if swings:
        viewer.swings(swings, start_ns, run=run)
    advise = _adviser(reader)
    for balance in reader.balances():
        time_s = seconds(balance.time_ns - start_ns)
        viewer.balance(time_s, balance_numbers(balance), advice=advise(balance), run=run)
    for event in [*reader.events(), *(note.event for note in reader.notes())]:
        viewer.event(start_ns, event, run=run)
    spots = _draw_spots(viewer, reader, run, start_ns)
    _draw_reference(viewer, reader, run, start_ns)
    _draw_images(viewer, reader, run, start_ns, spots)
    return len(spots["sequence"]), len(swings)


def _adviser(reader: RecordReader) -> Callable[[Balance], str]:
    """A function that returns advice for a recorded balance; empty if the configuration is not recorded."""
    try:
        config = recorded_configuration(reader)
    except RecordError:
        return lambda _: ""
    return lambda balance: advice_for(config, balance).markdown


def _draw_spots(viewer: Viewer, reader: RecordReader, run: str, start_ns: int) -> dict[str, NDArray[Any]]:
    """Draw X, Y and the losses; returns the frames' numbers and spot positions."""
    sequences: list[NDArray[np.int64]] = []
    places: list[NDArray[np.float32]] = []
    lost = missing = 0
    last: int | None = None
    viewer.losses(0.0, {"missing_frames": 0, "lost_spots": 0}, own=False, run=run)
    rate, shown = _clock_rate(reader), CameraClock()
    for table in spot_tables(reader):
        deflections = reader.deflections(table)
        time_s = seconds(deflections.times_ns - start_ns)
        viewer.samples(time_s, deflections.shown_x, deflections.shown_y, table["flags"], run=run)
        sequence = table["sequence"]
        before = sequence[0] - 1 if last is None else last
        missing += int(np.maximum(np.diff(sequence, prepend=before) - 1, 0).sum())
        lost += int(np.count_nonzero(table["flags"] & SpotFlag.LOST))
        last = int(sequence[-1])
        counts = {"missing_frames": missing, "lost_spots": lost}
        viewer.losses(float(time_s[-1]), counts, own=False, run=run)
        if rate is not None and (now := rate.take_rows(table)) != shown and now.known:
            shown = now
            viewer.clock(float(time_s[-1]), now.drift_ppm, now.u_drift_ppm, run=run)
        sequences.append(sequence.copy())
        places.append(np.column_stack((table["x_px"], table["y_px"])).astype(np.float32))
        viewer.wait_room()
    return {"sequence": np.concatenate(sequences), "place": np.concatenate(places)}


def _draw_reference(viewer: Viewer, reader: RecordReader, run: str, start_ns: int) -> None:
    """Draw the spot of a mirror on the base, if the record has one."""
    if not reader.has(REFERENCE.topic):
        return
    seen = reader.table(REFERENCE.topic)
    for begin in range(0, len(seen), BLOCK_ROWS):
        part = seen[begin : begin + BLOCK_ROWS]
        lost = part["flags"] & SpotFlag.LOST
        viewer.reference(seconds(part["time_ns"] - start_ns), part["x_px"], part["y_px"], lost, run=run)
        viewer.wait_room()


def _clock_rate(reader: RecordReader) -> ClockRate | None:
    """What reads the camera's clock; None for frames made on demand, and where no record says so."""
    try:
        return None if recorded_configuration(reader).on_demand else ClockRate(beside=False)
    except RecordError:
        return None


def _draw_images(
    viewer: Viewer, reader: RecordReader, run: str, start_ns: int, spots: dict[str, NDArray[Any]]
) -> None:
    """Draw the recorded whole frames, with the spots found in them."""
    next_ns = start_ns
    for frame in reader.images():
        if frame.time_ns < next_ns:
            continue
        next_ns = frame.time_ns + nanoseconds(PICTURE_INTERVAL_S)
        row = int(np.searchsorted(spots["sequence"], frame.sequence))
        found = row < len(spots["sequence"]) and spots["sequence"][row] == frame.sequence
        x_px, y_px = spots["place"][row] if found else (np.nan, np.nan)
        time_s = seconds(frame.time_ns - start_ns)
        viewer.image(time_s, frame.image, (float(x_px), float(y_px)), run=run)
        viewer.wait_room()
