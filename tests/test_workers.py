"""What runs in which worker of pytest-xdist: a file in one, all that measures real time in one."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent
TESTS = """
import os, pathlib, time, pytest
pytestmark = {mark}
@pytest.mark.parametrize("number", range(4))
def test(number):
    time.sleep(0.05)
    with pathlib.Path("{said}").open("a") as said:
        print("{name}", os.environ["PYTEST_XDIST_WORKER"], file=said)
"""


@pytest.mark.slow
def test_files_stay_together_and_those_of_real_time_too(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text((ROOT / "conftest.py").read_text(encoding="utf-8"))
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = realtime\n")
    said = tmp_path / "said"
    (tmp_path / "tests").mkdir()
    shutil.copy(ROOT / "orphans.py", tmp_path / "tests")
    for name in ("a", "b", "real", "true"):
        mark = "[]" if name in ("a", "b") else "pytest.mark.realtime"
        (tmp_path / f"test_{name}.py").write_text(TESTS.format(mark=mark, said=said, name=name))
    options = ["-n", "4", "--no-loadscope-reorder", "-q"]
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST_")}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    workers: dict[str, set[str]] = {}
    for line in said.read_text().splitlines():
        name, worker = line.split()
        workers.setdefault(name, set()).add(worker)
    assert {name: len(seen) for name, seen in workers.items()} == {
        "a": 1,
        "b": 1,
        "real": 1,
        "true": 1,
    }
    assert workers["real"] == workers["true"]
    assert not workers["real"] & (workers["a"] | workers["b"])
