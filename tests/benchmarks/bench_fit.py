"""Fits: coverage of their intervals. Run as ``python -m tests.benchmarks fit [--quick]``."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from processing.contact.laws import DRAG, PAPER
from processing.errors import RigError
from processing.fit.exact import fit_exact
from tests.processing.fit.decays import PAIRS, decay, paper_pair

COVERAGES = (0.6827, 0.95)


def coverage(flat: str, drag_s: float, noise_arcsec: float, seeds: int) -> dict[str, Any]:
    """Share of seeds in which each parameter's interval holds the truth, both kinds of interval."""
    parameters, pendulum = paper_pair(flat, drag_s)
    names = [*PAPER.names(), *([DRAG.key] if drag_s else [])]
    inside = {kind: {name: [0, 0] for name in names} for kind in ("interval", "value_and_u")}
    chi2, failed = [], 0
    for seed in range(seeds):
        points = decay(parameters, pendulum, noise_arcsec=noise_arcsec, seed=1000 + seed)
        try:
            result = fit_exact(points, pendulum, drag=drag_s > 0)
        except RigError:
            failed += 1
            continue
        chi2.append(result.chi2_per_dof)
        for name in names:
            truth = getattr(parameters, name)
            estimate = result.estimate(name)
            for k, share in enumerate(COVERAGES):
                low, high = result.interval(name, share)
                inside["interval"][name][k] += low <= truth <= high
                factor = (1.0, 1.96)[k]
                inside["value_and_u"][name][k] += (
                    abs(estimate.value - truth) <= factor * estimate.standard_uncertainty
                )
    done = seeds - failed
    return {
        "flat": flat,
        "drag_s": drag_s,
        "noise_arcsec": noise_arcsec,
        "seeds": seeds,
        "failed": failed,
        "mean_chi2_per_dof": float(np.mean(chi2)),
        **{
            kind: {name: [count / done for count in counts] for name, counts in by_name.items()}
            for kind, by_name in inside.items()
        },
        "one_sigma_all": sum(counts[0] for counts in inside["interval"].values()) / (done * len(names)),
        "ninety_five_all": sum(counts[1] for counts in inside["interval"].values()) / (done * len(names)),
    }


def coverages(seeds: int, flats: Sequence[str] = PAIRS) -> list[dict[str, Any]]:
    """Coverage with and without drag, at two noises."""
    found = []
    for flat in flats:
        for drag_s in (0.0, 1e-3):
            for noise in (0.0005, 0.005):
                case = coverage(flat, drag_s, noise, seeds)
                found.append(case)
                one_sigma = [shares[0] for shares in case["interval"].values()]
                print(
                    f"{flat:9s} drag {drag_s:g} s, {noise:g} arcsec: 1 sigma {case['one_sigma_all']:.3f} "
                    f"({min(one_sigma):.3f} to {max(one_sigma):.3f}), 95 % {case['ninety_five_all']:.3f}, "
                    f"chi2/dof {case['mean_chi2_per_dof']:.3f}, {case['failed']} failed",
                    flush=True,
                )
    return found


def run(quick: bool = False) -> dict[str, Any]:
    """All of it; numbers as plain values."""
    return {"coverage": coverages(20 if quick else 200, PAIRS[:1] if quick else PAIRS)}
