"""Several runs in one table, several films in one folder: what was found is said, one is chosen, or all."""

import re
from pathlib import Path

import numpy as np
import pytest

from processing.errors import ConfigurationError, DataError
from rig.analysis import read_results
from rig.archive.session_rows import session_rows
from rig.intake.table import TableColumns
from tests.acquisition.cameras.made_films import Film, write_film
from tests.rig.analysis.test_tables import ring_downs
from tests.rig.command_line import rig
from tests.rig.intake.test_film_positions import swing

DECREMENTS = (0.2, 0.3)


def columns(decrement: float) -> tuple[np.ndarray, np.ndarray]:
    t, y = ring_downs([1.0], [10.0], decrement)
    return np.round(t[50:1050], 6), y[50:1050]


def block(decrement: float, run: str = "", offset_s: float = 0.0) -> list[str]:
    front = f"{run}," if run else ""
    return [f"{front}{t + offset_s:.3f},{y:.6f}" for t, y in zip(*columns(decrement), strict=True)]


ONE, TWO = (block(decrement) for decrement in DECREMENTS)
NUMBERED = [line for k, d in enumerate(DECREMENTS, 1) for line in block(d, str(k))]
TITLED = ["t,x", *ONE]
MIXED = [line for pair in zip(block(0.2, "1"), block(0.3, "2"), strict=True) for line in pair]
FILES = {
    "a column": ["run,time,x", *NUMBERED],
    "a column of words": [
        "time,x,Lauf",
        *(f"{line},brass" for line in ONE),
        *(f"{line},steel" for line in TWO),
    ],
    "a column, times go on": ["Run #,t,x", *block(0.2, "1"), *block(0.3, "2", offset_s=100.0)],
    "mixed rows": ["run,t,x", *MIXED],
    "a blank line": [*ONE, "", *TWO],
    "two blank lines and a header again": [*TITLED, "", "", "t,x", *TWO],
    "a header again": [*TITLED, "t,x", *TWO],
    "a title": [*TITLED, "Run 2", *TWO],
    "a comment": [*TITLED, "# run 2", *TWO],
}  # fmt: skip


def table(folder: Path, lines: list[str]) -> Path:
    path = folder / "runs.csv"
    path.write_text("\n".join(lines))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_each_run_is_read_by_itself(tmp_path: Path, name: str) -> None:
    path = table(tmp_path, FILES[name])
    runs = TableColumns(unit="mm").read_runs(path)
    assert len(runs) == 2
    for run, decrement in zip(runs, DECREMENTS, strict=True):
        t, y = columns(decrement)
        assert np.allclose(run.times_ns * 1e-9, t - t[0], atol=1e-6)
        assert np.allclose(run.positions[0], y, atol=1e-6)
        assert any(
            line.startswith("2 runs, told apart by") and f"this is {run.run}" in line
            for line in run.understood
        )
        chosen = TableColumns(unit="mm", run=run.run).read(path)
        assert np.array_equal(chosen.positions[0], run.positions[0])
    with pytest.raises(ConfigurationError, match=r"2 runs, told apart by .*; choose one with --run"):
        TableColumns().read(path)
    with pytest.raises(ConfigurationError, match=r"--run 7: is not there; 2 runs, told apart by"):
        TableColumns(run="7").read(path)


def test_one_run_is_not_cut_into_several(tmp_path: Path) -> None:
    for lines in (
        ["t,x", *ONE[:500], "", *ONE[500:]],
        ["run,t,x", *(f"1,{line}" for line in ONE)],
        ["run,t,x", *(f"{k},{line}" for k, line in enumerate(ONE))],
        [line for row in ONE for line in (row, "")],
    ):
        path = table(tmp_path, lines)
        (run,) = TableColumns().read_runs(path)
        assert len(run.times_ns) == len(ONE)
    with pytest.raises(ConfigurationError, match="holds one run; leave the option out"):
        TableColumns(run="2").read(path)


def test_without_times_blank_lines_part_runs_and_spoilt_rows_do_not(tmp_path: Path) -> None:
    values = [f"{y:.6f}" for y in columns(0.2)[1]]
    path = table(tmp_path, [*values, "", *values[:900]])
    assert [len(run.times_ns) for run in TableColumns(rate_hz=50.0).read_runs(path)] == [len(values), 900]
    for between in (["1,2,3"], []):
        path = table(tmp_path, [*values[:400], *between, *values[400:]])
        assert [len(run.times_ns) for run in TableColumns(rate_hz=50.0).read_runs(path)] == [len(values)]


def test_rows_of_no_run_and_spoilt_rows_are_counted_where_they_are(tmp_path: Path) -> None:
    lines = ["run,t,x", *NUMBERED]
    lines[5] = ",0.08,1.0"
    lines[2000] = "2,broken"
    first, second = (" ".join(run.understood) for run in TableColumns().read_runs(table(tmp_path, lines)))
    assert "left out: 1 rows that are of no run" in first
    assert (first + second).count("1 rows without the right number of columns (line 2001)") == 1
    # times that begin again without a word
    with pytest.raises(DataError, match="several runs need a blank line between them or a column 'run'"):
        TableColumns().read_runs(table(tmp_path, [*ONE, *TWO]))


@pytest.mark.slow
def test_every_run_of_a_table_gets_a_folder_like_that_of_a_session(tmp_path: Path) -> None:
    path = table(tmp_path, FILES["a column"])
    done = rig("fit", path, "--unit", "mm", "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "2 runs, told apart by the column run: 1 (1000 rows), 2 (1000 rows); this is 2" in done.stdout
    for number, decrement in enumerate(DECREMENTS, 1):
        value, u = read_results(tmp_path / "out" / f"run-{number}")["log_decrement"]
        assert abs(value - decrement) < 4 * u
        page = (tmp_path / "out" / f"run-{number}" / "report.html").read_text()
        assert f"runs.csv, run {number}" in page
        (row,) = session_rows(tmp_path / "out" / f"run-{number}")[0]
        assert (row["run"], row["state"]) == (f"runs-run-{number}", "whole")
    again = rig("fit", path, "--unit", "mm", "-o", tmp_path / "out")
    assert again.returncode != 0
    assert "run-1/results.json: exists already" in again.stderr
    compared = rig("compare", tmp_path / "out" / "run-1", tmp_path / "out" / "run-2")
    assert compared.returncode == 0, compared.stderr
    assert "log decrement" in compared.stdout
    for number, decrement in enumerate(DECREMENTS, 1):
        assert re.search(rf"^run-{number}/\S+ .* {decrement:.1f}\d+ ± ", compared.stdout, re.MULTILINE)


def test_a_run_without_a_decay_does_not_keep_the_others_from_theirs(tmp_path: Path) -> None:
    rest = [f"{0.02 * k:.3f},0.0" for k in range(500)]
    done = rig("fit", table(tmp_path, [*ONE, "", *rest]), "--unit", "mm", "-o", tmp_path / "out")
    assert done.returncode == 1
    assert "not analysed: " in done.stdout
    assert len(read_results(tmp_path / "out" / "run-1").runs) == 1


@pytest.mark.slow
def test_the_films_of_a_folder_are_runs(tmp_path: Path) -> None:
    films = tmp_path / "films"
    films.mkdir()
    for name in ("swing10.mkv", "swing9.mkv"):
        write_film(films / name, swing(count=200), Film())
    (films / "notes.txt").write_text("two swings")
    done = rig("fit", films, "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert f"{films}: 2 films: swing9.mkv, swing10.mkv" in done.stdout
    results = [read_results(tmp_path / "out" / name) for name in ("swing9", "swing10")]
    assert tuple(results[0]["mean_period_s"]) == tuple(results[1]["mean_period_s"])
    for word in ("2", "swing10", "swing10.mkv"):
        one = rig("fit", films, "--run", word)
        assert one.returncode == 0, one.stderr
        assert f"{films / 'swing10.mkv'}: 200 samples" in one.stdout
    refused = rig("fit", films, "--run", "3")
    assert "holds no such film; there are swing9.mkv, swing10.mkv" in refused.stderr
    assert "leave the option out" in rig("fit", films / "swing9.mkv", "--run", "1").stderr
