"""A planned campaign as files that `rig run --plan` takes."""

import json
import os
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path

from processing.campaign import ChosenRun
from rig.campaigns.planned import PlannedCampaign, PlannedKind, reasons

_Kind = tuple[PlannedKind, ChosenRun]


def campaign_plan_files(
    planned: PlannedCampaign, config: Path, folder: Path, overrides: Sequence[str] = ()
) -> Mapping[str, str]:
    """plan.toml; of several samples one file for every stretch of runs on the same one, for a person changes
    it. `config` becomes relative to their folder."""
    source = Path(os.path.relpath(config.resolve(), folder.resolve())).as_posix()
    runs = [(planned.kind(one.candidate), one) for one in planned.choice.runs]
    if not runs:
        return {}
    stretches = [list(part) for _, part in groupby(runs, key=lambda pair: pair[0].sample)]
    why = [f"# {line}" for line in reasons(planned)]
    if len(planned.within.samples) == 1:
        return {"plan.toml": "\n".join([*why, *_series(stretches[0], source, overrides)]) + "\n"}
    width = len(str(len(stretches)))
    return {
        f"plan-{number:0{width}d}.toml": "\n".join(
            [
                f"# {number} of {len(stretches)}: set up {part[0][0].sample!r} before",
                *why,
                *_series(part, source, overrides),
            ]
        )
        + "\n"
        for number, part in enumerate(stretches, start=1)
    }


def _series(runs: Sequence[_Kind], config: str, overrides: Sequence[str]) -> list[str]:
    # a run that waits begins a series: the pause is between two
    groups = [
        (kind, [one for _, one in alike])
        for (kind, _), alike in groupby(
            runs, key=lambda pair: (pair[0], id(pair[1]) if pair[0].waiting_s else 0)
        )
    ]
    lines: list[str] = []
    width = len(str(len(groups)))
    for number, (kind, alike) in enumerate(groups, start=1):
        then_s = groups[number][0].waiting_s if number < len(groups) else 0.0
        changes = [
            *overrides,
            f"session.initial_amplitude_arcsec={kind.first_arcsec:g}",
            f"session.final_amplitude_arcsec={kind.last_arcsec:g}",
            f"session.sample={json.dumps(kind.sample, ensure_ascii=False)}",
        ]
        if number == 1 and kind.waiting_s:
            lines.append(f"# begin {kind.waiting_s / 60:g} min after the run before")
        name = f"{number:0{width}d}-{kind.first_arcsec:g}-to-{kind.last_arcsec:g}"
        lines += [
            "",
            f"# u is expected to fall from {alike[0].before:.3g} to {alike[-1].after:.3g} of its limit",
            "[[series]]",
            f"name = {json.dumps(name)}",
            f"config = {json.dumps(config, ensure_ascii=False)}",
            f"runs = {len(alike)}",
            f"set = {json.dumps(changes, ensure_ascii=False)}",
        ]
        if then_s:
            lines.append(f"pause_s = {then_s:g}")
    return lines
