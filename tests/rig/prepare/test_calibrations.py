"""`rig calibrate`: files that are made, used and rejected; hot pixels that the sensor's are left out by."""

import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.atomic_write import write_new
from acquisition.record.reader import RecordReader
from acquisition.simulation.settings import SensorTruth
from calibration.store import read_calibration, write_calibration
from processing.errors import ConfigurationError, RigError
from rig.analysis import analyse_record
from rig.instrument import complete
from rig.instrument.calibration import calibration_attachments, fill_from_files, judge_calibration
from rig.instrument.provenance import recorded_configuration
from rig.measure import record_plainly
from rig.prepare import (
    calibrate_axes,
    calibrate_clock,
    calibrate_lever,
    calibrate_pointing,
    calibrate_sensor,
    check_known_angle,
)
from rig.prepare.calibration_inputs import Filing
from rig.settings import Configuration, validate_configuration
from rig.view.replay import Replay
from tests.calibration.simulated_sensor import random_sensor, transfer_frames
from tests.rig.command_line import rig
from tests.rig.prepare.calibrated_measurement import measure

GEOMETRY = "[geometry]\narm_m = 1.0\nu_arm_m = 0.001\npixel_pitch_m = 4.8e-6\n"
ARCSEC_PX = 4.8481368e-6 * 2 * 1.0 / 4.8e-6


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def tilts(path: Path, readings: list[float], *, factor: float = 1.0, extra: str = "") -> Path:
    lines = ["kind = 'tilt'", "unit = 'arcsec'", "pixel_pitch_m = 4.8e-6", extra]
    for reading in readings:
        y_px = 320.0 - factor * reading * ARCSEC_PX
        lines += ["[[step]]", f"reference = {reading}", "x_px = 160.0", f"y_px = {y_px}", "u_px = 0.01"]
    return write(path, "\n".join(lines))


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A swing, a rest, and a burnt spot: short runs of the simulated rig."""
    folder = tmp_path_factory.mktemp("records")
    rest: dict[str, Any] = {"release": {"way": "by command"}, "fast": {"amplitude_arcsec": 0.0}}
    runs: dict[str, dict[str, Any]] = {
        "swing": {"max_duration_s": 12.0, "fast": {"amplitude_arcsec": 10.0}, "axes": {"leakage": 0.0}},
        "rest": {"max_duration_s": 4.0, **rest},
        "burnt": {"max_duration_s": 2.0, **rest, "optics": {"peak_dn": 900.0}},
    }
    for name, simulation in runs.items():
        config = validate_configuration({"camera": {"driver": "simulated"}, "simulation": simulation}, name)
        assert record_plainly(config, folder / "none.toml", folder / f"{name}.mcap") == 0
    return {name: folder / f"{name}.mcap" for name in runs}


def in_use(**files: Path) -> Configuration:
    calibrations = {kind: str(path) for kind, path in files.items()}
    tree: dict[str, Any] = {"camera": {"driver": "simulated"}, "calibration": calibrations}
    return validate_configuration(tree, "test")


def test_the_pitch_follows_the_binning(tmp_path: Path) -> None:
    """A lever measured with 2 x 2 pixels, used with 4 x 4: one pixel of the image is four of the sensor."""
    ladder = tilts(tmp_path / "l.toml", [-60.0, -30.0, 0.0, 30.0, 60.0], factor=0.5, extra="binning = 2")
    path = calibrate_lever(ladder, Filing(tmp_path / "c", 30, ""))
    values = read_calibration(path, "lever").values
    assert (values["binning"], values["pixel_pitch_m"]) == (2, 9.6e-6)
    tree: dict[str, Any] = {"calibration": {"lever": str(path)}}
    tree["camera"] = {"driver": "v4l2", "binning": 4}
    config = complete(validate_configuration(tree, "test"))
    assert config.lever is not None
    assert config.lever.pixel_pitch_m == pytest.approx(4 * 4.8e-6)
    assert config.lever.arm_m == pytest.approx(1.0, rel=1e-6)
    assert config.lever.reference_y_px == pytest.approx((320.0 + 0.5) / 2 - 0.5, abs=1e-3)
    assert complete(config) == config, "as a record's configuration is, which states it already"
    tree["camera"] = {"driver": "usb3vision", "colour_plane": "red"}
    coloured = complete(validate_configuration(tree, "test"))
    assert coloured.lever is not None
    assert coloured.lever.pixel_pitch_m == pytest.approx(2 * 4.8e-6), "one pixel of four is red"
    with pytest.raises(ConfigurationError, match=r"set camera\.binning instead"):
        validate_configuration(
            {"camera": {"driver": "simulated", "features": {"BinningVertical": 2}}}, "test"
        )


def test_a_lever_from_geometry_fills_the_configuration(tmp_path: Path) -> None:
    ladder, filing = write(tmp_path / "g.toml", GEOMETRY), Filing(tmp_path / "c", 30, "A. Person")
    path = calibrate_lever(ladder, filing)
    found = read_calibration(path, "lever")
    assert found.made_by == "A. Person"
    assert [source.name for source in found.sources] == ["g.toml"]
    assert found.valid_until - found.measured_at == datetime.timedelta(days=30)
    config = fill_from_files(in_use(lever=path))
    assert config.lever is not None
    assert config.lever.u_arm_m == pytest.approx(1e-3, rel=1e-6)
    assert calibration_attachments(config) == {"calibration/lever.toml": path.read_bytes()}
    # a new file never replaces an old one
    assert [path.name, calibrate_lever(ladder, filing).name] == ["lever-001.toml", "lever-002.toml"]


def test_what_is_printed_is_what_is_used(tmp_path: Path) -> None:
    """A ladder that bends by less than it knows is used as straight; its fitted bend was printed instead."""
    ladder = tilts(tmp_path / "tilts.toml", [-120.0, -60.0, 0.0, 60.0, 120.0])
    ladder.write_text(ladder.read_text().replace("y_px = 320.0\n", "y_px = 320.004\n"))
    done = rig("calibrate", "lever", ladder, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    found = read_calibration(Path(done.stdout.splitlines()[-1]))
    printed = dict(line.split() for line in done.stdout.splitlines() if line.startswith("  skew"))
    assert found.values["skew"] == 0.0
    assert float(printed["skew"]) == 0.0
    assert found.details["fitted_skew"] != 0.0
    assert not found.values.keys() & found.details.keys()


def test_a_ladder_in_another_unit_than_stated_is_doubted(tmp_path: Path) -> None:
    """Arc seconds called milliradians made an arm of 5 mm without a word; the reverse was no message."""
    ladder = tilts(tmp_path / "tilts.toml", [-120.0, -60.0, 0.0, 60.0, 120.0])
    assert not read_calibration(calibrate_lever(ladder, Filing(tmp_path)), "lever").notes
    right = ladder.read_text()
    write(ladder, right.replace("'arcsec'", "'arcmin'"))
    notes = read_calibration(calibrate_lever(ladder, Filing(tmp_path)), "lever").notes
    assert notes[-1] == (
        "from these tilts the arm is 0.0167 m, which is hardly that of a rig: "
        "check unit = 'arcmin', pixel_pitch_m"
    )
    write(ladder, right.replace("'arcsec'", "'mrad'"))
    with pytest.raises(ConfigurationError, match=r"arm is 0\.00485 m, which is hardly .* unit = 'mrad'"):
        calibrate_lever(ladder, Filing(tmp_path))
    write(ladder, tilts(ladder, [-1.0, -0.5, 0.0, 0.5, 1.0], factor=206.26).read_text())
    with pytest.raises(ConfigurationError, match=r"arm is 206 m, which is hardly .* unit = 'arcsec'"):
        calibrate_lever(ladder, Filing(tmp_path))


def test_a_file_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    ladder = tilts(tmp_path / "l.toml", [-100, -50, 0, 50, 100, 50, 0, -50, -100])
    first = read_calibration(calibrate_lever(ladder, Filing(tmp_path / "c", made_by='quote " and \\')))
    again = read_calibration(write_calibration(tmp_path / "d", first, write_new))
    assert again == first


@pytest.mark.slow
def test_pointing_and_axes_from_records(records: dict[str, Path], tmp_path: Path) -> None:
    pointing = read_calibration(calibrate_pointing(records["rest"], Filing(tmp_path)))
    assert 0.5 < pointing.details["x"]["claimed_ratio"] < 2.0
    axes = fill_from_files(in_use(axes=calibrate_axes(records["swing"], Filing(tmp_path), "+", "+"))).axes
    assert axes is not None
    assert not axes.mirrored
    assert abs(axes.slow_angle_rad) < 4 * axes.u_slow_angle_rad + 5e-6
    assert abs(axes.non_orthogonality_rad) < 4 * axes.u_non_orthogonality_rad


@pytest.mark.slow
def test_a_record_carries_its_calibration_and_says_whether_it_held(tmp_path: Path) -> None:
    good = calibrate_lever(write(tmp_path / "g.toml", GEOMETRY), Filing(tmp_path / "c"))
    old = read_calibration(good)
    past = datetime.datetime.now(datetime.UTC) - datetime.timedelta(days=400)
    expired = write_calibration(
        tmp_path / "c",
        old.model_copy(update={"measured_at": past, "valid_until": past + datetime.timedelta(days=90)}),
        write_new,
    )
    for path, validity in ((good, "valid"), (expired, "expired")):
        camera = {"driver": "simulated"}
        simulation = {"max_duration_s": 20.0, "clock": {"frame_rate_hz": 25.0}, "sensor": {"width_px": 96}}
        tree = {"camera": camera, "simulation": simulation, "calibration": {"lever": str(path)}}
        record = tmp_path / f"{validity}.mcap"
        assert record_plainly(validate_configuration(tree, "test"), tmp_path / "none.toml", record) == 0
        with RecordReader(record) as reader:
            assert reader.attachments["calibration/lever.toml"] == path.read_bytes()
        result = analyse_record(record)
        assert result.calibration["lever"]["validity"] == validity
        assert any("expired" in line for line in result.warnings) is (validity == "expired")


def test_missing_calibrations_are_said() -> None:
    config = validate_configuration({"camera": {"driver": "usb3vision"}}, "test")
    now = datetime.datetime.now(datetime.UTC)
    tree, warnings = judge_calibration(config, {}, now, now)
    assert {entry["validity"] for entry in tree.values()} == {"missing"}
    assert warnings == ["not calibrated: sensor, lever, axes, clock (rig calibrate)"]


def test_a_lever_that_moved_between_the_checks_is_flagged(tmp_path: Path) -> None:
    readings = [-100.0, -50.0, 0.0, 50.0, 100.0, 50.0, 0.0, -50.0, -100.0]
    folder = Filing(tmp_path / "c")
    lever = calibrate_lever(tilts(tmp_path / "l.toml", readings), folder)
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    data = {}
    for number, (factor, hours) in enumerate([(1.0, -2), (1.005, 2)], 1):
        check = read_calibration(
            check_known_angle(tilts(tmp_path / f"k{number}.toml", readings, factor=factor), lever, folder)
        )
        at = now + datetime.timedelta(hours=hours)
        path = write_calibration(tmp_path / "d", check.model_copy(update={"measured_at": at}), write_new)
        data[f"calibration/check-{number}.toml"] = path.read_bytes()
    tree, warnings = judge_calibration(in_use(lever=lever), data, now, now)
    assert len(tree["checks"]) == 2
    assert any("moved by +0.5 %" in line for line in warnings)


def test_a_check_that_is_named_twice_is_one_check_and_is_read(tmp_path: Path) -> None:
    readings = [-50.0, 0.0, 50.0, 0.0, -50.0]
    folder = Filing(tmp_path / "c")
    lever = calibrate_lever(tilts(tmp_path / "l.toml", readings), folder)
    check = check_known_angle(tilts(tmp_path / "k.toml", readings), lever, folder)
    config, now = in_use(lever=lever), datetime.datetime.now(datetime.UTC)
    for path, unread in ((check, []), (tmp_path / "gone.toml", ["gone.toml"])):
        files = config.calibration.model_copy(update={"checks": (check, path)})
        tree, warnings = judge_calibration(config.model_copy(update={"calibration": files}), {}, now, now)
        assert len(tree["checks"]) == 1
        assert [line.rpartition("/")[2] for line in warnings if "could not be read" in line] == unread


def test_stated_and_calibrated_differently_is_refused(tmp_path: Path) -> None:
    path = calibrate_lever(write(tmp_path / "g.toml", GEOMETRY), Filing(tmp_path))
    tree = {"lever": {"arm_m": 2.0, "pixel_pitch_m": 4.8e-6}, "calibration": {"lever": str(path)}}
    tree["camera"] = {"driver": "simulated"}
    with pytest.raises(ConfigurationError, match="leave one of them out"):
        fill_from_files(validate_configuration(tree, "test"))
    with pytest.raises(ConfigurationError, match="is a calibration of lever; one of axes is needed"):
        fill_from_files(in_use(axes=path))
    with pytest.raises(ConfigurationError, match=r"^calibration\.axes = .*none\.toml': no such file; rig"):
        fill_from_files(in_use(axes=tmp_path / "none.toml"))


def test_what_cannot_serve_leaves_no_file(records: dict[str, Path], tmp_path: Path) -> None:
    folder = tmp_path / "c"
    filing = Filing(folder)
    swinging = "".join(f"[[step]]\nreference = {r}\nrecord = '{records['swing']}'\n" for r in range(-3, 4))
    swinging = "pixel_pitch_m = 4.8e-6\n" + swinging
    attempts: list[tuple[str, Any]] = [
        ("2 of the 5 steps", lambda: calibrate_lever(tilts(tmp_path / "a.toml", [-9.0, 9.0]), filing)),
        ("one sign", lambda: calibrate_lever(tilts(tmp_path / "b.toml", [1.0, 2, 3, 4, 5]), filing)),
        ("pendulum swings", lambda: calibrate_lever(write(tmp_path / "d.toml", swinging), filing)),
        ("pendulum swings", lambda: calibrate_pointing(records["swing"], filing)),
        ("100 % of the spots are saturated", lambda: calibrate_pointing(records["burnt"], filing)),
        ("does not swing|fast mode", lambda: calibrate_axes(records["rest"], filing, None, None)),
        ("on demand", lambda: calibrate_clock(records["rest"], filing, None)),
        ("darks", lambda: calibrate_sensor(write(tmp_path / "e.toml", "level = []\n"), filing)),
        ("cannot be read", lambda: calibrate_lever(tmp_path / "none.toml", filing)),
        ("arm_m", lambda: calibrate_lever(tilts(tmp_path / "f.toml", [1.0], extra="arm_m = -1"), filing)),
    ]
    for words, attempt in attempts:
        with pytest.raises(RigError, match=words) as caught:
            attempt()
        assert "\n" not in str(caught.value)
    assert not folder.exists()


def transfer(folder: Path, darks: Any, pairs: Any, full_scale_dn: int, exposures: Any = ()) -> Path:
    """Frames in the dark and in pairs of each level, and their list."""
    np.save(folder / "dark.npy", np.stack(darks))
    lines = ["darks = 'dark.npy'", f"full_scale_dn = {full_scale_dn}"]
    for number, pair in enumerate(pairs):
        np.save(folder / f"level-{number}.npy", np.stack(pair))
        lines += ["[[level]]", f"frames = 'level-{number}.npy'"]
        lines += [f"exposure_us = {exposure}" for exposure in exposures[number : number + 1]]
    return write(folder / "t.toml", "\n".join(lines))


def test_a_sensor_from_stacks_of_frames_feeds_the_tracker(tmp_path: Path) -> None:
    truth = random_sensor(np.random.default_rng(8))
    pairs, darks, exposures = transfer_frames(truth, 3, levels=5)
    full_scale_dn, filing = 2**truth.bit_depth - 1, Filing(tmp_path / "c")
    path = calibrate_sensor(transfer(tmp_path, darks, pairs, full_scale_dn, exposures), filing)
    found = read_calibration(path)
    assert len(found.sources) == 2 + len(pairs)
    sensor = fill_from_files(in_use(sensor=path)).sensor
    assert sensor is not None
    assert abs(sensor.gain_e_per_dn - truth.gain_e_per_dn) < 4 * found.details["u_gain_e_per_dn"]
    assert sensor.pedestal_dn == pytest.approx(truth.black_level_dn, abs=6 * found.details["u_dark_level_dn"])
    assert truth.prnu > 4 * found.details["u_prnu"]
    assert sensor.prnu == pytest.approx(truth.prnu, abs=4 * found.details["u_prnu"])
    assert not any("exposure_us" in note for note in found.notes)
    path = calibrate_sensor(transfer(tmp_path, darks, pairs, full_scale_dn, exposures[::-1]), filing)
    assert "see which level has which exposure" in read_calibration(path).notes[-1]
    with pytest.raises(
        ConfigurationError, match=r"full_scale_dn = 99999: the frames in dark\.npy end at \d+ DN"
    ):
        calibrate_sensor(transfer(tmp_path, darks, pairs, 99999, exposures), filing)


@pytest.mark.slow
def test_a_clock_from_a_record_in_real_time_fills_the_timebase(tmp_path: Path) -> None:
    simulation = {"real_time": True, "max_duration_s": 2.0, "clock": {"drift_ppm": 30.0}}
    record = tmp_path / "clock.mcap"
    config = validate_configuration({"camera": {"driver": "simulated"}, "simulation": simulation}, "test")
    assert record_plainly(config, tmp_path / "none.toml", record) == 0
    path = calibrate_clock(record, Filing(tmp_path / "c"), None)
    found = read_calibration(path)
    timebase = fill_from_files(in_use(clock=path)).timebase
    assert timebase is not None
    assert timebase.camera_rate == pytest.approx(1 / (1 + 30e-6), abs=4 * timebase.u_camera_rate)
    with RecordReader(record) as reader:
        stated = [anchor["synchronised"] for anchor in reader.table("/clock")]
    assert found.details["host_synchronised"] is all(stated)
    assert found.details["frame_jitter_limit_s"] == 15e-6
    by_command = rig("calibrate", "clock", str(record), cwd=tmp_path)
    assert by_command.returncode == 0, by_command.stderr
    assert read_calibration(tmp_path / "calibrations" / "clock-001.toml").values == found.values


@pytest.mark.slow
def test_parameters_cover_the_truth_with_the_calibration_included(tmp_path: Path) -> None:
    """Of one rig; the row `coverage-calibrated` of the validation has a hundred."""
    for name, (value, u, truth) in measure(9000, tmp_path).items():
        assert abs(value - truth) < 4.0 * u, name


SEED = 1
HOT = SensorTruth(width_px=100, height_px=120, hot_pixels=1500, hot_pixel_dn=4.0)


def spots(record: Path, truth: SensorTruth, **sections: Any) -> np.ndarray:
    """(n, 4) x, y and their uncertainties of a pendulum at rest."""
    simulation = {
        "seed": SEED,
        "sensor": truth.model_dump(),
        "release": {"way": "by command"},
        "fast": {"amplitude_arcsec": 0.0},
        "max_duration_s": 1.0,
    }
    tree = {"camera": {"driver": "simulated"}, "simulation": simulation, **sections}
    assert record_plainly(validate_configuration(tree, "test"), record, record) == 0
    with RecordReader(record) as reader:
        table = reader.spots()
    return np.column_stack([table[name] for name in ("x_px", "y_px", "u_x_px", "u_y_px")])[10:]


@pytest.mark.slow
def test_the_map_takes_away_what_hot_pixels_do_and_a_replay_repeats_it(tmp_path: Path) -> None:
    """Of a sensor of whose pixels one in eight is hot."""
    pairs, darks, _ = transfer_frames(HOT, SEED)
    calibration = calibrate_sensor(transfer(tmp_path, darks, pairs, 255), Filing(tmp_path))
    sensor = fill_from_files(in_use(sensor=calibration)).sensor
    assert sensor is not None
    assert len(sensor.hot_pixels_xy) > 300
    stated = {
        name: getattr(sensor, name)
        for name in ("gain_e_per_dn", "read_noise_e", "full_scale_dn", "pedestal_dn")
    }
    cold = spots(tmp_path / "cold.mcap", HOT.model_copy(update={"hot_pixels": 0}))
    true_px, u_px = cold[:, :2].mean(axis=0), cold[:, 2:].mean(axis=0)
    biased = spots(tmp_path / "hot.mcap", HOT, sensor=stated)
    mapped = spots(tmp_path / "mapped.mcap", HOT, calibration={"sensor": str(calibration)})
    in_u = [np.abs((found[:, :2].mean(axis=0) - true_px) / u_px).max() for found in (biased, mapped)]
    assert in_u[0] > 0.8
    assert in_u[1] < 0.5  # what is too dark for the map, and three standard deviations of the means
    with RecordReader(tmp_path / "mapped.mcap") as reader:
        replay = Replay(reader, recorded_configuration(reader), retrack=True)
        assert sum(len(numbers) for numbers, _ in replay.blocks())
        found = replay.finish()
    assert found.comparison.spots.largest_u < 1e-3
    assert found.beam.model is not None
