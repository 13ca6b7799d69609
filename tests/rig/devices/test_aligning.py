"""Aligning by eye: what is drawn, and what the keys do, on the simulated camera."""

import os
import re
import sys
from contextlib import suppress

import numpy as np
import pytest

from acquisition.camera import CameraSettings, Frame
from acquisition.cameras.simulated import SimulatedCamera
from calibration import Axes, Lever
from processing.errors import DeviceError
from processing.spot import SensorModel, SpotTracker
from rig.devices import Devices, FrameStream, aligning
from rig.devices.aligning import LivePicture
from rig.devices.alignment_look import AlignmentFrame, annotated_picture, take_look
from rig.devices.picture import figures
from rig.instrument import Optics, Pipeline, reference_px
from rig.settings import Configuration, PreflightSettings, load_configuration
from rig.terminal import palette
from tests.rig.command_line import CONFIGS

FULL_SCALE_DN = 255
SHAPE = (400, 300)


def look_at(image: np.ndarray, crosshair_px: tuple[float, float] = (149.5, 199.5)) -> AlignmentFrame:
    tracker = SpotTracker(SensorModel(gain_e_per_dn=2.4, read_noise_e=7.0, full_scale_dn=FULL_SCALE_DN))
    spot = tracker.track(image)
    return AlignmentFrame(
        image, FULL_SCALE_DN, figures(image, FULL_SCALE_DN), spot, crosshair_px, CameraSettings()
    )


def spot_at(x_px: float, y_px: float, peak_dn: float) -> np.ndarray:
    y, x = np.indices(SHAPE)
    light = peak_dn * np.exp(-0.5 * (((x - x_px) / 9.0) ** 2 + ((y - y_px) / 6.0) ** 2))
    noise = np.random.default_rng(3).normal(8.0, 1.5, SHAPE)
    return np.clip(np.rint(light + noise), 0, FULL_SCALE_DN).astype(np.uint8)


def coloured(picture: np.ndarray, colour: str) -> np.ndarray:
    """Rows and columns (n, 2) of the pixels in exactly this colour."""
    return np.argwhere((picture == np.array(palette.rgba(colour)[:3])).all(axis=2))


@pytest.mark.parametrize("shape", [(5, 7), (4, 6)], ids=["odd", "even"])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_background_is_the_median_of_all_pixels(
    kind: type[np.unsignedinteger], shape: tuple[int, int]
) -> None:
    image = np.random.default_rng(5).integers(0, 200, shape).astype(kind)
    assert figures(image, FULL_SCALE_DN).background == np.median(image) / FULL_SCALE_DN


def test_crosshair_ellipse_and_saturation_stand_where_they_are() -> None:
    look = look_at(spot_at(100.0, 250.0, 400.0))
    picture = annotated_picture(look, SHAPE[1], SHAPE[0])
    assert picture.shape == (*SHAPE, 3)
    saturated = coloured(picture, palette.VERMILLION)
    assert len(saturated) == np.count_nonzero(look.image == FULL_SCALE_DN)
    assert saturated.mean(axis=0) == pytest.approx([250.0, 100.0], abs=1.0)
    ellipse = coloured(picture, palette.YELLOW)
    wide, high = np.ptp(ellipse[:, 1]), np.ptp(ellipse[:, 0])
    assert wide == pytest.approx(4 * look.spot.sigma_x_px, abs=3)
    assert high == pytest.approx(4 * look.spot.sigma_y_px, abs=3)
    cross = coloured(picture, palette.SKY_BLUE)
    assert np.bincount(cross[:, 0]).argmax() == pytest.approx(199.5, abs=1)
    assert np.bincount(cross[:, 1]).argmax() == pytest.approx(149.5, abs=1)


@pytest.mark.parametrize(
    ("below_dn", "ok", "said"),
    [
        (90.0, True, ", 320.0 px"),
        (0.0, False, "below row 260"),
        (900.0, False, "weaken the reference's beam"),
    ],
)
def test_the_reference_is_a_second_spot_with_a_lamp_of_its_own(below_dn: float, ok: bool, said: str) -> None:
    """The pendulum's spot is found although the reference's is the brighter one."""
    image = np.maximum(spot_at(100.0, 200.0, 60.0), spot_at(210.0, 320.0, below_dn))
    model = SensorModel(gain_e_per_dn=2.4, read_noise_e=7.0, full_scale_dn=FULL_SCALE_DN)
    # the spot is as bright as the preflight of this rig allows, and no brighter
    limits = PreflightSettings(min_peak_fraction=0.02, max_peak_fraction=0.3)
    pipeline = Pipeline(Optics(model, None, Axes(), reference_row=260), image.shape)
    look = take_look(Frame(image, 0, 0, 0), FULL_SCALE_DN, pipeline, None, CameraSettings(), limits)
    assert (look.spot.x_px, look.spot.y_px) == pytest.approx((100.0, 200.0), abs=0.5)
    lamps = {one.name: one for one in look.lamps()}
    # what is wrong with the reference is none of the pendulum's spot
    assert lamps["saturated"].ok
    assert (lamps["peak"].ok, lamps["peak"].limit) == (True, "2 to 30 %")
    # the middle and the shorter side of the pendulum's part, which is wider than high
    assert look.crosshair_px == (149.5, 129.5)
    assert lamps["centring"].limit == "26 px"
    assert dict(look.rows())["nearest edge"] == "59 px"
    assert lamps["reference"].ok is ok
    assert said in lamps["reference"].line
    drawn = coloured(annotated_picture(look, SHAPE[1], SHAPE[0]), palette.BLUISH_GREEN)
    assert np.bincount(drawn[:, 0]).argmax() == pytest.approx(259.5, abs=1)
    ellipse = drawn[drawn[:, 0] > 262]
    assert (len(ellipse) > 0) is (below_dn > 0.0)
    if below_dn:
        assert ellipse.mean(axis=0) == pytest.approx([320.0, 210.0], abs=4.0)


def test_each_coordinate_of_the_crosshair_is_the_levers_if_it_states_one_else_the_middle() -> None:
    lever = Lever(arm_m=1.0, pixel_pitch_m=5e-6, reference_x_px=10.0)
    assert reference_px(lever, (100, 200)) == (10.0, 49.5)
    assert reference_px(None, (100, 200)) == (99.5, 49.5)


def test_a_saturated_pixel_stays_visible_in_a_small_picture() -> None:
    image = np.full(SHAPE, 10, dtype=np.uint8)
    image[17, 33] = FULL_SCALE_DN
    small = annotated_picture(look_at(image), 30, 40)
    assert small.shape == (40, 30, 3)
    assert coloured(small, palette.VERMILLION).tolist() == [[1, 3]]


def test_zoomed_in_the_spot_is_in_the_middle() -> None:
    picture = annotated_picture(look_at(spot_at(100.0, 250.0, 150.0)), 300, 400, zoom=4.0)
    ellipse = coloured(picture, palette.YELLOW)
    assert ellipse.mean(axis=0) == pytest.approx([200.0, 150.0], abs=6.0)


def test_a_spot_off_the_crosshair_is_a_matter_where_it_has_no_room() -> None:
    for x_px, remedy in ((150.0, False), (60.0, False), (28.0, True)):
        lamps = {one.name: one for one in look_at(spot_at(x_px, 200.0, 150.0)).lamps()}
        assert bool(lamps["centring"].remedy) is remedy


def test_words_say_where_the_spot_is_and_what_is_wrong() -> None:
    bright, clean, none = (
        dict(look_at(image).rows())
        for image in (
            spot_at(100.0, 250.0, 400.0),
            spot_at(100.0, 250.0, 150.0),
            np.full(SHAPE, 10, np.uint8),
        )
    )
    assert re.fullmatch(r"\d+ px", bright["saturated"])
    assert bright["off the crosshair"] == "−49.5, +50.5 px"
    assert bright["nearest edge"] == "100 px"
    assert "saturated" in bright["fit"]
    assert clean["saturated"] == "none"
    assert "a clean spot" in clean["fit"]
    assert none["spot"] == "none found"
    assert "sigma" not in none


@pytest.fixture
def config() -> Configuration:
    keys = ["simulation.sensor.width_px=160", "simulation.sensor.height_px=640", "camera.exposure_us=100"]
    return load_configuration(CONFIGS / "demo.toml", keys)


def test_a_setting_that_the_camera_does_not_report_is_not_stepped(config: Configuration) -> None:
    with Devices(config) as devices, devices.camera(config) as opened:
        unknown = opened._replace(applied=opened.applied.model_copy(update={"gain_db": None}))
        picture = LivePicture(config, devices)
        refused = picture.press("G")
        picture.press("q")
        picture.show(unknown)
        assert refused.result(0) == "the gain: this camera does not report its setting: state a value"
        assert opened.camera.configure(CameraSettings()).gain_db == opened.applied.gain_db


def test_keys_set_the_camera_and_its_figures_are_shown(
    config: Configuration, capsys: pytest.CaptureFixture[str]
) -> None:
    with Devices(config) as devices, devices.camera(config) as opened:
        picture = LivePicture(config, devices)
        for key in "EEeq":
            picture.press(key)
        picture.show(opened)
        assert opened.camera.configure(CameraSettings()).exposure_us == pytest.approx(100 * 1.25, rel=0.01)
        LivePicture(config, devices).show(opened, seconds=0.1)
    # 69 % before
    assert re.search(r"^peak +8[4-7]\.\d %, background", capsys.readouterr().out)


def test_a_search_of_the_exposure_that_fails_leaves_the_settings_of_the_camera_known(
    config: Configuration,
) -> None:
    optics = config.simulation.optics.model_copy(update={"peak_dn": 0.0})
    dark = config.model_copy(update={"simulation": config.simulation.model_copy(update={"optics": optics})})
    with Devices(dark) as devices, devices.camera(dark) as opened:
        picture = LivePicture(dark, devices)
        search = picture.press("a")
        picture.show(opened, seconds=0.1)
        assert "the peak stays" in search.result(0)
        present = opened.camera.configure(CameraSettings())
        assert present.exposure_us != opened.applied.exposure_us
        assert picture.news.news()["camera"]["applied"] == present.model_dump(exclude_none=True)


@pytest.mark.parametrize(("fails", "said"), [(True, "the sensor is gone"), (False, "its last frame")])
def test_a_camera_that_ends_ends_the_picture_with_its_reason(
    config: Configuration, monkeypatch: pytest.MonkeyPatch, fails: bool, said: str
) -> None:
    usual, reads = SimulatedCamera.read, iter(range(5))

    def read(camera: SimulatedCamera, timeout_s: float) -> Frame | None:
        if next(reads, None) is not None:
            return usual(camera, timeout_s)
        if fails:
            raise DeviceError("the sensor is gone")
        return None

    monkeypatch.setattr(SimulatedCamera, "read", read)
    with Devices(config) as devices, devices.camera(config) as opened, pytest.raises(DeviceError, match=said):
        LivePicture(config, devices).show(opened)


def test_the_newest_of_the_frames_that_have_come_is_shown(
    config: Configuration, monkeypatch: pytest.MonkeyPatch
) -> None:
    came, shown = list[list[Frame]](), list[Frame]()
    take = FrameStream.take
    monkeypatch.setattr(FrameStream, "take", lambda *words: came.append(take(*words)) or came[-1])
    monkeypatch.setattr(aligning, "take_look", lambda *words: shown.append(words[0]) or take_look(*words))
    with Devices(config) as devices, devices.camera(config) as opened:
        LivePicture(config, devices).show(opened, seconds=0.5)
    blocks = [frames for frames in came if frames]
    assert max(map(len, blocks)) > 1
    assert all(frame is frames[-1] for frame, frames in zip(shown, blocks, strict=True))


def test_it_ends_with_the_program_that_reads_its_lines(
    config: Configuration, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the live picture of a desk that was killed: it would keep camera, laser and port."""
    reads, writes = os.pipe()
    os.close(reads)
    with suppress(BrokenPipeError), os.fdopen(writes, "w") as lines, Devices(config) as devices:
        monkeypatch.setattr(sys, "stdout", lines)
        with devices.camera(config) as opened, pytest.raises(SystemExit):
            LivePicture(config, devices).show(opened)
