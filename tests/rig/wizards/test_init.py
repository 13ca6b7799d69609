"""`rig init`: the answers become a configuration that loads; nothing is written before the last."""

import os
import shlex
import tomllib
from pathlib import Path

import cv2
import pytest

from acquisition.camera import PluggedCamera
from processing.angle import ARCSEC_RAD
from processing.errors import ConfigurationError, RigError
from rig.analysis import read_results
from rig.settings import load_configuration, quantity
from rig.wizards import (
    Draft,
    FirstConfiguration,
    answered,
    ask_in_terminal,
    progress,
    stated_keys,
    write_configuration,
)
from tests.acquisition.cameras.made_films import Film, write_film
from tests.rig.analysis.test_table_laws import swings
from tests.rig.command_line import rig
from tests.rig.intake.test_film_positions import PERIOD_S, swing

PORTS = (("/dev/ttyACM0", "Pico"), ("/dev/ttyUSB0", "laser"))
PLUGGED = [
    PluggedCamera("usb3vision", "Daheng MER", "KE01", "SuperSpeed"),
    PluggedCamera("usb3vision", "Daheng MER", "KE02", "SuperSpeed"),
    PluggedCamera("v4l2", "Webcam", "", "/dev/video0"),
    PluggedCamera("v4l2", "Webcam", "", "/dev/video2"),
]
SIMULATED = ["simulated", "406 g ± 0.1 g", "6.05 mm +- 1 um", "", "", "4.07", "", "a person", ""]


def draft_of(wizard: FirstConfiguration, *texts: str) -> Draft:
    draft = Draft()
    for text in texts:
        draft = answered(wizard, draft, text)
    return draft


def test_a_real_rig_with_everything(tmp_path: Path) -> None:
    wizard = FirstConfiguration(PLUGGED, PORTS)
    answers = ["2", "0.406 ± 0.0001", "6.05 mm", "my_ball", "211 GPa ± 3 GPa", "0.28", "my_ball", "4.07"]
    answers += ["(1 ± 0.001) m", "4.8 um ± 1 nm", "steel on K8", "A. Person", "", "/dev/ttyACM0"]
    answers += ["thorlabs4000", "2", "80 mA", "60 mA", "", "640 x 320 at 8,16", "starter"]
    done = progress(wizard, draft_of(wizard, *answers))
    assert done.question is None
    path = tmp_path / "mine.toml"
    config = write_configuration(path, stated_keys(done.values))
    assert (config.camera.driver, config.camera.serial) == ("usb3vision", "KE02")
    assert config.pendulum is not None
    assert (config.pendulum.mass_kg, config.pendulum.u_mass_kg) == (0.406, 0.0001)
    assert (config.pendulum.ball_radius_m, config.pendulum.u_ball_radius_m) == (6.05e-3, 0.0)
    assert config.pendulum.ball_material == config.pendulum.flat_material == "my_ball"
    assert config.materials["my_ball"].u_youngs_modulus_pa == 3e9
    assert config.lever is not None
    assert (config.lever.u_arm_m, config.lever.u_pixel_pitch_m) == (0.001, 1e-9)
    assert (config.controller.kind, config.controller.port) == ("serial", "/dev/ttyACM0")
    assert (config.laser.kind, config.laser.port) == ("thorlabs4000", "/dev/ttyUSB0")
    assert (config.laser.max_current_a, config.laser.current_a) == (0.08, 0.06)
    assert config.laser.interlock == "controller"
    camera = config.camera
    assert (camera.width_px, camera.height_px, camera.offset_x_px, camera.offset_y_px) == (640, 320, 8, 16)
    assert config.start.way == "starter"
    text = path.read_text(encoding="utf-8")
    assert "# [record]" in text, "other keys are there to be uncommented"
    assert "[simulation" not in text
    uncommented = [line.partition("=")[0] for line in text.splitlines() if line and line[0] not in "#["]
    assert len(uncommented) == 1 + len(stated_keys(done.values))  # of the schema
    with pytest.raises(ConfigurationError, match="exists already"):
        write_configuration(path, stated_keys(done.values))


def test_every_answer_is_held_against_the_models() -> None:
    wizard = FirstConfiguration(PLUGGED, PORTS)
    good = ["1", "0.406", "6.05 mm", "", "", "", "1", "4.8 um", "", "", "", "/dev/ttyACM0", "controller"]
    refused = {
        0: {"10": "choose one of", "nothing": "choose one of"},
        1: {
            "": "an answer is needed",
            "0,406": "with a point: 0.406",
            "heavy": "should be a number",
            "-1": "greater than 0 kg",
            "406": "less than 100 kg",
            "406 m": "has the unit m; kg is meant",
            "1e999": "finite",
            "0.4 ± -1": "u_mass_kg = -1.0: should be at least 0",
        },
        2: {"2 m": "pendulum.ball_radius_m = 2.0: should be less than 1 m"},
        3: {"hard steel": "a name of letters", "a.b": "a name of letters"},
        5: {"-4": "0.1 s or more", "4 m": "has the unit m; s is meant", "4 ± 1": "the number alone"},
        6: {"0": "lever.arm_m = 0.0: should be greater than 0 m"},
        7: {"4.8": "lever.pixel_pitch_m = 4.8: should be less than 0.001 m"},
        12: {"torch": "choose one of"},
    }
    for place, wrong in refused.items():
        draft = draft_of(wizard, *good[:place])
        for text, said in wrong.items():
            if not said:
                continue
            with pytest.raises(RigError) as caught:
                answered(wizard, draft, text)
            assert said in str(caught.value), (place, text)
            assert "\n" not in str(caught.value)
    limited = draft_of(wizard, *good, "1 mW")
    with pytest.raises(ConfigurationError, match=r"power_w 0\.002 is above max_power_w 0\.001"):
        answered(wizard, limited, "2 mW")
    lit = answered(wizard, limited, "0.5 mW")
    for text in ("640", "0 x 320", "640 x 320 px", "a x b"):
        with pytest.raises(ConfigurationError, match=r"width x height in px|camera\.width_px = 0"):
            answered(wizard, lit, text)
    whole = answered(wizard, lit, "")
    assert progress(wizard, answered(wizard, whole, "")).question is None
    assert stated_keys(progress(wizard, answered(wizard, whole, "")).values)["start.way"] == "at once"


def test_without_a_controller_none_starts_the_run() -> None:
    wizard = FirstConfiguration(PLUGGED, PORTS)
    by_hand = draft_of(wizard, "1", "0.406", "6.05 mm", "", "", "", "", "", "", "", "none", "none", "")
    with pytest.raises(ConfigurationError, match="choose one of at once, by hand"):
        answered(wizard, by_hand, "magnet")


def test_the_first_that_is_said_is_the_first_question(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = "acquisition.cameras.drivers.find_cameras"
    monkeypatch.setattr(found, lambda: ((), ("x cameras were not looked for: y is missing",)))
    lines = rig("init", "mine.toml", cwd=tmp_path).stderr.splitlines()
    assert lines[0].startswith("A configuration for your rig.")
    assert not any("not looked for" in line for line in lines)
    assert "x cameras were not looked for" in rig("devices").stdout


def test_two_cameras_of_one_driver_without_serial_numbers_differ_by_their_device() -> None:
    wizard = FirstConfiguration(PLUGGED)
    keys = stated_keys(progress(wizard, draft_of(wizard, "4")).values)
    assert keys == {"camera.driver": "v4l2", "camera.v4l2.device": "/dev/video2"}


def test_quantities_are_read_as_they_are_written() -> None:
    read = {
        ("6.05 mm ± 1 um", "m"): (6.05e-3, 1e-6),
        ("(6.05 ± 0.001) mm", "m"): (6.05e-3, 1e-6),
        ("6.05e-3", "m"): (6.05e-3, None),
        ("406g+/-0.1", "kg"): (0.406, 1e-4),
        ("2 deg", "rad"): (0.03490658503988659, None),
        ("82 GPa", "Pa"): (8.2e10, None),
        ("-3.5", ""): (-3.5, None),
    }
    assert {given: quantity(*given) for given in read} == read


def test_the_command_writes_a_file_that_runs(tmp_path: Path) -> None:
    done = rig("init", "mine.toml", cwd=tmp_path, typed="\n".join(SIMULATED) + "\n")
    assert done.returncode == 0, done.stderr
    assert done.stdout == "mine.toml\n"
    assert "rig run mine.toml -o runs/mine" in done.stderr
    config = load_configuration(tmp_path / "mine.toml")
    assert config.simulated
    assert config.session.operator == "a person"
    assert config.balance.seconds == 14.0
    assert rig("doctor", "mine.toml", cwd=tmp_path).returncode == 0
    again = rig("init", "mine.toml", cwd=tmp_path)
    assert (again.returncode, again.stdout) == (2, "")
    assert again.stderr == "rig: mine.toml: exists already and is not overwritten; choose another name\n"


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("simulated\n", "the answers end at: Mass of the pendulum"),
        ("simulated\nheavy\n", "'heavy': should be a number"),
        ("", "the answers end at: Which camera:"),
    ],
)
def test_without_a_terminal_a_wrong_or_missing_answer_ends_it(tmp_path: Path, typed: str, said: str) -> None:
    done = rig("init", "mine.toml", cwd=tmp_path, typed=typed)
    assert done.returncode == 2
    assert said in done.stderr.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["mine.txt", "nowhere/mine.toml"])
def test_a_name_that_cannot_be_written_is_refused_before_anything_is_asked(tmp_path: Path, name: str) -> None:
    done = rig("init", name, cwd=tmp_path)
    assert done.returncode == 2
    assert name in done.stderr
    assert "Which camera" not in done.stderr


def test_what_contradicts_leaves_no_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    with pytest.raises(ConfigurationError):
        write_configuration(path, {"camera.driver": "simulated", "session.final_amplitude_arcsec": 500.0})
    assert not path.exists()


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals are those of POSIX")
def test_at_a_terminal_wrong_answers_are_asked_again_and_ctrl_c_leaves_nothing(tmp_path: Path) -> None:
    from tests.rig.pseudo_terminal import Terminal

    terminal = Terminal("init", "mine.toml", cwd=tmp_path, on_screen=True)
    try:
        terminal.wait_for("Which camera: ")
        terminal.press("simulated\n")
        terminal.wait_for("Mass of the pendulum")
        terminal.press("0,406\n")
        terminal.wait_for(r"with a point: 0\.406")
        terminal.press("<\n")
        terminal.wait_for("Which camera: ")
        terminal.press("simulated\n")
        terminal.wait_for("Mass of the pendulum")
        terminal.process.send_signal(2)
        # a signal that comes between the prompt and the waiting is seen with the next key
        terminal.press("\n")
        terminal.end()
        assert terminal.process.returncode == 130
        assert list(tmp_path.iterdir()) == []
    finally:
        terminal.close()


def test_back_goes_one_question_back(monkeypatch: pytest.MonkeyPatch) -> None:
    typed = iter(["simulated", "0.4", "<", "0.406", *SIMULATED[2:]])
    monkeypatch.setattr("builtins.input", lambda _="": next(typed))
    wizard = FirstConfiguration()
    done = progress(wizard, ask_in_terminal(wizard))
    assert stated_keys(done.values)["pendulum.mass_kg"] == 0.406


def test_the_file_shows_every_key_of_such_a_rig_once(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    write_configuration(path, {"camera.driver": "simulated"})
    text = path.read_text(encoding="utf-8")
    whole = "\n".join(
        line.removeprefix("# ") if " = " in line and "<" not in line.partition(" #")[0] else line
        for line in text.splitlines()
    )
    # every key, uncommented, is one that the models know; sections without keys above them are tables
    tables = [line for line in text.splitlines() if line.startswith(("# [", "["))]
    assert len(tables) == len(set(tables))
    assert "[simulation.contact]" in text
    assert tomllib.loads(text)["camera"] == {"driver": "simulated"}
    assert whole.count("max_duration_s") == 2


def commands_of(done: str) -> list[list[str]]:
    """The commands that are named as next steps, without what stands behind the colon."""
    steps = [line.strip() for line in done.partition("next:\n")[2].splitlines()]
    return [shlex.split(step.rpartition(": ")[0])[1:] for step in steps if step]


def test_from_images_to_a_configuration_with_which_all_that_is_named_runs(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    for k, picture in enumerate(swing(count=450)):
        cv2.imwrite(str(tmp_path / "frames" / f"f{k:04d}.png"), picture)
    typed = ["files", "frames", "30", "406 g", "6.05 mm", "", "", "1 m ± 1 mm", "4.8 um", "left and right"]
    done = rig("init", "mine.toml", cwd=tmp_path, typed="\n".join(typed) + "\n")
    assert done.returncode == 0, done.stderr
    config = load_configuration(tmp_path / "mine.toml")
    assert config.camera.driver == "files"
    commands = commands_of(done.stderr)
    assert [words[0] for words in commands] == ["video", "video", "run"]
    for words in commands:
        ran = rig(*words, cwd=tmp_path)
        assert ran.returncode == 0, ran.stderr
        (run,) = read_results(tmp_path / words[words.index("-o") + 1]).runs
        assert abs(run.period_s.value - PERIOD_S) < 4 * run.period_s.standard_uncertainty < 0.01
    # the scale of the lever is that of the pixel
    amplitudes = [
        read_results(tmp_path / words[words.index("-o") + 1]).runs[0].initial_amplitude for words in commands
    ]
    assert amplitudes[1] == pytest.approx(amplitudes[0] * 4.8e-6 / 2.0 / ARCSEC_RAD, rel=1e-6)


def test_a_film_alone_needs_no_further_answer(tmp_path: Path) -> None:
    write_film(tmp_path / "my swing.mkv", swing(count=30), Film())
    done = rig("init", "mine.toml", cwd=tmp_path, typed="files\nmy swing.mkv\n\n\n")
    assert done.returncode == 0, done.stderr
    assert commands_of(done.stderr) == [["video", "my swing.mkv", "-o", "runs/mine"]]
    assert load_configuration(tmp_path / "mine.toml").pendulum is None


def test_a_table_needs_the_pendulum_alone(tmp_path: Path) -> None:
    swings(tmp_path / "decay.csv")
    done = rig("init", "mine.toml", cwd=tmp_path, typed="table\ndecay.csv\n406 g\n6.05 mm\n\n\n")
    assert done.returncode == 0, done.stderr
    (words,) = commands_of(done.stderr)
    ran = rig(*words, cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert "exact" in read_results(tmp_path / "runs" / "mine").runs[0].fits


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("files\nnowhere.mp4\n", "nowhere.mp4: no such file or folder here"),
        ("files\nnotes.txt\n", "notes.txt: cannot be read as a video"),
        ("table\nnowhere.csv\n", "nowhere.csv: no such file here"),
    ],
)
def test_a_file_that_is_none_is_asked_for_again(tmp_path: Path, typed: str, said: str) -> None:
    (tmp_path / "notes.txt").write_text("a note")
    done = rig("init", "mine.toml", cwd=tmp_path, typed=typed)
    assert done.returncode == 2
    assert said in done.stderr
    assert not (tmp_path / "mine.toml").exists()
