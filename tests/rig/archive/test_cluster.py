"""The documented commands of a cluster, which listen on this computer alone, and a refit by them."""

import importlib.util
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from rig.archive import add_folders, refit_runs
from rig.interruption import free_port
from tests.rig.command_line import SAMPLES
from tests.waiting import until

ROOT = Path(__file__).resolve().parents[3]
DOCUMENTS = (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"))
needs_dask = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None,
    reason="no Dask here: pip install 'optical-pendulum-rig[series]'",
)


def documented() -> list[str]:
    """The commands of Dask that stand in the documents."""
    return [
        command
        for path in DOCUMENTS
        for command in re.findall(
            r"(?:`|^ {4})(dask (?:scheduler|worker)[^`\n]*)", path.read_text(encoding="utf-8"), re.MULTILINE
        )
    ]


def test_every_documented_command_names_the_loopback() -> None:
    found = documented()
    assert [command.split()[1] for command in found] == ["scheduler", "worker"]
    for command in found:
        assert "--host 127.0.0.1" in command, command
        assert "--dashboard-address 127.0.0.1:" in command, command


def listening(process: int) -> set[str]:
    """The addresses on which a process and its children listen."""
    from psutil import NoSuchProcess, Process

    found = set()
    for one in (Process(process), *Process(process).children(recursive=True)):
        with suppress(NoSuchProcess):
            sockets = one.net_connections("inet")
            found |= {socket.laddr.ip for socket in sockets if socket.status == "LISTEN"}
    return found


@pytest.fixture
def started() -> Iterator["list[subprocess.Popen[bytes]]"]:
    """Processes, each the first of its group, that are ended with all of it."""
    found: list[subprocess.Popen[bytes]] = []
    yield found
    for process in found[::-1]:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def start(started: "list[subprocess.Popen[bytes]]", command: str, folder: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", *shlex.split(command)],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    started.append(process)
    until(lambda: listening(process.pid))


@needs_dask
@pytest.mark.slow
@pytest.mark.timeout(240)
def test_a_cluster_listens_on_the_loopback_alone_and_fits_sessions_again(
    started: "list[subprocess.Popen[bytes]]", tmp_path: Path
) -> None:
    from distributed import Client

    port = free_port(0)
    for command in documented():
        start(started, command.replace("8786", str(port)).replace("8787", "0"), tmp_path)
    with Client(f"tcp://127.0.0.1:{port}", timeout="60s", set_as_default=False) as client:
        client.wait_for_workers(1, timeout=60)
        assert client.submit(sum, [1, 2]).result(timeout=60) == 3
        for process in started:
            assert listening(process.pid) == {"127.0.0.1"}
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    add_folders(tmp_path / "archive.duckdb", [tmp_path / "runs"])
    assert refit_runs(tmp_path / "archive.duckdb", [], "", "swings", cluster=f"tcp://127.0.0.1:{port}") == 0
    assert (tmp_path / "runs" / "series" / "results-2.json").exists()
