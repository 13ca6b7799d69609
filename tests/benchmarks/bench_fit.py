"""Fits: coverage of their intervals, bias, speed; and Eq. 5 in closed form against scipy's quad.

Run as ``python -m tests.benchmarks.bench_fit [--quick]`` from the repository.
"""

import json
import sys
from collections.abc import Callable, Sequence
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
from scipy.integrate import quad

from processing.contact.hertz import MATERIALS
from processing.contact.laws import DRAG, PAPER
from processing.contact.parameters import ContactParameters
from processing.errors import RigError
from processing.fit import InputQuantity, RigQuantities
from processing.fit.asymptotic import fit_asymptotic
from processing.fit.determination import identifiability
from processing.fit.drag import drag_verdict
from processing.fit.exact import fit_exact
from processing.fit.reported import fitted_contact
from processing.fit.uncertainty import budgets
from tests.processing.contact.eq5_closed_form import decay_time
from tests.processing.fit.decays import ARCSEC, PAIRS, decay, paper_pair

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


def biases() -> dict[str, Any]:
    """Relative errors of both fits on noise-free turning points, in per cent."""
    out: dict[str, Any] = {}
    for flat in PAIRS:
        parameters, pendulum = paper_pair(flat)
        points = decay(parameters, pendulum, noise_arcsec=0.005, seed=0, noise_free=True)
        for kind, fit in (("asymptotic", fit_asymptotic), ("exact", fit_exact)):
            result = fit(points, pendulum)
            out.setdefault(flat, {})[kind] = {
                name: 100 * (result.estimate(name).value / getattr(parameters, name) - 1)
                for name in PAPER.names()
            }
    return out


def seconds(call: Callable[[], object], repeats: int) -> float:
    call()
    times = []
    for _ in range(repeats):
        start = perf_counter()
        call()
        times.append(perf_counter() - start)
    return median(times)


def closed_form_against_quad(rounds: int) -> dict[str, float]:
    """Time a point of Eq. 5, interleaved; quad at the same relative tolerance of 1e-10."""
    out = {}
    for flat in PAIRS:
        parameters, _ = paper_pair(flat)
        b, p, c, first = parameters.b, parameters.p, parameters.c, 124 * ARCSEC
        alpha = np.geomspace(2 * ARCSEC, 0.999 * first, 1000)
        decay_time(alpha, first, b=b, p=p, c=c, period_s=4.0)

        def integrand(phi: float, b: float = b, p: float = p, c: float = c) -> float:
            return float(1 / (c + b * phi**p / (p + 1)))

        ratios = []
        for _ in range(rounds):
            start = perf_counter()
            decay_time(alpha, first, b=b, p=p, c=c, period_s=4.0)
            middle = perf_counter()
            for a in alpha[::10]:
                quad(integrand, a, first, epsabs=0, epsrel=1e-10)
            end = perf_counter()
            ratios.append((end - middle) * 10 / (middle - start))
        out[flat] = median(ratios)
    return out


def speed(quick: bool) -> dict[str, float]:
    """Seconds, compiled, on decays of the rig's noise."""
    repeats = 1 if quick else 5
    parameters, pendulum = paper_pair("steel")
    long_run = decay(parameters, pendulum, noise_arcsec=0.005, seed=1)
    parameters, pendulum = paper_pair("silicon", 1e-4)
    dragged = decay(parameters, pendulum, noise_arcsec=0.005, seed=1)
    rig = RigQuantities(
        InputQuantity(0.406, 1e-4),
        InputQuantity(6.05e-3, 2e-6),
        MATERIALS["steel"],
        MATERIALS["silicon"],
        InputQuantity(1.0, 1e-3),
        InputQuantity(3.45e-6, 1e-9),
    )

    def whole_analysis() -> None:
        fit_asymptotic(dragged, pendulum)
        found = fit_exact(dragged, pendulum, drag=True)
        drag_verdict(dragged, pendulum, found)
        identifiability(dragged, pendulum, found)
        budgets(fitted_contact(found), rig)

    return {
        "half_cycles": len(long_run),
        "asymptotic_fit_s": seconds(lambda: fit_asymptotic(long_run, pendulum), repeats),
        "exact_fit_s": seconds(lambda: fit_exact(long_run, pendulum), repeats),
        "exact_fit_with_drag_s": seconds(lambda: fit_exact(dragged, pendulum, drag=True), repeats),
        "whole_analysis_s": seconds(whole_analysis, 1 if quick else 3),
    }


def random_decays(count: int) -> dict[str, Any]:
    """Parameters nobody chose, noise from 0.0005 to 0.5 arcsec: how often a fit fails or misfits."""
    failed = misfit = fits = 0
    slowest = 0.0
    size = 124 * ARCSEC
    _, pendulum = paper_pair("silicon")
    weight = pendulum.mass_kg * pendulum.gravity_m_per_s2
    for seed in range(count):
        rng = np.random.default_rng(seed)
        p, n = rng.uniform(0.2, 1.6), rng.uniform(0.03, 1.2)
        loss, share = 10 ** rng.uniform(-3, -1.5), 10 ** rng.uniform(-3, -0.3)
        kappa = 10 ** rng.uniform(-3, -1) * size**-n
        parameters = ContactParameters(
            loss / 2 * (1 - share) * (p + 1) * size ** (1 - p),
            p,
            0.15 * loss * share * size,
            n,
            rng.uniform(2, 6),
            kappa * weight / (2 * pendulum.contact_radius_m**2),
        )
        points = decay(parameters, pendulum, noise_arcsec=10 ** rng.uniform(-3.3, -0.3), seed=seed)
        for drag in (False, True):
            start = perf_counter()
            fits += 1
            try:
                result = fit_exact(points, pendulum, drag=drag)
            except RigError:
                failed += 1
                continue
            slowest = max(slowest, perf_counter() - start)
            misfit += abs(result.chi2_per_dof - 1) > 5 * np.sqrt(2 / result.dof)
    return {"fits": fits, "failed": failed, "misfit": int(misfit), "slowest_s": slowest}


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
    result: dict[str, Any] = {"coverage": coverages(20 if quick else 200, PAIRS[:1] if quick else PAIRS)}
    result["bias_percent"] = biases()
    result["closed_form_times_faster_than_quad"] = closed_form_against_quad(3 if quick else 9)
    result["speed"] = speed(quick)
    result["random_decays"] = random_decays(5 if quick else 60)
    for flat, ratio in result["closed_form_times_faster_than_quad"].items():
        print(f"Eq. 5 in closed form, {flat}: {ratio:.0f} times faster than quad")
    for name, value in result["speed"].items():
        print(f"{name}: {value:.3g}")
    print(f"random decays: {result['random_decays']}")
    for flat, kinds in result["bias_percent"].items():
        for kind, values in kinds.items():
            print(f"bias % {flat} {kind}: " + ", ".join(f"{k} {v:+.3g}" for k, v in values.items()))
    return result


if __name__ == "__main__":
    json.dump(run("--quick" in sys.argv), sys.stderr, indent=1)
