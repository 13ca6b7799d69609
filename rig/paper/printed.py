"""Values printed in the paper "Phenomenological Laws of Single Point Contact: Pre-Rolling Contact Resistance
through Pendulum", Lubricants 2023, 11(2), 88."""

from dataclasses import dataclass
from typing import Final

SOURCE: Final = "Lubricants 2023, 11(2), 88"
MASS_KG: Final = 0.406
BALL_RADIUS_M: Final = 6.05e-3
PERIOD_RATIO: Final = 5.0
INITIAL_AMPLITUDE_ARCSEC: Final = 124.0
FINAL_AMPLITUDE_ARCSEC: Final = 2.0
RUNS: Final = 3
LOOP_AMPLITUDE_ARCSEC: Final = 3.1
BALL: Final = "steel"


@dataclass(frozen=True, slots=True)
class PrintedPair:
    """Values of one contact pair in Tables 1 to 3.

    Table 2 prints b without its power of ten; with 1e-4, a run lasts as long as stated in the paper.
    """

    flat_name: str
    flat: str
    contact_radius_um: float
    depth_um: float
    contact_angle_arcmin: float
    b_printed: float
    p: float
    c: float
    surface_energy_j_per_m2: float
    arae_decay: float
    n: float
    period0_s: float
    gamma_pa: float
    arae_period: float

    @property
    def name(self) -> str:
        return f"{BALL} on {self.flat_name}"


PAIRS: Final = (
    PrintedPair(
        "K8 glass", "glass_k8", 66, 0.7, 38,
        37.330, 0.944, 10.510e-9, 28.900e-3, 0.008, 0.092, 4.071, 28.97e6, 0.002,
    ),
    PrintedPair(
        "silicon", "silicon", 59, 0.6, 34,
        7.060, 0.815, 3.840e-9, 13.200e-3, 0.026, 0.552, 4.072, 290.69e6, 0.002,
    ),
    PrintedPair(
        "steel", "steel", 54, 0.5, 31,
        7.961, 0.850, 6.601e-9, 27.300e-3, 0.035, 0.461, 4.049, 95.46e6, 0.004,
    ),
)  # fmt: skip

CONTRADICTIONS: Final = (
    (
        "Table 2's first row is printed without label and unit: it is b without its power of ten. "
        "The row labelled b is p."
    ),
    (
        "Eq. 2 as printed, σ = m g c/(2a), gives a hundredth of Table 2's surface energies; m g R c/(2a²) "
        "gives 28.90, 13.21 and 27.22 mJ/m², Table 2's within 0.3 %. Both are reported."
    ),
    (
        "Eq. 6 prints 0.55 where averaging Eq. 3 gives a factor that depends on n (0.540 at n = 0); "
        "here it is calculated."
    ),
    "Eqs. 8 and 9 sum k + 1 terms and divide by k; here the mean is taken.",
    (
        "Eqs. 5 and 6 are asymptotic: fitted to swings that obey the paper's own laws they return b, c and "
        "γ that are off, by some per cent if b's power of ten is -4 (columns of Tables 2 and 3); the "
        "relative errors of Eqs. 8 and 9 do not show it. The exact map is not off."
    ),
    "Table 4 draws its loops and states its works in pictures only: there is no printed number to compare.",
)
