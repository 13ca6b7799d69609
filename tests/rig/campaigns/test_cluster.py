"""A campaign whose work a Dask cluster does says what it says without."""

import subprocess
from pathlib import Path

import pytest

from tests.rig.archive.test_cluster import documented, free_port, needs_dask, start, started  # noqa: F401
from tests.rig.campaigns.made_sessions import humid_campaign
from tests.rig.command_line import rig


@pytest.mark.slow
@needs_dask
def test_a_cluster_says_the_same(
    started: "list[subprocess.Popen[bytes]]",  # noqa: F811
    tmp_path: Path,
) -> None:
    folders = humid_campaign(tmp_path)
    port = free_port()
    for command in documented():
        start(started, command.replace("8786", str(port)).replace("8787", "0"), tmp_path)
    done = rig("campaign", *folders, "--cluster", f"tcp://127.0.0.1:{port}")
    assert done.returncode == 0, done.stderr
    assert done.stdout == rig("campaign", *folders).stdout


@needs_dask
def test_a_cluster_that_is_not_there_is_said(tmp_path: Path) -> None:
    done = rig("campaign", *humid_campaign(tmp_path), "--cluster", f"tcp://127.0.0.1:{free_port()}")
    assert done.returncode == 2
    assert "no Dask scheduler answers there" in done.stderr
