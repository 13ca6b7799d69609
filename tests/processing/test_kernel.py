"""Kernels are compiled once, kept while nothing that they use has changed, and work without a cache."""

import gc
import importlib
import signal
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

from processing.kernel import kernel, notify_of_compilation
from processing.kernel_compiler import locked
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


def printed(folder: Path, program: str) -> str:
    """What another process prints, which finds the kernels of the folder."""
    done = subprocess.run(
        [sys.executable, "-B", "-c", program], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def compilations(module: ModuleType, ways: int = 1) -> tuple[float, list[bool]]:
    """Result of `outer`, and what was said of its compilation: one entry if it was compiled."""
    said: list[bool] = []
    with notify_of_compilation(said.append):
        return module.outer(1.0, ways), said


def test_compiled_again_after_a_change_and_not_for_words(folder: Path) -> None:
    assert compilations(imported_again()) == (21.0, [True])
    for name, old, new, result in (
        ("outer_kernel", "Text.", "Other text.", 21.0),
        ("inner_kernel", "FACTOR =", "# why\nFACTOR =", 21.0),
        ("inner_kernel", "2.0 * x", "3.0 * x", 31.0),
        ("inner_kernel", "FACTOR = 10.0", "FACTOR = 20.0", 61.0),
        ("outer_kernel", "FACTOR * inner", "FACTOR + inner", 24.0),
    ):
        source = folder / f"{name}.py"
        source.write_text(source.read_text().replace(old, new))
        assert compilations(imported_again()) == (result, [True] if result != 21.0 else [])


CALLING_AND_CALLED = """
import sys
from typing import NamedTuple
from inner_kernel import filled
from processing.kernel import notify_of_compilation, kernel

class Pair(NamedTuple):
    one: float
    other: float

@kernel
def outer(x):
    return x * filled(1)[0]

@kernel
def product(pair):
    return pair.one * pair.other

said = []
with notify_of_compilation(said.append):
    print(outer(2.1), filled(2).tolist(), product(Pair(2.0, 10.5)), len(said))
# what only compiles
print('numba.np.arraymath' in sys.modules)
"""


@pytest.mark.slow
def test_loaded_in_another_process_and_compiled_again_when_what_the_machine_code_names_is_gone(
    folder: Path,
) -> None:
    """One is called by another and by Python; code names modules of what it calls, classes of arguments."""
    (folder / "moved_kernel.py").write_text(INNER)
    moved = CALLING_AND_CALLED.replace("inner_kernel", "moved_kernel").replace("Pair", "Couple")
    for text, compiled in ((CALLING_AND_CALLED, 1), (CALLING_AND_CALLED, 0), (moved, 1)):
        (folder / "outer_kernel.py").write_text(text)
        wanted = f"21.0 [10.0, 10.0] 21.0 {compiled}\n{compiled > 0}\n"
        assert printed(folder, "import outer_kernel") == wanted
        if not compiled:
            (folder / "inner_kernel.py").unlink()


def test_an_inner_kernel_is_compiled_for_types_and_not_for_values(folder: Path) -> None:
    module = imported_again()
    assert compilations(module, ways=2)[0] == 22.0
    assert len(module.inner_kernel.scaled.signatures) == 1


def test_garbage_is_collected_again_after_a_compilation_even_one_that_failed() -> None:
    seen: list[bool] = []

    def wrong(x: float) -> float:
        return x.nothing  # type: ignore[attr-defined,no-any-return]

    wrong.__code__ = wrong.__code__.replace(co_filename="<string>")  # nowhere to keep it
    with notify_of_compilation(lambda _: seen.append(gc.isenabled())), pytest.raises(TypingError):
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
    assert printed(folder, LITTLE_SPACE) == "13.0\n"
    assert compilations(imported_again()) == (13.0, [True])
    assert compilations(imported_again()) == (13.0, [])
    # what can no longer be loaded is deleted
    assert len(list(folder.rglob("outer_kernel.outer*.nbc"))) == 1


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
        for _ in range(2)
    ]
    assert [process.stdout.readline() for process in running] == 2 * ["ready\n"]
    said = sorted(process.communicate("\n")[0] for process in running)
    assert said == ["21.0 0 1\n", "21.0 1 0\n"]


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


def test_works_where_nothing_can_be_written(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """numba tries a folder by a temporary file in it."""

    def refused(*_: object, **__: object) -> None:
        raise PermissionError("read-only")

    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    assert compilations(imported_again()) == (21.0, [False])
    assert not list(folder.rglob("*.nb?"))


def test_what_calls_no_kernel_does_not_import_numba(tmp_path: Path) -> None:
    record = make_long_record(tmp_path / "run.mcap", 20)
    program = (
        f"import sys; sys.argv = ['rig', 'record', 'info', {str(record)!r}]\n"
        "from rig.cli import main\n"
        "try:\n    main()\nfinally:\n    print('numba' in sys.modules)"
    )
    assert printed(ROOT, program).splitlines()[-1] == "False"


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
        for after_us in range(10, 210, 4):
            try:
                signal.setitimer(signal.ITIMER_VIRTUAL, 1e-6 * after_us)
                while True:
                    _sums(x)
            except Pressed:
                pressed += 1
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)
    assert pressed == 50


HOLDER = """
import sys
from pathlib import Path
from processing.kernel_compiler import locked
with locked(Path(sys.argv[1]), lambda: None):
    print("held", flush=True)
    input()
"""


def test_a_lock_is_waited_for_until_its_process_is_killed_and_done_without_where_it_has_no_place(
    tmp_path: Path,
) -> None:
    path = tmp_path / "lock"
    other = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout.readline() == "held\n"
    waits: list[bool] = []

    def kill() -> None:
        waits.append(other.poll() is None)
        threading.Timer(0.3, other.kill).start()

    with other, locked(path, kill):
        assert other.wait(30.0) != 0
    assert waits == [True]
    with locked(tmp_path / "none" / "lock", lambda: waits.append(False)):
        assert not (tmp_path / "none").exists()
    assert waits == [True]
