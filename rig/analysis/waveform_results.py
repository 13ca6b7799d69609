"""The waveform of a recorded run against the laws that were fitted to it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot

import numpy as np
from numpy.typing import NDArray

from processing.angle import ARCSEC_RAD
from processing.contact import PendulumOnBall
from processing.fit import CONTRADICTED, LawComparison, predicted_harmonics, waveform_chances
from processing.swing import ORDERS, HarmonicClass, harmonic_classes
from rig.analysis.analysed_run import AnalysedRun
from rig.analysis.law_results import ComparedLaws, Harmonics, WaveformClass
from rig.presentation import Cell, Table

_THIRD = ORDERS.index(3)


def with_waveform(
    values: ComparedLaws, run: AnalysedRun, pendulum: PendulumOnBall, compared: LawComparison
) -> ComparedLaws:
    """The laws with what the record's deflections say of them; unchanged where they say nothing."""
    classes = [] if run.harmonics is None else harmonic_classes(run.harmonics)
    if not classes:
        return values
    predicted = {
        trial.law.name: predicted_harmonics(classes, trial.fit, pendulum)
        for trial in compared.trials
        if trial.fit is not None
    }
    chances = waveform_chances(classes, predicted)
    laws = {
        name: replace(law, waveform_chance=chances[name]) if name in chances else law
        for name, law in values.laws.items()
    }
    verdict = f"{values.verdict}; {_said(classes, chances)}"
    return replace(values, laws=laws, verdict=verdict, waveform=_stored(classes, predicted))


def _said(classes: Sequence[HarmonicClass], chances: Mapping[str, float]) -> str:
    """What the third harmonic says of the laws."""
    first = classes[0]
    third_mas, u_mas = np.array([abs(first.harmonics[_THIRD]), first.u[_THIRD]]) / ARCSEC_RAD * 1e3
    measured = f"the waveform (third harmonic {third_mas:.1f} ± {u_mas:.1f} mas at "
    measured += f"{first.amplitude / ARCSEC_RAD:.0f} arcsec)"
    against = [name for name, chance in chances.items() if chance < CONTRADICTED]
    if not against:
        return f"{measured} contradicts none"
    if len(against) == len(chances):
        return f"{measured} contradicts them all: sensor or beam distort it, or none is right"
    return f"{measured} contradicts {', '.join(against)}"


def _stored(
    classes: Sequence[HarmonicClass], predicted: Mapping[str, Sequence[NDArray[np.complex128]]]
) -> tuple[WaveformClass, ...]:
    return tuple(
        WaveformClass(
            amplitude_rad=one.amplitude,
            measured=_harmonics(one.harmonics),
            u_rad=one.u,
            laws={name: _harmonics(laws[place]) for name, laws in predicted.items()},
        )
        for place, one in enumerate(classes)
    )


def _harmonics(values: NDArray[np.complex128]) -> Harmonics:
    return Harmonics(values.real.copy(), -values.imag)


def waveform_table(compared: ComparedLaws) -> Table:
    """Every harmonic of every class, measured and by law; the third one shown."""
    names = list(compared.waveform[0].laws) if compared.waveform else []
    rows: list[list[Cell]] = []
    shown = []
    for one in compared.waveform:
        for place, order in enumerate(ORDERS):
            values = [one.measured, *(one.laws[name] for name in names)]
            parts = [float(part[place]) for each in values for part in (each.cosine_rad, each.sine_rad)]
            u = float(one.u_rad[place])
            rows.append([one.amplitude_rad, order, u, *parts])
            if order == 3:
                sizes = [hypot(*part) for part in zip(parts[::2], parts[1::2], strict=True)]
                texts = [f"{1e3 * size / ARCSEC_RAD:.2f}" for size in sizes]
                texts[0] += f" ± {1e3 * u / ARCSEC_RAD:.2f}"
                shown.append([f"{one.amplitude_rad / ARCSEC_RAD:.1f}", *texts])
    columns = [f"{name}_{part}_rad" for name in ("measured", *names) for part in ("cosine", "sine")]
    return Table(
        "waveform", "Third harmonic of the swing, mas",
        ("amplitude_rad", "order", "u_rad", *columns), rows, ("arcsec", "measured", *names), shown,
        "Deflections stacked by phase. A law with a different third harmonic does not describe "
        "the motion within the swing, however well it describes the decay.",
    )  # fmt: skip
