"""Examples H.1 to H.6 of the GUM (JCGM 100:2008, annex H) through the program's propagation of uncertainty.

Data and answers are the printed ones. Compared with a second source, and no difference found, have been the
data and answers of H.1 to H.3, by what the documentation of GTC prints of them (Measurement Standards
Laboratory of New Zealand; fewer digits, and 16.5 effective degrees of freedom in H.1, where it combines other
parts), and the data of H.2 to H.4, by the data sets of R's package `propagate`. The answers of H.4 and all of
H.5 and H.6 have been compared with none. What is judged: `sensitivities`, `budget_of` and `propagate`
(derivatives, combination, effective degrees of freedom, covariances), `solve` (a line), `combine` (runs of a
series, here days).
"""

from collections.abc import Callable, Mapping
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats
from processing.estimate import Estimate
from processing.fit import InputQuantity
from processing.fit.uncertainty import Budget, budget_of, sensitivities
from processing.least_squares import propagate, solve
from processing.series import combine
from tests.validation.row import Found

Array = NDArray[np.float64]


def budget_by(model: Callable[[Mapping[str, Floats]], Floats], inputs: Mapping[str, InputQuantity]) -> Budget:
    """The program's budget of one quantity that follows from independent inputs."""
    slopes = sensitivities(lambda drawn: {"y": model(drawn)}, inputs)["y"]
    value = float(model({name: np.array([quantity.value]) for name, quantity in inputs.items()})[0])
    parts = [
        (name, "B", inputs[name].u, slope, abs(slope) * inputs[name].u)
        for name, slope in slopes.items()
        if slope != 0
    ]
    return budget_of("", value, parts, [(part[4], inputs[part[0]].dof) for part in parts])  # type: ignore[arg-type]


def _propagated(
    model: Callable[[Mapping[str, Floats]], dict[str, Floats]],
    means: Mapping[str, float],
    covariance: Array,
) -> tuple[dict[str, float], Array]:
    """Values of a model of correlated inputs, and their covariance."""
    inputs = {
        name: InputQuantity(mean, sqrt(covariance[k, k])) for k, (name, mean) in enumerate(means.items())
    }
    values = {name: float(v[0]) for name, v in model({n: np.array([m]) for n, m in means.items()}).items()}
    slopes = sensitivities(model, inputs)
    rows = np.array([[slopes[of].get(name, 0.0) for name in means] for of in values])
    return values, propagate(rows, covariance)


def units_off(value: float, printed: str) -> float:
    """The distance in units of the last printed digit: up to a half the value rounds to what is printed."""
    decimals = len(printed.partition(".")[2])
    return float(abs(value - float(printed)) * 10.0**decimals)


def _found(pairs: Mapping[str, tuple[float, str]]) -> dict[str, Found]:
    off = {name: units_off(value, printed) for name, (value, printed) in pairs.items()}
    worst = max(off, key=lambda name: off[name])
    return {"off": Found((max(off.values()),), f"{len(off)} numbers; the farthest, {worst}: "
                         f"{pairs[worst][0]:.6g}, printed {pairs[worst][1]}")}  # fmt: skip


def end_gauge() -> dict[str, Found]:
    """H.1: the length of an end gauge, nm."""
    length = "length of the standard"
    inputs = {
        length: InputQuantity(50_000_623.0, 25.0, dof=18),
        "d": InputQuantity(215.0, 5.8, dof=24),
        "d1": InputQuantity(0.0, 3.9, dof=5),
        "d2": InputQuantity(0.0, 6.7, dof=8),
        "alpha": InputQuantity(11.5e-6, 2e-6 / sqrt(3)),
        "theta": InputQuantity(-0.1, 0.41),
        "d_alpha": InputQuantity(0.0, 1e-6 / sqrt(3), dof=50),
        "d_theta": InputQuantity(0.0, 0.05 / sqrt(3), dof=2),
    }

    def model(x: Mapping[str, Floats]) -> Floats:
        heat = x["d_alpha"] * x["theta"] + x["alpha"] * x["d_theta"]
        return x[length] + x["d"] + x["d1"] + x["d2"] - x[length] * heat

    budget = budget_by(model, inputs)
    part = {source.source: source.contribution for source in budget.sources}
    return _found(
        {
            "l": (budget.value, "50000838"),
            "u of l": (budget.standard_uncertainty, "32"),
            "part of the standard": (part[length], "25"),
            "part of d": (sqrt(part["d"] ** 2 + part["d1"] ** 2 + part["d2"] ** 2), "9.7"),
            "part of the expansions": (part["d_alpha"], "2.9"),
            "part of the temperatures": (part["d_theta"], "16.6"),
            "degrees of freedom": (budget.degrees_of_freedom, "16.7"),
        }
    )


VOLTS = np.array([5.007, 4.994, 5.005, 4.990, 4.999])
AMPERES = np.array([19.663, 19.639, 19.640, 19.685, 19.678]) * 1e-3
PHASES = np.array([1.0456, 1.0438, 1.0468, 1.0428, 1.0433])


def impedance() -> dict[str, Found]:
    """H.2: resistance, reactance and impedance from five sets of correlated readings."""
    readings = np.array([VOLTS, AMPERES, PHASES])
    means = dict(zip(("V", "I", "phi"), readings.mean(axis=1).tolist(), strict=True))

    def model(x: Mapping[str, Floats]) -> dict[str, Floats]:
        z = x["V"] / x["I"]
        return {"R": z * np.cos(x["phi"]), "X": z * np.sin(x["phi"]), "Z": z}

    value, out = _propagated(model, means, np.cov(readings) / 5)
    u = np.sqrt(np.diag(out))
    r = out / np.outer(u, u)
    return _found(
        {
            "R": (value["R"], "127.732"),
            "X": (value["X"], "219.847"),
            "Z": (value["Z"], "254.260"),
            "u of R": (float(u[0]), "0.071"),
            "u of X": (float(u[1]), "0.295"),
            "u of Z": (float(u[2]), "0.236"),
            "r of R and X": (float(r[0, 1]), "-0.588"),
            "r of R and Z": (float(r[0, 2]), "-0.485"),
            "r of X and Z": (float(r[1, 2]), "0.993"),
        }
    )


READINGS_C = np.array(
    [21.521, 22.012, 22.512, 23.003, 23.507, 23.999, 24.513, 25.002, 25.503, 26.010, 26.511]
)
CORRECTIONS_C = -1e-3 * np.array([171.0, 169, 166, 159, 164, 165, 156, 157, 159, 161, 160])


def thermometer() -> dict[str, Found]:
    """H.3: a line through the corrections of a thermometer, and a correction predicted by it."""
    design = np.column_stack([np.ones(11), READINGS_C - 20.0])
    fit = solve(lambda y: (design @ y - CORRECTIONS_C, design), np.zeros(2))
    scale = fit.chi2 / fit.dof
    covariance = fit.covariance * scale
    u = np.sqrt(np.diag(covariance))
    at_30 = np.array([[1.0, 10.0]])
    return _found(
        {
            "y1": (float(fit.values[0]), "-0.1712"),
            "u of y1": (float(u[0]), "0.0029"),
            "y2": (float(fit.values[1]), "0.00218"),
            "u of y2": (float(u[1]), "0.00067"),
            "r of y1 and y2": (float(covariance[0, 1] / (u[0] * u[1])), "-0.930"),
            "s": (sqrt(scale), "0.0035"),
            "b at 30 °C": (float((at_30 @ fit.values)[0]), "-0.1494"),
            "u of b at 30 °C": (sqrt(float(propagate(at_30, covariance)[0, 0])), "0.0041"),
        }
    )


# minutes from the reference time, counts in 60 minutes; standard, blank, sample
T_STANDARD = np.array([243.74, 984.53, 1723.87, 2463.17, 3217.56, 3956.83])
N_STANDARD = np.array([15380.0, 14978, 14394, 13254, 12516, 11058])
N_BLANK = np.array([4054.0, 3922, 4200, 3830, 3956, 3980])
T_SAMPLE = np.array([367.37, 1107.66, 1846.99, 2586.28, 3340.68, 4079.94])
N_SAMPLE = np.array([41432.0, 38706, 35860, 32238, 29640, 26356])
DECAY_PER_MIN = 1.25894e-4


def activity() -> dict[str, Found]:
    """H.4: the activity of a sample, by correlated means of counting rates."""
    rates = np.array(
        [
            (N_SAMPLE - N_BLANK) / 60 * np.exp(DECAY_PER_MIN * T_SAMPLE),
            (N_STANDARD - N_BLANK) / 60 * np.exp(DECAY_PER_MIN * T_STANDARD),
        ]
    )
    mean, covariance = rates.mean(axis=1), np.zeros((5, 5))
    covariance[:2, :2] = np.cov(rates) / 6
    known = {"A_S": (0.1368, 0.0018), "m_S": (5.0192, 0.0050), "m_x": (5.0571, 0.0010)}
    for k, (_, u) in enumerate(known.values()):
        covariance[2 + k, 2 + k] = u**2
    means = {"R_x": float(mean[0]), "R_S": float(mean[1]), **{name: one for name, (one, _) in known.items()}}

    def model(x: Mapping[str, Floats]) -> dict[str, Floats]:
        ratio = x["R_x"] / x["R_S"]
        return {"ratio": ratio, "A_x": x["A_S"] * x["m_S"] / x["m_x"] * ratio}

    value, out = _propagated(model, means, covariance)
    u_out = np.sqrt(np.diag(out))
    return _found(
        {
            "ratio of rates": (value["ratio"], "3.167"),
            "u of the ratio": (float(u_out[0]), "0.045"),
            "A_x": (value["A_x"], "0.4300"),
            "u of A_x": (float(u_out[1]), "0.0083"),
        }
    )


DAYS_UV = np.array([172.0, 116, 13, 144, 106, 31, 60, 125, 163, 41])
WITHIN_UV = np.array([60.0, 77, 111, 101, 67, 93, 80, 73, 88, 86])


def zener() -> dict[str, Found]:
    """H.5: a Zener voltage on ten days, five readings each: the scatter between days beyond that within."""
    pooled = sqrt(float(np.mean(WITHIN_UV**2)) / 5)
    found = combine("V", [Estimate(float(day), pooled) for day in DAYS_UV])
    return _found(
        {
            "V - 10 V": (found.value, "97"),
            "u of V": (found.standard_uncertainty, "18"),
            "between days": (found.between_runs, "43"),
            "degrees of freedom": (float(found.degrees_of_freedom), "9"),
        }
    )


def hardness() -> dict[str, Found]:
    """H.6: a hardness on Rockwell's scale C: the three parts that the GUM names, in scale units."""
    inputs = {
        "mean of five": InputQuantity(64.0, 0.45 / sqrt(5)),
        "non-uniformity of the block": InputQuantity(0.0, 0.11),
        "national machine and definition": InputQuantity(0.0, 0.5),
    }
    budget = budget_by(lambda x: np.asarray(sum(x.values())), inputs)
    part = {source.source: source.contribution for source in budget.sources}
    return _found(
        {
            "h": (budget.value, "64.0"),
            "u of h": (budget.standard_uncertainty, "0.55"),
            "part of the mean": (part["mean of five"], "0.20"),
        }
    )
