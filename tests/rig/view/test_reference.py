"""The reference spot in the live view and in that of the record: one curve, from where it was found."""

from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from acquisition.record.topics import REFERENCE
from rig.view import show_records
from tests.rig.command_line import rig, set_words
from tests.rig.view.rrd_contents import entities, scalars

SHORT = {"session.max_duration_s": "12", "instrument.kind": '"tomlinson"'}
VAULT = Path(__file__).parents[3] / "configs" / "vault.toml"


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("vault")
    done = rig("run", VAULT, "-o", "out", *set_words(SHORT), cwd=folder)
    assert (folder / "out" / "run-1.rrd").exists(), done.stderr
    return folder / "out"


def test_live_and_recorded_curves_are_the_positions_of_the_record(measured: Path, tmp_path: Path) -> None:
    show_records([measured / "run-1.mcap"], rrd=tmp_path / "again.rrd")
    with RecordReader(measured / "run-1.mcap") as reader:
        spots = reader.table(REFERENCE.topic)
    for axis in ("x", "y"):
        times_s, values = scalars(tmp_path / "again.rrd", f"/reference/{axis}")
        rows = np.searchsorted(spots["time_ns"], spots["time_ns"][0] + np.rint(1e9 * times_s) - 1_000_000)
        expected = spots[f"{axis}_px"] - spots[f"{axis}_px"][0]
        assert values == pytest.approx(expected[rows], abs=1e-9)
        assert len(values) == pytest.approx(10 * times_s[-1], abs=2)
        live = scalars(measured / "run-1.rrd", f"/reference/{axis}")
        assert np.array_equal(live[1], values)
        assert live[0] == pytest.approx(times_s)


def test_a_rig_without_one_has_no_such_curve(tmp_path: Path) -> None:
    demo = VAULT.with_name("demo.toml")
    rig("run", demo, "-o", "out", *set_words(SHORT), cwd=tmp_path)
    assert not [path for path in entities(tmp_path / "out" / "run-1.rrd") if "reference" in path]
