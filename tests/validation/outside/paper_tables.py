"""The paper's own numbers: its Table 1, its surface energies, the parameters of its three pairs."""

from functools import cache

from processing.contact.hertz import MATERIALS, pendulum_on_ball
from processing.contact.moments import surface_energy
from processing.estimate import Estimate
from rig.report.paper import BALL_RADIUS_M, MASS_KG, PAIRS, elastic_rows, friction_rows, simulate_pair, table1
from tests.validation.row import Found


def first_table() -> dict[str, Found]:
    """Rows of Table 1 (radii, depths, angles after Hertz) that do not come out as printed."""
    rows = table1().shown
    off = [row[1] for row in rows if row[-1] != "agrees as rounded"]
    return {"off": Found((float(len(off)),), f"of {len(rows)} printed numbers")}


def energies() -> dict[str, Found]:
    """Surface energies of Table 3 by the form of Table 2, relative to the printed ones, %."""
    off = []
    for pair in PAIRS:
        pendulum = pendulum_on_ball(MASS_KG, BALL_RADIUS_M, MATERIALS["steel"], MATERIALS[pair.flat])
        energy = surface_energy(Estimate(pair.c, 0.0), pendulum)
        off.append(100 * abs(energy.table2.value / pair.surface_energy_j_per_m2 - 1))
    return {"off": Found(tuple(off), ", ".join(pair.flat for pair in PAIRS))}


@cache
def parameters() -> dict[str, Found]:
    """All three pairs: decays integrated with the printed parameters, and what the fit finds, over u.

    Where u is below 1e-4 of the printed value, this stands for it: the printed digits are no better.
    """
    off, kept = [], []
    for pair in PAIRS:
        simulated = simulate_pair(pair, seed=5)
        for row in (*friction_rows(simulated), *elastic_rows(simulated)):
            if row.label in ("b", "p", "c", "n", "T₀", "γ"):
                off.append(abs(row.exact - row.printed) / max(row.u, 1e-4 * abs(row.printed)))
                kept.append(f"{pair.flat} {row.label}")
    worst = kept[off.index(max(off))]
    return {"pull": Found((max(off),), f"{len(off)} parameters; the farthest, {worst}")}
