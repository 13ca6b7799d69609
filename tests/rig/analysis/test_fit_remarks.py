"""What is said of a linear drag follows from its numbers, not from the sentence stored beside them."""

from dataclasses import replace

import pytest

from processing.estimate import Estimate
from processing.fit import DragFinding
from rig.analysis import Drag, RunResults
from rig.analysis.fit_remarks import remarks
from rig.report.tables import drag_table

_SEEN = Drag(drag_s=Estimate(2e-3, 1e-4), p_value=1e-9, significant=True, text="reworded; without a colon")


@pytest.mark.parametrize(
    ("drag", "finding", "said"),
    [
        (_SEEN, DragFinding.SEEN, "a linear drag is in the data"),
        (
            replace(_SEEN, drag_s=Estimate(-2e-3, 1e-4), significant=False),
            DragFinding.NEGATIVE,
            "the data ask for a negative drag",
        ),
        (replace(_SEEN, p_value=0.4, significant=False), DragFinding.UNSEEN, "no linear drag is seen"),
    ],
)
def test_a_drag_is_judged_by_its_numbers(drag: Drag, finding: DragFinding, said: str) -> None:
    results = RunResults(record="run-1.mcap", drag=drag)
    assert drag.finding is finding
    assert remarks(results)[0].startswith(f"{said.capitalize()}: ")
    assert drag_table(results).shown[-1] == ["verdict", said]
