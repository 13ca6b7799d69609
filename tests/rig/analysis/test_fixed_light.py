"""A reflection that stays where it is while the spot swings past it, from frames to parameters."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.rig.analysis.spinning import DEMONSTRATION
from tests.rig.command_line import SMALL, rig, set_words

TRUE = {"b": 37.33e-4, "p": 0.944, "c": 10.51e-9, "period0_s": 4.071}
REFLECTION = {
    **SMALL,
    "session.max_duration_s": "300",
    "camera.frame_rate_hz": "12.5",
    "simulation.reference.relative": "0.03",
    # the spot swings along x 79.5, past y 400
    "simulation.reference.y_px": "400",
    "simulation.reference.x_px": "83.5",
}
WITHOUT_PIXELS = {
    **REFLECTION,
    "session.max_duration_s": "60",
    "record.windows": "false",
    "record.full_frame_interval_s": "2",
    "instrument.kind": '"tomlinson"',
}


def measured(folder: Path, words: dict[str, str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A run's results, and its condition of fixed light."""
    rig("run", DEMONSTRATION, "-o", folder, *set_words(words))
    run: dict[str, Any] = json.loads((folder / "results.json").read_text())["runs"][0]
    (found,) = [one for one in run["conditions"] if one["name"] == "fixed light"]
    return run, found


@pytest.mark.slow
@pytest.mark.usefixtures("no_fits_meanwhile")
def test_the_parameters_know_nothing_of_a_reflection_of_three_percent(tmp_path: Path) -> None:
    run, said = measured(tmp_path / "run", REFLECTION)
    exact = run["fits"]["exact"]
    for name, true in TRUE.items():
        assert abs(exact[name]["value"] - true) < 2.5 * exact[name]["standard_uncertainty"], name
    assert exact["c"]["standard_uncertainty"] < 0.06 * TRUE["c"]
    # as without the light: none is left out; the last half-cycle may miss the end of the record
    assert run["half_cycles"] >= 142
    assert said["ok"]
    assert "taken off" in said["measured"]
    assert "light that stays where it is, 3" in said["reason"]
    _, said = measured(tmp_path / "without", WITHOUT_PIXELS)
    assert not said["ok"]
    assert "not taken off, as the record has no pixels of the spot" in said["measured"]
    assert "block it" in said["remedy"]
