"""Display of records: content, bad input, and what the State panel says."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from acquisition.camera import Frame
from acquisition.record.events import EventKind, Severity
from acquisition.record.reader import RecordReader
from acquisition.record.topics import (
    RecordedClockStep,
    RecordedHealth,
    RecordedLosses,
    RecordedPhase,
)
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import ConfigurationError, RecordError
from processing.spot import Spot, SpotFlag
from processing.units import ARCSEC_RAD
from rig.instrument import complete, configuration_attachments
from rig.settings import load_configuration
from rig.view.plotting import is_plotted
from rig.view.show import setup_of, show_record
from tests.rig.view import scene as view_scene
from tests.rig.view.replay_record import CONFIG, EPOCH_NS, WITHOUT_FIT, make_record
from tests.rig.view.rrd_contents import column, entities, measured, scalars


def test_a_record_is_drawn_from_its_start(tmp_path: Path) -> None:
    rrd, record = tmp_path / "shown.rrd", make_record(tmp_path / "run.mcap", 20.0, windows=True)
    show_record(record, rrd=rrd)
    with RecordReader(record) as reader:
        seen, half_cycles, balances = reader.deflections(), reader.half_cycles(), reader.balances()
    times_s, x = scalars(rrd, "/deflection/x")
    np.testing.assert_allclose(x, seen.shown_x, rtol=1e-12)
    assert times_s[[0, -1]] == pytest.approx([0.0, 19.98], abs=1e-9)
    amplitudes = [(h.amplitude / ARCSEC_RAD, h.u_amplitude / ARCSEC_RAD) for h in half_cycles]
    periods_s = [(2 * h.half_period_s, 2 * h.u_half_period_s) for h in half_cycles]
    periods_s = [pair for pair in periods_s if not math.isnan(pair[0])]
    for name, expected in (("amplitude", amplitudes), ("period", periods_s)):
        np.testing.assert_allclose(np.transpose(measured(rrd, f"/{name}")[1:]), expected, rtol=1e-5)
    angle_deg = [math.degrees(balance.line_angle_rad) for balance in balances]
    assert measured(rrd, "/balance/line_angle")[1] == pytest.approx(angle_deg)
    _, ratio, u_ratio = measured(rrd, "/balance/transverse_ratio")
    assert ratio == pytest.approx([100 * balance.transverse_ratio for balance in balances])
    assert u_ratio == pytest.approx([100 * balance.u_transverse_ratio for balance in balances])
    assert scalars(rrd, "/losses/missing_frames")[1][-1] == 1
    assert scalars(rrd, "/losses/lost_spots")[1][-1] == 1
    assert column(rrd, "/events", "TextLog:text")[1] == [["start: first frame"], ["stop: time limit"]]
    # a rig without a reference spot has no such curve
    assert not [path for path in entities(rrd) if "reference" in path]
    # the lost spot breaks the trajectory
    _, strips = column(rrd, "/lissajous/equal/trajectory/recent", "LineStrips2D:strips")
    assert sum(len(strip[0]) - 1 for strip in strips) == len(seen) - 1 - 2
    assert np.isfinite(np.concatenate([np.array(strip[0]) for strip in strips])).all()


def test_a_cross_stands_where_the_spot_of_a_preview_is_and_a_lost_reference_nowhere(tmp_path: Path) -> None:
    metadata = {"frame": {"width_px": "640", "height_px": "320"}}
    with RecordWriter(tmp_path / "run.mcap", EPOCH_NS, metadata=metadata) as writer:
        spot = Spot(420.0, 160.0, 0.01, 0.01, 12.0, 12.0, 0.0, 200.0, 8.0, 1.0, 0)
        image = view_scene.spot_image((420.0, 160.0), np.random.default_rng(0))
        lost = spot._replace(x_px=999.0, flags=int(SpotFlag.LOST))
        references = [spot, lost, spot._replace(x_px=423.0)]
        writer.write_spots([0, 1, 2], [0] * 3, [0] * 3, [spot] * 3, nowhere(3), references)
        writer.write_preview(Frame(image, 0, 0, 0))
    show_record(tmp_path / "run.mcap", rrd=tmp_path / "shown.rrd")
    (crosses,) = column(tmp_path / "shown.rrd", "/camera/spot", "LineStrips2D:strips")[1]
    # of a frame half as large; the cross' arms are symmetric about the spot, half a pixel further in Rerun's
    # coordinates
    assert np.mean(np.array(crosses).reshape(-1, 2), axis=0) == pytest.approx([210.5, 80.5], abs=1e-3)
    reference = scalars(tmp_path / "shown.rrd", "/reference/x")[1]
    assert reference == pytest.approx([0.0, math.nan, 3.0], nan_ok=True)


def nowhere(count: int) -> Deflections:
    none = np.full(count, math.nan)
    return Deflections(10**9 * np.arange(count), none, none, none, none, DeflectionUnit.RAD)


def test_a_failing_record_is_a_warning_as_in_the_records_own_log(tmp_path: Path) -> None:
    path, rrd = tmp_path / "run.mcap", tmp_path / "shown.rrd"
    lost_light = ("laser dark", "laser unknown")
    warnings = [kind for kind in EventKind if kind.level is Severity.WARNING]
    assert EventKind.GAP in warnings
    with RecordWriter(path, EPOCH_NS) as writer:
        writer.write_spots([0], [0], [0], [Spot(*[math.nan] * 10, SpotFlag.LOST)], nowhere(1))
        for kind in ("start", "trip", *lost_light, *warnings):
            writer.write_event(0, kind, "happened")
    show_record(path, rrd=rrd)
    texts = [text for (text,) in column(rrd, "/events", "TextLog:text")[1]]
    levels = [level for (level,) in column(rrd, "/events", "TextLog:level")[1]]
    found = dict(zip(texts, levels, strict=True))
    assert found.pop("start: happened") == "INFO"
    warned = {f"{kind}: happened": "WARN" for kind in warnings}
    alarms = {f"{kind}: happened": "ERROR" for kind in lost_light}
    assert found == warned | {"trip: happened": "CRITICAL", **alarms}


def test_a_record_cut_short_is_shown_as_far_as_it_goes_and_set_up_as_the_whole_one(tmp_path: Path) -> None:
    path, cut, rrd = tmp_path / "run.mcap", tmp_path / "cut" / "run.mcap", tmp_path / "shown.rrd"
    cut.parent.mkdir()
    data = make_record(path, 20.0, overrides=WITHOUT_FIT).read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    show_record(cut, rrd=rrd)
    assert 100 < len(scalars(rrd, "/deflection/x")[0]) < 900
    with RecordReader(cut) as early, RecordReader(path) as late:
        assert len(early.spots()) < len(late.spots())
        assert setup_of(early, "measuring") == setup_of(late, "measuring")


@pytest.mark.parametrize(
    ("content", "message"), [(b"", "empty"), (b"no MCAP at all", "not an MCAP file"), (None, "no such")]
)
def test_bad_files_are_named_and_nothing_is_written(
    tmp_path: Path, content: bytes | None, message: str
) -> None:
    bad, rrd = tmp_path / "bad.mcap", tmp_path / "shown.rrd"
    if content is not None:
        bad.write_bytes(content)
    before = set(tmp_path.iterdir())
    with pytest.raises(RecordError, match=f"bad.mcap.*{message}"):
        show_record(bad, rrd=rrd)
    assert set(tmp_path.iterdir()) == before


def test_a_rerun_file_that_exists_or_cannot_be_made_is_refused(tmp_path: Path) -> None:
    record, rrd = make_record(tmp_path / "run.mcap", 15.0), tmp_path / "shown.rrd"
    rrd.write_bytes(b"kept")
    for path, said in (
        (rrd, "exists already"),
        (tmp_path / "missing" / "a.rrd", "is not there"),
        (tmp_path, "a folder"),
    ):
        with pytest.raises(ConfigurationError, match=said):
            show_record(record, rrd=path)
    assert rrd.read_bytes() == b"kept"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here to stand for a full disk")
def test_a_full_disk_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    rrd = tmp_path / "shown.rrd"
    rrd.symlink_to("/dev/full")
    with pytest.raises(RecordError, match=r"shown\.rrd is not whole: .*No space left"):
        show_record(make_record(tmp_path / "run.mcap", 15.0), rrd=rrd)


def test_without_a_screen_nothing_opens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not sys.platform.startswith("linux"):
        pytest.skip("a screen may be missing on Linux only")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ConfigurationError, match="no screen"):
        show_record(make_record(tmp_path / "run.mcap", 15.0))


HEALTHY = RecordedHealth(0, 1000, 4, 0, 0, 0, 10**6, 0.0123, 1e9, 0.0, 31.204, 0.052, "", "one Gaussian")


def test_the_state_says_how_the_session_keeps_up(tmp_path: Path) -> None:
    """The last text but that of the end of a run of one spot, whose session says something of itself."""
    config, one = complete(load_configuration(CONFIG)), np.zeros(1)
    attachments = configuration_attachments(config, CONFIG)
    with RecordWriter(tmp_path / "run.mcap", EPOCH_NS, attachments=attachments) as writer:
        spot = Spot(320.0, 160.0, 0.01, 0.01, 12.0, 12.0, 0.0, 200.0, 8.0, 1.0, 0)
        deflections = Deflections(np.zeros(1, np.int64), one, one, one, one, config.deflection_unit)
        writer.write_spots([0], [0], [0], [spot], deflections)
        writer.write(RecordedPhase(0, 0.0, "measuring", instruction="look at the laser"))
        writer.write(RecordedClockStep(0, 130_000_000, 1000))
        writer.write(RecordedLosses(0, 0, 3, 1, 0, 0))
        writer.write(HEALTHY)
    show_record(tmp_path / "run.mcap", rrd=tmp_path / "run.rrd")
    ((text,),) = column(tmp_path / "run.rrd", "/state", "TextDocument:text")[1][-2:-1]
    assert text.startswith("**measuring**\n\nlook at the laser\n\n- state of ")
    assert "- frames were 12 ms old when they were processed\n" in text
    assert "- camera's clock +31.204 ± 0.052 ppm against the computer's, stepped once by +0.13 s\n" in text
    assert "- lost: 3 by the bus, 1 by this computer\n" in text
    assert "- beam: one Gaussian\n" in text


@pytest.mark.parametrize(("u", "drawn"), [(0.4, True), (0.6, False), (math.nan, False)])
def test_a_parameter_is_drawn_once_it_is_known_to_a_half_of_its_value(u: float, drawn: bool) -> None:
    assert is_plotted(-1.0, u) is drawn
