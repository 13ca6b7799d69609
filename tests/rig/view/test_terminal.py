"""What `rig replay` shows: a Rerun file, and a page at a pseudo-terminal."""

import os
import signal
import urllib.request
from pathlib import Path

import pytest

from tests.acquisition.cameras.usb3vision.backend import wait_until
from tests.rig.command_line import rig
from tests.rig.view.replay_record import make_record
from tests.rig.view.rrd_contents import measured, scalars

if os.name != "posix":
    pytest.skip("pseudo-terminals are those of POSIX", allow_module_level=True)

from tests.rig.pseudo_terminal import LIMIT_S, Terminal

pytestmark = pytest.mark.timeout(300)

SECONDS = 60.0


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Without a fit of the contact, which takes long for a short run."""
    path = tmp_path_factory.mktemp("terminal") / "run-1.mcap"
    return make_record(path, SECONDS, overrides=["instrument.kind='tomlinson'"])


@pytest.mark.slow
def test_a_rerun_file_of_a_replay_has_all_of_it(record: Path, tmp_path: Path) -> None:
    rrd = tmp_path / "replay.rrd"
    done = rig("replay", record, "--rrd", rrd)
    assert done.returncode == 0, done.stderr
    assert "equal bit for bit" in done.stdout
    times_s, values = scalars(rrd, "/deflection/y")
    assert len(times_s) == round(SECONDS * 50) - 1
    assert abs(values[0]) > 100.0
    assert len(measured(rrd, "/amplitude")[0]) >= 25
    assert len(measured(rrd, "/balance/line_angle")[0]) >= 10


@pytest.mark.slow
def test_the_page_of_a_replay_stays_until_it_is_closed(record: Path) -> None:
    terminal = Terminal("replay", record, "--view", "web")
    try:
        terminal.wait_for("the page has all of it and stays until Ctrl-C")
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
        terminal.process.send_signal(signal.SIGINT)
        assert "equal bit for bit" in terminal.end()
    finally:
        terminal.close()
