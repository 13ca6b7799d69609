"""The documented commands of a cluster, which listen on this computer alone, and a refit by them."""

import importlib.util
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rig.archive import add_folders, refit_runs
from tests.waiting import until

ROOT = Path(__file__).resolve().parents[3]
DOCUMENTS = (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"))
SAMPLES = ROOT / "tests" / "rig" / "data" / "samples"
needs_dask = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None,
    reason="no Dask here: pip install 'optical-pendulum-rig[series]'",
)
needs_ss = pytest.mark.skipif(shutil.which("ss") is None, reason="needs ss (iproute2)")


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
    assert {command.split()[1] for command in found} == {"scheduler", "worker"}
    for command in found:
        assert "--host 127.0.0.1" in command, command
        assert "--dashboard-address 127.0.0.1:" in command, command


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        return port


def group_of(process: int) -> int:
    try:
        return os.getpgid(process)
    except ProcessLookupError:
        return 0


def listening(group: int) -> set[tuple[str, int]]:
    """The addresses and ports on which processes of a group listen, as the kernel tells `ss`."""
    lines = subprocess.run(["ss", "-Hltnp"], capture_output=True, text=True, check=True).stdout.splitlines()
    return {
        (address, int(port))
        for line in lines
        if any(group_of(int(process)) == group for process in re.findall(r"pid=(\d+)", line))
        for address, _, port in [line.split()[3].rpartition(":")]
    }


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
@needs_ss
def test_scheduler_and_worker_listen_on_the_loopback_alone(
    started: "list[subprocess.Popen[bytes]]", tmp_path: Path
) -> None:
    from distributed import Client

    port = free_port()
    commands = documented()
    assert [text.split()[1] for text in commands] == ["scheduler", "worker"]
    for command in commands:
        start(started, command.replace("8786", str(port)).replace("8787", "0"), tmp_path)
    with Client(f"tcp://127.0.0.1:{port}", timeout="60s", set_as_default=False) as client:
        client.wait_for_workers(1, timeout=60)
        assert client.submit(sum, [1, 2]).result(timeout=60) == 3
        for process in started:
            assert {address for address, _ in listening(process.pid)} == {"127.0.0.1"}


@needs_dask
@needs_ss
@pytest.mark.slow
@pytest.mark.timeout(240)
def test_a_cluster_fits_sessions_again(started: "list[subprocess.Popen[bytes]]", tmp_path: Path) -> None:
    port = free_port()
    for command in documented():
        start(started, command.replace("8786", str(port)).replace("8787", "0"), tmp_path)
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    add_folders(tmp_path / "archive.duckdb", [tmp_path / "runs"])
    assert refit_runs(tmp_path / "archive.duckdb", [], "", "swings", cluster=f"tcp://127.0.0.1:{port}") == 0
    assert (tmp_path / "runs" / "series" / "results-2.json").exists()
