"""An auxiliary seismometer from a file, beside a table or a record, and the times of a recorded one."""

import re
from dataclasses import replace
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rig
from processing.arrival_times import sample_times
from processing.errors import ConfigurationError, DataError
from processing.estimate import Estimate
from processing.fit import Response, SeismometerUse
from processing.fit.seismometer import SeismometerVerdict
from rig.analysis import AnalysedTable, analyse_record, record_fit, session_results
from rig.analysis.results import RunResults, SessionResults
from rig.analysis.results_file import RESULTS_NAME, decoded, encoded, write_results
from rig.analysis.run_remarks import seismometer_sentences
from rig.archive.session_rows import results_row
from rig.intake import read_seismometer
from rig.intake.table import TableColumns
from rig.report import make_table_report
from rig.settings import load_configuration
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.driven import driven_path
from tests.rig.analysis.test_compared_laws import PENDULUM
from tests.rig.command_line import SAMPLES
from tests.rig.intake.table_cases import analyse_table

STEP_S = 0.1
FRAMES_PER_S = 10.0


def csv(path: Path, head: str, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=head, comments="", fmt="%.9g")
    return path


def ground(seed: int) -> np.ndarray:
    return np.asarray(3e-7 * np.sqrt(0.5 / STEP_S) * np.random.default_rng(seed).standard_normal(4000))


@pytest.fixture(scope="module")
def decay(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A decay on a white drive, as a table, with its configuration and seismometeres beside it."""
    folder = tmp_path_factory.mktemp("seismometer")
    parameters, pendulum = paper_pair("glass_k8")
    clock = STEP_S * np.arange(4000)
    _, _, path = driven_path(
        parameters,
        pendulum,
        q=0.0,
        seed=0,
        last_arcsec=60.0,
        frames_per_s=FRAMES_PER_S,
        forcing=lambda t: np.interp(t, clock - 20.0, ground(1)),
    )
    seen = path / ARCSEC + 0.005 * np.random.default_rng(2).standard_normal(len(path))
    # the table's clock does not begin at 0
    csv(folder / "decay.csv", "time_s,y_arcsec", 500.0 + np.arange(len(seen)) / FRAMES_PER_S, seen)
    csv(folder / "seismometer.csv", "time_s,east,north", 480.0 + clock, 1e9 * ground(5), -2e9 * ground(1))
    (folder / "rig.toml").write_text(PENDULUM + '[fit]\ndrag = "vacuum"\n')
    return folder


@cache
def analysed(folder: Path, *columns: str) -> AnalysedTable:
    config = load_configuration(folder / "rig.toml", needs_camera=False)
    seismometer = read_seismometer(folder / "seismometer.csv", columns) if columns else None
    return analyse_table(folder / "decay.csv", config, TableColumns(unit="arcsec"), seismometer)


def fitted(folder: Path, *columns: str) -> RunResults:
    return analysed(folder, *columns).longest


@pytest.mark.slow
@pytest.mark.usefixtures("figures")
def test_a_table_is_fitted_with_a_seismometer_and_says_what_it_saved(decay: Path, tmp_path: Path) -> None:
    alone, found = fitted(decay), fitted(decay, "east", "north")
    assert alone.seismometer is None
    assert found.seismometer is not None
    assert found.seismometer.used
    assert [response.name for response in found.seismometer.responses] == ["north"]
    assert found.seismometer.responses[0].gain == pytest.approx(0.5e-9, rel=0.05)
    before, after = (one.fits["exact"].estimate("b") for one in (alone, found))
    assert before.standard_uncertainty / after.standard_uncertainty == pytest.approx(
        found.seismometer.saved["b"], rel=1e-6
    )
    # of 4.5 if the first half-cycles knew nothing of the drive within them, as detected
    assert found.seismometer.saved["b"] > 3
    assert abs(after.value - paper_pair("glass_k8")[0].b) < 4 * after.standard_uncertainty
    # Eqs. 5 and 6 keep the paper's procedure
    of_eqs = [one.fits["asymptotic"].estimate("b").value for one in (found, alone)]
    assert of_eqs[0] == of_eqs[1]
    said = " ".join(seismometer_sentences(found.seismometer))
    assert "it explains" in said
    assert re.search(r"reduces the uncertainties by factors of [\d.]+ \(\w+\)", said)
    table = analysed(decay, "east", "north")
    write_results(tmp_path / RESULTS_NAME, table)
    make_table_report(table, tmp_path)
    assert "it explains" in (tmp_path / "report.html").read_text()


@pytest.mark.slow
def test_the_python_interface_takes_a_seismometer_of_a_table_as_the_terminal_does(decay: Path) -> None:
    words = {"configuration": decay / "rig.toml", "seismometer": decay / "seismometer.csv"}
    found = rig.fit_table(decay / "decay.csv", "arcsec", **words).runs[0]
    assert found.seismometer is not None
    assert found.seismometer == fitted(decay, "east", "north").seismometer
    assert dict(results_row(found))["seismometer"] == "used"
    assert dict(results_row(found))["seismometer_explained"] == found.seismometer.explained > 0.9
    with pytest.raises(ConfigurationError, match="seismometer: has no effect without configuration"):
        rig.fit_table(decay / "decay.csv", "arcsec", seismometer=decay / "seismometer.csv")


@pytest.mark.slow
def test_an_unrelated_seismometer_changes_nothing_but_what_is_said(decay: Path) -> None:
    alone, found = fitted(decay), fitted(decay, "east")
    assert found.seismometer is not None
    assert found.seismometer.verdict is SeismometerVerdict.NO_GAIN
    assert encoded(replace(found, seismometer=None)) == encoded(alone)
    (said,) = seismometer_sentences(found.seismometer)
    assert said.startswith("Auxiliary seismometer refused")
    assert "--seismometer-offset states by how much" in said


@pytest.mark.slow
def test_a_record_with_a_seismometer_of_another_year_says_that_it_does_not_cover_the_run(
    tmp_path: Path,
) -> None:
    times = 1.2e9 + STEP_S * np.arange(2000)
    path = tmp_path / "w.csv"
    path.write_text("\n".join(["time_s,z", *(f"{time:.1f},{k % 7}" for k, time in enumerate(times))]))
    alone = analyse_record(SAMPLES / "series" / "run-1.mcap")
    found = analyse_record(alone.path, seismometer=read_seismometer(path))
    assert found.seismometer is not None
    assert found.seismometer.verdict is SeismometerVerdict.ABSENT
    results = [session_results([run], tmp_path) for run in (alone, found)]
    without = [replace(one, runs=(replace(one.runs[0], seismometer=None),)) for one in results]
    assert encoded(without[0]) == encoded(without[1])


def test_times_are_put_on_the_clock_of_the_turning_points(tmp_path: Path) -> None:
    begin_ns, clocks = 5_000_000_000, {"to_file_ns": -2_000_000_000, "to_utc_ns": 1_500_000_000_000_000_000}
    times = np.arange(10.0)
    relative = read_seismometer(csv(tmp_path / "a.csv", "time_s,z", 2 + times, times))
    seismometer = replace(relative, **clocks).seismogram(begin_ns)
    assert seismometer.time_s[0] == pytest.approx(-1.0)
    stated = read_seismometer(tmp_path / "a.csv", offset_s=0.25)
    seismometer = replace(stated, **clocks).seismogram(begin_ns)
    assert seismometer.time_s[0] == pytest.approx(-0.75)
    in_ns = [f"{1_500_000_000_000_000_000 + 100_000_000 * k},{k}" for k in range(10)]
    (tmp_path / "b.csv").write_text("\n".join(["time_ns,z", *in_ns]))
    absolute = read_seismometer(tmp_path / "b.csv")
    seismometer = replace(absolute, **clocks).seismogram(begin_ns)
    assert seismometer.time_s[0] == pytest.approx(-5.0, abs=1e-6)
    # two clocks that have nothing in common: both begin at once
    assert absolute.seismogram(0).time_s[0] == 0.0


def test_times_of_a_file_count_from_the_first_frame_of_a_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first frame of a record has any time on its own clock; one at 5 s is at 0 s of the seismometer."""

    class Stop(Exception):
        pass

    taken: list[tuple[Any, ...]] = []

    def take(*arguments: Any) -> None:
        taken.append(arguments)
        raise Stop

    monkeypatch.setattr(record_fit, "analyse_swings", take)
    times = np.arange(10.0)
    seismometer = read_seismometer(csv(tmp_path / "a.csv", "time_s,z", times, times))
    with pytest.raises(Stop):
        analyse_record(SAMPLES / "series" / "run-1.mcap", seismometer=seismometer)
    ((_, followed, *_, placed),) = taken
    first_ns = next(iter(followed.deflections)).times_ns[0]
    assert first_ns >= 1_000_000_000
    assert placed.seismogram(int(first_ns) + 3_000_000_000).time_s[0] == pytest.approx(-3.0)


def test_the_unit_of_its_times_is_that_of_the_header(tmp_path: Path) -> None:
    path = tmp_path / "w.csv"
    path.write_text("t,z\n" + "".join(f"0:{k // 60:02d}:{k % 60:02d},{k % 7}\n" for k in range(300)))
    assert set(np.diff(read_seismometer(path).times_ns).tolist()) == {10**9}
    backwards = csv(tmp_path / "b.csv", "t,z", np.arange(9.0)[::-1], np.arange(9.0))
    with pytest.raises(DataError, match="call the time column time_s"):
        read_seismometer(backwards)
    in_ms = csv(tmp_path / "c.csv", "time_ms,z", np.arange(9.0), np.arange(9.0))
    assert read_seismometer(in_ms).times_ns[-1] == 8_000_000
    unstated = csv(tmp_path / "d.csv", "t,z", np.arange(9.0), np.arange(9.0))
    with pytest.raises(ConfigurationError, match=r"unit of 't', .* apart; name in the header ns, us, .* d$"):
        read_seismometer(unstated)


@pytest.mark.slow
def test_what_is_no_number_is_left_out_and_told(decay: Path, tmp_path: Path) -> None:
    rows = (decay / "seismometer.csv").read_text().splitlines()
    head, *samples = (f"{row},{'name' if k == 0 else 'ABC'}" for k, row in enumerate(rows))
    samples[7] = samples[7].replace(samples[7].split(",")[2], "-")
    samples[9] = "x," + samples[9].partition(",")[2]
    path = tmp_path / "w.csv"
    path.write_text("\n".join([head, *samples]))
    record = read_seismometer(path)
    assert record.names == ("east", "north")
    assert len(record.times_ns) == len(samples) - 1
    told = " ".join(record.understood)
    assert "time: time_s, in s" in told
    assert "columns: east, north" in told
    assert "left out: columns without numbers: name" in told
    assert "1 values of north that are not numbers (line 9)" in told
    assert "left out: 1 rows without a readable time (line 11)" in told
    config = load_configuration(decay / "rig.toml", needs_camera=False)
    found = analyse_table(
        decay / "decay.csv", config, TableColumns(unit="arcsec"), record
    ).longest.seismometer
    assert found is not None
    assert (found.source, found.understood) == ("w.csv", record.understood)
    assert "Of the seismometer w.csv: left out" in seismometer_sentences(found)[-1]
    with pytest.raises(DataError, match="column 'name' has no numbers"):
        read_seismometer(path, ("name",))
    with pytest.raises(ConfigurationError, match=r"no column 'up'; columns: time_s, east, north"):
        read_seismometer(decay / "seismometer.csv", ("up",))


BEGIN_S = 1_772_600_000
STEP_NS, SLOW_NS = 100_000_000, 100_400_000


def recorded(time_s: np.ndarray) -> np.ndarray:
    return 1e5 * np.sin(0.2 * np.pi * time_s)


def seismic(path: Path, *records: tuple[str, float, int], step_ns: int = STEP_NS) -> Path:
    """Records of (NET.STA.LOC.CHA, begin, samples) that state steps of 0.1 s, which last `step_ns`."""
    obspy = pytest.importorskip("obspy")
    data = b""
    for name, begin_s, count in records:
        time_s = begin_s + np.arange(max(count, 1)) * step_ns * 1e-9
        trace = obspy.Trace(np.rint(recorded(time_s)).astype(np.int32), {"sampling_rate": 10.0})
        trace.id, trace.stats.starttime = name, obspy.UTCDateTime(BEGIN_S + begin_s)
        trace.write(buffer := BytesIO(), format="MSEED", encoding="STEIM2", reclen=4096)
        record = bytearray(buffer.getvalue())
        if not count:
            record[30:32] = b"\0\0"
        data += record
    path.write_bytes(data)
    return path


Z = "XX.AAA.00.BHZ"
EVERY = [(Z, 30.0 * k, 300) for k in range(4)]


@pytest.mark.filterwarnings("ignore")  # of ObsPy's own imports
@pytest.mark.parametrize(
    ("records", "step_ns", "span_s", "lost", "said"),
    [
        ([(Z, 10.04 * k, 100) for k in range(60)], SLOW_NS, 602.2996, 0, "9.96016 samples a second"),
        ([(Z, 100.4 * k, 1000) for k in range(6)], SLOW_NS, 602.2996, 0, "9.96016 samples a second"),
        ([(Z, 99.6 * k, 1000) for k in range(6)], 99_600_000, 597.5004, 0, "10.0402 samples a second"),
        (EVERY, STEP_NS, 119.9, 0, ""),
        (EVERY[::-1] + EVERY[1:3], STEP_NS, 119.9, 0, "left out: 600 samples of records that overlap others"),
        ([*EVERY, (Z, 115.0, 100)], STEP_NS, 124.9, 0, "left out: 50 samples of records that overlap others"),
        ([EVERY[0], (Z, 30.0, 0), *EVERY[2:]], STEP_NS, 119.9, 300, "left out: 1 records without samples"),
        ([EVERY[0], *EVERY[2:]], STEP_NS, 119.9, 300, "missing: 300 of 1200 samples"),
    ],
    ids=["drift", "drift, long", "drift, fast", "even", "order, twice", "overlap", "empty", "gap"],
)
def test_records_are_read_with_the_times_of_their_own(
    tmp_path: Path, records: list[tuple[str, float, int]], step_ns: int, span_s: float, lost: int, said: str
) -> None:
    """ObsPy takes records that are early or late by less than half a sample for ones without a gap."""
    found = read_seismometer(seismic(tmp_path / "w.mseed", *records, step_ns=step_ns))
    since_s = found.times_ns * 1e-9
    assert found.absolute
    assert found.first_ns == BEGIN_S * 10**9
    assert since_s[-1] == pytest.approx(span_s, abs=1e-6)
    assert round((since_s[-1] * 1e9) / step_ns) + 1 - len(since_s) == lost
    assert found.value[:, 0] == pytest.approx(recorded(since_s), abs=1.0)
    assert said in " ".join(found.understood)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("other", ["XX.BBB.00.BHZ", "XX.AAA.10.BHZ", "XX.AAA.00.LHZ"])
def test_of_several_sensors_one_is_asked_for(tmp_path: Path, other: str) -> None:
    path = seismic(tmp_path / "w.mseed", (Z, 0.0, 300), (other, 0.0, 200))
    with pytest.raises(
        ConfigurationError, match=r"holds 2 sensors.*; state one: --seismometer-column"
    ) as caught:
        read_seismometer(path)
    assert {f"{Z[:-1]}?", f"{other[:-1]}?"} <= set(re.split("[ ,;']+", str(caught.value)))
    for name, count in ((Z, 300), (other, 200)):
        for stated in (name, f"{name[:-1]}?"):
            found = read_seismometer(path, (stated,))
            assert (found.names, len(found.value)) == ((name[-3:],), count)
        assert f"not used: {other if name == Z else Z}" in found.understood
    assert read_seismometer(path, (Z, other)).names == (Z, other)


@pytest.mark.filterwarnings("ignore")
def test_a_seismic_file_is_read_with_its_damage_and_its_components(tmp_path: Path) -> None:
    names = [f"XX.AAA..BH{letter}" for letter in "EZ"]
    path = seismic(tmp_path / "w.mseed", *[(name, 30.0 * k, 300) for k in range(4) for name in names])
    data = bytearray(path.read_bytes())
    data[2 * 4096 + 200] ^= 0x55
    path.write_bytes(data)
    found = read_seismometer(path)
    assert found.names == ("BHE", "BHZ")
    assert found.value.shape == (900, 2)
    assert {"missing: 300 of 1200 samples", "left out: 1 records that cannot be decoded"} <= {
        *found.understood
    }
    assert np.isnan(read_seismometer(path, ("BHZ", "BHE")).value).sum(axis=0).tolist() == [0, 300]
    assert read_seismometer(path, ("BHZ",)).names == ("BHZ",)
    with pytest.raises(ConfigurationError, match="no channel 'BHN'; channels: BHE, BHZ"):
        read_seismometer(path, ("BHN",))
    obspy = pytest.importorskip("obspy")
    trace = obspy.Trace(np.arange(1000, dtype=np.float32), {"sampling_rate": 20.0, "channel": "BHZ"})
    trace.write(str(tmp_path / "w.sac"), format="SAC")
    of_sac = read_seismometer(tmp_path / "w.sac")
    assert of_sac.names == ("BHZ",)
    assert of_sac.value[:, 0] == pytest.approx(np.arange(1000.0))
    (tmp_path / "bad.mseed").write_text("no samples")
    with pytest.raises(DataError, match="as neither miniSEED nor SAC"):
        read_seismometer(tmp_path / "bad.mseed")
    with pytest.raises(DataError, match="BHZ holds no samples"):
        read_seismometer(seismic(tmp_path / "none.mseed", (Z, 0.0, 0)))


def test_results_keep_what_a_seismometer_told_and_sentences_say_it() -> None:
    use = SeismometerUse(
        verdict=SeismometerVerdict.USED,
        responses=(Response(name="Z", gain=2e-10, u_gain=1e-12, phase_rad=1.0, u_phase_rad=0.01),),
        missing_half_cycles=7,
        delay_s=Estimate(0.1, 0.05),
        saved={"b": 6.1, "c": 1.0},
    )
    results = SessionResults(runs=(RunResults(record="run.mcap", seismometer=use),))
    again = decoded(encoded(results), Path("results.json")).runs[0].seismometer
    assert again is not None
    assert (again.responses, again.delay_s) == (use.responses, use.delay_s)
    said = " ".join(seismometer_sentences(again))
    assert "7 half-swings have no seismometer's record" in said
    assert "factors of 6.10 (b)." in said


RATE_HZ, COUNT = 20.0, 12_000
EPOCH_S = 1_790_000_000.0


def off(late_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], tuple[float, ...]]:
    """Errors of the times that are found from arrivals so late, in s, and the steps that are said."""
    own_s = EPOCH_S + np.arange(COUNT) / RATE_HZ
    true_s = 100.0 + (own_s - EPOCH_S)
    times_ns, steps_s = sample_times(np.rint(1e9 * (true_s + late_s)).astype(np.int64), own_s)
    return times_ns * 1e-9 - true_s, steps_s


def stalled(count: int, speed: float = np.inf) -> tuple[int, int, NDArray[np.float64]]:
    """A host that hung for minutes reads at once, or some times as fast, what waited meanwhile."""
    late_s = count / RATE_HZ - np.arange(COUNT - 3000) / RATE_HZ * (1 - 1 / speed)
    return 3000, COUNT, np.maximum(late_s, 0.0)


@pytest.mark.parametrize(
    ("late_by", "steps_s"),
    [
        ([(0, 600, 10.0)], (-10.0,)),
        ([(0, 7000, -0.7)], (0.7,)),
        ([(0, 7000, -40.0)], (40.0,)),
        ([(0, 3000, 2.0), (3000, 5000, -5.0)], (-7.0, 5.0)),
        ([stalled(1200)], ()),
        ([stalled(6000)], ()),
        ([stalled(2500, speed=4.0)], ()),
        ([(2000, 3500, np.arange(1500)[::-1] / RATE_HZ), (0, 6000, -3.0)], (3.0,)),
    ],
    ids=["back", "a little", "far", "two", "stall", "long stall", "slow end of a stall", "after a stall"],
)
def test_where_a_clock_was_set_the_later_holds_and_it_is_said_and_a_stall_is_none(
    late_by: list[tuple[int, int, NDArray[np.float64]]], steps_s: tuple[float, ...]
) -> None:
    """The instrument's clock was wrong until somebody or a satellite receiver set it."""
    late = 1e-3 * np.random.default_rng(2).standard_normal(COUNT)
    for first, last, by_s in late_by:
        late[first:last] += by_s
    error, said = off(late)
    assert error == pytest.approx(0.0, abs=0.01)
    assert said == pytest.approx(steps_s, abs=0.01)


def test_lateness_that_comes_and_goes_and_a_clock_that_drifts_are_no_step() -> None:
    drift = 2e-4 * np.arange(COUNT) / RATE_HZ
    late = 0.05 * np.random.default_rng(3).exponential(size=COUNT) + drift
    # a thread waited for four seconds, and then all came at once
    late[5000:5080] += np.arange(80)[::-1] / RATE_HZ
    error, said = off(late)
    assert said == ()
    assert error == pytest.approx(0.05 + drift, abs=0.02)
