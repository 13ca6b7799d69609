"""What runs in which worker of pytest-xdist: a file in one, all that measures real time in one."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from tests.conftest import FileByFile

REAL = "import pytest\npytestmark = pytest.mark.realtime\n"


class Worker:
    """One of xdist's, which notes what it is given."""

    def __init__(self, name: str) -> None:
        self.gateway = SimpleNamespace(id=name)
        self.workerinput: dict[str, Any] = {}
        self.shutting_down = False
        self.given: list[int] = []

    def send_runtest_some(self, indices: list[int]) -> None:
        self.given += indices

    def shutdown(self) -> None:
        self.shutting_down = True


def test_files_stay_together_and_those_of_real_time_too(tmp_path: Path) -> None:
    for name, text in (("a", ""), ("b", ""), ("real", REAL), ("true", REAL)):
        (tmp_path / f"test_{name}.py").write_text(text)
    tests = [f"test_{name}.py::test[{number}]" for name in ("a", "real", "b", "true") for number in range(4)]
    option = SimpleNamespace(tx=["popen"] * 4, maxschedchunk=None, loadscopereorder=False, debug=False)
    config: Any = SimpleNamespace(
        rootpath=tmp_path, option=option, getvalue=lambda name: getattr(option, name)
    )
    scheduler = FileByFile(config, None)
    workers: list[Any] = [Worker(f"gw{number}") for number in range(4)]
    for worker in workers:
        scheduler.add_node(worker)
        scheduler.add_node_collection(worker, tests)
    scheduler.schedule()
    for worker in workers:
        for index in worker.given:
            scheduler.mark_test_complete(worker, index)
    of_file: dict[str, set[str]] = {}
    for worker in workers:
        for index in worker.given:
            of_file.setdefault(tests[index].partition("::")[0], set()).add(worker.gateway.id)
    assert {name: len(seen) for name, seen in of_file.items()} == dict.fromkeys(
        ("test_a.py", "test_b.py", "test_real.py", "test_true.py"), 1
    )
    assert of_file["test_real.py"] == of_file["test_true.py"]
    assert not of_file["test_real.py"] & (of_file["test_a.py"] | of_file["test_b.py"])
