"""What is said of a run that ends before its record begins, with the real firmware: no vain remedy."""

import signal
import time
from contextlib import closing
from pathlib import Path

import pytest

from tests.benchmarks.safety_faults import ENDED_WITHIN_S, Trial
from tests.rig.control.conftest import micropython
from tests.rig.control.test_ending import command, lit, running, wait_for
from tests.rig.control.wires import FirmwareBoard

__all__ = ["micropython"]
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


def test_ended_before_the_record_nothing_is_offered_to_go_on_with(micropython: Path, tmp_path: Path) -> None:
    log, out = tmp_path / "said", tmp_path / "out"
    with closing(FirmwareBoard(micropython, tmp_path)) as board:
        words = command(out, board, preflight__when='"always"', preflight__duration_s="30")
        with running(words, log) as process:
            wait_for(board, lambda: lit(board), log)
            process.send_signal(signal.SIGHUP)
            assert process.wait(ENDED_WITHIN_S) == 130
    said = log.read_text()
    assert "nothing was recorded" in said
    assert "--resume" not in said
    assert not (out / "session.json").exists()


def test_a_computer_that_stood_still_in_preflight_is_told_as_that(micropython: Path, tmp_path: Path) -> None:
    """SIGSTOP and SIGCONT: the board's watchdog has darkened what the frames should show."""
    trial = Trial(micropython, tmp_path, "preflight", "", "end")
    process = trial.start("preflight")
    try:
        assert trial.wait(lambda: trial.lit, 60.0), trial.log.read_text()
        process.send_signal(signal.SIGSTOP)
        assert trial.wait(lambda: not trial.lit, 10.0)
        time.sleep(0.3)
        process.send_signal(signal.SIGCONT)
        assert process.wait(ENDED_WITHIN_S) == 1
    finally:
        process.kill()
        process.wait()
        trial.board.close()
    said = trial.log.read_text()
    assert "WATCHDOG" in said
    assert "exposure" not in said
    assert "--force" not in said
