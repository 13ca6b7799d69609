"""What results.json keeps of damping that depends on the amplitude."""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from typing import Annotated

import numpy as np

from processing.damping import PARTS, Damping
from processing.estimate import NOT_DETERMINED, Estimate
from processing.quantity import OWN, PART, PER, Quantity
from rig.analysis.encoding import Section

_SURE = 3.0
_SHOWN = 9
"""Amplitudes at which the curve is kept; it is smooth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DampingAt:
    """Time constant at an amplitude (in the decay's unit); quality factor where the frequency is known."""

    amplitude: Annotated[float, PART]
    time_constant_s: Estimate = NOT_DETERMINED
    quality_factor: Annotated[Estimate | None, Section] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AmplitudeDamping:
    """dA/dt = -(constant + linear A + quadratic A^2), in the amplitude's unit and s; see
    `processing.damping`.

    `needed` are the parts that the decay needs with a probability of more than 95 %, `probabilities` those of
    all three in order. `curve` goes from the first amplitude to the last.
    """

    constant: Annotated[Estimate, Quantity("", "friction", unit=OWN + PER + "s")] = NOT_DETERMINED
    linear: Annotated[Estimate, Quantity("", "viscous damping", unit="1/s")] = NOT_DETERMINED
    quadratic: Annotated[Estimate, Quantity("", "quadratic drag", unit="1/s" + PER + OWN)] = NOT_DETERMINED
    probabilities: tuple[float, ...] = ()
    needed: tuple[str, ...] = ()
    chi2_per_dof: float = float("nan")
    curve: Annotated[tuple[DampingAt, ...], PART] = ()


def amplitude_damping(
    damping: Damping, frequency_hz: float | None, shown: Callable[[float], float] = float
) -> AmplitudeDamping:
    """The parts and the curve; `shown` brings an amplitude into the unit in which it is kept."""
    amplitudes = damping.amplitudes(_SHOWN)
    tau_s, u_tau_s = damping.time_constant_s(amplitudes)
    parts = {name: Estimate(*getattr(damping, name)[:2]) for name in PARTS}
    return AmplitudeDamping(
        **parts,
        probabilities=tuple(float(getattr(damping, name).probability) for name in PARTS),
        needed=damping.needed,
        chi2_per_dof=damping.chi2_per_dof,
        curve=tuple(
            DampingAt(
                amplitude=shown(float(amplitude)),
                time_constant_s=Estimate(float(tau), float(u)),
                quality_factor=(
                    None
                    if frequency_hz is None
                    else Estimate(pi * frequency_hz * float(tau), pi * frequency_hz * float(u))
                ),
            )
            for amplitude, tau, u in zip(amplitudes, tau_s, u_tau_s, strict=True)
            if np.isfinite(tau) and tau > 0
        ),
    )


def damping_lines(results: AmplitudeDamping, unit: str) -> list[str]:
    """Lines for a person: the parts with what speaks for them, and the time constants at both ends."""
    from rig.presentation import with_uncertainty

    units = {"constant": f" {unit}/s", "linear": " /s", "quadratic": f" /({unit} s)"}
    said = []
    for name, probability in zip(PARTS, results.probabilities, strict=True):
        part = with_uncertainty(*getattr(results, name))
        said.append(f"damping, {name} part {part}{units[name]}, needed with probability {probability:.2g}")
        value, u = getattr(results, name)
        if value < -_SURE * u:
            said.append(f"a negative {name} part fits the decay but is not friction: something else changes")
    if results.curve:
        for where in (results.curve[0], results.curve[-1]):
            quality = where.quality_factor
            more = "" if quality is None else f", quality factor {with_uncertainty(*quality)}"
            tau = with_uncertainty(*where.time_constant_s)
            said.append(f"time constant {tau} s at {where.amplitude:.4g} {unit}{more}")
    return said
