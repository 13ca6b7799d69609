"""Tables of other instruments are reported as records are: decays apart, means that change, formats."""

import re
import textwrap
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from processing.decay_summary import summarise_decay
from processing.errors import ConfigurationError, DataError
from processing.swing import turning_points
from processing.unsigned import unsigned_period_s
from rig.intake.table import TableColumns
from rig.settings import Configuration
from tests.rig.command_line import rig
from tests.rig.intake.table_cases import analyse_table

PAGE = Path(__file__).resolve().parents[3] / "docs" / "other-data.md"


def write(path: Path, *columns: np.ndarray, separator: str = " ") -> Path:
    rows = (separator.join(f"{value:.9g}" for value in row) for row in zip(*columns, strict=True))
    path.write_text("\n".join(rows))
    return path


def ring_downs(starts_s: list[float], amplitudes: list[float], decrement: float) -> tuple[np.ndarray, ...]:
    """Swings of a period of 2 s, pushed in the middle of a rest or of a swing."""
    t = np.arange(0.0, starts_s[-1] + 40.0, 0.02)
    y = 0.01 * np.random.default_rng(1).standard_normal(len(t))
    for start, amplitude in zip(starts_s, amplitudes, strict=True):
        since = np.maximum(t - start, 0.0)
        y += amplitude * np.exp(-0.5 * decrement * since) * np.sin(np.pi * since)
    return t, y


def test_decays_after_one_another_are_found_and_each_is_analysed(tmp_path: Path) -> None:
    t, y = ring_downs([1.0, 41.0, 79.5], [10.0, 8.0, 12.0], 0.2)
    found = analyse_table(write(tmp_path / "three.txt", t, y), None, TableColumns(unit="mm"))
    assert len(found.runs) == 3
    for decay, start in zip(found.runs, (1.0, 41.0, 79.5), strict=True):
        assert decay.decay is not None
        assert start < decay.decay.began_s < start + 8.0
        for name, true in (("log_decrement", 0.2), ("mean_period_s", 2.0)):
            value, u = decay[name]
            assert abs(value - true) < 4 * u, name
    assert found.longest.half_cycles == max(decay.half_cycles for decay in found.runs)


def test_a_real_ring_down_that_is_excited_twice(tmp_path: Path, shared_data: Path) -> None:
    """The real file, then itself again: two decays, each with the decrement of the one."""
    table = np.genfromtxt(shared_data / "ringdown" / "seismometer-11mm.txt", skip_header=2)[:1050]
    times_s = np.concatenate([table[:, 0], table[:, 0] + 105.0])
    path = write(tmp_path / "twice.txt", times_s, np.tile(table[:, 1], 2))
    found = analyse_table(path, None, TableColumns(unit="V"))
    assert len(found.runs) == 2
    for decay in found.runs:
        assert decay.number("log_decrement").value == pytest.approx(0.5, abs=0.08)
        # the period is not the same all along, and its uncertainty says so
        assert 5 * decay.number("mean_period_s").standard_uncertainty > 17.2 - 14.7
        assert any("period is not constant" in warning for warning in decay.warnings)
        # 0.61(14) at the start and 0.42(9) at the end: a quality factor with an uncertainty that holds both
        assert not any("decrement is not constant" in warning for warning in decay.warnings)
        assert "quality_factor" in decay.rows
        assert 5 * decay.number("log_decrement").standard_uncertainty > 0.61 - 0.42


def test_a_real_pendulum_whose_period_depends_on_the_amplitude(shared_data: Path) -> None:
    path = shared_data / "ringdown" / "camera-tracked-pendulum.txt"
    (decay,) = analyse_table(path, None, TableColumns(positions=("2", "3"), unit="rad")).runs
    period = summarise_decay(turning_points(decay.detected_half_cycles)).period_s
    assert period.changes
    # of a circular pendulum T rises by A^2/16; means of the first and last third
    assert period.first / period.last == pytest.approx((1 + 0.58**2 / 16) / (1 + 0.26**2 / 16), abs=3e-3)
    assert decay.number("mean_period_s").standard_uncertainty > 0.3 * (period.first - period.last)
    printed = rig("fit", path, "--position", "2", "--position", "3", "--unit", "rad").stdout
    assert re.search(
        r"period is not constant \(χ²/dof 1\.5.*: 1\.66\d+ s over the .*, 1\.63\d+ s over", printed
    )


def test_absolute_times_keep_every_nanosecond(tmp_path: Path) -> None:
    start = 1_763_800_000_123_456_789
    (tmp_path / "t.csv").write_text("".join(f"{start + 1001 * i},{i % 2}\n" for i in range(9)))
    found = TableColumns(None, (), "V", "ns").read(tmp_path / "t.csv")
    assert found.times_ns.tolist() == [1001 * i for i in range(9)]


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (["1e300", "1e308", "inf"], "which no decay lasts; state their unit"),
        (["5", "5", "5"], "time does not increase"),
        (["-1e308", "1e308"], "which no decay lasts"),
    ],
)
def test_columns_that_are_no_times(tmp_path: Path, times: list[str], words: str) -> None:
    (tmp_path / "t.csv").write_text("".join(f"{time} {i}\n" for i, time in enumerate(times)))
    with pytest.raises(DataError, match=words):
        TableColumns(None, (), "V", "s").read(tmp_path / "t.csv")


@pytest.mark.slow
def test_the_page_on_tables_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every example makes its file and fits it, and the program prints what the page says."""
    monkeypatch.chdir(tmp_path)
    text = PAGE.read_text(encoding="utf-8").partition("\n## A table\n")[2].partition("\n## ")[0]
    fitted = 0
    for block in re.findall(r"^```(\w*)\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        if block[0] == "python":
            exec(textwrap.dedent(block[1]), {})
            continue
        printed = ""
        for line in block[1].splitlines():
            if line.startswith("$ rig "):
                done = rig(*line.split()[2:])
                assert done.returncode == 0, done.stderr
                printed, fitted = " ".join(done.stdout.split()), fitted + 1
            elif line.strip() not in ("", "..."):
                assert " ".join(line.split()) in printed, printed
    assert fitted >= 5


@pytest.mark.parametrize(
    ("unit", "problem"),
    [
        ("rad", "the pendulum is not described; --config FILE"),
        ("", "the unit of the position is not stated"),
        ("mm", "the laws need an angle, but the unit is 'mm'"),
        ("radd", "did you mean rad?"),
    ],
)
def test_what_the_laws_lack_is_said(tmp_path: Path, unit: str, problem: str) -> None:
    t, y = ring_downs([1.0], [10.0], 0.2)
    path = write(tmp_path / "one.txt", t, 1e-4 * y if unit == "rad" else y)
    found = analyse_table(path, None, TableColumns(unit=unit) if unit else TableColumns())
    assert problem in found.runs[0].problem
    assert not found.runs[0].fits


def _decaying(period_s: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    """A swing of 20, decaying with 50 s, every 50 ms; its noise is 0.01."""
    t = 0.05 * np.arange(1200)
    noise = 0.01 * np.random.default_rng(3).standard_normal(len(t))
    return t, 20.0 * np.exp(-t / 50.0) * np.cos(2.0 * np.pi * t / period_s + 0.3) + noise


@pytest.mark.parametrize("per_s", [1e3, 1e9, 20.0, 1 / 60], ids=["ms", "ns", "rows", "minutes"])
def test_times_of_no_unit_that_are_strange_in_seconds_are_asked_for(tmp_path: Path, per_s: float) -> None:
    t, x = _decaying()
    path = write(tmp_path / "t.csv", np.round(t * per_s) if per_s > 1.0 else t * per_s, x)
    with pytest.raises((ConfigurationError, DataError), match=r"unit.*--time-unit"):
        analyse_table(path, None, TableColumns(unit="mm"))
    # a torsion balance, of which it is said
    found = analyse_table(path, None, TableColumns(unit="mm", time_unit="s" if per_s < 1e9 else "ns"))
    assert found.longest.number("mean_period_s").value == pytest.approx(
        2.0 * per_s * (1.0 if per_s < 1e9 else 1e-9), rel=1e-3
    )


@pytest.mark.parametrize(
    "unsigned",
    [
        pytest.param(np.abs, id="|x|"),
        pytest.param(lambda x: 50.0 - np.abs(x), id="a distance that grows as |x| falls"),
        pytest.param(np.square, id="x²"),
        pytest.param(lambda x: 1e3 * np.cos(np.radians(x)), id="the cosine of an angle"),
        pytest.param(lambda x: np.hypot(50.0, x), id="the distance to a point beside the swing"),
        pytest.param(lambda x: np.exp(-((x / 10.0) ** 2)), id="light behind a slit"),
    ],
)
def test_a_position_without_its_sign_is_refused_with_the_pendulums_period(
    tmp_path: Path, unsigned: Callable[[np.ndarray], np.ndarray]
) -> None:
    t, x = _decaying()
    with pytest.raises(
        DataError, match=r"column 2 has no sign.* the pendulum's period is (2|1.99\d) s; give"
    ):
        analyse_table(write(tmp_path / "t.csv", t, unsigned(x)), None, TableColumns(unit="cm"))


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_amplitudes_instead_of_positions_are_refused_as_such(tmp_path: Path, noise: float) -> None:
    """They come back to no value, so that no period is named."""
    t = 2.1 * np.arange(400)
    amplitudes = 100.0 * np.exp(-t / 400.0) + noise * np.random.default_rng(1).standard_normal(len(t))
    with pytest.raises(DataError, match=r"column 2 goes from 100 to 12\.3\d and hardly ever back"):
        analyse_table(write(tmp_path / "t.csv", t, amplitudes), None, TableColumns(unit="arcsec"))


@pytest.mark.parametrize(
    "signed",
    [
        pytest.param(lambda t, x: x, id="about zero"),
        pytest.param(lambda t, x: x - x.min(), id="from its smallest value"),
        pytest.param(lambda t, x: x + 0.3 * t, id="with a drift"),
        pytest.param(lambda t, x: np.clip(x, -15.0, 8.0), id="cut off by its sensor"),
        pytest.param(lambda t, x: np.maximum(x, 0.0), id="of which a sensor sees one side"),
        pytest.param(lambda t, x: np.minimum(x, 12.0), id="cut off on one side"),
        pytest.param(lambda t, x: x + 0.01 * x**2, id="by a sensor that is not linear"),
        pytest.param(lambda t, x: x + 4.0 * np.exp(-t / 50.0), id="about a middle that settles"),
    ],
)
def test_other_shapes_have_a_sign(signed: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
    t, x = _decaying()
    assert np.isnan(unsigned_period_s(np.rint(t * 1e9).astype(np.int64), signed(t, x)))


@pytest.mark.parametrize(
    ("unit", "turn", "low"), [("deg", 360.0, -180.0), ("deg", 360.0, 0.0), ("rad", 2 * np.pi, 0.0)]
)
def test_an_angle_that_was_counted_round_a_turn_goes_on(
    tmp_path: Path, unit: str, turn: float, low: float
) -> None:
    t, x = _decaying()
    # about the angle at which the count jumps, with a value that is missing
    wrapped = np.mod(x * turn / 360.0, turn) + low
    wrapped[100] = np.nan
    path = write(tmp_path / "t.csv", t, wrapped)
    found = analyse_table(path, None, TableColumns(unit=unit))
    assert found.longest.number("mean_period_s").value == pytest.approx(2.0, abs=1e-3)
    assert found.longest.amplitudes[0] == pytest.approx(19.64 * turn / 360.0, rel=2e-3)
    assert any(re.search(r"jumps by a turn \d+ times: unwrapped", line) for line in found.understood)
    with pytest.raises(
        ConfigurationError, match=r"jumps by .* against its motion.*state its unit with --unit"
    ):
        analyse_table(path, None, TableColumns())


@pytest.mark.parametrize(
    ("seen", "is_cut"),
    [
        (lambda x: np.clip(x, -15.0, 12.0), True),
        (lambda x: np.minimum(np.round(x), 12.0), True),
        (np.round, False),
        (lambda x: np.round(x / 4.0), False),
    ],
    ids=["cut off", "cut off, of whole numbers", "of whole numbers", "of few digits"],
)
def test_a_position_that_its_sensor_cuts_off_is_said(
    tmp_path: Path, seen: Callable[[np.ndarray], np.ndarray], is_cut: bool
) -> None:
    t, x = _decaying()
    found = analyse_table(write(tmp_path / "t.csv", t, seen(x)), None, TableColumns(unit="V"))
    assert any("cuts the swings off" in line for line in found.longest.warnings) == is_cut


@pytest.mark.parametrize(
    ("motion", "why"),
    [(lambda t, x: np.maximum(x, 0.0), "0 usable half-cycles"), (lambda t, x: t, "hardly ever back")],
)
def test_what_is_no_decay_is_refused_without_warnings(
    tmp_path: Path, motion: Callable[[np.ndarray, np.ndarray], np.ndarray], why: str
) -> None:
    """A sensor that sees one side, and a ramp; warnings are errors here."""
    t, x = _decaying()
    with pytest.raises(DataError, match=why):
        analyse_table(write(tmp_path / "t.csv", t, motion(t, x)), None, TableColumns(unit="V"))


def test_a_note_on_growth_states_it(tmp_path: Path) -> None:
    """Its first and last amplitude may say the opposite, of a swing that is driven."""
    t, x = _decaying()
    found = analyse_table(write(tmp_path / "t.csv", t, x[::-1]), None, TableColumns(unit="V"))
    (said,) = [line for line in found.longest.warnings if "grows" in line]
    assert said.startswith("the amplitude grows, its log decrement is −0.0400 in the mean")


@pytest.mark.parametrize(("scale", "is_said"), [(1.0, False), (1.0 / 206.265, True)])
def test_amplitudes_that_the_rig_does_not_have_are_said(tmp_path: Path, scale: float, is_said: bool) -> None:
    """A table in mrad, whose header says arcsec."""
    t, x = _decaying(4.0)
    path = write(tmp_path / "t.csv", t, 3.0 * scale * x)
    config = Configuration.model_validate({"camera": {"driver": "files"}})
    warnings = analyse_table(path, config, TableColumns(unit="arcsec")).longest.warnings
    assert any("none of this rig, which swings from 124 to 2 arcsec" in one for one in warnings) == is_said
