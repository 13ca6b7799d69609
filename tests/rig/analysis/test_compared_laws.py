"""`rig fit --law`: laws are compared on a record and on a table, or one line says what is missing."""

import json
from pathlib import Path

import numpy as np
import pytest

from processing.decay_summary import Periods
from rig.analysis import compared_laws
from rig.analysis.results import LawMoments, ModelFreeMoments
from rig.analysis.table_fit import _exact_scale_notes
from rig.commands.fitting import fit_records
from rig.settings import load_configuration
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.driven import driven_path
from tests.rig.command_line import rig

PENDULUM = """
[pendulum]
mass_kg = 0.406
ball_radius_m = 6.05e-3
ball_material = "steel"
flat_material = "glass_k8"
"""


def swings(path: Path) -> Path:
    """The paper's pendulum on glass down to 60 arcsec, with noise, in arcsec."""
    _, _, path_rad = driven_path(*paper_pair("glass_k8"), q=0.0, seed=0, last_arcsec=60.0, frames_per_s=20.0)
    t = np.arange(len(path_rad)) / 20.0
    phi = path_rad / ARCSEC + 0.02 * np.random.default_rng(1).standard_normal(len(t))
    path.write_text(
        "t [s],phi [arcsec]\n" + "".join(f"{a:.2f},{b:.4f}\n" for a, b in zip(t, phi, strict=True))
    )
    return path


def test_without_a_pendulum_one_line_says_so(tmp_path: Path) -> None:
    done = rig("fit", swings(tmp_path / "t.csv"), "--law", "all")
    assert done.returncode != 0
    assert done.stderr.strip() == "rig: --law all: laws need swings and --config CONFIG with [pendulum]"


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ("", ["angles", "times"]),
        ("[timebase]\nu_camera_rate = 5e-5\n", ["angles"]),
        ("[timebase]\n", ["angles", "times"]),
    ],
)
def test_what_a_table_states_no_uncertainty_of_is_said(tmp_path: Path, stated: str, said: list[str]) -> None:
    """50 ppm of the clock moved T0 by 2.4 u, and only the angles were said to be taken as exact."""
    path = tmp_path / "mine.toml"
    path.write_text(PENDULUM + stated)
    lines = _exact_scale_notes(load_configuration(path, needs_camera=False))
    assert [line.split("table's ")[1].split()[0] for line in lines] == said


@pytest.mark.slow
def test_a_records_laws_are_compared_and_the_verdict_stands_in_the_results(
    measured_series: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fit_records([measured_series / "run-1.mcap"], tmp_path / "out", (), ["viscous"]) == 0
    run = json.loads((tmp_path / "out" / "results.json").read_text())["runs"][0]
    assert list(run["laws"]["laws"]) == ["paper", "viscous"]
    paper, viscous = run["laws"]["laws"].values()
    assert not paper["excluded"]
    assert viscous["excluded"]
    assert viscous["bic_above_best"] > 10
    # the same fit as the run's own
    assert paper["parameters"]["b"] == run["fits"]["exact"]["b"]
    free = run["laws"]["without_law"]
    assert set(free["laws"]) == {"paper", "viscous"}
    friction, u = np.array(free["friction_n_m"]), np.array(free["u_friction_n_m"])
    apart = (np.array(free["laws"]["paper"]["friction_n_m"]) - friction) / u
    assert np.all(np.abs(apart) < 4)
    said = " ".join(capsys.readouterr().out.split())
    assert "Laws of the contact" in said
    assert "paper describes this decay best; excluded: viscous" in said


def test_the_runs_that_tell_two_laws_apart_by_three_u_are_proposed() -> None:
    phi, u, none = ARCSEC * np.array([10.0, 40.0, 100.0]), np.array([2.0, 4.0, 5.0]), np.zeros(3)
    more = "; a larger first amplitude or more runs may decide"
    runs = ", by 0.7 u of one run: 19 such runs, or a larger first amplitude, may decide"
    for most, said in ((3.1, more), (0.7, runs), (0.29, more)):
        other = LawMoments(0.2 * u, np.array([0.5 * most, -most, 0.2]) * u)
        laws = {"one": LawMoments(none, none), "other": other}
        free = ModelFreeMoments(phi_rad=phi, u_friction_n_m=u, u_elastic_n_m=u, laws=laws)
        found = compared_laws._remedy(free, "one", "other")
        assert found == f"they differ most in elastic moment at 40 arcsec{said}"


def test_the_smooth_curve_of_the_periods_smooths_and_heeds_their_uncertainties() -> None:
    """It went through every period, with the whole of its noise."""
    x = np.linspace(0.0, 2.5, 201)
    u, truth = 1e-5 * np.exp(-0.8 * x), 4.0 + 0.01 * x
    measured = truth + u * np.random.default_rng(1).standard_normal(201)
    # of ten periods next to nothing is known
    u[100:110], measured[100:110] = 3e-4, truth[100:110] + 9e-4
    smooth = compared_laws._smooth(np.exp(x), Periods(np.arange(201), measured, u))
    off = (smooth - truth) / (1e-5 * np.exp(-0.8 * x))
    # 18 free numbers would leave sqrt(18 / 201) of the noise
    assert np.sqrt(np.mean(off**2)) < 0.3
    assert abs(off[105]) < 0.5
