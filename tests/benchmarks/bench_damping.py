"""Time constants: how often they are covered, at five amplitudes of each kind of damping."""

from functools import partial

import numpy as np

from processing.damping import fit_damping
from tests.benchmarks.cases import run_of
from tests.benchmarks.coverage import Case, Floats, measure, of_pulls
from tests.processing.test_damping import KINDS, NOISE, T, true_amplitude
from tests.rig.analysis.spinning import Held


def cases() -> list[Case]:
    def case(kind: str) -> Case:
        constant, linear, quadratic = KINDS[kind]
        truth = true_amplitude(KINDS[kind])
        amplitudes = np.geomspace(1.0, truth[-1], 5)
        true_tau_s = 1.0 / (constant / amplitudes + linear + quadratic * amplitudes)
        return Case(kind, partial(found, truth, amplitudes, true_tau_s))

    def found(truth: Floats, amplitudes: Floats, true_tau_s: Floats, seed: int) -> dict[str, Held]:
        noise = NOISE * np.random.default_rng(seed).standard_normal(len(T))
        tau_s, u_tau_s = fit_damping(T, truth + noise, np.full(len(T), NOISE)).time_constant_s(amplitudes)
        pulls = (tau_s - true_tau_s) / u_tau_s
        return of_pulls({f"at {at:.2g}": float(z) for at, z in zip(amplitudes, pulls, strict=True)})

    return [case(kind) for kind in KINDS]


run = run_of(measure, cases, seeds=400, quick_seeds=40, apart=0)
