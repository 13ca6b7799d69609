"""The comparison of the ledger: what counts as equal, as within the limits, and as moved."""

import math

import pytest

from tests.ledger.numbers import Entry, differences, entries


@pytest.mark.parametrize(
    ("before", "after", "kind"),
    [
        ([3.0, 0.5], [3.0, 0.5], None),
        ([3.0, 0.5], [-3.0, 0.5], "moved"),
        ([3.0, 0.5], [3.024, 0.5], "within"),
        ([3.0, 0.5], [2.974, 0.5], "moved"),
        ([3.0, 0.5], [3.0, 0.489], "moved"),
        ([3.0, 0.5], [3.0, 0.509], "within"),
        ([3.0], [-3.0], "moved"),
        ([3.0], [math.nan], "moved"),
        (["determined"], ["not determined"], "moved"),
        ([3.0], None, "gone"),
        (None, [3.0], "new"),
    ],
)
def test_a_difference_has_its_kind(before: Entry | None, after: Entry | None, kind: str | None) -> None:
    old, new = ({} if entry is None else {"/runs/0/c": entry} for entry in (before, after))
    assert [one.kind for one in differences("demo", old, new)] == ([] if kind is None else [kind])


def test_every_number_has_its_path_and_its_uncertainty() -> None:
    c = {"value": 1.5, "standard_uncertainty": 0.25, "verdict": "determined"}
    found = entries({"runs": [{"c": c, "frames": 7, "half_cycles": 3, "curve": [*range(20)]}]})
    assert found == {
        "/runs/0/c": [1.5, 0.25],
        "/runs/0/c/verdict": ["determined"],
        "/runs/0/half_cycles": [3],
        "/runs/0/curve": [20, 0.0, 19.0, 9.5],
    }
