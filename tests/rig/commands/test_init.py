"""`rig init`: the answers become a configuration that loads, or an example does; nothing is left."""

import os
import tomllib
from pathlib import Path

import pytest

from acquisition.camera import PluggedCamera
from processing.errors import ConfigurationError
from rig.commands.init import ask
from rig.settings import (
    copy_shipped,
    load_configuration,
    read_quantity,
    shipped,
    shipped_names,
    write_configuration,
)
from tests.rig.command_line import rig

PORTS = (("/dev/ttyACM0", "Pico"), ("/dev/ttyUSB0", "laser"))
PLUGGED = [
    PluggedCamera("usb3vision", "Daheng MER", "KE01", "SuperSpeed"),
    PluggedCamera("usb3vision", "Daheng MER", "KE02", "SuperSpeed"),
    PluggedCamera("v4l2", "Webcam", "", "/dev/video0"),
    PluggedCamera("v4l2", "Webcam", "", "/dev/video2"),
]


def asked(monkeypatch: pytest.MonkeyPatch, *texts: str) -> dict[str, object]:
    typed = iter(texts)
    monkeypatch.setattr("builtins.input", lambda _="": next(typed))
    found = ask(PLUGGED, PORTS)
    assert next(typed, None) is None, "every answer was asked for"
    return found


def test_a_real_rig_with_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stated = asked(
        monkeypatch,
        "2",
        "/dev/ttyACM0",
        "thorlabs4000",
        "2",
        "(1 ± 0.001) m",
        "4.8 um ± 1 nm",
        "steel on K8",
        "data",
    )
    path = tmp_path / "mine.toml"
    config = write_configuration(path, stated)
    assert (config.camera.driver, config.camera.serial) == ("usb3vision", "KE02")
    assert (config.controller.kind, config.controller.port) == ("serial", "/dev/ttyACM0")
    assert (config.laser.kind, config.laser.port) == ("thorlabs4000", "/dev/ttyUSB0")
    assert (config.laser.max_current_a, config.laser.current_a) == (0.0, 0.0), "dark until a limit is stated"
    assert config.lever is not None
    assert (config.lever.arm_m, config.lever.u_arm_m) == (1.0, 0.001)
    assert (config.lever.pixel_pitch_m, config.lever.u_pixel_pitch_m) == (4.8e-6, 1e-9)
    assert (config.session.sample, config.session.output) == ("steel on K8", Path("data"))
    text = path.read_text(encoding="utf-8")
    assert "# [record]" in text, "other keys are there to be uncommented"
    assert "[simulation" not in text
    uncommented = [line.partition("=")[0] for line in text.splitlines() if line and line[0] not in "#["]
    assert len(uncommented) == 1 + len(stated)  # of the schema
    with pytest.raises(ConfigurationError, match="exists already"):
        write_configuration(path, stated)


@pytest.mark.parametrize(
    ("question", "wrong", "said"),
    [
        ("Distance from mirror", "0", "lever.arm_m = 0.0: should be greater than 0 m"),
        ("Distance from mirror", "4 kg", "has the unit kg; m is meant"),
        ("Distance from mirror", "0,406", "with a point: 0.406"),
        ("Distance from mirror", "1 ± -1", "u_arm_m = -1.0: should be at least 0"),
        ("Distance of neighbouring pixels", "4.8", "lever.pixel_pitch_m = 4.8: should be less than 0.001 m"),
    ],
)
def test_every_answer_is_held_against_the_models(
    monkeypatch: pytest.MonkeyPatch, question: str, wrong: str, said: str
) -> None:
    before = ["1", "none", "none", *(["1"] if "pixels" in question else [])]
    with pytest.raises(ConfigurationError, match=f"^{question}") as caught:
        asked(monkeypatch, *before, wrong)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_cameras_of_one_driver_without_serial_numbers_differ_by_their_device(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stated = asked(monkeypatch, "4", "none", "none", "", "", "")
    assert stated == {"camera.driver": "v4l2", "camera.v4l2.device": "/dev/video2", "session.output": "runs"}


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
    assert {given: read_quantity(*given) for given in read} == read


def test_the_command_writes_a_file_that_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = "acquisition.cameras.drivers.find_cameras"
    monkeypatch.setattr(found, lambda: ((), ("x cameras were not looked for: y is missing",)))
    done = rig("init", "mine.toml", cwd=tmp_path, typed="simulated\nsteel\n\n")
    assert done.returncode == 0, done.stderr
    assert done.stdout == "mine.toml\n"
    assert done.stderr.startswith("A configuration for your rig."), "the first words are the first question's"
    assert "x cameras were not looked for" not in done.stderr
    assert "edit mine.toml: [pendulum]" in done.stderr
    assert "rig run mine.toml -o runs/mine" in done.stderr
    config = load_configuration(tmp_path / "mine.toml")
    assert config.simulated
    assert config.session.sample == "steel"
    assert rig("doctor", "mine.toml", cwd=tmp_path).returncode == 0
    again = rig("init", "mine.toml", cwd=tmp_path)
    assert (again.returncode, again.stdout) == (2, "")
    assert again.stderr == "rig: mine.toml: exists already and is not overwritten; choose another name\n"


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("simulated\n", "the answers end at: Ball and flat"),
        ("torch\n", "'torch': choose one of"),
        ("20\n", "'20': choose one of"),
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
        terminal.press("torch\n")
        terminal.wait_for("choose one of")
        terminal.press("simulated\n")
        terminal.wait_for("Ball and flat")
        terminal.process.send_signal(2)
        # a signal that comes between the prompt and the waiting is seen with the next key
        terminal.press("\n")
        terminal.end()
        assert terminal.process.returncode == 130
        assert list(tmp_path.iterdir()) == []
    finally:
        terminal.close()


def test_the_file_shows_every_key_of_such_a_rig_once(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    write_configuration(path, {"camera.driver": "simulated"})
    text = path.read_text(encoding="utf-8")
    tables = [line for line in text.splitlines() if line.startswith(("# [", "["))]
    assert len(tables) == len(set(tables))
    assert "[simulation.contact]" in text
    assert tomllib.loads(text)["camera"] == {"driver": "simulated"}


ROOT = Path(__file__).parents[3]


def test_every_configuration_of_the_repository_is_shipped_by_its_name() -> None:
    assert shipped_names() == sorted(path.stem for path in (ROOT / "configs").glob("*.toml"))
    assert shipped("demo").read_bytes() == (ROOT / "configs" / "demo.toml").read_bytes()


@pytest.mark.parametrize("name", sorted(set(shipped_names()) - {"rig-example"}))
def test_a_copy_is_the_same_configuration(name: str, tmp_path: Path) -> None:
    written = copy_shipped(name, tmp_path / "mine.toml")
    assert written[0] == tmp_path / "mine.toml"
    assert load_configuration(tmp_path / "mine.toml") == load_configuration(shipped(name))
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in written}


def test_what_is_there_stays(tmp_path: Path) -> None:
    assert rig("init", "--example", "basement", cwd=tmp_path).stdout == "basement.toml\ndemo.toml\n"
    # vault.toml extends both, which lie there as they are
    assert rig("init", "--example", "vault", cwd=tmp_path).stdout == "vault.toml\n"
    (tmp_path / "demo.toml").write_text("# mine")
    done = rig("init", "other.toml", "--example", "basement", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("rig: demo.toml: exists already and is not overwritten")
    assert not (tmp_path / "other.toml").exists()


def test_an_example_that_does_not_exist(tmp_path: Path) -> None:
    done = rig("init", "--example", "cellar", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == (
        f"rig: example cellar: there is no such configuration; there are {', '.join(shipped_names())}\n"
    )
    assert not list(tmp_path.iterdir())
