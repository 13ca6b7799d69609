"""The least-squares layer on NIST's Statistical Reference Datasets (public domain).

https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml: values and standard errors certified to
eleven digits, from two starts each, one of them far away.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.least_squares import solve


@dataclass(frozen=True)
class Dataset:
    name: str
    function: Callable[[NDArray, NDArray], NDArray]
    x: list[float]
    y: list[float]
    starts: tuple[list[float], list[float]]
    certified: list[float]
    standard_error: list[float]
    residual_sum: float


MISRA1A = Dataset(
    "Misra1a",
    lambda x, b: b[0] * (1 - np.exp(-b[1] * x)),
    [77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0],
    [10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40, 75.47, 81.78],
    ([500, 0.0001], [250, 0.0005]),
    [2.3894212918e02, 5.5015643181e-04],
    [2.7070075241e00, 7.2668688436e-06],
    1.2455138894e-01,
)
MGH09 = Dataset(
    "MGH09",
    lambda x, b: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    [4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625],
    [0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246],
    ([25, 39, 41.5, 39], [0.25, 0.39, 0.415, 0.39]),
    [1.9280693458e-01, 1.9128232873e-01, 1.2305650693e-01, 1.3606233068e-01],
    [1.1435312227e-02, 1.9633220911e-01, 8.0842031232e-02, 9.0025542308e-02],
    3.0750560385e-04,
)
THURBER = Dataset(
    "Thurber",
    lambda x, b: (b[0] + b[1] * x + b[2] * x**2 + b[3] * x**3) / (1 + b[4] * x + b[5] * x**2 + b[6] * x**3),
    [
        -3.067, -2.981, -2.921, -2.912, -2.840, -2.797, -2.702, -2.699, -2.633, -2.481, -2.363, -2.322,
        -1.501, -1.460, -1.274, -1.212, -1.100, -1.046, -0.915, -0.714, -0.566, -0.545, -0.400, -0.309,
        -0.109, -0.103, 0.010, 0.119, 0.377, 0.790, 0.963, 1.006, 1.115, 1.572, 1.841, 2.047, 2.200,
    ],
    [
        80.574, 84.248, 87.264, 87.195, 89.076, 89.608, 89.868, 90.101, 92.405, 95.854, 100.696, 101.060,
        401.672, 390.724, 567.534, 635.316, 733.054, 759.087, 894.206, 990.785, 1090.109, 1080.914,
        1122.643, 1178.351, 1260.531, 1273.514, 1288.339, 1327.543, 1353.863, 1414.509, 1425.208,
        1421.384, 1442.962, 1464.350, 1468.705, 1447.894, 1457.628,
    ],
    ([1000, 1000, 400, 40, 0.7, 0.3, 0.03], [1300, 1500, 500, 75, 1, 0.4, 0.05]),
    [
        1.2881396800e03, 1.4910792535e03, 5.8323836877e02, 7.5416644291e01,
        9.6629502864e-01, 3.9797285797e-01, 4.9727297349e-02,
    ],
    [
        4.6647963344e00, 3.9571156086e01, 2.8698696102e01, 5.5675370270e00,
        3.1333340687e-02, 1.4984928198e-02, 6.5842344623e-03,
    ],
    5.6427082397e03,
)  # fmt: skip
ECKERLE4 = Dataset(
    "Eckerle4",
    lambda x, b: b[0] / b[1] * np.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    [
        400, 405, 410, 415, 420, 425, 430, 435, 436.5, 438, 439.5, 441, 442.5, 444, 445.5, 447, 448.5, 450,
        451.5, 453, 454.5, 456, 457.5, 459, 460.5, 462, 463.5, 465, 470, 475, 480, 485, 490, 495, 500,
    ],
    [
        0.0001575, 0.0001699, 0.0002350, 0.0003102, 0.0004917, 0.0008710, 0.0017418, 0.0046400, 0.0065895,
        0.0097302, 0.0149002, 0.0237310, 0.0401683, 0.0712559, 0.1264458, 0.2073413, 0.2902366, 0.3445623,
        0.3698049, 0.3668534, 0.3106727, 0.2078154, 0.1164354, 0.0616764, 0.0337200, 0.0194023, 0.0117831,
        0.0074357, 0.0022732, 0.0008800, 0.0004579, 0.0002345, 0.0001586, 0.0001143, 0.0000710,
    ],
    ([1, 10, 500], [1.5, 5, 450]),
    [1.5543827178e00, 4.0888321754e00, 4.5154121844e02],
    [1.5408051163e-02, 4.6803020753e-02, 4.6800518816e-02],
    1.4635887487e-03,
)  # fmt: skip

CASES = [(data, start) for data in (MISRA1A, MGH09, THURBER, ECKERLE4) for start in (0, 1)]


@pytest.mark.parametrize(("data", "start"), CASES, ids=[f"{d.name}-start{s + 1}" for d, s in CASES])
def test_certified_values_and_standard_errors(data: Dataset, start: int) -> None:
    x, y = np.array(data.x, dtype=np.float64), np.array(data.y)

    def model(values: NDArray) -> tuple[NDArray, NDArray]:
        jacobian = np.empty((len(x), len(values)))
        for i in range(len(values)):
            step = values.astype(complex)
            step[i] += 1e-30j  # the complex step: derivatives without cancellation
            jacobian[:, i] = np.imag(data.function(x, step)) / 1e-30
        return data.function(x, values) - y, jacobian

    solution = solve(
        model, np.array(data.starts[start], dtype=np.float64), cost_tolerance=1e-15, max_evaluations=3000
    )
    assert solution.converged, solution.message
    np.testing.assert_allclose(solution.values, data.certified, rtol=1e-6)
    assert solution.chi2 == pytest.approx(data.residual_sum, rel=1e-9)
    # the data come without uncertainties: their scatter about the curve gives the scale
    errors = np.sqrt(np.diag(solution.covariance) * solution.chi2 / solution.dof)
    np.testing.assert_allclose(errors, data.standard_error, rtol=1e-5)


def test_a_direction_without_information_has_infinite_variance() -> None:
    x = np.linspace(0, 1, 20)

    def model(values: NDArray) -> tuple[NDArray, NDArray]:
        # the first two appear only as their sum
        return values[0] + values[1] + values[2] * x - 3 * x, np.column_stack([x**0, x**0, x])

    solution = solve(model, np.array([1.0, 2.0, 0.0]))
    variance = np.diag(solution.covariance)
    assert np.isinf(variance[0])
    assert np.isinf(variance[1])
    assert variance[2] == pytest.approx(1 / np.sum((x - x.mean()) ** 2), rel=1e-9)


@pytest.mark.parametrize("loss", ["soft_l1", "huber", "cauchy"])
def test_a_robust_loss_states_its_own_scatter(loss: str) -> None:
    """Over seeded repetitions with one wild point in twenty, the stated u is the scatter seen."""
    rng = np.random.default_rng(11)
    x = np.linspace(-1, 1, 100)
    jacobian = np.column_stack([x**0, x])
    found, stated = [], []
    for _ in range(200):
        y = rng.standard_normal(100)
        wild = rng.random(100) < 0.05
        y[wild] += rng.choice([-1, 1], wild.sum()) * 20

        def model(values: NDArray, y: NDArray = y) -> tuple[NDArray, NDArray]:
            return jacobian @ values - y, jacobian

        solution = solve(model, np.zeros(2), loss=loss)  # type: ignore[arg-type]
        found.append(solution.values)
        stated.append(np.sqrt(np.diag(solution.covariance)))
    # a standard deviation from 200 draws is known to 5 %; three of those
    np.testing.assert_allclose(np.mean(stated, axis=0), np.std(found, axis=0), rtol=0.15)
    assert np.all(np.abs(np.mean(found, axis=0)) < 3.5 * np.std(found, axis=0) / np.sqrt(200))
