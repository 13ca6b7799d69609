"""`rig fit --law`: laws compared on a record."""

import json
from pathlib import Path

import numpy as np
import pytest

from processing.errors import ConfigurationError
from rig.commands.fitting import fit_records


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
    # the demonstration's contact is the paper's: its third harmonic, and no other law's, is in the motion
    (swings,) = run["laws"]["waveform"]
    assert paper["waveform_chance"] > 1e-3
    assert viscous["waveform_chance"] < 1e-4
    third = np.hypot(swings["measured"]["cosine_rad"][1], swings["measured"]["sine_rad"][1])
    assert third > 20 * swings["u_rad"][1]
    said = " ".join(capsys.readouterr().out.split())
    assert "Laws of the contact" in said
    assert "paper describes this decay best; excluded: viscous" in said


def test_an_unknown_law_is_named_with_those_that_there_are(measured_series: Path, tmp_path: Path) -> None:
    with pytest.raises(
        ConfigurationError, match=r"--law hertz: no such law; there are paper, masing, .*none and all"
    ):
        fit_records([measured_series / "run-1.mcap"], tmp_path / "out", (), ["hertz"])
