"""An archive of many sessions: adding, listing, killed at random moments, two that add at once, refits.

Run as ``python -m tests.benchmarks archive [--quick]``; `RIG_BENCH_SESSIONS` names another number of sessions
than 10,000 (which take 4 GB and more than an hour), `RIG_BENCH_REFITS` that of the sessions, of three runs
each, that are fitted again. The archive on S3 needs moto's server and s3fs, the cluster Dask.
"""

import contextlib
import importlib.util
import os
import random
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquisition.record.digest import sha256_of
from rig.analysis import analyse_record
from rig.archive import add_sessions, refit_runs
from rig.archive.refits import Task, refit
from rig.archive.remote import opened
from rig.archive.store import Archive
from tests.rig.archive.many_sessions import RUNS, make_sessions

KILLS = 100
_LISTED = "sample like '%K8%' and humidity < 45 and state = 'whole' order by c limit 40"
_MEASURE = """
import os, subprocess, sys
quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
_, status, usage = os.wait4(subprocess.Popen(sys.argv[1:], **quiet).pid, 0)
print(usage.ru_maxrss, usage.ru_utime + usage.ru_stime, status)
"""
"""Starts a command and tells its use, from a small process: a child's most memory is never less than its
parent's was.
"""


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers; `quick` takes 200 sessions and 10 kills."""
    sessions = int(os.environ.get("RIG_BENCH_SESSIONS", "200" if quick else "10000"))
    kills = 10 if quick else KILLS
    results: dict[str, Any] = {}

    def tell(**measured: Any) -> None:
        """Each number as soon as it is known: all together take an hour and more."""
        results.update(measured)
        for key, value in measured.items():
            print(f"  {key}: {f'{value:,.4g}' if isinstance(value, float) else value}", flush=True)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        began_s = time.process_time()
        made = sum(1 for _ in make_sessions(folder / "runs", sessions, templates=8 if quick else 24))
        assert made == sessions
        generated_s = time.process_time() - began_s
        tell(**{"sessions": sessions, "runs": sessions * RUNS, "generated, CPU s": generated_s})
        tell(**_added_and_listed(folder / "runs", folder / "archive"))
        tell(**_killed(folder / "runs", folder / "killed", sessions, kills))
        tell(**_two_at_once(folder / "runs", folder / "two", sessions))
        refitted = int(os.environ.get("RIG_BENCH_REFITS", "3" if quick else "40"))
        tell(**_refits(folder / "refitted", sessions=refitted))
        tell(**cluster_on_s3(folder / "cluster", sessions=4 if quick else 20))
    return results


def _added_and_listed(runs: Path, archive: Path) -> dict[str, Any]:
    """Added to a new archive, again to the full one, and listed with a filter."""
    results: dict[str, Any] = {}
    for what in ("add", "add again"):
        began_s = time.monotonic()
        peak_mib, spent_s = _taken("add", runs, "--archive", archive)
        results |= {f"{what}: CPU s": spent_s, f"{what}: s": time.monotonic() - began_s}
        results[f"{what}: MiB resident"] = peak_mib
    _taken("list", "limit 1", "--archive", archive)  # compiles bytecode
    peak_mib, results["list: CPU s"] = _taken("list", _LISTED, "--archive", archive)
    results["list: MiB resident"] = peak_mib
    results["list: whole runs"] = _listed(archive, "state = 'whole'")
    results["catalogue MB"] = _size(archive / "sessions") / 1e6
    results["merged MB"] = _size(archive / "merged") / 1e6
    return results


def _command(*words: str | Path) -> list[str]:
    return [sys.executable, "-m", "rig", "archive", *map(str, words)]


def _taken(*words: str | Path) -> tuple[float, float]:
    """Most memory of a command in MiB, and its processor time in s. It must succeed."""
    told = subprocess.run(
        [sys.executable, "-S", "-c", _MEASURE, *_command(*words)],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    peak_kib, spent_s, status = told.stdout.split()
    if int(status) != 0:
        raise RuntimeError(f"rig archive {words[0]} failed")
    return float(peak_kib) / 1024, float(spent_s)


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir()) if folder.is_dir() else 0


def _killed(runs: Path, archive: Path, sessions: int, kills: int) -> dict[str, Any]:
    """`add` killed after random numbers of sessions and started again: nothing listed is ever lost again."""
    moments = random.Random(1)
    before = broken = further = 0
    for _ in range(kills):
        process = subprocess.Popen(
            _command("add", runs, "--archive", archive),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        # the whole work in all, so that it is killed at every stage of it, also while it merges
        enough = _count(archive / "sessions") + moments.randint(0, 2 * sessions // kills)
        while process.poll() is None and _count(archive / "sessions") < enough:
            time.sleep(0.02)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(moments.uniform(0.0, 0.3))
        process.kill()
        process.wait()
        found = _listed(archive)
        broken += found < before
        further += found > before
        before = max(found, before)
    _taken("add", runs, "--archive", archive)
    return {
        "killed: times": kills,
        "killed: times after something was added": further,
        "killed: listed less than before, or nothing": broken,
        "killed: runs missing at the end": sessions * RUNS - _listed(archive),
    }


def _count(folder: Path) -> int:
    return len(os.listdir(folder)) if folder.is_dir() else 0


def _two_at_once(runs: Path, archive: Path, sessions: int) -> dict[str, Any]:
    folders = sorted(path for path in runs.iterdir() if path.is_dir())
    halves: Sequence[Sequence[Path]] = (folders, folders[::-1])
    began_s = time.monotonic()
    both = [
        subprocess.Popen(_command("add", *half, "--archive", archive), stdout=subprocess.DEVNULL)
        for half in halves
    ]
    failed = sum(process.wait() != 0 for process in both)
    return {
        "two at once: s": time.monotonic() - began_s,
        "two at once: failed": failed,
        "two at once: runs missing": sessions * RUNS - _listed(archive),
    }


def _refits(folder: Path, sessions: int) -> dict[str, Any]:
    """Results made again: by one and two processes beside the bare fits, and by processes that are killed."""
    archive, runs = folder / "archive", sessions * RUNS
    for _ in make_sessions(folder / "runs", sessions, templates=6, seed=2):
        pass
    add_sessions(archive, [folder / "runs"])
    records = sorted((folder / "runs").rglob("*.mcap"))
    results: dict[str, Any] = {"refit: runs": runs}
    analyse_record(records[0])  # loads the compiled functions
    measured = records[:: max(1, runs // 20)]
    began_s = time.process_time()
    for record in measured:
        analyse_record(record)
    bare_s = (time.process_time() - began_s) / len(measured) * runs
    results["refit: bare fits, CPU s"] = bare_s
    for processes in (1, 2):
        began_s, spent_s = time.monotonic(), _children_s()
        refit_runs(archive, [], "", "swings", settings=[f"fit.robust={processes == 1}"], processes=processes)
        results[f"refit: {processes} processes, s"] = time.monotonic() - began_s
        results[f"refit: {processes} processes, CPU s"] = _children_s() - spent_s
    results["refit: times faster"] = results["refit: 1 processes, s"] / results["refit: 2 processes, s"]
    marks = folder / "marks"
    marks.mkdir()
    random.Random(3).shuffle(records)
    hashes = [sha256_of(record) for record in records]
    work = Killed(marks, frozenset(hashes[:3]), frozenset(hashes[3 : 3 + runs // 10]))
    before = len(Archive(archive).refits.names())
    refit_runs(archive, [], "", "swings", settings=["fit.printed_055=true"], processes=2, work=work)
    results["killed workers: random, poison"] = f"{len(work.once)}, {len(work.always)}"
    results["killed workers: runs missing"] = runs - 3 - (len(Archive(archive).refits.names()) - before)
    results["killed workers: in quarantine"] = len(list((archive / "quarantine").iterdir()))
    return results


def cluster_on_s3(folder: Path, sessions: int) -> dict[str, Any]:
    """Refits by a Dask cluster of two processes, the archive on S3; some records kill their worker."""
    if any(importlib.util.find_spec(name) is None for name in ("distributed", "s3fs", "moto")):
        return {"cluster: not measured": "needs distributed, s3fs and moto"}
    import fsspec

    for _ in make_sessions(folder / "runs", sessions, templates=6, seed=3):
        pass
    records = sorted((folder / "runs").rglob("*.mcap"))
    random.Random(4).shuffle(records)
    hashes = [sha256_of(record) for record in records]
    marks = folder / "marks"
    marks.mkdir()
    work = Killed(marks, frozenset(hashes[:3]), frozenset(hashes[3 : 3 + max(1, len(records) // 10)]))
    s3, dask, url = _free_port(), f"tcp://127.0.0.1:{_free_port()}", "s3://laboratory/friction"
    os.environ |= {"AWS_ACCESS_KEY_ID": "bench", "AWS_SECRET_ACCESS_KEY": "bench"}
    os.environ |= {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{s3}", "AWS_DEFAULT_REGION": "us-east-1"}
    os.environ |= {"XDG_CACHE_HOME": str(folder / "cache"), "OPENBLAS_NUM_THREADS": "1"}
    local = ("--host", "127.0.0.1", "--no-dashboard")
    worker = ("dask", "worker", dask, *local, "--nworkers", "2", "--nthreads", "1")
    commands = (
        ("moto.server", "-H", "127.0.0.1", "-p", str(s3)),
        ("dask", "scheduler", *local, "--port", dask.rpartition(":")[2]),
        (*worker, "--local-directory", str(folder)),
    )
    with contextlib.ExitStack() as stack:
        for command in commands:
            quiet = subprocess.DEVNULL
            process = subprocess.Popen([sys.executable, "-m", *command], stdout=quiet, stderr=quiet)
            stack.callback(process.wait)
            stack.callback(process.terminate)
        system = fsspec.filesystem("s3")
        _until(lambda: system.mkdir("laboratory") is None)
        began_s = time.monotonic()
        with opened(url) as archive:
            add_sessions(archive, [folder / "runs"])
        results: dict[str, Any] = {"cluster: runs": len(records), "cluster: add to S3, s": _since(began_s)}
        began_s = time.monotonic()
        with opened(url) as archive:
            _until(lambda: _workers(dask) == 2)
            refit_runs(archive, [], "", "swings", sent_to=url, cluster=dask, work=work)
        results["cluster: refit with killed workers, s"] = _since(began_s)
        done = {path.rpartition("/")[2] for path in system.find("laboratory/friction/refits")}
        results["cluster: killed at random, poison"] = f"{len(work.once)}, {len(work.always)}"
        results["cluster: killed in all"] = sum(len(mark.read_bytes()) for mark in marks.iterdir())
        results["cluster: runs missing"] = len(records) - 3 - len(done)
        results["cluster: in quarantine"] = len(system.find("laboratory/friction/quarantine"))
        results["cluster: runs with two results"] = len(done) - len({name[:16] for name in done})
    return results


def _workers(address: str) -> int:
    from distributed import Client

    with Client(address, timeout="10s", set_as_default=False) as client:
        return len(client.scheduler_info()["workers"])


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        return port


def _until(reached: Callable[[], bool], longest_s: float = 120.0) -> None:
    """Wait for a server that is starting."""
    end_s = time.monotonic() + longest_s
    while time.monotonic() < end_s:
        with contextlib.suppress(Exception):
            if reached():
                return
        time.sleep(0.5)
    raise TimeoutError("a server of the benchmark did not start")


def _since(began_s: float) -> float:
    return time.monotonic() - began_s


@dataclass(frozen=True)
class Killed:
    """Makes results again, but ends its process with some records always and with some the first time."""

    marks: Path
    always: frozenset[str]
    once: frozenset[str]

    def __call__(self, task: Task) -> str:
        mark = self.marks / task.sha256
        if task.sha256 in self.always or (task.sha256 in self.once and not mark.exists()):
            with mark.open("ab") as file:
                file.write(b"x")
            os.kill(os.getpid(), signal.SIGKILL)
        return refit(task)


def _children_s() -> float:
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def _listed(archive: Path, condition: str = "") -> int:
    """How many runs are listed; 0 of an archive that holds none yet, -1 where it cannot be read."""
    done = subprocess.run(
        _command("list", condition, "--columns", "count(*)", "--format", "csv", "--archive", archive),
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        return 0 if "holds no sessions" in done.stderr else -1
    return int(done.stdout.split()[-1])
