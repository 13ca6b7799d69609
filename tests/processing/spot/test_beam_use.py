"""What the flags of a run's spots say of its beam: the model since when, and how often it did not fit."""

import numpy as np

from processing.spot import LONGEST_CHOICE_FRAMES, BeamUse, SpotFlag, SpotModel

GOOD, POOR, LOST = 0, int(SpotFlag.POOR_FIT), int(SpotFlag.LOST)
LEARNED, TWO = int(SpotFlag.LEARNED), int(SpotFlag.MULTIPLE)


def used(*stretches: tuple[int, int]) -> BeamUse:
    """Of so many frames with each flag; passed in pieces, which must not matter."""
    flags = np.repeat([flag for _, flag in stretches], [count for count, _ in stretches])
    use, pieces = BeamUse(), BeamUse()
    use.take(np.arange(len(flags)), flags)
    for start in range(0, len(flags), 50):
        pieces.take(np.arange(start, min(start + 50, len(flags))), flags[start : start + 50])
    assert vars(use) == vars(pieces)
    return use


def test_frames_before_the_first_learned_profile_are_counted_and_not_judged() -> None:
    use = used((147, POOR), (5000, LEARNED))
    assert (use.model, use.since_frame, use.changes) == (SpotModel.LEARNED, 147, 0)
    assert use.flags[SpotFlag.POOR_FIT] == use.choosing_frames == 147
    assert (use.judged_frames, use.poor_frames) == (5000, 0)


def test_a_beam_that_stops_fitting_in_the_run_is_judged_and_its_change_is_told() -> None:
    late = used((3000, GOOD), (400, POOR), (2000, LEARNED))
    assert (late.model, late.since_frame, late.changes) == (SpotModel.LEARNED, 3400, 1)
    assert (late.judged_frames, late.poor_frames, late.choosing_frames) == (5400, 400, 0)
    again = used((147, POOR), (1000, LEARNED), (300, LEARNED | POOR), (147, POOR), (900, LEARNED))
    assert (again.model, again.since_frame, again.changes) == (SpotModel.LEARNED, 1594, 2)
    assert again.poor_frames == 447


def test_a_short_run_that_never_fits_is_judged_as_a_whole() -> None:
    use = used((LONGEST_CHOICE_FRAMES, POOR))
    assert use.judged_frames == use.poor_frames == LONGEST_CHOICE_FRAMES


def test_single_frames_that_the_model_missed_are_no_change() -> None:
    use = used((10, LOST), (200, TWO), (3, GOOD), (20, TWO), (60, GOOD), (500, TWO))
    assert (use.model, use.since_frame, use.changes) == (SpotModel.TWO, 10, 0)
    assert use.flags[SpotFlag.LOST] == 10
    assert used((1, TWO), (400, GOOD)).text == "one Gaussian since frame 1"
    assert used((5, LOST)).text == "no spot"
