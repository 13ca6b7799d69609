"""Fits: coverage of their intervals. Run as ``python -m tests.benchmarks fit [--quick]``."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from processing.contact.laws import PAPER
from processing.fit import FitResult, fit_exact
from tests.benchmarks.cases import each_seed
from tests.benchmarks.coverage import of_fits
from tests.processing.fit.decays import PAIRS, decay, paper_pair, truth


def measure(flat: str, drag_s: float, noise_arcsec: float, seeds: int) -> dict[str, Any]:
    """Share of seeds in which each parameter's interval holds the truth, and errors over u."""
    parameters, pendulum = paper_pair(flat, drag_s)
    names = PAPER.names(drag=drag_s > 0)

    def one(seed: int) -> FitResult:
        points = decay(parameters, pendulum, noise_arcsec=noise_arcsec, seed=seed)
        return fit_exact(points, pendulum, drag=drag_s > 0)

    fits, failed = each_seed(one, seeds, 1000)
    table = of_fits(fits, names, truth(parameters, names))
    return {
        "seeds": seeds,
        "failed": failed,
        "mean_chi2_per_dof": float(np.mean([fit.chi2_per_dof for fit in fits])),
        **table,
        "one_sigma_all": float(np.mean(list(table["one_u"].values()))),
    }


def coverages(seeds: int, flats: Sequence[str] = PAIRS) -> dict[str, dict[str, Any]]:
    """Coverage with and without drag, at two noises."""
    return {
        f"{flat}, drag {drag_s:g} s, {noise_arcsec:g} arcsec": measure(flat, drag_s, noise_arcsec, seeds)
        for flat in flats
        for drag_s in (0.0, 1e-3)
        for noise_arcsec in (0.0005, 0.005)
    }


def run(quick: bool = False) -> dict[str, Any]:
    """All of it; numbers as plain values."""
    return {"coverage": coverages(20 if quick else 200, PAIRS[:1] if quick else PAIRS)}
