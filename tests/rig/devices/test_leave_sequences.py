"""Whatever faults, keys and commands follow each other: nothing is lit without a person's leave."""

from pathlib import Path

from tests.benchmarks.safety_lasers import TRIALS, measured
from tests.benchmarks.safety_sequences import run_sequences


def test_nothing_is_lit_without_leave() -> None:
    """The first of the thousand that the benchmark makes."""
    found = run_sequences(40, 30)
    assert found["violations"] == []
    assert found["lit"] > 20
    assert found["acknowledged"] > 5


def test_lasers_of_their_own_go_dark_and_wait_for_a_person(tmp_path: Path) -> None:
    rows = [measured(*trial, tmp_path) for trial in TRIALS]
    assert [row for row in rows if row.violation or row.relit] == []
    # as documented: without the relay nothing darkens a laser whose program was killed
    lit = {row.fault for row in rows if row.dark_s is None}
    assert lit == {"program killed, interlock not wired"}
    assert max(row.dark_s for row in rows if row.dark_s is not None) < 2.5
