"""A few moments of a few commands; `python -m tests.benchmarks archive_trust` takes 200 of all."""

import os

import pytest

from tests.rig.archive.killed_commands import kills


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="killed by a signal of POSIX")
def test_a_killed_command_loses_and_invents_nothing_and_the_next_one_completes() -> None:
    found = kills(4, names=("add again", "recover"))
    assert found["kills: which"] == []
    assert found["kills"] == 4
