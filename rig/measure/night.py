"""An unattended night: the series of a plan one after the other, each when its conditions allow."""

import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from processing.errors import ConfigurationError, RecordError
from rig.analysis import read_results
from rig.instrument import check_materials, complete
from rig.measure.live_fit import check_stop_when
from rig.measure.notices import Notices, announced
from rig.measure.resumption import go_on
from rig.measure.session import make_session, session_folder
from rig.measure.session_file import STATE_NAME, RunState, SessionFile
from rig.presentation import failures, say
from rig.settings import Configuration, PlannedSeries, load_configuration, load_plan

Sleep = Callable[[float], None]


def measure_plan(
    source: Path,
    output: Path | None,
    *,
    force: bool = False,
    json_lines: bool = False,
    now_s: Callable[[], float] = time.monotonic,
    sleep: Sleep = time.sleep,
) -> int:
    """Measure the series of a plan in folders of their names, in `output` or where the first one belongs.

    A run whose preflight says no-go is tried again until the series has waited `wait_max_s`; then the series
    is left out and the next one begins. Anything else that fails, and Ctrl-C, ends the plan: nothing is lit
    again before somebody has looked. When a plan is started again, series are continued where they ended.
    Returns the exit status: 0 if every series was measured under its conditions. Raises ConfigurationError
    before anything is lit if a configuration of the plan cannot be used.
    """
    plan = load_plan(source)
    configs = [_configuration(series) for series in plan.series]
    folder = output or configs[0].session.output / source.stem
    worst = 0
    for series, config in zip(plan.series, configs, strict=True):
        place = folder / series.name
        waiting = _Waiting(series, now_s, sleep)
        say(f"series {series.name}")
        with announced(config.session, place) as told:
            measured = _Series(series, config, place, told.notices, waiting, force, json_lines)
            told.status = measured.made_and_repeated()
        worst = max(worst, told.status)
        with closing(SessionFile.opened(place)) as file:
            last = file.state.entries[-1]
        if last.state in {RunState.FAILED, RunState.STOPPED} and not waiting.over:
            say(f"series {series.name}: {last.reason}; the plan ends here", error=True)
            return 1
        if series is not plan.series[-1]:
            sleep(series.pause_s)
    return worst


class _Waiting:
    """Waits until a series may be tried again; `over` once it must not any more."""

    def __init__(self, series: PlannedSeries, now_s: Callable[[], float], sleep: Sleep) -> None:
        self._series, self._now_s, self._sleep = series, now_s, sleep
        self._waited_s = 0.0
        self.over = False

    def __call__(self, why: str) -> bool:
        series = self._series
        left_s = series.wait_max_s - self._waited_s
        if left_s <= 0:
            self.over = True
            say(
                f"series {series.name} is left out: not ready within {series.wait_max_s:g} s: {why}",
                error=True,
            )
            return False
        say(f"series {series.name} waits: {why}")
        begun_s = self._now_s()
        self._sleep(min(series.try_every_s, left_s))
        self._waited_s += self._now_s() - begun_s
        return True


def _configuration(series: PlannedSeries) -> Configuration:
    config = complete(load_configuration(series.config, series.overrides()))
    check_materials(config)
    check_stop_when(config)
    if series.temperature_c is not None and config.environment_sensor.kind == "none":
        raise ConfigurationError(
            f"series {series.name}: temperature_c needs a thermometer:"
            f" see [environment_sensor] in {series.config}"
        )
    if series.quiet_arcsec is not None and (config.start.way == "at once" or config.lever is None):
        raise ConfigurationError(
            f"series {series.name}: quiet_arcsec needs a pendulum at rest and [lever]:"
            f" set start.way to 'by hand', 'magnet' or 'starter' in {series.config}"
        )
    return config


class _Series(NamedTuple):
    """What measuring a series takes."""

    planned: PlannedSeries
    config: Configuration
    folder: Path
    notices: Notices
    waiting: _Waiting
    force: bool
    json_lines: bool

    def made_and_repeated(self) -> int:
        """Measure it and repeat its bad runs; returns its exit status."""
        repeats = self.planned.repeat_bad
        status = self._gone_on() if (self.folder / STATE_NAME).exists() else self._made()
        while status and (bad := _set_bad_aside(self.folder, repeats)):
            repeats -= bad
            say(f"series {self.planned.name}: {bad} of its runs are repeated; their conditions were not met")
            status = self._gone_on()
        return status

    def _made(self) -> int:
        source = self.planned.config
        folder = session_folder(self.config, source, self.folder)
        return make_session(
            self.config,
            source,
            folder,
            self.notices,
            force=self.force,
            json_lines=self.json_lines,
            patience=self.waiting,
        )

    def _gone_on(self) -> int:
        with closing(SessionFile.opened(self.folder)) as file:
            return go_on(
                file,
                self.config,
                self.notices,
                force=self.force,
                json_lines=self.json_lines,
                patience=self.waiting,
            )


def _set_bad_aside(folder: Path, most: int) -> int:
    """Note runs whose conditions were not met as rejected, so that others are made; returns how many.

    None if a run failed, or if not all are there.
    """
    with closing(SessionFile.opened(folder)) as file:
        if len(file.state.complete) < file.state.runs_wanted:
            return 0
        try:
            judged = {run.record: failures(run.conditions) for run in read_results(folder).runs}
        except RecordError:
            return 0
        bad = [entry for entry in file.state.complete if judged.get(entry.record)][:most]
        for entry in bad:
            file.note(entry.number, entry.record, RunState.REJECTED, judged[entry.record])
    return len(bad)
