"""A planned campaign as files that `rig run --plan` takes."""

import json
import os
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path

from processing.campaign import ChosenRun
from rig.campaigns.planned import PlannedCampaign, PlannedKind, reasons
from rig.campaigns.planner import AskedPlan
from rig.campaigns.sources import NamedRuns
from rig.settings import Configuration, load_configuration

_Kind = tuple[PlannedKind, ChosenRun]
_MORE = 2
"""Runs and hours of a night that decides, over what is expected: runs may scatter more than is thought."""


def campaign_plan_files(
    planned: PlannedCampaign, asked: AskedPlan, made: NamedRuns, folder: Path
) -> Mapping[str, str]:
    """plan.toml with these runs, and auto.toml, whose night chooses again after each; of several samples one
    file for every stretch of runs on the same one, for a person changes it. Paths become relative to their
    folder."""
    config = load_configuration(asked.source, asked.overrides)
    source = _from(folder, asked.source)
    runs = [(planned.kind(one.candidate), one) for one in planned.choice.runs]
    if not runs:
        return {}
    stretches = [list(part) for _, part in groupby(runs, key=lambda pair: pair[0].sample)]
    why = [f"# {line}" for line in reasons(planned)]
    if len(planned.within.samples) == 1:
        return {
            "plan.toml": "\n".join([*why, *_series(stretches[0], source, asked.overrides, config)]) + "\n",
            "auto.toml": "\n".join(_deciding(planned, asked, made, folder)) + "\n",
        }
    width = len(str(len(stretches)))
    return {
        f"plan-{number:0{width}d}.toml": "\n".join(
            [
                f"# {number} of {len(stretches)}: set up {part[0][0].sample!r} before",
                *why,
                *_series(part, source, asked.overrides, config),
            ]
        )
        + "\n"
        for number, part in enumerate(stretches, start=1)
    }


def changes_of(kind: PlannedKind, config: Configuration, overrides: Sequence[str] = ()) -> list[str]:
    """Changes of a configuration that make a run of this kind, as with --set, after others."""
    changes = [
        f"session.initial_amplitude_arcsec={kind.first_arcsec:g}",
        f"session.final_amplitude_arcsec={kind.last_arcsec:g}",
        f"session.sample={json.dumps(kind.sample, ensure_ascii=False)}",
    ]
    if config.simulated and config.start.way == "at once":
        # who sets the simulated pendulum swinging is the simulation
        changes.append(f"simulation.release.amplitude_arcsec={kind.first_arcsec:g}")
    # a key may be stated once
    own = {_key(change) for change in changes}
    return [*(change for change in overrides if _key(change) not in own), *changes]


def _key(change: str) -> str:
    return change.partition("=")[0].strip()


def _series(runs: Sequence[_Kind], source: str, overrides: Sequence[str], config: Configuration) -> list[str]:
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
        if number == 1 and kind.waiting_s:
            lines.append(f"# begin {kind.waiting_s / 60:g} min after the run before")
        name = f"{number:0{width}d}-{kind.first_arcsec:g}-to-{kind.last_arcsec:g}"
        lines += [
            "",
            f"# u is expected to fall from {alike[0].before:.3g} to {alike[-1].after:.3g} of its limit",
            "[[series]]",
            f"name = {_word(name)}",
            f"config = {_word(source)}",
            f"runs = {len(alike)}",
            f"set = {_word(changes_of(kind, config, overrides))}",
        ]
        if then_s:
            lines.append(f"pause_s = {then_s:g}")
    return lines


def _deciding(planned: PlannedCampaign, asked: AskedPlan, made: NamedRuns, folder: Path) -> list[str]:
    """The limits of a night that decides by itself: what was asked for, and as much again."""
    choice, within = planned.choice, planned.within
    hours = min(_MORE * choice.rig_time_s, within.longest_s) / 3600
    lines = [
        "# Chooses again after every run, within these limits.",
        "[auto]",
        f"config = {_word(_from(folder, asked.source))}",
        f"for = {_word([target.text for target in planned.targets])}",
        f"set = {_word([*asked.overrides, *_sample(asked)])}",
    ]
    if asked.campaign is not None:
        lines.append(f"campaign = {_word(_from(folder, asked.campaign))}")
    if made.folders:
        lines.append(f"after = {_word([_from(folder, one) for one in made.folders])}")
    if made.archive is not None:
        place = made.archive if "://" in made.archive else _from(folder, Path(made.archive))
        lines += [f"archive = {_word(place)}", f"where = {_word(made.where)}"]
    if asked.contact is not None:
        lines.append(f"contact = {_word(_from(folder, asked.contact))}")
    if asked.noise_arcsec is not None:
        lines.append(f"noise_arcsec = {asked.noise_arcsec:g}")
    return [
        *lines,
        f"first_arcsec = {_word(list(within.first_arcsec))}",
        f"last_arcsec = {_word(list(within.last_arcsec))}",
        f"waits_min = {_word([wait_s / 60 for wait_s in within.waits_s])}",
        f"max_runs = {min(_MORE * len(choice.runs) + _MORE, within.most_runs)}",
        f"hours = {hours:.2g}",
        "",
        "# runs begin only while: temperature_c = [19.5, 20.5], humidity_percent = [40, 50],",
        "# ground_rad_per_s2_rthz = 1e-8, quiet_arcsec = 0.05; and wait so long for that:",
        "# wait_max_s = 7200",
        "# or until = 07:00:00",
    ]


def _sample(asked: AskedPlan) -> list[str]:
    return [f"session.sample={_word(one)}" for one in asked.samples]


def _from(folder: Path, path: Path) -> str:
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()


def _word(value: object) -> str:
    """As TOML has it, which for texts, numbers and lists is JSON."""
    return json.dumps(value, ensure_ascii=False)
