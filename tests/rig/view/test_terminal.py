"""`rig replay` controlled by keys on a pseudo-terminal, and without a terminal."""

import os
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.acquisition.cameras.usb3vision.backend import wait_until
from tests.rig.command_line import rig
from tests.rig.view.replay_record import WITHOUT_FIT, make_record
from tests.rig.view.rrd_contents import measured, scalars

if os.name != "posix":
    pytest.skip("pseudo-terminals are those of POSIX", allow_module_level=True)

from tests.rig.pseudo_terminal import LIMIT_S, Terminal

pytestmark = pytest.mark.timeout(300)

SECONDS = 60.0


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("terminal") / "run-1.mcap"
    return make_record(path, SECONDS, overrides=WITHOUT_FIT)


@pytest.fixture
def terminal(record: Path) -> Iterator[Terminal]:
    started = Terminal("replay", record, "--speed", "0.5")
    yield started
    started.close()


PAUSED = r"paused  (\d+\.\d\d) of 60\.0 s .*? (\d+) frames  (\d+) half-cycles"


@pytest.mark.slow
def test_pause_step_seek_and_end_by_keys(terminal: Terminal) -> None:
    terminal.wait_for("keys: space pause")
    terminal.wait_for(r"replaying  \d")
    terminal.press(" ")
    frames = int(terminal.wait_for(PAUSED)[2])
    terminal.press("n")
    terminal.wait_for(PAUSED, lambda match: int(match[2]) == frames + 1)
    terminal.press("\x1b[C")
    stepped = terminal.wait_for(PAUSED, lambda match: int(match[2]) == frames + 2)
    terminal.press("+")
    there_s = float(stepped[1]) + 10.0
    forwards = terminal.wait_for(PAUSED, lambda match: abs(float(match[1]) - there_s) < 0.03)
    # nothing was left out on the way; one frame is missing in the record
    assert 499 <= int(forwards[2]) - (frames + 2) <= 500
    terminal.press("h")
    terminal.wait_for(PAUSED, lambda match: int(match[3]) > int(forwards[3]))
    terminal.press("g50")
    terminal.wait_for(r"go to \(seconds from the start, Enter\): 50")
    terminal.press("\r")
    terminal.wait_for(r"paused  50\.00 of ")
    terminal.press("-")
    terminal.wait_for(PAUSED, lambda match: match[1] == "40.00" and match[2] == match[3] == "0")
    terminal.press(" ")
    terminal.wait_for(r"replaying  4\d\.\d\d of ")
    terminal.press("q")
    output = terminal.end()
    assert terminal.process.returncode == 0, terminal.screen
    assert "restarted at 40.00 s by going back: the results are not compared" in output
    assert terminal.settings == terminal.before


@pytest.mark.slow
def test_ctrl_c_leaves_the_terminal_as_it_was(terminal: Terminal) -> None:
    terminal.wait_for(r"replaying  \d")
    assert terminal.settings != terminal.before
    # the terminal itself sends no signal, since it is nobody's controlling one here
    terminal.process.send_signal(2)
    terminal.end()
    assert terminal.process.returncode == 130
    assert terminal.settings == terminal.before


@pytest.mark.slow
def test_without_a_terminal_there_are_no_keys(record: Path, tmp_path: Path) -> None:
    rrd = tmp_path / "replay.rrd"
    done = rig("replay", record, "--rrd", rrd, typed="q g 5 \n")
    assert done.returncode == 0, done.stderr
    assert "equal bit for bit" in done.stdout
    assert "keys:" not in done.stderr
    # and what the live view was told is all of it, though it went as fast as it could
    times_s, values = scalars(rrd, "/deflection/y")
    assert len(times_s) == round(SECONDS * 50) - 1
    assert abs(values[0]) > 100.0
    assert len(measured(rrd, "/amplitude")[0]) >= 25
    assert len(measured(rrd, "/balance/line_angle")[0]) >= 10


@pytest.mark.slow
def test_the_page_of_a_replay_stays_until_it_is_closed(record: Path) -> None:
    terminal = Terminal("replay", record, "--view", "web")
    try:
        terminal.wait_for("the page has all of it and stays until q or Ctrl-C")
        address = terminal.wait_for(r"http://127\.0\.0\.1:\d+\S*")[0]
        asked = urllib.request.build_opener(urllib.request.ProxyHandler({}))

        def is_served() -> bool:
            try:
                with asked.open(address, timeout=30) as page:
                    return bool(page.status == 200)
            except OSError:
                return False

        assert wait_until(is_served, LIMIT_S)
        assert terminal.process.poll() is None
        terminal.press("q")
        assert "equal bit for bit" in terminal.end()
    finally:
        terminal.close()
