"""`rig compare --against`: parameters over what surrounded the runs."""

import json
from pathlib import Path

import pytest

from processing.ambient import AmbientConditions
from processing.errors import ConfigurationError, RecordError
from rig.analysis.air import ambient_warnings
from rig.report.comparison import compare
from tests.rig.report.test_compare import session


def at_humidities(folder: Path, percent: list[float | None]) -> Path:
    """A session whose c rises by 2e-10 with each per cent, with a scatter of 1e-11."""
    made = session(folder)
    tree = json.loads((made / "results.json").read_text())
    tree["runs"] = []
    for number, humidity in enumerate(percent):
        c = 1e-8 + 2e-10 * ((humidity or 0.0) - 40) + 1e-11 * (-1) ** number
        exact = {"c": {"value": c, "standard_uncertainty": 2e-11}}
        exact["b"] = {"value": 3.7e-3 + 1e-6 * (-1) ** number, "standard_uncertainty": 2e-6}
        run = {"record": f"run-{number + 1}.mcap", "fits": {"exact": exact}}
        tree["runs"].append(run | {"surroundings": {"humidity_percent": humidity}})
    (made / "results.json").write_text(json.dumps(tree))
    return made


@pytest.mark.usefixtures("figures")
def test_what_depends_on_the_humidity_is_seen(tmp_path: Path) -> None:
    folders = [
        at_humidities(tmp_path / "a", [35.0, 40.0, 45.0]),
        at_humidities(tmp_path / "b", [50.0, 55.0, None]),
    ]
    *_, table = compare(folders, tmp_path / "page.html", "humidity")
    assert [row[:3] for row in table.rows][-1] == ["b", "run-2.mcap", 55.0]
    assert len(table.rows) == 5
    by_name = {row[0]: row for row in table.shown}
    assert float(by_name["c"][1].split()[0]) == pytest.approx(2.0, rel=0.05)
    assert by_name["c"][3] == "1/%"
    assert float(by_name["b"][4]) > 0.2
    assert (tmp_path / "page" / "against.svg").stat().st_size > 10_000
    assert (tmp_path / "page" / "against.csv").read_text().startswith("series,run,humidity_percent,b,u_b")
    # one session is enough, and two runs make no line
    values, table = compare([at_humidities(tmp_path / "c", [35.0, 45.0])], None, "humidity_percent")
    assert values.name == "values"
    assert table.shown == []
    assert "too few" in table.note


def test_a_humidity_stated_as_a_fraction_is_said(tmp_path: Path) -> None:
    table = compare([at_humidities(tmp_path / "a", [41.0, 0.45, 50.0, 58.0])], None, "humidity")[-1]
    assert "humidity_percent is 0.45 of a run-2.mcap, and 41 to 58 of the other runs" in table.note
    assert (
        "another unit"
        not in compare([at_humidities(tmp_path / "b", [5.0, 45, 58])], None, "humidity")[-1].note
    )
    (doubt,) = ambient_warnings(AmbientConditions(humidity_percent=0.45))
    assert doubt.endswith("state humidity_percent = 45")


def test_what_is_not_known_is_said(tmp_path: Path) -> None:
    folder = at_humidities(tmp_path / "a", [35.0, None])
    with pytest.raises(
        ConfigurationError, match="--against wind: there is no such quantity; there are age, dwell"
    ):
        compare([folder], None, "wind")
    with pytest.raises(RecordError, match="--against humidity_percent: known for 1 of 2 fitted runs"):
        compare([folder], None, "humidity")
