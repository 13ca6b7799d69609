"""A reference spot on the same frames: recorded, and taken off the pendulum's, from pixels to fits."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from acquisition.record.topics import REFERENCE, SPOT
from acquisition.simulation.true_path import true_path, true_turning_points
from processing.errors import ConfigurationError
from processing.spot import Spot
from processing.swing import HalfCycle, half_cycles_of_blocks
from processing.units import ARCSEC_RAD
from rig.analysis import analyse_record, read_results
from rig.analysis.passing_deflections import without_beam_motion
from rig.devices import FrameStream
from rig.instrument import (
    camera_settings,
    complete,
    make_camera,
    optics_of,
    recorded_configuration,
)
from rig.measure import measure_session, record_plainly
from rig.measure.recent_frames import RecentFrames
from rig.settings import Configuration, ReferenceSettings, load_configuration
from rig.view import analyse_replayed
from tests.rig.conftest import APPARATUS, CONFIGS, SMALL

ROW = 646
DEMO = CONFIGS / "demo.toml"
BESIDE = (
    *(f"{key}={value}" for key, value in {**SMALL, "simulation.sensor.height_px": "720"}.items()),
    *APPARATUS,
    "simulation.optics.reference_y_px=319.5",
    "lever.reference_x_px=79.5",
    "lever.reference_y_px=319.5",
    "simulation.reference.relative=0.9",
    "simulation.reference.x_px=80",
    f"reference.from_row_px={ROW}",
)
AIRY = (
    *BESIDE,
    "simulation.disturbances.air_arcsec=0.1",
    "simulation.disturbances.air_from_hz=0.05",
    "simulation.disturbances.pointing_walk_px_per_sqrt_s=0.02",
    "simulation.reference.gain=1.5",
    "simulation.reference.air_common=0.999",
    "reference.gain=1.5",
    "reference.u_gain=0.01",
    "session.max_duration_s=60",
    "fit.drag='vacuum'",
)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record of a minute in air, with a reference spot below the pendulum's."""
    folder = tmp_path_factory.mktemp("reference") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rig.measure.run.live_posterior", lambda _: None)
        assert measure_session(load_configuration(DEMO, AIRY), DEMO, folder) == 0
    return folder / "run-1.mcap"


@pytest.mark.slow
def test_every_frame_has_both_spots_as_they_were_seen(recorded: Path) -> None:
    with RecordReader(recorded) as reader:
        reference, spots = reader.table(REFERENCE.topic), reader.table(SPOT.topic)
        config = recorded_configuration(reader)
        first = reader.deflections(next(reader.spot_blocks()))
    assert np.array_equal(reference["sequence"], spots["sequence"])
    assert np.array_equal(reference["time_ns"], spots["time_ns"])
    assert np.all(np.abs(reference["y_px"] - 684.0) < 3.0)
    assert np.all(spots["y_px"] < ROW)
    assert np.all(reference["u_y_px"] < 0.05)
    deflector, count = optics_of(config, full_scale_dn=255.0).deflector((720, 160)), len(first.times_ns)
    rows = [
        Spot(*row, *[0] * (len(Spot._fields) - 4)) for row in spots[list(Spot._fields[:4])][:count].tolist()
    ]
    assert first.y == pytest.approx(deflector(spots["time_ns"][:count], rows).y, rel=1e-9)


def scatter(half_cycles: Sequence[HalfCycle]) -> tuple[float, float]:
    """Of the amplitudes about the simulator's own, in arcsec, and over what is said of it."""
    true = true_turning_points(load_configuration(DEMO).simulation, max_duration_s=70.0)
    good = [h for h in half_cycles if not h.flags]
    # the simulated camera's clock begins with 1 s
    time_s = np.array([h.turn_time_ns for h in good]) * 1e-9 - 1.0
    nearest = np.argmin(np.abs(time_s[:, None] - true.time_s), axis=1)
    off = np.array([h.amplitude for h in good]) - np.abs(true.angle_rad[nearest])
    u = np.array([h.u_amplitude for h in good])
    return float(np.std(off)) / ARCSEC_RAD, float(np.std(off / u))


def corrected(recorded: Path, **gain: Any) -> tuple[str, tuple[float, float], tuple[float, float]]:
    """What is said of the reference with a gain stated otherwise, and the scatter before and after."""
    with RecordReader(recorded) as reader:
        config: Configuration = recorded_configuration(reader)
        assert config.reference is not None
        reference = config.reference.model_copy(update=gain)
        less = without_beam_motion(reader, config.model_copy(update={"reference": reference}))
        assert less is not None
        assert less.used
        blocks = (less.correct(reader.deflections(one)) for one in reader.spot_blocks())
        return less.note, scatter(reader.half_cycles()), scatter(half_cycles_of_blocks(blocks))


def test_half_cycles_are_nearer_to_the_truth_without_the_beams_motion(recorded: Path) -> None:
    _, before, after = corrected(recorded)
    assert before[0] > 0.02
    assert after[0] < 0.3 * before[0]
    assert after[1] < 2.0


@pytest.mark.slow
def test_fits_and_replays_take_it_off_and_say_so(recorded: Path) -> None:
    (run,) = read_results(recorded.parent).runs
    found = run.fits["exact"].estimate("b")
    replayed, tracked = (analyse_replayed(recorded, retrack=retrack) for retrack in (False, True))
    for one in (run, replayed, tracked):
        assert "reference spot: x used, y used" in one.notes
    assert replayed.fits["exact"].estimate("b") == found
    again = tracked.fits["exact"].estimate("b").value
    # within which a search ends
    assert again == pytest.approx(found.value, abs=0.02 * found.standard_uncertainty)


def test_a_gain_that_is_not_stated_is_found_from_the_run(recorded: Path) -> None:
    note, before, after = corrected(recorded, gain=None, u_gain=0.0)
    gains = re.findall(r"with a gain of (\S+) ± (\S+) from the run itself", note)
    assert len(gains) == 2
    for value, u in gains:
        assert float(value) == pytest.approx(1.5, abs=4 * float(u))
        assert float(u) < 0.1
    assert " y used with a gain of 1." in note
    assert note.endswith("from the run itself")
    assert after[0] < 0.3 * before[0]


def test_a_stated_gain_is_used_however_uncertain_it_is(recorded: Path) -> None:
    assert "not stated" not in corrected(recorded, gain=1.5, u_gain=0.4)[0]


def test_what_has_no_effect_of_a_reference_is_refused(recorded: Path) -> None:
    with pytest.raises(ValueError, match=r"u_gain = 0\.1: has no effect without gain"):
        ReferenceSettings(from_row_px=600, u_gain=0.1)
    with pytest.raises(ConfigurationError, match=r"--set reference\.from_row_px: has no effect here"):
        analyse_record(recorded, ["reference.from_row_px=600"])


def test_before_the_record_each_spot_is_followed_in_its_own_part() -> None:
    """The brightest spot of the whole frame may be the reference's."""
    config = complete(load_configuration(DEMO, AIRY))
    camera = make_camera(config)
    info = camera.open()
    camera.configure(camera_settings(config))
    optics = optics_of(config, info.full_scale_dn)
    shown: list[Sequence[Spot]] = []
    stream = FrameStream(camera, camera_settings(config), policy="wait", timeout_s=5.0)
    stream.start_camera()
    assert stream.begin() is not None
    frames = RecentFrames(stream, optics, 1.0, 1.0, lambda _, block: shown.append(block.references))
    while frames.frames_taken < 60:
        assert frames.advance()
    look = frames.trial(resting=True, duration_s=1.0)
    stream.close()
    camera.close()
    assert all(spot.y_px < ROW for spot in look.spots)
    assert len(look.references) == len(look.spots) == len(look.deflections)
    assert all(abs(spot.y_px - 684.0) < 3.0 for spot in look.references)
    assert sum(map(len, shown)) >= 60


@pytest.mark.slow
def test_it_takes_off_the_creep_of_the_camera_which_an_analysis_without_it_shows(tmp_path: Path) -> None:
    creep = (
        "simulation.disturbances.camera_creep_y_px_per_min=3",
        "simulation.disturbances.camera_slips_at_s=8",
        "simulation.disturbances.camera_slip_y_px=-0.8",
        # what moves the camera moves both as far; so short a run would not show it
        "reference.gain=1",
        "session.max_duration_s=16",
        "record.windows=false",
    )
    config = load_configuration(DEMO, (*BESIDE, *creep))
    record_plainly(config, DEMO, tmp_path / "run-1.mcap")
    truth = true_path(config.simulation, 18.0)
    with RecordReader(tmp_path / "run-1.mcap") as reader:
        less = without_beam_motion(reader, recorded_configuration(reader))
        assert less is not None
        blocks = [reader.deflections(one) for one in reader.spot_blocks()]
    off = []
    for read in (blocks, [less.correct(one) for one in blocks]):
        time_s = np.concatenate([one.times_ns for one in read]) * 1e-9 - 1.0
        y = np.concatenate([one.y for one in read])
        error = (y - np.interp(time_s, truth.times_ns * 1e-9, truth.y_rad)) / ARCSEC_RAD
        off.append(error - error[time_s < 2.0].mean())
    # in a plain analysis the camera's way is the pendulum's: 3 px a minute, and 0.8 px at once
    px_arcsec = 4.8e-6 / 2 / ARCSEC_RAD
    way = -3 / 60 * time_s + 0.8 * (time_s >= 8.0)
    assert off[0] == pytest.approx((way - way[time_s < 2.0].mean()) * px_arcsec, abs=0.06)
    assert np.std(off[1]) < 0.2 * np.std(off[0])
    assert np.max(np.abs(off[1][np.abs(time_s - 8.0) > 1.0])) < 0.1 * np.ptp(off[0])
