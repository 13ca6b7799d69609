"""What results say of the beam: its model, flags, and a warning with the likely cause of bad fits."""

from pathlib import Path

import numpy as np
import pytest

from processing.spot import BeamUse, SpotFlag
from rig.analysis.record_fit import _beam
from rig.analysis.results_file import read_results
from rig.analysis.run_values import Beam
from rig.settings import PreflightSettings

MOST = PreflightSettings().max_poor_fit_fraction
POOR, LEARNED = SpotFlag.POOR_FIT, SpotFlag.LEARNED


def beam(*stretches: tuple[int, int], noise_is_known: bool = True) -> Beam:
    flags = np.repeat([flag for _, flag in stretches], [count for count, _ in stretches])
    use = BeamUse()
    use.take(np.arange(len(flags)), flags)
    return Beam.of(use, noise_is_known=noise_is_known)


def test_an_ordinary_run_with_a_learned_profile_is_no_warning() -> None:
    found = beam((147, POOR), (3000, LEARNED), (20, LEARNED | POOR), (1000, LEARNED))
    verdict = _beam(found, MOST)
    assert verdict.ok
    assert not verdict.remedy
    assert found.sentence == "Beam: learned profile since frame 147; spots with POOR_FIT 167."
    assert beam((147, POOR), (900, LEARNED)).sentence.endswith("POOR_FIT 147 (while it was learned).")


@pytest.mark.parametrize(
    ("stretches", "known", "cause"),
    [
        ([(900, 0), (100, POOR | SpotFlag.EDGE)], True, "edge of the sensor"),
        ([(900, 0), (100, POOR | SpotFlag.SATURATED)], True, "saturated"),
        ([(147, POOR), (900, LEARNED), (100, LEARNED | POOR)], True, "changes with position"),
        ([(1000, 0), (400, POOR), (900, LEARNED)], True, "changed during the run"),
        ([(200, POOR)], True, "too short"),
        ([(2000, POOR)], False, "assumed, not measured"),
        ([(2000, POOR)], True, "no constant profile"),
    ],
)
def test_bad_fits_are_a_warning_with_cause_and_remedy(
    stretches: list[tuple[int, int]], known: bool, cause: str
) -> None:
    verdict = _beam(beam(*stretches, noise_is_known=known), MOST)
    assert verdict.ok  # the numbers stand, with widened uncertainties
    assert cause in verdict.reason
    assert verdict.remedy


def test_a_measured_series_states_its_beam(measured_series: Path) -> None:
    for run in read_results(measured_series).runs:
        assert run.beam is not None
        assert (run.beam.model, run.beam.since_frame, run.beam.poor_fit_frames) == ("one Gaussian", 0, 0)
        assert run.beam.judged_frames == run.frames
        assert "beam" in [item.name for item in run.conditions]
