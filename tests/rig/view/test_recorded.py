"""Display of records: content, alignment, overlay, and bad input."""

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.camera import Frame
from acquisition.record.events import EventKind, Severity
from acquisition.record.reader import RecordReader
from acquisition.record.writer import RecordWriter
from processing.balance import Balance
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import ConfigurationError, RecordError
from processing.spot import Spot, SpotFlag
from processing.swing import HalfCycle
from processing.units import ARCSEC_RAD
from rig.view.show import run_names, setup_of, show_records
from tests.rig.view import scene as view_scene
from tests.rig.view.rrd_contents import column, entities, measured, scalars

EPOCH_NS = 1_700_000_000_000_000_000
LOST_ROW = 500


def make_record(
    path: Path, *, start_s: float = 7.0, rows: int = 1000, unit: str = "rad", ended: str = ""
) -> Path:
    """A record of `rows` frames at 100 a second; one is missing, one has lost its spot."""
    sequence = np.delete(np.arange(rows + 1), 200)
    times_ns = np.round((start_s + sequence / 100) * 1e9).astype(np.int64)
    x, y = view_scene.trajectory(sequence / 100, np.random.default_rng(3))
    factor = ARCSEC_RAD if unit == "rad" else 1.0
    x, y = x * factor, y * factor
    x[LOST_ROW] = y[LOST_ROW] = math.nan
    spots = [
        Spot(320.0 + n, 160.0, 0.01, 0.01, 12.0, 12.0, 0.0, 200.0, 8.0, 1.0, 0) for n in range(len(sequence))
    ]
    spots[LOST_ROW] = Spot(*[math.nan] * 10, SpotFlag.LOST)
    u = np.full(len(sequence), 0.01 * factor)
    metadata = {"frame": {"width_px": "640", "height_px": "320"}}
    with RecordWriter(path, EPOCH_NS, metadata=metadata, deflection_unit=DeflectionUnit(unit)) as writer:
        for first in range(0, len(sequence), 500):
            part = slice(first, first + 500)
            numbers, times = sequence[part].tolist(), times_ns[part]
            deflections = Deflections(times, x[part], y[part], u[part], u[part], DeflectionUnit(unit))
            writer.write_spots(numbers, times.tolist(), times.tolist(), spots[part], deflections)
            writer.flush()
        for index in range(4):
            time_ns = int(times_ns[0]) + round(2.035e9 * index)
            swing = HalfCycle(
                index, time_ns, 1e-4, 120 * factor, 0.005 * factor, 2.035, 1e-4, 0.0, 1 - 2 * (index % 2), 0
            )
            writer.write_swing(swing)
            unknown: dict[str, Any] = dict.fromkeys(Balance.__dataclass_fields__, math.nan)
            line = {"line_angle_rad": math.radians(1.5), "u_line_angle_rad": math.radians(0.01)}
            line |= {"transverse_ratio": 0.02, "u_transverse_ratio": 0.0005}
            at = {"time_ns": time_ns, "unit": DeflectionUnit(unit)}
            writer.write_balance(Balance(**{**unknown, **line, **at}))
        writer.write_event(int(times_ns[200]), "gap", "1 frame is missing")
        if ended:
            writer.write_event(int(times_ns[-1]), ended, "")
        image = view_scene.spot_image((420.0, 160.0), np.random.default_rng(0))
        writer.write_preview(Frame(image, int(sequence[100]), int(times_ns[100]), int(times_ns[100])))
    return path


def test_a_record_is_drawn_from_its_start(tmp_path: Path) -> None:
    rrd = tmp_path / "shown.rrd"
    show_records([make_record(tmp_path / "run.mcap")], rrd=rrd)
    times_s, x = scalars(rrd, "/deflection/x")
    expected, _ = view_scene.trajectory(np.delete(np.arange(1001), 200) / 100, np.random.default_rng(3))
    expected[LOST_ROW] = np.nan
    np.testing.assert_allclose(x, expected, rtol=1e-12)
    assert times_s[0] == 0.0
    assert times_s[-1] == pytest.approx(10.0, abs=1e-9)
    assert measured(rrd, "/amplitude")[1] == pytest.approx([120.0] * 4)
    assert measured(rrd, "/period")[1] == pytest.approx([4.07] * 4)
    assert measured(rrd, "/balance/line_angle")[1] == pytest.approx([1.5] * 4)
    _, ratio, u_ratio = measured(rrd, "/balance/transverse_ratio")
    assert ratio == pytest.approx([2.0] * 4)
    assert u_ratio == pytest.approx([0.05] * 4)
    assert scalars(rrd, "/losses/missing_frames")[1][-1] == 1
    assert scalars(rrd, "/losses/lost_spots")[1][-1] == 1
    assert column(rrd, "/events", "TextLog:text")[1] == [["gap: 1 frame is missing"]]
    times_s, crosses = column(rrd, "/camera/spot", "LineStrips2D:strips")
    assert times_s == pytest.approx([1.0])
    # of a frame half as large; the cross' arms are symmetric about the spot, half a pixel further in Rerun's
    # coordinates
    assert np.mean(np.array(crosses[0]).reshape(-1, 2), axis=0) == pytest.approx([210.5, 80.5], abs=1e-3)
    # the lost spot breaks the trajectory
    _, strips = column(rrd, "/lissajous/equal/trajectory/recent", "LineStrips2D:strips")
    assert sum(len(strip[0]) - 1 for strip in strips) == 1000 - 1 - 2
    assert np.isfinite(np.concatenate([np.array(strip[0]) for strip in strips])).all()


def test_what_is_drawn_of_a_record_does_not_depend_on_how_much_was_there_at_first(tmp_path: Path) -> None:
    data = make_record(tmp_path / "run.mcap").read_bytes()
    (tmp_path / "begun").mkdir()
    begun = tmp_path / "begun" / "run.mcap"
    begun.write_bytes(data[: len(data) // 3])
    with RecordReader(begun) as early, RecordReader(tmp_path / "run.mcap") as late:
        assert len(early.spots()) < len(late.spots())
        assert setup_of([early], [""], "measuring") == setup_of([late], [""], "measuring")


def test_a_failing_record_is_a_warning_as_in_the_records_own_log(tmp_path: Path) -> None:
    path, rrd = tmp_path / "run.mcap", tmp_path / "shown.rrd"
    lost_light = ("laser dark", "laser unknown")
    warnings = [kind for kind in EventKind if kind.level is Severity.WARNING]
    assert EventKind.GAP in warnings
    with RecordWriter(path, EPOCH_NS) as writer:
        spot = Spot(*[math.nan] * 10, SpotFlag.LOST)
        nowhere = np.full(1, math.nan)
        at = Deflections(np.zeros(1, np.int64), nowhere, nowhere, nowhere, nowhere, DeflectionUnit.RAD)
        writer.write_spots([0], [0], [0], [spot], at)
        for kind in ("start", "trip", *lost_light, *warnings):
            writer.write_event(0, kind, "happened")
    show_records([path], rrd=rrd)
    texts = [text for (text,) in column(rrd, "/events", "TextLog:text")[1]]
    levels = [level for (level,) in column(rrd, "/events", "TextLog:level")[1]]
    found = dict(zip(texts, levels, strict=True))
    assert found.pop("start: happened") == "INFO"
    warned = {f"{kind}: happened": "WARN" for kind in warnings}
    alarms = {f"{kind}: happened": "ERROR" for kind in lost_light}
    assert found == warned | {"trip: happened": "CRITICAL", **alarms}


def test_records_are_laid_over_each_other(tmp_path: Path) -> None:
    rrd = tmp_path / "shown.rrd"
    paths = [make_record(tmp_path / "run-1.mcap"), make_record(tmp_path / "run-2.mcap", start_s=100.0)]
    show_records(paths, rrd=rrd)
    assert scalars(rrd, "/run-1/deflection/y")[0][0] == 0.0
    assert scalars(rrd, "/run-2/deflection/y")[0][0] == 0.0
    assert {
        "/lissajous/equal/trajectory/run-1/recent",
        "/lissajous/equal/trajectory/run-2/recent",
    } <= entities(rrd)


def test_a_record_without_calibration_is_shown_in_px_and_not_laid_over_another(tmp_path: Path) -> None:
    rrd = tmp_path / "shown.rrd"
    show_records([make_record(tmp_path / "run.mcap", unit="px")], rrd=rrd)
    assert np.nanmax(scalars(rrd, "/deflection/y")[1]) == pytest.approx(120.0, rel=0.01)
    paths = [make_record(tmp_path / "a.mcap"), tmp_path / "run.mcap"]
    with pytest.raises(RecordError, match="cannot be overlaid"):
        show_records(paths, rrd=tmp_path / "both.rrd")
    assert not (tmp_path / "both.rrd").exists()


def test_a_record_cut_short_is_shown_as_far_as_it_goes(tmp_path: Path) -> None:
    path = make_record(tmp_path / "run.mcap", rows=30_000)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    rrd = tmp_path / "shown.rrd"
    show_records([path], rrd=rrd)
    assert 1000 < len(scalars(rrd, "/deflection/x")[0]) < 30_000


@pytest.mark.parametrize(
    ("content", "message"), [(b"", "empty"), (b"no MCAP at all", "not an MCAP file"), (None, "no such")]
)
def test_bad_files_are_named_and_nothing_is_written(
    tmp_path: Path, content: bytes | None, message: str
) -> None:
    good, bad, rrd = make_record(tmp_path / "good.mcap"), tmp_path / "bad.mcap", tmp_path / "shown.rrd"
    if content is not None:
        bad.write_bytes(content)
    before = set(tmp_path.iterdir())
    with pytest.raises(RecordError, match=f"bad.mcap.*{message}"):
        show_records([good, bad], rrd=rrd)
    assert set(tmp_path.iterdir()) == before


def test_a_rerun_file_that_exists_or_cannot_be_made_is_refused(tmp_path: Path) -> None:
    record, rrd = make_record(tmp_path / "run.mcap"), tmp_path / "shown.rrd"
    rrd.write_bytes(b"kept")
    for path, said in (
        (rrd, "exists already"),
        (tmp_path / "missing" / "a.rrd", "is not there"),
        (tmp_path, "a folder"),
    ):
        with pytest.raises(ConfigurationError, match=said):
            show_records([record], rrd=path)
    assert rrd.read_bytes() == b"kept"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here to stand for a full disk")
def test_a_full_disk_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    rrd = tmp_path / "shown.rrd"
    rrd.symlink_to("/dev/full")
    with pytest.raises(RecordError, match=r"shown\.rrd is not whole: .*No space left"):
        show_records([make_record(tmp_path / "run.mcap")], rrd=rrd)


def test_without_a_screen_nothing_opens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not sys.platform.startswith("linux"):
        pytest.skip("a screen may be missing on Linux only")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ConfigurationError, match="no screen"):
        show_records([make_record(tmp_path / "run.mcap")])


def test_names_of_runs() -> None:
    assert run_names([Path("a/run-1.mcap")]) == [""]
    assert run_names([Path("a/run-1.mcap"), Path("a/run-2.mcap")]) == ["run-1", "run-2"]
    assert run_names([Path("a/run-1.mcap"), Path("b/run-1.mcap")]) == ["a run-1", "b run-1"]
    assert len(set(run_names([Path("a/run-1.mcap")] * 3))) == 3
