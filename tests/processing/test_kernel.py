"""Kernels are compiled once, kept while nothing that they use has changed, and work without a cache."""

import gc
import importlib
import json
import os
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numba.core.errors import TypingError
from numpy.typing import NDArray

from processing.kernel import at_compilation, kernel
from processing.kernel_compiler import cache_of
from tests.rig.long_record import make_long_record

ROOT = Path(__file__).parents[2]
OUTER = """
from processing.kernel import kernel
import inner_kernel
from inner_kernel import FACTOR, filled

@kernel
def outer(x, ways):
    '''Text.'''
    return FACTOR * inner_kernel.scaled(x, True) + inner_kernel.scaled(x, ways > 1) + 0.0 * filled(1)[0]
"""
INNER = """
import numpy as np
from processing.kernel import kernel

FACTOR = 10.0

@kernel
def filled(n):
    return np.full(n, FACTOR)

@kernel
def scaled(x, much):
    return 2.0 * x if much else x
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / "outer_kernel.py").write_text(OUTER)
    (tmp_path / "inner_kernel.py").write_text(INNER)
    monkeypatch.syspath_prepend(tmp_path)
    # two versions of a source may have the same size and time
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    yield tmp_path
    for name in ("outer_kernel", "inner_kernel"):
        sys.modules.pop(name, None)


def imported_again() -> ModuleType:
    for name in ("outer_kernel", "inner_kernel"):
        sys.modules.pop(name, None)
    importlib.invalidate_caches()
    return importlib.import_module("outer_kernel")


def compilations(module: ModuleType, ways: int = 1) -> tuple[float, list[bool]]:
    """Result of `outer`, and what was said of its compilation: one entry if it was compiled."""
    said: list[bool] = []
    with at_compilation(said.append):
        return module.outer(1.0, ways), said


def test_compiled_once_and_then_loaded(folder: Path) -> None:
    assert compilations(imported_again()) == (21.0, [True])
    assert compilations(imported_again()) == (21.0, [])


@pytest.mark.slow
def test_a_kernel_called_by_another_and_by_python_is_loaded_for_both(folder: Path) -> None:
    program = "import outer_kernel; print(outer_kernel.outer(1.0, 1), outer_kernel.filled(2).tolist())"
    for _ in range(2):  # compiled, then loaded in a process that has compiled nothing
        done = subprocess.run(
            [sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, check=True
        )
        assert done.stdout == "21.0 [10.0, 10.0]\n"


@pytest.mark.parametrize(
    ("name", "old", "new", "result"),
    [
        ("inner_kernel", "2.0 * x", "3.0 * x", 31.0),
        ("inner_kernel", "FACTOR = 10.0", "FACTOR = 20.0", 41.0),
        ("outer_kernel", "FACTOR * inner", "FACTOR + inner", 13.0),
    ],
)
def test_compiled_again_after_a_change(folder: Path, name: str, old: str, new: str, result: float) -> None:
    assert compilations(imported_again()) == (21.0, [True])
    source = folder / f"{name}.py"
    source.write_text(source.read_text().replace(old, new))
    assert compilations(imported_again()) == (result, [True])


@pytest.mark.slow
def test_compiled_again_when_a_module_of_what_it_calls_is_gone(folder: Path) -> None:
    """As after an update of the program: the machine code names the modules that it was made from."""
    source = folder / "outer_kernel.py"
    source.write_text(
        "from processing.kernel import kernel\nfrom inner_kernel import filled\n\n"
        "@kernel\ndef outer(x, ways):\n    return 2.1 * filled(1)[0]\n"
    )
    assert compilations(imported_again()) == (21.0, [True])
    (folder / "inner_kernel.py").rename(folder / "moved_kernel.py")
    source.write_text(source.read_text().replace("inner_kernel", "moved_kernel"))
    done = subprocess.run(
        [sys.executable, "-B", "-c", "import outer_kernel; print(outer_kernel.outer(1.0, 1))"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "21.0\n", done.stderr


@pytest.mark.slow
def test_compiled_again_when_the_class_of_an_argument_is_gone(folder: Path) -> None:
    """As after an update of the program: the index of the machine code names the classes of arguments."""
    source = folder / "outer_kernel.py"
    source.write_text(
        "from typing import NamedTuple\nfrom processing.kernel import kernel\n\n"
        "class Pair(NamedTuple):\n    one: float\n    other: float\n\n"
        "@kernel\ndef outer(pair):\n    return pair.one * pair.other\n"
    )
    for name in ("Pair", "Couple"):
        source.write_text(source.read_text().replace("Pair", name))
        done = subprocess.run(
            [sys.executable, "-B", "-c", f"from outer_kernel import *; print(outer({name}(2.0, 10.5)))"],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.stdout == "21.0\n", done.stderr


def test_not_compiled_again_for_words(folder: Path) -> None:
    assert compilations(imported_again()) == (21.0, [True])
    for name, old, new in (("outer", "Text.", "Other text."), ("inner", "FACTOR =", "# why\nFACTOR =")):
        source = folder / f"{name}_kernel.py"
        source.write_text(source.read_text().replace(old, new))
    assert compilations(imported_again()) == (21.0, [])


def test_an_inner_kernel_is_compiled_for_types_and_not_for_values(folder: Path) -> None:
    module = imported_again()
    assert compilations(module, ways=2)[0] == 22.0
    assert len(module.inner_kernel.scaled.signatures) == 1


def test_garbage_is_collected_again_after_a_compilation_even_one_that_failed() -> None:
    seen: list[bool] = []

    def wrong(x: float) -> float:
        return x.nothing  # type: ignore[attr-defined,no-any-return]

    wrong.__code__ = wrong.__code__.replace(co_filename="<string>")  # nowhere to keep it
    with at_compilation(lambda _: seen.append(gc.isenabled())), pytest.raises(TypingError):
        kernel(wrong)(1.0)
    assert (seen, gc.isenabled()) == ([False], True)


def test_a_spoilt_cache_is_made_again(folder: Path) -> None:
    module = imported_again()
    assert compilations(module) == (21.0, [True])
    for path in Path(module.outer.stats.cache_path).glob("outer_kernel*.nb?"):
        path.write_bytes(b"")
    assert compilations(imported_again()) == (21.0, [True])
    assert compilations(imported_again()) == (21.0, [])


LITTLE_SPACE = """
import resource, outer_kernel
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
print(outer_kernel.outer(1.0, 1))
"""


@pytest.mark.slow
def test_code_that_was_not_kept_is_not_taken_for_what_was_kept_before(folder: Path) -> None:
    """A disk may have room for the cache's index and not for the machine code."""
    assert compilations(imported_again()) == (21.0, [True])
    source = folder / "outer_kernel.py"
    source.write_text(source.read_text().replace("FACTOR * inner", "FACTOR + inner"))
    done = subprocess.run(
        [sys.executable, "-B", "-c", LITTLE_SPACE], cwd=folder, capture_output=True, text=True, check=True
    )
    assert done.stdout == "13.0\n"
    assert compilations(imported_again()) == (13.0, [True])
    assert compilations(imported_again()) == (13.0, [])
    # what can no longer be loaded is deleted
    assert len(list(folder.rglob("outer_kernel.outer*.nbc"))) == 1


def test_two_processes_that_keep_code_at_once_keep_it_apart(folder: Path) -> None:
    """Both have found the cache empty before one of them has kept code for other types than the other."""
    one, other, reader = (cache_of(imported_again().outer.py_func, {})._cache_file for _ in range(3))
    found = other._load_index()
    one.save("types", "code")
    other._load_index = lambda: found
    other._save_data = full_disk
    with pytest.raises(OSError, match="full"):
        other.save("other types", "other code")
    assert reader.load("other types") is None


AT_ONCE = """
import outer_kernel
print("ready", flush=True)
input()
result, stats = outer_kernel.outer(1.0, 1), outer_kernel.outer.stats
print(result, sum(stats.cache_misses.values()), sum(stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_processes_that_need_a_kernel_at_once_compile_it_once(folder: Path) -> None:
    running = [
        subprocess.Popen(
            [sys.executable, "-B", "-c", AT_ONCE],
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(3)
    ]
    for process in running:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in running:
        assert process.stdin is not None
        process.stdin.write("\n")
        process.stdin.flush()
    said = sorted(process.communicate()[0] for process in running)
    assert said == ["21.0 0 1\n", "21.0 0 1\n", "21.0 1 0\n"]


def test_an_error_of_a_kernel_within_another_names_its_values(folder: Path) -> None:
    """Where it is compiled, and where it is loaded."""
    (folder / "inner_kernel.py").write_text(
        INNER
        + "\n@kernel\ndef root(x):\n    if x < 0.0:\n        raise ValueError('of', x)\n    return x**0.5\n"
    )
    (folder / "outer_kernel.py").write_text(
        "from processing.kernel import kernel\nfrom inner_kernel import root\n\n"
        "@kernel\ndef outer(x, ways):\n    return root(x) + root(x + ways)\n"
    )
    for _ in range(2):
        module = imported_again()
        assert module.outer(4.0, 5) == 5.0
        with pytest.raises(ValueError, match=r"'of', -2\.0"):
            module.outer(-2.0, 1)


def full_disk(name: str, data: object) -> None:
    raise OSError("full")


@pytest.fixture
def for_everyone() -> Iterator[Path]:
    """A folder that another user can enter, which pytest's own are not."""
    folder = Path(tempfile.mkdtemp(prefix="kernels-"))
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


def as_nobody(*command: str) -> list[str]:
    """A command line for a user who may write nowhere: permissions do not bind root."""
    if os.geteuid() != 0:
        return list(command)
    if shutil.which("setpriv") is None:
        pytest.skip("root may write everywhere, and setpriv is not installed")
    return ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", "--no-new-privs", *command]


def locked(folder: Path) -> Path:
    for path in [folder, *folder.rglob("*")]:
        path.chmod(path.stat().st_mode & ~(stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH))
    return folder


PROGRAM = """
import json, outer_kernel
from processing.kernel import at_compilation
from tests.rig.long_record import make_long_record
said = []
with at_compilation(said.append):
    result = outer_kernel.outer(1.0, 1)
print(json.dumps([result, said]))
"""


def run_as_nobody(folder: Path, *words: str) -> str:
    """What a python prints that may write nowhere; it finds modules in this folder first."""
    done = subprocess.run(
        as_nobody(sys.executable, "-B", *words),
        cwd=folder,
        env={
            "PATH": os.environ["PATH"],
            "HOME": str(folder),
            "NUMBA_OPT": "0",  # what is compiled is not asked to be fast
            "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)]),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0 and "Permission denied" in done.stderr and "python" in done.stderr.split("\n")[0]:
        pytest.skip(f"another user cannot run this python: {done.stderr.splitlines()[0]}")
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


@pytest.mark.slow
def test_works_where_nothing_can_be_written(for_everyone: Path) -> None:
    (for_everyone / "outer_kernel.py").write_text(OUTER)
    (for_everyone / "inner_kernel.py").write_text(INNER)
    locked(for_everyone)
    assert json.loads(run_as_nobody(for_everyone, "-c", PROGRAM)) == [21.0, [False]]


@pytest.fixture
def sources(for_everyone: Path) -> Path:
    """A copy of the program that nobody can write, with a folder for records that everybody can."""
    for name in ("rig", "acquisition", "calibration", "processing", "configs"):
        shutil.copytree(ROOT / name, for_everyone / name, ignore=shutil.ignore_patterns("__pycache__"))
    locked(for_everyone)
    for_everyone.chmod(0o755)
    (for_everyone / "records").mkdir()
    (for_everyone / "records").chmod(0o777)
    return for_everyone


def test_a_record_is_shown_where_no_cache_can_be_written(sources: Path) -> None:
    record = make_long_record(sources / "records" / "run.mcap", 200)
    record.chmod(0o644)
    assert "full_scale_dn" in run_as_nobody(sources, "-m", "rig", "record", "info", "records/run.mcap")


def test_threads_that_first_call_a_kernel_at_the_same_time_get_the_same_code() -> None:
    @kernel
    def total(values: NDArray[np.float64]) -> float:
        found = 0.0
        for value in values:
            found += value
        return found

    together = threading.Barrier(3)

    def call() -> float:
        together.wait(30.0)
        return float(total(np.ones(4)))

    with ThreadPoolExecutor(3) as threads:
        done = [threads.submit(call) for _ in range(3)]
        assert [one.result(60.0) for one in done] == [4.0, 4.0, 4.0]
    assert sum((total.stats.cache_misses + total.stats.cache_hits).values()) == 1


@kernel
def _sums(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    return float(x.sum()), x.copy()


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="timers are those of POSIX")
def test_an_interrupt_in_a_kernel_that_makes_arrays_is_an_interrupt() -> None:
    """Ctrl-C comes up while numba hands the arrays over, which it calls an error of its own."""
    x = np.ones(200)
    _sums(x)

    class Pressed(KeyboardInterrupt):
        pass

    def press(*_: object) -> None:
        raise Pressed

    before = signal.signal(signal.SIGVTALRM, press)
    pressed = 0
    try:
        for after_us in range(10, 210):
            try:
                signal.setitimer(signal.ITIMER_VIRTUAL, 1e-6 * after_us)
                while True:
                    _sums(x)
            except Pressed:
                pressed += 1
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)
    assert pressed == 200
