"""All examples of docs/scripts.md run, and `import rig` loads nothing before it is used."""

import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig
from tests.rig.command_line import SAMPLES

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a session in runs/first."""
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "first")
    shutil.copytree(SAMPLES / "calibrations", tmp_path / "calibrations")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.usefixtures("figures")
def test_every_example_runs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    blocks = re.findall(
        r"^```python\n(.*?)^```$", (ROOT / "docs" / "scripts.md").read_text("utf-8"), re.M | re.S
    )
    assert len(blocks) >= 7
    names: dict[str, Any] = {}
    for block in blocks:
        exec(block, names)
    assert "run-7.mcap: no such record" in capsys.readouterr().out
    assert (folder / "decay.png").stat().st_size > 10_000
    assert names["deflections"].unit == "rad"
    assert len(names["deflections"]) == 594
    assert names["good"]["amplitude_rad"][0] == pytest.approx(118 * np.pi / 648000, rel=0.01)
    assert set(names["record"].events()["kind"]) >= {"start", "stop"}
    assert names["b"].value == pytest.approx(0.03, rel=0.02)
    assert names["b"].u_total > names["b"].u
    assert len(names["balance"]) == 10
    assert names["table"].fits["exact"].parameters["p"].value == pytest.approx(0.944, rel=0.01)
    assert np.sqrt(np.mean(names["pull"] ** 2)) == pytest.approx(1, abs=0.6)
    assert len(names["half_period_s"][0]) == len(names["exact"].index) - 1
    assert set(names["laws"].laws) == {"paper", "proportional"}
    assert names["laws"].laws["proportional"].parameters["k"].value == pytest.approx(0.05, rel=0.4)
    assert np.all(np.isfinite(names["own_curve"].amplitude_residual_rad))
    assert names["film"]["mean_period_s"].value == pytest.approx(1.3, rel=1e-4)
    assert names["film"].number("log_decrement").value == pytest.approx(0.026, rel=1e-2)
    reread = rig.read_results(folder / "robust.json")
    assert reread.runs[0].fits["exact"].parameters == names["again"].runs[0].fits["exact"].parameters


@pytest.mark.slow
@pytest.mark.usefixtures("figures")
def test_a_session_is_a_series(folder: Path) -> None:
    session = rig.open_session(folder / "runs" / "first")
    again = rig.fit(session)
    assert again.runs[0].sha256 == session.results.runs[0].sha256
    assert [row.quantity for row in again.runs[0].table] == [
        row.quantity for row in session.results.runs[0].table
    ]
    assert sum(1 for _ in session.records[0].windows()) == 594
    assert sum(1 for _ in session.records[0].images()) == 1
    assert set(rig.figures(again)) >= {"fig12-decay", "fig13-period", "table4-loops", "losses"}
    with pytest.raises(rig.RigError, match="run 2"):
        session.figures(2)
    with pytest.raises(rig.RigError, match="no such result; there are b, p"):
        session["bb"]
    # a session printed 86,826 characters
    for shown in (session, session.results, session.results.runs[0], session.records[0], session["b"]):
        assert len(repr(shown)) < 1500, type(shown)
    assert str(session["b"]) in repr(session)


def test_a_bound_is_one_in_python_too(measured_series: Path) -> None:
    """c was a bound on the terminal, and 4.7e-9 +- 4.5e-9 in Python."""
    session = rig.open_session(measured_series)
    assert {"time_ns", "period_ratio", "u_period_ratio"} <= set(session.records[0].balance().dtype.names)
    c = session["c"]
    assert c.verdict != "determined"
    assert np.isnan([c.value, c.u, c.u_total]).all()
    assert "95 %" in str(c)


UNCALIBRATED = SAMPLES / "uncalibrated" / "run-1.mcap"


def test_an_uncalibrated_record_says_px() -> None:
    record = rig.open_record(UNCALIBRATED)
    assert record.unit == record.deflections().unit == "px"
    assert "amplitude_px" in record.half_cycles().dtype.names


def test_what_is_not_meant_is_refused_in_one_line(tmp_path: Path) -> None:
    """A run that was named twice was two runs; a file of what is no results could not be read again."""
    results, path = rig.read_results(SAMPLES / "first"), tmp_path / "results.json"
    wrong: list[tuple[Callable[[], object], str]] = [
        (
            lambda: rig.fit([UNCALIBRATED, rig.open_record(UNCALIBRATED)]),
            r"holds the run of .*, which counts once",
        ),
        (lambda: rig.fit([]), "nothing is named"),
        (lambda: rig.fit(UNCALIBRATED, law="none"), "law: a function of the angle is needed, not 'none'"),
        (lambda: rig.curves(results), "an item of results.runs is needed, not a SessionResults"),
    ]
    not_results = (results.runs[0], {"a": 1}, None)
    said = "results: SessionResults are needed"
    wrong += [(partial(rig.write_results, path, given), said) for given in not_results]
    for call, said in wrong:
        with pytest.raises(rig.RigError, match=said):
            call()
    assert not path.exists()


def test_numbers_of_numpy_are_numbers() -> None:
    found = rig.fit(UNCALIBRATED.parent, {"fit.robust": np.bool_(True), "fit.u_ageing": np.float32(0.25)})
    assert found.runs[0].settings["robust"] is True
    assert found.runs[0].settings["u_ageing"] == 0.25


def decay(path: Path, name: str, growth_per_s: float = -0.01) -> Path:
    """A table of half a minute of a swing."""
    time_s = 0.05 * np.arange(600)
    swing = 10.0 * np.exp(growth_per_s * time_s) * np.cos(2.5 * time_s)
    swing += 0.01 * np.random.default_rng(1).standard_normal(len(time_s))
    np.savetxt(path, np.column_stack([time_s, swing]), delimiter=",", header=f"time_s,{name}", comments="")
    return path


def test_columns_are_named_as_a_text_or_a_number_and_tables_by_their_file(tmp_path: Path) -> None:
    table, named = decay(tmp_path / "decay.csv", "x"), [("time_s", "x"), (1, 2), (1, [2]), ("1", ["2"])]
    found = [rig.fit_table(table, "mm", time=time, positions=x) for time, x in ((None, ()), *named)]
    assert len({one["mean_period_s"].value for one in found}) == 1


def test_a_table_that_runs_backwards_is_said_to_be_no_decay(tmp_path: Path) -> None:
    found = rig.fit_table(decay(tmp_path / "back.csv", "x_mm", 0.01), "mm")
    assert "quality_factor" not in found.rows
    assert any("is no free decay; is time reversed" in warning for warning in found.runs[0].warnings)


def test_results_are_read_and_written_by_a_text_too(tmp_path: Path) -> None:
    found, path = rig.read_results(str(SAMPLES / "first")), str(tmp_path / "results.json")
    rig.write_results(path, found)
    with pytest.raises(rig.RigError, match="exists already and is not overwritten"):
        rig.write_results(path, found)


def test_every_name_is_there_and_no_other() -> None:
    for name in rig.__all__:
        assert getattr(rig, name).__doc__
    assert set(rig.__all__) <= set(dir(rig))
    text = (ROOT / "docs" / "scripts.md").read_text("utf-8")
    functions = {name for name in rig.__all__ if name.islower()}
    assert {name for name in functions if f"rig.{name}(" not in text} == set()
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = rig.nonsense


def test_importing_rig_loads_nothing_and_its_parts_nothing_that_takes_long() -> None:
    """The command line comes before numpy, which would start threads that cost a third of a fit."""
    modules = ("rig", "rig.cli", "rig.measure, rig.view")
    code = "import sys; " + "; ".join(f"import {names}; print(*sys.modules)" for names in modules)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    first, at_the_command_line, then = (set(line.split()) for line in done.stdout.splitlines())
    assert {"numpy", "pydantic", "matplotlib", "rig.scripting"}.isdisjoint(first)
    assert {"numpy", "rich.console"}.isdisjoint(at_the_command_line)
    late = {"scipy.stats", "scipy.signal", "scipy.optimize", "matplotlib", "rerun", "pyarrow"}
    assert late.isdisjoint(then)


def test_a_package_of_another_with_one_of_our_names_is_told(tmp_path: Path) -> None:
    (tmp_path / "processing").mkdir()
    (tmp_path / "processing" / "__init__.py").touch()
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import rig"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith(f"ImportError: the package 'processing' found first is {tmp_path}")
    assert "an environment of its own" in last
