"""Configuration files: inheritance, overrides, conditions to stop; messages about faulty keys and values."""

import re
from pathlib import Path

import pytest

from processing.errors import ConfigurationError
from processing.estimate import Estimate
from rig.instrument import check_materials, complete, pendulum_on_ball
from rig.settings import FITTED, REPLAYED, Configuration, load_configuration, refuse_without_effect
from tests.rig.command_line import CONFIGS
from tests.rig.settings.example_configuration import TARGET, keys, text


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.toml")), ids=lambda path: path.name)
def test_every_configuration_that_is_shipped_loads(path: Path) -> None:
    config = complete(load_configuration(path))
    check_materials(config)


def test_extends_states_only_what_differs() -> None:
    demo = load_configuration(CONFIGS / "demo.toml")
    silicon = load_configuration(CONFIGS / "silicon.toml")
    assert silicon.session.final_amplitude_arcsec == demo.session.final_amplitude_arcsec
    assert silicon.simulation.contact.gamma_pa == 290.69e6
    assert silicon.session.runs == 3


def test_overrides_take_any_dotted_path() -> None:
    config = load_configuration(
        CONFIGS / "demo.toml",
        [
            "simulation.contact.b=1e-3",
            "session.operator=A. Nother",
            "record.windows=false",
            'session.sample="x = 1"',
        ],
    )
    assert config.simulation.contact.b == 1e-3
    assert config.session.operator == "A. Nother"
    assert config.record.windows is False
    assert config.session.sample == "x = 1"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("session.rnus=3", r"session\.rnus: unknown key; did you mean runs\?"),
        ("camera.fps=50", r"camera\.fps: unknown key; did you mean frame_rate_hz\?"),
        ("sesion.runs=3", r"sesion: unknown key; did you mean session\?"),
        ("simulation.contact.bb=3", r"simulation\.contact\.bb: unknown key; did you mean b\?"),
        ("camera.exposure_us=-3", r"camera\.exposure_us = -3: should be greater than 0"),
        ("balance.rest_arcsec=-1", r"balance\.rest_arcsec = -1: should be greater than 0"),
        ("balance.rst_arcsec=1", r"balance\.rst_arcsec: unknown key; did you mean rest_arcsec\?"),
        ("balance.weight_x.mas_kg=1", r"balance\.weight_x\.mas_kg: unknown key; did you mean mass_kg\?"),
        ("materials.tin.poisson_ratio=2", r"materials\.tin\.youngs_modulus_pa: is missing; state a value"),
        (
            "sensor={gain_e_per_dn=1, read_noise_e=-1, full_scale_dn=255}",
            r"sensor\.read_noise_e = -1: should be at least 0",
        ),
        (
            "sensor={gain_e_per_dn=1, read_noise_e=1, full_scale_dn=255, predestal_dn=3}",
            r"sensor\.predestal_dn: unknown key; did you mean pedestal_dn\?",
        ),
        ("session.runs=many", r"session\.runs = 'many': should be a whole number"),
        ("session.final_amplitude_arcsec=500", "must be below session.initial_amplitude_arcsec = 124"),
        (
            "simulation.contact.balls=2",
            r"--set simulation\.contact\.balls = 2 with instrument\.kind = 'single_ball', .* on 1:",
        ),
        (
            "instrument.kind=two_ball",
            r"--set instrument\.kind=two_ball: simulation\.contact\.balls = 1 with .* on 2: .*balls = 2",
        ),
        (
            "session.initial_amplitude_arcsec=1",
            r"--set session\.initial_amplitude_arcsec=1: session\.final_amplitude_arcsec = 2 must be below",
        ),
        ("session.runs", r"--set session\.runs: must read KEY=VALUE"),
        ("session.runs.more=1", r"session\.runs"),
        ("session.runs=true", r"--set session\.runs = true: should be a number"),
        ('camera.exposure_us="80"', r'--set camera\.exposure_us = "80": should be a number, without quotes'),
        ("session.runs=1,5", r"--set session\.runs = '1,5': should be a number, with a point: 1\.5"),
        ("environment.pressure_pa=1013", "should be greater than 10000 Pa"),
        ("simulation.contact.gravity_m_per_s2=981", "should be less than 30 m/s²"),
        ("simulation.contact.period0_s=inf", "should be a finite number"),
    ],
)
def test_a_wrong_setting_is_one_line_that_names_it(override: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_configuration(CONFIGS / "demo.toml", [override])
    assert all(line.startswith(("--set ", str(CONFIGS))) for line in str(caught.value).split("\n"))


@pytest.mark.parametrize("text", ["", "[session]\nruns = 1\n", "[camera]\nexposure_us = 80\n"])
def test_a_camera_that_is_not_named_is_never_the_simulated_one(tmp_path: Path, text: str) -> None:
    path = write(tmp_path / "mine.toml", text)
    with pytest.raises(ConfigurationError) as caught:
        load_configuration(path)
    assert str(caught.value).startswith(
        f"{path}: camera.driver: is missing; state a value: one of simulated, "
    )
    assert "\n" not in str(caught.value)


def test_a_table_needs_no_camera(tmp_path: Path) -> None:
    path = write(tmp_path / "table.toml", "[pendulum]\nmass_kg = 0.4\nball_radius_m = 6e-3\n")
    assert not load_configuration(path, needs_camera=False).simulated


def test_every_fault_has_a_line_and_unknown_keys_come_first() -> None:
    slips = ["pendulum.mas_kg=3", "pendulum.ball_radius_m=true", "session.runs=0"]
    with pytest.raises(ConfigurationError) as caught:
        load_configuration(CONFIGS / "demo.toml", slips)
    why = " (--set pendulum.ball_radius_m states this section)"
    assert str(caught.value).split("\n") == [
        "--set pendulum.mas_kg: unknown key; did you mean mass_kg?",
        "--set session.runs = 0: should be at least 1",
        f"{CONFIGS / 'demo.toml'}: pendulum.mass_kg: is missing; state a value{why}",
        "--set pendulum.ball_radius_m = true: should be a number",
    ]


def test_a_file_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    path = write(tmp_path / "bom.toml", '\ufeff[camera]\ndriver = "simulated"\n')
    assert load_configuration(path).simulated


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[session\n", "is not TOML"),
        (
            "[pendulum]\nball_radius_m = 6.05 mm\n",
            "ball_radius_m is a number alone, in the unit that its name",
        ),
        ('extends = "none.toml"\n', "extends = 'none.toml': no such file in "),
        ("extends = 3\n", "must be the name of a file"),
        ('extends = "self.toml"\n', "extends itself"),
    ],
)
def test_a_wrong_file_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_configuration(write(tmp_path / "self.toml", text))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ("6.05 mm", "should be a number alone, in m: 0.00605"),
        ("6.05 g", "should be a number alone, in m"),
    ],
)
def test_a_unit_in_a_file_is_told_what_number_is_meant(tmp_path: Path, stated: str, said: str) -> None:
    text = f'[camera]\ndriver = "simulated"\n[pendulum]\nmass_kg = 0.4\nball_radius_m = "{stated}"\n'
    with pytest.raises(ConfigurationError) as caught:
        load_configuration(write(tmp_path / "mine.toml", text))
    assert f"pendulum.ball_radius_m = '{stated}': {said}" in str(caught.value)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no such configuration file"):
        load_configuration(tmp_path / "none.toml")
    with pytest.raises(ConfigurationError, match="is a folder"):
        load_configuration(tmp_path)


def test_unknown_material_is_named_before_anything_is_measured() -> None:
    config = load_configuration(
        CONFIGS / "demo.toml",
        ["pendulum.mass_kg=0.4", "pendulum.ball_radius_m=6e-3", "pendulum.flat_material=cheese"],
    )
    with pytest.raises(ConfigurationError, match="cheese"):
        check_materials(config)


def test_the_lever_of_a_simulated_camera_is_that_of_its_region() -> None:
    """Of 320 x 640 pixels, in which the untilted spot lies in the middle unless its place is stated."""
    keys = ["width_px=100", "offset_x_px=40", "height_px=200", "offset_y_px=80", "binning=2"]
    stated = [f"camera.{key}" for key in keys] + ["simulation.optics.reference_y_px=299.5"]
    lever = complete(load_configuration(CONFIGS / "demo.toml", stated)).lever
    assert lever is not None
    assert (lever.reference_x_px, lever.reference_y_px) == (39.5, 69.5)


def test_a_simulated_rig_knows_its_apparatus_and_a_stated_section_wins() -> None:
    config = complete(load_configuration(CONFIGS / "demo.toml", ["simulation.contact.mass_kg=0.5"]))
    assert config.pendulum is not None
    assert config.pendulum.mass_kg == 0.5
    ball = pendulum_on_ball(config)
    assert ball is not None
    # Hertz goes as the cube root of the load: 66.18 um at 0.406 kg, Table 1
    assert ball.contact_radius_m == pytest.approx(66.18e-6 * (0.5 / 0.406) ** (1 / 3), rel=1e-4)
    stated = complete(
        load_configuration(CONFIGS / "demo.toml", ["lever.arm_m=2.0", "lever.pixel_pitch_m=5e-6"])
    )
    assert stated.lever is not None
    assert stated.lever.arm_m == 2.0


def test_a_complete_configuration_survives_the_record() -> None:
    config = complete(load_configuration(CONFIGS / "silicon.toml"))
    assert Configuration.model_validate_json(config.model_dump_json()).model_dump() == config.model_dump()


@pytest.mark.parametrize(
    ("override", "value", "u"),
    [
        ('pendulum.ball_radius_m="6.05 mm ± 1 um"', 0.00605, 1e-6),
        ("pendulum.mass_kg=406g", 0.406, 0.0),
        ('pendulum.gravity_m_per_s2="(9.81 +- 0.01) m/s^2"', 9.81, 0.01),
    ],
)
def test_a_number_may_state_its_unit(tmp_path: Path, override: str, value: float, u: float) -> None:
    file = tmp_path / "rig.toml"
    file.write_text('[camera]\ndriver = "simulated"\n[pendulum]\nmass_kg = 1\nball_radius_m = 0.01\n')
    pendulum = load_configuration(file, [override]).pendulum
    name = override.partition("=")[0].removeprefix("pendulum.")
    assert (getattr(pendulum, name), getattr(pendulum, f"u_{name}")) == (value, u)


@pytest.mark.parametrize(
    ("override", "line"),
    [
        ('pendulum.ball_radius_m="6 kg"', "has the unit kg; m is meant, or mm, um or nm"),
        ('pendulum.ball_radius_m="6 mm ± 1 g"', "has the unit g; m is meant"),
        ('camera.exposure_us="3 yards"', "has the unit yards; us is meant, or ms"),
        ('session.max_duration_s="2 h ± 1 s"', "session.u_max_duration_s: unknown key"),
    ],
)
def test_another_unit_than_the_keys_is_one_line(tmp_path: Path, override: str, line: str) -> None:
    file = tmp_path / "rig.toml"
    file.write_text('[camera]\ndriver = "simulated"\n')
    with pytest.raises(ConfigurationError, match=line) as error:
        load_configuration(file, [override])
    assert str(error.value).startswith("--set ")


def test_a_unit_in_plain_text_is_text(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text('[camera]\ndriver = "simulated"\n')
    assert load_configuration(file, ['session.notes="3 mm"']).session.notes == "3 mm"
    assert load_configuration(file, ['camera.exposure_us="2 ms"']).camera.exposure_us == 2000.0


def test_every_key_without_effect_gets_a_line_and_those_with_one_are_keys() -> None:
    begins = [f"{section}.{name}" for section, names in REPLAYED.items() for name in names]
    assert all(any(key.startswith(one) for key in keys()) for one in begins)
    made_with = [
        "lever.arm_m",
        "lever.skew",
        "axes.mirrored",
        "sensor.prnu",
        "session.runs",
        "shutter.first_row",
    ]
    stated = [f"{key}=1" for key in ("fit.robust", *made_with, "lever.u_arm_m", "pendulum")]
    with pytest.raises(ConfigurationError) as caught:
        refuse_without_effect(stated, FITTED, "try elsewhere")
    assert str(caught.value).split("\n") == [
        f"--set {key}: has no effect here; try elsewhere" for key in made_with
    ]
    with pytest.raises(ConfigurationError, match=r"sensor\.prnu: has .*\n--set session\.runs: has no effect"):
        refuse_without_effect(stated, REPLAYED, "try elsewhere")


def test_conditions_name_parameters_as_people_write_them() -> None:
    texts = '["u(c)/c < 0.03", "u(gamma)/gamma<1e-3", " u( T0 ) / T₀ < .5"]'.replace(" .5", " 0.5")
    config = load_configuration(CONFIGS / "demo.toml", [f"session.stop_when={texts}"])
    found = [(one.parameter, one.limit) for one in config.stop_conditions]
    assert found == [("c", 0.03), ("gamma_pa", 1e-3), ("period0_s", 0.5)]
    condition = config.stop_conditions[0]
    assert condition.text({"c": Estimate(1e-8, 2e-10)}) == "u(c)/c = 0.02 < 0.03"
    assert condition.text({"c": Estimate(-1e-8, 1e-9)}) == "u(c)/c = 0.1 ≥ 0.03"
    assert condition.text({}) == "u(c)/c = ? ≥ 0.03"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("c < 0.03", r"'c < 0\.03' must read u\(NAME\)/NAME < NUMBER, for example u\(c\)/c < 0\.03"),
        ("u(c)/c > 0.03", "must read"),
        ("u(c)/c < 3 %", "must read"),
        ("u(z)/z < 0.1", "no parameter z; known are b, p, c, n, T0, gamma, drag"),
        ("u(c)/b < 0.1", r"'u\(c\)/b < 0\.1' names two parameters; write u\(c\)/c"),
        ("u(c)/c < 3", "3 must lie between 0 and 1, 0.03 for 3 %"),
        ("u(c)/c < 0", "0 must lie between 0 and 1"),
        ("u(c)/c < 1.2.3", r"1\.2\.3 is not a number"),
    ],
)
def test_a_wrong_condition_is_one_line(text: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=rf"session\.stop_when: .*{message}") as caught:
        load_configuration(CONFIGS / "demo.toml", [f'session.stop_when=["{text}"]'])
    assert "\n" not in str(caught.value)


def test_conditions_are_a_list() -> None:
    with pytest.raises(ConfigurationError, match=r"session\.stop_when = 'u\(c\)/c < 0\.03': should be"):
        load_configuration(CONFIGS / "demo.toml", ["session.stop_when=u(c)/c < 0.03"])


def test_a_drag_that_is_not_fitted_ends_no_run() -> None:
    wanted = ['session.stop_when=["u(drag)/drag < 0.1"]']
    assert load_configuration(CONFIGS / "demo.toml", wanted).stop_conditions
    with pytest.raises(ConfigurationError, match=r"session\.stop_when: .*fit\.drag = 'vacuum' fits none"):
        load_configuration(CONFIGS / "demo.toml", [*wanted, "fit.drag=vacuum"])


def test_the_example_is_what_the_models_say() -> None:
    assert TARGET.read_text(encoding="utf-8") == text(), (
        "run: python -m tests.rig.settings.example_configuration"
    )


def test_the_example_loads_as_it_is() -> None:
    config = load_configuration(TARGET)
    assert config.camera.driver == "usb3vision"
    assert config.session.runs == 3


def test_every_key_stands_in_the_example() -> None:
    section = ""
    found = set()
    for line in TARGET.read_text(encoding="utf-8").splitlines():
        if match := re.fullmatch(r"(?:# )?\[+([\w.]+)\]+", line):
            section = match.group(1) + "."
        elif match := re.match(r"(?:# )?(\w+) = ", line):
            found.add(section + match.group(1))
    assert set(keys()) <= found
