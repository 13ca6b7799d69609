"""Maxwell slip: springs in parallel, each of which slips beyond an angle of its own.

    f(phi) = sum k_i min(phi, phi_i),    phi_i = 4, 12, 36, 90 arcsec,    branches by Masing's rule

Any backbone that rises ever less is such a sum; this one asks nothing of its shape but four stiffnesses.

Where a slider begins to slip, the loss of a half-swing has a kink over the amplitude. The table of
half-swings rounds it, by 2e-5 of amplitude and time; the derivatives by the stiffnesses are off by 3 to 5 %
there, and so may be uncertainties that hang on these amplitudes.
"""

import numpy as np

from processing.arrays import Floats
from processing.contact.coordinates import Scaling, logarithms_of
from processing.contact.law import CONSTANT, FREE_PERIOD, PERIOD, Parameter
from processing.contact.memory import Arrays, branch_law, masing
from processing.contact.start_values import StartValues

YIELD_ARCSEC = (4.0, 12.0, 36.0, 90.0)
"""By factors of about three through the swings of the paper's runs, 124 to 2 arcsec."""
_YIELD_RAD = tuple(np.deg2rad(angle / 3600).item() for angle in YIELD_ARCSEC)
_KEYS = tuple(f"k{number}" for number in range(1, len(YIELD_ARCSEC) + 1))


def _backbone(x: Floats, q: Arrays) -> Floats:
    total = sum(q[key] * np.minimum(x, y / q["reference"]) for key, y in zip(_KEYS, _YIELD_RAD, strict=True))
    return np.asarray(total)


def _work(x: Floats, q: Arrays) -> Floats:
    total: Floats = np.zeros(())
    for key, y_rad in zip(_KEYS, _YIELD_RAD, strict=True):
        y = y_rad / q["reference"]
        total = total + q[key] * np.where(x < y, 0.5 * x * x, y * (x - 0.5 * y))
    return np.asarray(total)


def _likely(found: StartValues, reference_rad: float) -> list[dict[str, float]]:
    from scipy.optimize import nnls

    decay = found.decay
    a = np.geomspace(0.2, 5.0, 30)
    loss = 2 * (decay.c + decay.b * a**decay.p / (decay.p + 1))
    unit = {key: np.zeros(()) for key in _KEYS} | {"reference": np.array(reference_rad)}
    columns = [np.full_like(a, 2.0)]
    for key in _KEYS:
        one = {**unit, key: np.ones(())}
        columns.append(4 * _work(a, one) / a - 2 * _backbone(a, one))
    solution, _ = nnls(np.column_stack(columns) / loss[:, None], np.ones_like(a))
    c, *stiffness = solution.tolist()
    period0_s = found.mean_period_s * np.sqrt(1 + min(sum(stiffness), 1.0))
    return [{"c": c, **dict(zip(_KEYS, stiffness, strict=True)), PERIOD: period0_s}]


MAXWELL_SLIP = branch_law(
    "maxwell-slip",
    "four springs that slip, with memory",
    "Iwan 1966",
    (
        *(
            Parameter(key, f"k{'₁₂₃₄'[i]}", "rad⁻¹", f"stiffness that slips at {YIELD_ARCSEC[i]:g} arcsec",
                      "f = Σ k min(φ, φ_i)", lower=0.0)
            for i, key in enumerate(_KEYS)
        ),
        CONSTANT,
        FREE_PERIOD,
    ),
    masing(_backbone, _work, constant=CONSTANT.key),
    {**{key: Scaling() for key in _KEYS}, "c": Scaling(1.0)},
    logarithms_of(),
    _likely,
    in_angles=True,
)  # fmt: skip
