"""Digital calibration certificates read as calibrations: of the mass, of the lever."""

import datetime
import hashlib
from pathlib import Path

import pytest

from calibration import parse_certificate
from calibration.store import read_calibration
from processing.errors import ConfigurationError
from rig.calibrate import Filing, calibrate_lever, calibrate_mass
from rig.instrument.calibration import calibration_attachments, fill_from_files, judge_calibration
from rig.settings import Configuration, validate_configuration
from tests.rig.certificates import EXAMPLE, certificate, quantity, real, schema
from tests.rig.command_line import rig

MASS = quantity("Mass", real("406.0", r"\gram", "0.090", "3", "0.9973"), "basic_measuredValue mass_mass")


def in_use(mass_kg: float = 0.4, **files: Path) -> Configuration:
    tree = {
        "camera": {"driver": "usb3vision"},
        "pendulum": {"mass_kg": mass_kg, "ball_radius_m": 0.015},
        "calibration": files,
    }
    return validate_configuration(tree, "test")


def test_what_is_written_here_by_hand_is_a_certificate(shared_data: Path, tmp_path: Path) -> None:
    schema(shared_data).validate(str(certificate(tmp_path / "m.xml", MASS, recalibrate_by="2031-03-01")))


def test_a_mass_fills_the_configuration_with_its_standard_uncertainty(tmp_path: Path) -> None:
    xml = certificate(tmp_path / "m.xml", MASS, recalibrate_by="2031-03-01")
    path = calibrate_mass(xml, Filing(tmp_path / "c", 30))
    found = read_calibration(path, "mass")
    assert found.values == {"mass_kg": pytest.approx(0.406), "u_mass_kg": pytest.approx(3.0e-5, rel=1e-12)}
    assert found.method == "certificate M-2025-17 of A Laboratory"
    assert (found.measured_at.isoformat()[:10], found.valid_until.isoformat()[:10]) == (
        "2025-03-02",
        "2031-03-01",
    )
    config = fill_from_files(in_use(mass=path))
    assert config.pendulum is not None
    assert (config.pendulum.mass_kg, config.pendulum.u_mass_kg) == pytest.approx((0.406, 3.0e-5))
    assert fill_from_files(config) == config, "as a record's configuration is, which has it already"


def test_a_certificate_without_a_date_of_recalibration_ages_as_other_calibrations_do(tmp_path: Path) -> None:
    path = calibrate_mass(certificate(tmp_path / "m.xml", MASS), Filing(tmp_path / "c", 30))
    found = read_calibration(path, "mass")
    assert f"{found.measured_at:%Y-%m-%d} {found.valid_until:%Y-%m-%d}" == "2025-03-02 2025-04-01"
    assert "states no date of recalibration: valid for 30 d from then on" in found.notes
    config = in_use(mass=path)
    for day, warns in (("2025-03-31", False), ("2025-05-01", True)):
        began = datetime.datetime.fromisoformat(f"{day}T00:00:00+00:00")
        tree, warnings = judge_calibration(config, calibration_attachments(config), began, began)
        assert tree["mass"]["validity"] == ("expired" if warns else "valid")
        said = [line for line in warnings if "calibration of the mass had expired on 2025-04-01: " in line]
        assert [line.partition(": ")[2] for line in said] == (
            ["it was measured on 2025-03-02, 60 d before the run"] if warns else []
        )


def test_the_certificate_itself_is_kept_with_the_calibration_and_the_record(tmp_path: Path) -> None:
    xml = certificate(tmp_path / "m.xml", MASS)
    data = xml.read_bytes().replace(b"\n", b"\r\n")
    xml.write_bytes(data)
    path = calibrate_mass(xml, Filing(tmp_path / "c"))
    xml.unlink()
    (source,) = read_calibration(path).sources
    assert source.data() == data
    assert source.sha256 == hashlib.sha256(data).hexdigest()
    config = in_use(mass=path)
    attached = calibration_attachments(config)
    assert attached == {"calibration/mass.toml": path.read_bytes()}
    now = read_calibration(path).made_at
    tree, _ = judge_calibration(config, attached, now, now)
    assert tree["mass"]["sources"] == [{"name": "m.xml", "sha256": source.sha256}]
    text = path.read_text()
    path.write_text(text.replace('content = "', 'content = "AAAA'))
    with pytest.raises(ConfigurationError, match=r"the content of m\.xml is not that of its SHA-256"):
        read_calibration(path)


def test_the_mass_of_another_body_is_refused(tmp_path: Path) -> None:
    path = calibrate_mass(certificate(tmp_path / "m.xml", MASS), Filing(tmp_path / "c"))
    with pytest.raises(ConfigurationError, match=r"pendulum\.mass_kg = 0\.5 is \+23 % off the 0\.406 kg"):
        fill_from_files(in_use(0.5, mass=path))


def test_an_arm_and_a_pitch_make_a_lever(tmp_path: Path) -> None:
    arm = quantity("Distance", real("1000.3", r"\milli\metre", "0.4", "2"))
    pitch = quantity("Pixels", real("4.8", r"\micro\metre", "0.002", "2"))
    path = calibrate_lever(certificate(tmp_path / "l.xml", arm, pitch), Filing(tmp_path / "c"))
    config = fill_from_files(in_use(lever=path))
    assert config.lever is not None
    assert (config.lever.arm_m, config.lever.u_arm_m) == pytest.approx((1.0003, 2e-4))
    assert (config.lever.pixel_pitch_m, config.lever.u_pixel_pitch_m) == pytest.approx((4.8e-6, 1e-9))
    (tmp_path / "lever.toml").write_text('certificate = "arm.xml"\npixel_pitch_m = 3.45e-6\n')
    certificate(tmp_path / "arm.xml", arm)
    found = read_calibration(calibrate_lever(tmp_path / "lever.toml", Filing(tmp_path / "c")))
    assert (found.values["arm_m"], found.values["pixel_pitch_m"]) == pytest.approx((1.0003, 3.45e-6))
    assert [source.name for source in found.sources] == ["lever.toml", "arm.xml"]


@pytest.mark.parametrize(
    ("quantities", "said"),
    [
        (
            [quantity("Length", real("1", r"\metre", "0.1"))],
            "states no mass (in a unit like kg); it has: Length (m)",
        ),
        ([quantity("Mass", real("1", r"\carat", "0.1"))], r"it has: Mass ('\\carat': no unit that is known"),
        (
            [quantity("Mass", real("1", r"\kilogram"))],
            "Mass: states no uncertainty, so it cannot be used as a mass",
        ),
        ([MASS, MASS], "states several numbers that could be the mass: Mass = 406 g; Mass = 406 g"),
        ([quantity("Mass", real("1", r"\kilogram", "0.1", "0"))], "Mass: its coverage factor is 0"),
        ([quantity("Mass", real("one", r"\kilogram", "0.1"))], "Mass: 'one' is not a number"),
        ([], "states no mass (in a unit like kg); it has: no numbers"),
        ([quantity("Mass", real("NaN", r"\gram", "0.1"))], "Mass = nan g is no mass"),
        ([quantity("Mass", real("-406", r"\gram", "0.1"))], "Mass = -406 g is no mass"),
        ([quantity("Mass", real("4_06", r"\gram", "0.1"))], "Mass: '4_06' is not a number"),
        ([quantity("Mass", real("406", r"\gram", "-0.1"))], "Mass = 406 g with an uncertainty of -0.05"),
        ([quantity("Mass", real("406", r"\gram", "INF"))], "Mass = 406 g with an uncertainty of inf"),
        ([quantity("Mass", real("406", r"\gram", "0"))], "Mass: states no uncertainty"),
        ([quantity("Mass", real("406", r"\gram", "0.1", "INF"))], "Mass: its coverage factor is inf"),
        (
            [quantity("Mass", real("406", r"\gram", "0.1", ""))],
            "Mass: its expanded uncertainty has no coverage factor",
        ),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(tmp_path: Path, quantities: list[str], said: str) -> None:
    xml = certificate(tmp_path / "m.xml", *quantities)
    done = rig("calibrate", "mass", xml, "-o", tmp_path / "c")
    assert done.returncode == 2
    assert said in done.stderr
    assert str(xml) in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "c").exists()


def test_a_file_that_is_no_certificate_is_refused(tmp_path: Path) -> None:
    xml = certificate(tmp_path / "m.xml", MASS, schema="2.4.0")
    with pytest.raises(ConfigurationError, match=r"is a certificate of schema 2\.4\.0; 3\.x is read here"):
        calibrate_mass(xml, Filing(tmp_path))
    for text, said in (("<a/>", "is XML of 'a'"), ("<a", "is not XML"), ("", "is not XML")):
        xml.write_text(text)
        with pytest.raises(ConfigurationError, match=said):
            calibrate_mass(xml, Filing(tmp_path))
    certificate(xml, MASS)
    with pytest.raises(ConfigurationError, match="rig calibrate lever, or mass, makes a calibration"):
        fill_from_files(in_use(mass=xml))


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("2025-03-02", "2025-02-30", r"'2025-02-30' \(endPerformanceDate\) is no date"),
        ("2031-03-01", "2031-02-29", r"'2031-02-29' \(date\) is no date"),
        (
            "https://ptb.de/dcc",
            "https://a.example",
            "in the namespace https://a.example, not a digital .*is https://ptb",
        ),
        (
            "https://ptb.de/si",
            "https://a.example",
            "its numbers are in the namespace https://a.example; https://ptb",
        ),
        ("2025-03-02", "2099-03-02", "was calibrated on 2099-03-02, which has not come yet"),
        ("2025-03-01", "2025-03-05", r"ended \(2025-03-02\) before it began \(2025-03-05\)"),
        # k = 1 covers 0.68: u would be three times too large
        ("Factor>3<", "Factor>1<", "coverage factor 1 and its coverage probability 0.9973 do not belong"),
        ("Factor>3<", "Factor>300<", "coverage factor 300 and its coverage probability 0.9973 do not belong"),
        ("Probability>0.9973<", "Probability>95<", "coverage probability is 95; 0.95 is 95 %"),
        (
            "Probability>0.9973<",
            "Probability>0.5<",
            "factor 3 and its coverage probability 0.5 do not",
        ),
        ("?>", '?><!DOCTYPE x [<!ENTITY v "999">]>', r"declares a document type \(x\).*remove the DOCTYPE"),
    ],
)
def test_nothing_is_read_in_place_of_what_it_says(tmp_path: Path, before: str, after: str, said: str) -> None:
    """A day that there is not was the day before it, or none; an entity was a number that stands nowhere."""
    xml = certificate(tmp_path / "m.xml", MASS, recalibrate_by="2031-03-01")
    for encoding in ("utf-8", "utf-16"):
        text = certificate(xml, MASS, recalibrate_by="2031-03-01").read_text().replace(before, after, 1)
        xml.write_bytes(text.replace('"utf-8"', f'"{encoding}"').encode(encoding))
        with pytest.raises(ConfigurationError, match=said):
            calibrate_mass(xml, Filing(tmp_path / "c"))
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize(
    ("k", "probability"),
    [
        ("2", "0.9545"),
        ("1", "0.6827"),
        ("1.645", "0.95"),
        ("1.41", "0.95"),
        ("12.7", "0.95"),
        ("3.18", "0.95"),
    ],
)
def test_factors_of_every_usual_distribution_are_taken(tmp_path: Path, k: str, probability: str) -> None:
    """Normal, rectangular, arcsine, Student of one and of three degrees of freedom."""
    number = real("0.4", r"\kilogram", "0.0004", k, probability)
    xml = certificate(tmp_path / "m.xml", quantity("mass", number))
    found = read_calibration(calibrate_mass(xml, Filing(tmp_path / "c")))
    assert found.values["u_mass_kg"] == 0.0004 / float(k)


def test_the_nominal_value_is_not_taken_for_the_measured_one(tmp_path: Path) -> None:
    nominal = quantity("Nominal", real("400", r"\gram", "5"), "basic_nominalValue")
    conventional = MASS.replace("mass_mass", "mass_conventionalMass")
    path = calibrate_mass(certificate(tmp_path / "m.xml", nominal, conventional), Filing(tmp_path / "c"))
    found = read_calibration(path)
    assert found.values["mass_kg"] == pytest.approx(0.406)
    assert any("a conventional mass" in note for note in found.notes)


def test_uncertainties_of_newer_schemas_and_lists_are_read(tmp_path: Path) -> None:
    newer = quantity(
        "Mass",
        r"<si:hybrid><si:real><si:value>1</si:value><si:unit>\pound</si:unit></si:real>"
        r"<si:real><si:value>0.406</si:value><si:unit>\kilogram</si:unit>"
        "<si:measurementUncertaintyUnivariate><si:expandedMU><si:valueExpandedMU>3e-5</si:valueExpandedMU>"
        "<si:coverageFactor>2</si:coverageFactor><si:coverageProbability>0.95</si:coverageProbability>"
        "</si:expandedMU></si:measurementUncertaintyUnivariate></si:real></si:hybrid>",
    )
    interval = quantity(
        "Mass",
        r"<si:real><si:value>0.406</si:value><si:unit>\kilogram</si:unit><si:coverageInterval>"
        "<si:standardUnc>1.5e-5</si:standardUnc><si:intervalMin>0.4</si:intervalMin>"
        "<si:intervalMax>0.5</si:intervalMax><si:coverageProbability>0.95</si:coverageProbability>"
        "</si:coverageInterval></si:real>",
    )
    listed = quantity(
        "Masses",
        "<si:realListXMLList><si:valueXMLList>0.406 0.1</si:valueXMLList>"
        r"<si:unitXMLList>\kilogram</si:unitXMLList><si:expandedUncXMLList>"
        "<si:uncertaintyXMLList>3e-5 2e-5</si:uncertaintyXMLList>"
        "<si:coverageFactorXMLList>2</si:coverageFactorXMLList>"
        "<si:coverageProbabilityXMLList>0.95</si:coverageProbabilityXMLList></si:expandedUncXMLList>"
        "</si:realListXMLList>",
    )
    intervals = quantity(
        "Masses",
        "<si:realListXMLList><si:valueXMLList>0.3 0.2</si:valueXMLList>"
        r"<si:unitXMLList>\kilogram</si:unitXMLList><si:coverageIntervalXMLList>"
        "<si:standardUncXMLList>1e-5 2e-5</si:standardUncXMLList>"
        "<si:intervalMinXMLList>0 0</si:intervalMinXMLList>"
        "<si:intervalMaxXMLList>1 1</si:intervalMaxXMLList>"
        "<si:coverageProbabilityXMLList>0.95</si:coverageProbabilityXMLList></si:coverageIntervalXMLList>"
        "</si:realListXMLList>",
    )
    path = certificate(tmp_path / "m.xml", newer, interval, f"<dcc:list>{listed}{intervals}</dcc:list>")
    found = parse_certificate(path.read_bytes(), "m.xml")
    assert [(each.value, each.unit, each.u) for each in found.quantities] == [
        (0.406, "kg", 1.5e-5),
        (0.406, "kg", 1.5e-5),
        (0.406, "kg", 1.5e-5),
        (0.1, "kg", 1e-5),
        (0.3, "kg", 1e-5),
        (0.2, "kg", 2e-5),
    ]


@pytest.mark.parametrize("binning", ["2.5", "nan"])
def test_a_part_of_a_binning_is_none(tmp_path: Path, binning: str) -> None:
    """Nobody bins by 2.5 pixels, and 2 was made of it: the pitch of another image."""
    arm = quantity("arm", real("1.2", r"\metre", "0.002"), "rig_arm_m")
    pitch = quantity("pitch", real("4.8e-6", r"\metre", "1e-9"), "rig_pixel_pitch_m")
    path = certificate(tmp_path / "l.xml", arm, pitch, quantity("bin", real(binning, r"\one"), "rig_binning"))
    with pytest.raises(ConfigurationError, match=r"l\.xml: .*binning"):
        calibrate_lever(path, Filing(tmp_path / "c"))


def test_ptbs_example_is_read(shared_data: Path) -> None:
    path = shared_data / "dcc" / EXAMPLE
    if not path.is_file():
        pytest.skip(f"no example of a certificate at {path}")
    found = parse_certificate(path.read_bytes(), path.name)
    assert (found.identifier, found.laboratory) == ("Id 123456789 HtW", "Kalibrierfirma GmbH")
    errors = [each for each in found.quantities if each.name == "Measurement error"]
    assert [each.value for each in errors] == [-0.004, -0.001, 0.003, 0.011, 0.012, 0.006, -0.003]
    assert [each.u for each in errors] == [0.003, 0.004, 0.005, 0.0055, 0.005, 0.004, 0.003]
    assert {each.unit for each in errors} == {"1"}
    assert {(each.k, each.probability) for each in errors} == {(2.0, 0.95)}
