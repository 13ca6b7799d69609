"""Certificates that are written: valid, and read back to the last digit by libraries that are not ours."""

import datetime
import json
import math
import warnings
from pathlib import Path
from typing import Any

import pytest

from calibration import CertificateFacts, certificate_bytes, parse_certificate
from calibration.store import read_calibration
from processing.d_si import from_d_si, in_d_si
from processing.errors import RigError
from processing.units import _OTHERS, _PREFIXABLE, COUNTS, D_SI, conversion, size
from rig.calibrate import Filing, calibrate_lever
from rig.export.session_export import export_session
from tests.rig.certificates import schema
from tests.rig.command_line import rig

DAY = datetime.date(2026, 3, 1)
GEOMETRY = "[geometry]\narm_m = 1.2345678901234567\nu_arm_m = 0.0012345678901\npixel_pitch_m = 4.8e-6\n"
GEOMETRY += "u_pixel_pitch_m = 1.1e-9\n"


def read_by_the_schema(found: Any, path: Path) -> dict[str, tuple[float, float, float, float, str]]:
    """Value, u, k, probability and unit by reference type, as xmlschema decodes them."""
    tree = found.to_dict(str(path))
    said: dict[str, tuple[float, float, float, float, str]] = {}
    for measured in tree["dcc:measurementResults"]["dcc:measurementResult"]:
        for result in measured["dcc:results"]["dcc:result"]:
            for each in result["dcc:data"]["dcc:quantity"]:
                number = each["si:real"]
                unc = number.get("si:expandedUnc")
                k = unc["si:coverageFactor"] if unc else math.nan
                said.setdefault(
                    each["@refType"][0],
                    (
                        number["si:value"],
                        unc["si:uncertainty"] / k if unc else math.nan,
                        k,
                        unc["si:coverageProbability"] if unc else math.nan,
                        number["si:unit"],
                    ),
                )
    return said


def test_a_lever_is_written_and_read_back_exactly(shared_data: Path, tmp_path: Path) -> None:
    (tmp_path / "g.toml").write_text(GEOMETRY)
    lever = calibrate_lever(tmp_path / "g.toml", Filing(tmp_path / "c", made_by='A & B "<C>"'))
    path = tmp_path / "lever.xml"
    assert rig("export", lever, "--format", "dcc", "-o", path).returncode == 0
    found = schema(shared_data)
    found.validate(str(path))
    values = read_calibration(lever).values
    said = read_by_the_schema(found, path)
    assert said["rig_arm_m"] == (values["arm_m"], values["u_arm_m"], 2.0, pytest.approx(0.9545), r"\metre")
    assert said["rig_pixel_pitch_m"][:2] == (values["pixel_pitch_m"], values["u_pixel_pitch_m"])
    again = read_calibration(calibrate_lever(path, Filing(tmp_path / "c")))
    assert again.values == values, "the project reads its own"
    assert not again.expired(again.made_at)


def test_the_results_of_runs_are_written_and_read_back_exactly(
    measured_series: Path, shared_data: Path, tmp_path: Path
) -> None:
    path = tmp_path / "runs.xml"
    assert export_session(measured_series, "dcc", path) == [path]
    found = schema(shared_data)
    found.validate(str(path))
    results = json.loads((measured_series / "results.json").read_text(encoding="utf-8"))["runs"]
    tree = found.to_dict(str(path))
    measured = tree["dcc:measurementResults"]["dcc:measurementResult"]
    assert len(measured) == len(results) + 1, "and the series"
    stated = 0
    for one, run in zip(measured[:-1], results, strict=True):
        open_ends = {item["name"] for item in run["identifiability"] if item["verdict"] != "determined"}
        for result in one["dcc:results"]["dcc:result"]:
            (name,) = [content["$"] for content in result["dcc:name"]["dcc:content"]]
            table = next((fit for key, fit in run["fits"].items() if name.startswith(f"{key} fit")), run)
            table = run["budget"] if name.startswith("whole") else table
            for each in result["dcc:data"]["dcc:quantity"]:
                key = each["@refType"][0].removeprefix("rig_")
                unc = each["si:real"]["si:expandedUnc"]
                assert each["si:real"]["si:value"] == table[key]["value"]
                assert unc["si:uncertainty"] / unc["si:coverageFactor"] == table[key]["standard_uncertainty"]
                assert key not in open_ends, "no number for what the data do not determine"
                stated += 1
    assert stated > 10
    assert b"SIMULATED" in path.read_bytes()
    with pytest.raises(RigError, match="exists already"):
        export_session(measured_series, "dcc", path)


def test_fewer_degrees_of_freedom_cover_less(tmp_path: Path, shared_data: Path) -> None:
    (tmp_path / "lever-001.toml").write_text(
        "kind = 'lever'\nmade_at = 2026-01-01T00:00:00Z\nvalid_until = 2027-01-01T00:00:00Z\n"
        "measured_at = 2026-01-01T00:00:00Z\n[values]\narm_m = 1.0\nu_arm_m = 1e-3\narm_dof = 4.0\n"
        "pixel_pitch_m = 4.8e-6\n"
    )
    export_session(tmp_path / "lever-001.toml", "dcc", tmp_path / "l.xml")
    found = schema(shared_data)
    found.validate(str(tmp_path / "l.xml"))
    # Student's t of 4 degrees of freedom: P(|t| < 2) = 0.88388, from tables
    assert read_by_the_schema(found, tmp_path / "l.xml")["rig_arm_m"][3] == pytest.approx(0.883883, abs=1e-6)
    assert "rig_arm_dof" in read_by_the_schema(found, tmp_path / "l.xml")


UNITS = [
    "m",
    "kg",
    "mg",
    "µm",
    "J/m^2",
    "N m",
    "Pa",
    "1/s",
    "rad",
    "arcsec",
    "rad/s^2",
    "%",
    "ppm",
    "min",
    "K/s",
]


def parsed(dsi_unit: Any, text: str) -> Any:
    """A unit as dsiunits reads it, which warns of an outdated word in whatever it reads."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return dsi_unit.DsiUnit(text)


@pytest.mark.parametrize("unit", UNITS)
def test_units_are_those_of_ptbs_own_library(unit: str) -> None:
    dsi_unit = pytest.importorskip("dsi_unit", reason="dsiunits is not installed")
    theirs = parsed(dsi_unit, in_d_si(unit))
    assert theirs.valid
    again = from_d_si(in_d_si(unit))
    assert conversion(again, unit) == 1.0
    si = {"m": "metre", "kg": "kilogram", "s": "second", "K": "kelvin", "rad": "radian"}
    base = parsed(
        dsi_unit,
        "".join(
            rf"\{si[{'kelvin': 'K'}.get(name, name)]}\tothe{{{float(power):g}}}"
            for name, power in size(unit).powers.items()
        )
        or r"\one",
    )
    assert base.get_scale_factor(theirs) == pytest.approx(size(unit).factor, rel=1e-12)


def test_every_unit_of_the_table_has_a_name_or_is_a_count() -> None:
    known = {*_OTHERS, *_PREFIXABLE}
    assert known - set(D_SI) - {"mas"} == set(COUNTS)
    assert set(D_SI) <= known
    assert in_d_si("e/DN") == r"\one"
    assert from_d_si(r"\kilo\metre\per\second\tothe{2}") == "km s^-2"


def test_a_name_that_xml_cannot_write_makes_no_broken_certificate() -> None:
    """A path of undecodable bytes, a BELL, a noncharacter."""
    facts = CertificateFacts("1", "rig", "1", "caf\udce9 \a\ufffe\u00e9\U0001f52d", "1", "", DAY, DAY)
    found = parse_certificate(certificate_bytes(facts, []), "written")
    assert found.item == "caf \u00e9\U0001f52d"
