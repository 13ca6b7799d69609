"""Measures a list of sessions, one after the other."""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from processing.errors import ConfigurationError
from rig.measure.notices import PreflightWait
from rig.measure.session import complete_checked, finish_session, measure_session, with_other_seed
from rig.measure.session_file import STATE_NAME, RunState, SessionFile, read_session
from rig.settings import load_configuration
from rig.terminal import say

_SEED_STEP_OF_SESSIONS = 2_000_003


def measure_sessions(
    sources: Sequence[Path],
    overrides: Sequence[str],
    output: Path | None,
    *,
    force: bool = False,
    json_lines: bool = False,
) -> int:
    """Measure one session for each configuration, in folders of their names in `output`.

    A session whose preflight still says no-go after `preflight.wait_max_s` is left out, and the next one
    begins. Any other failure, and Ctrl-C, end the list, so that nothing is lit again before a person has
    checked the rig. Called again with the same folder, it continues the list. Returns the exit status: 0 if
    every session was measured under its conditions. Raises ConfigurationError before anything is lit if one
    of the configurations cannot be used.
    """
    names = [source.stem for source in sources]
    if repeated := next((name for name in names if names.count(name) > 1), None):
        raise ConfigurationError(f"{repeated}: named twice; each session needs a folder of its own name")
    configs = [
        with_other_seed(
            complete_checked(load_configuration(source, overrides)), _SEED_STEP_OF_SESSIONS * number
        )
        for number, source in enumerate(sources)
    ]
    folder = output or configs[0].session.output
    worst_status = 0
    for source, config in zip(sources, configs, strict=True):
        target = folder / source.stem
        waiting = PreflightWait(source.stem, config.preflight)
        say(f"session {target}")
        if (target / STATE_NAME).exists():
            with closing(SessionFile.opened(target)) as file:
                task = "rig run --resume"
                status = finish_session(file, config, task, waiting, force=force, json_lines=json_lines)
        else:
            status = measure_session(
                config, source, target, force=force, json_lines=json_lines, waiting=waiting
            )
        worst_status = max(worst_status, status)
        if (reason := _why_ended(target)) and not waiting.is_used_up:
            say(f"session {target}: {reason}; the list ends here", error=True)
            return 1
    return worst_status


def _why_ended(folder: Path) -> str:
    """Why the last run of a session failed or was stopped; empty if it did neither."""
    if not (folder / STATE_NAME).exists():
        return "nothing was recorded"
    last = read_session(folder).entries[-1]
    return last.reason if last.state in {RunState.FAILED, RunState.STOPPED} else ""
