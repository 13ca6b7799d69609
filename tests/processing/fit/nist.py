"""NIST's Statistical Reference Datasets for nonlinear regression (public domain), as the files state them.

https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml: values and standard errors certified to eleven
digits, from two starts each, one of them far away. The model is compiled from its formula in the file.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processing.least_squares import Solution, solve

FOLDER = Path(__file__).parent / "data" / "nist"
NAMES = sorted(path.stem for path in FOLDER.glob("*.dat"))
_MATH = {"exp": np.exp, "cos": np.cos, "sin": np.sin, "arctan": np.arctan, "pi": np.pi}


@dataclass(frozen=True)
class Dataset:
    """Response and predictors, the model of them, where to begin, and what is certified."""

    y: NDArray
    function: Callable[[NDArray], NDArray]
    starts: NDArray
    certified: NDArray
    standard_error: NDArray
    residual_sum: float


def dataset(name: str) -> Dataset:
    """Read one of `NAMES`."""
    text = (FOLDER / f"{name}.dat").read_text()
    formula = re.search(r"^ *(?:log\[)?y\]? *=(.*?)\+ *e *$", text, re.MULTILINE | re.DOTALL)
    assert formula is not None
    code = compile(re.sub(r"\s+", " ", formula[1].translate({91: "(", 93: ")"})).strip(), name, "eval")
    rows = re.findall(r"^ *b(\d+) *= *(\S+) +(\S+) +(\S+) +(\S+) *$", text, re.MULTILINE)
    numbers = np.array([[float(word) for word in row[1:]] for row in rows])
    table = np.array(
        [
            [float(word) for word in line.split()]
            for line in text.rpartition("Data:")[2].splitlines()[1:]
            if line.strip()
        ]
    )
    y, x = table[:, 0], table[:, 1:].T
    if "log[y]" in text:
        y = np.log(y)
    at = {"x": x[0]} if len(x) == 1 else {f"x{number}": column for number, column in enumerate(x, start=1)}

    def function(b: NDArray) -> NDArray:
        values = {f"b{number}": value for number, value in enumerate(b, start=1)}
        found = eval(code, {"__builtins__": {}}, {**_MATH, **at, **values})
        return np.asarray(found)

    total = re.search(r"Residual Sum of Squares: *(\S+)", text)
    assert total is not None
    return Dataset(y, function, numbers[:, :2].T, numbers[:, 2], numbers[:, 3], float(total[1]))


def fitted(data: Dataset, start: int) -> Solution:
    """The fit from the first start (far) or the second (near); derivatives by complex steps."""

    def model(values: NDArray) -> tuple[NDArray, NDArray]:
        jacobian = np.empty((len(data.y), len(values)))
        # far from the minimum exponentials overflow, which the solver takes for a step too long
        with np.errstate(all="ignore"):
            for i in range(len(values)):
                step = values.astype(complex)
                step[i] += 1e-30j  # derivatives without cancellation
                jacobian[:, i] = np.imag(data.function(step)) / 1e-30
            return data.function(values) - data.y, jacobian

    return solve(model, data.starts[start - 1], cost_tolerance=1e-15, max_evaluations=3000)


def digits(found: NDArray, certified: NDArray) -> float:
    """Digits to which all numbers agree (log relative error), at most the eleven that are certified."""
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.nanmax(np.abs(found / certified - 1))
    return float(min(11.0, -np.log10(relative))) if np.isfinite(relative) else 0.0
