"""Files that are no tables as they are read here: refused, never taken for text, and nothing in them runs."""

import gzip
import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import scipy
from pyarrow import feather, parquet

from processing.errors import DataError
from rig.intake.table import TableColumns

TIME_S = 0.05 * np.arange(200)
X = 10.0 * np.cos(2.0 * np.pi / 2.5 * TIME_S)


def _refused(path: Path, said: str) -> None:
    with pytest.raises(DataError, match=said):
        TableColumns().read(path)


def test_a_file_of_another_program_is_never_taken_for_text(tmp_path: Path) -> None:
    table = pa.table({"time_s": TIME_S, "x_mm": X})
    parquet.write_table(table, tmp_path / "a.parquet")
    feather.write_feather(table, tmp_path / "a.feather")
    # by what it is, whatever it is called
    (tmp_path / "b.csv").write_bytes((tmp_path / "a.parquet").read_bytes())
    (tmp_path / "packed.csv").write_bytes(gzip.compress(b"0,1\n1,2\n"))
    (tmp_path / "wide.txt").write_bytes("0 1\n1 2\n".encode("utf-32"))
    for name in ("a.parquet", "a.feather", "b.csv", "packed.csv", "wide.txt"):
        _refused(tmp_path / name, "is no text; save the table as text")
    (tmp_path / "a.jsonl").write_text(
        "".join(f'{{"t": {t}, "x": {x}}}\n' for t, x in zip(TIME_S, X, strict=True))
    )
    _refused(tmp_path / "a.jsonl", "holds 0 rows of numbers")


def test_nothing_pickled_is_unpacked(tmp_path: Path) -> None:
    """An array of objects runs what it likes when it is loaded."""

    class Planted:
        def __reduce__(self) -> tuple[object, tuple[Path, str]]:
            return Path.write_text, (tmp_path / "ran", "")

    for name in ("a.npy", "a.npz", "a.csv"):
        out = io.BytesIO()
        objects = np.array([Planted(), None], dtype=object)
        if name.endswith("npz"):
            np.savez(out, t=objects, x=X)
        else:
            np.save(out, objects, allow_pickle=True)
        (tmp_path / name).write_bytes(out.getvalue())
    _refused(tmp_path / "a.npy", "allow_pickle")
    for name in ("a.npz", "a.csv"):
        _refused(tmp_path / name, "is no text; save the table as text .* with that ending")
    assert not (tmp_path / "ran").exists()


def test_structs_of_matlab_are_named(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "struct.mat", {"run": {"t": TIME_S, "x": X}})
    _refused(tmp_path / "struct.mat", r"no arrays of real numbers: run\)")


@pytest.mark.parametrize("tick", ["ns", "us", "ms"])
def test_moments_of_numpy_are_moments(tmp_path: Path, tick: str) -> None:
    began = np.datetime64("2024-05-01T12:00:00", tick)
    steps = np.round(TIME_S * {"ns": 1e9, "us": 1e6, "ms": 1e3}[tick]).astype(f"m8[{tick}]")
    table = np.empty(len(X), dtype=[("time", f"M8[{tick}]"), ("x_mm", "f8")])
    table["time"], table["x_mm"] = began + steps, X
    table["time"][7] = np.datetime64("NaT")
    np.save(tmp_path / "decay.npy", table)
    found = TableColumns().read(tmp_path / "decay.npy")
    assert found.first_ns == 1_714_564_800_000_000_000
    assert len(found.times_ns) == len(X) - 1
    assert "left out: 1 rows without a readable time (line 9)" in found.understood
    np.testing.assert_allclose(found.times_ns * 1e-9, np.delete(TIME_S, 7), atol=1e-9)
