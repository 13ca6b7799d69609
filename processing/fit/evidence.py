"""Evidence of a fit beyond the turning points: the waveform of the swing, and the expected drag of the air.

A drag takes energy as a friction does that grows with the amplitude, so that turning points hardly tell them
apart on ground that moves. Within a swing they differ: friction reverses at each turning point and makes
odd harmonics in quadrature, a drag makes none. Neither a lever that is not straight, nor fixed-pattern
position errors of the sensor, nor slow motion of the ground make such harmonics; even orders, which rows
exposed in turn make, are left out.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import log

import numpy as np

from processing.arrays import Floats
from processing.contact import DRAG, Law, PendulumOnBall, law_harmonics
from processing.estimate import Estimate
from processing.fit.known_drive import KnownDrive
from processing.least_squares import FactoredJacobian
from processing.noise_models import MAD_TO_SIGMA
from processing.swing import ORDERS, PieceHarmonics

WAVEFORM, AIR = "waveform", "air"
"""Names of the evidence's sources: the waveform, and the prior of the drag of the air."""
_ODD = [ORDERS.index(order) for order in (3, 5, 7, 9)]
_NODE_RATIO = 1.6
"""Ratio of neighbouring nodes' amplitudes; between the nodes harmonics are interpolated."""
_MIN_PIECES = 8
"""Fewest pieces that make a waveform: half of their stated uncertainty then comes from their scatter."""
_STATED_PIECES = 10.0
"""Weight of the stated covariance against the scatter of the harmonics, as a number of pieces."""
_MAX_CACHED = 32
"""Most predictions in a waveform's cache: a fit and the verdicts on it need the same ones again."""
_TREND_TERMS = 3
"""Number of terms of the smooth curve of harmonics over the amplitudes."""
_OUTLIER_U = 5.0
"""Standard deviations of a harmonic beyond which its piece counts as disturbed."""


@dataclass(frozen=True, eq=False)
class Waveform:
    """Odd harmonics in quadrature of the swing over a decay, with their covariance."""

    amplitude_rad: Floats
    """Amplitudes (n,) of the pieces."""
    sine_rad: Floats
    """Their harmonics of orders 3, 5, 7 and 9 (n, 4)."""
    covariance: Floats
    """Covariance (n, 4, 4) of each piece's harmonics: that of the samples, enlarged to the scatter of
    neighbours, which contains the ground's part whatever its spectrum."""
    scatter: float
    """Ratio of the scatter to that by the stated uncertainties of the samples, as standard deviations."""

    @property
    def median_covariance(self) -> Floats:
        """Median covariance (4, 4) of the harmonics of a piece."""
        return np.asarray(np.median(self.covariance, axis=0))

    @cached_property
    def _hats(self) -> Floats:
        """Weights (n, nodes) of linear interpolation in ln A."""
        x = np.log(self.amplitude_rad)
        span = float(x.max() - x.min())
        nodes = np.linspace(x.min(), x.max(), max(2, round(span / log(_NODE_RATIO)) + 1))
        position = (x - nodes[0]) / (nodes[1] - nodes[0])
        return np.asarray(np.maximum(0.0, 1.0 - np.abs(position[:, None] - np.arange(len(nodes)))))

    @cached_property
    def _reduction(self) -> Floats:
        """Matrix (m, 4 n) that reduces the pieces to m independent numbers of unit variance."""
        whitening = np.linalg.inv(np.linalg.cholesky(self.covariance))
        nodes, orders = self._hats.shape[1], self.sine_rad.shape[1]
        columns = np.einsum("ij,iab->iajb", self._hats, whitening).reshape(-1, nodes * orders)
        directions = FactoredJacobian(columns).directions.T.reshape(-1, len(whitening), orders)
        return np.asarray(np.einsum("kia,iab->kib", directions, whitening).reshape(len(directions), -1))

    @cached_property
    def _predictions(self) -> dict[tuple[object, ...], tuple[Law, Floats]]:
        return {}

    def predicted_rad(self, law: Law, values: Mapping[str, float], pendulum: PendulumOnBall) -> Floats:
        """Harmonics that a law predicts for `sine_rad`; raises DataError if the pendulum would not swing."""
        key = (pendulum, *values.items())
        cached = self._predictions.get(key)
        if cached is None or cached[0] is not law:
            sine = -law_harmonics(law, values, pendulum, self.amplitude_rad).imag[:, _ODD]
            while len(self._predictions) >= _MAX_CACHED:
                del self._predictions[next(iter(self._predictions))]
            cached = self._predictions[key] = law, sine
        return cached[1]

    def reduced(self, sine_rad: Floats) -> Floats:
        """Harmonics of the pieces as independent numbers of unit variance."""
        return np.asarray(self._reduction @ sine_rad.ravel())

    def residuals(self, law: Law, values: Mapping[str, float], pendulum: PendulumOnBall) -> Floats:
        """A law's harmonics minus the measured ones, as independent numbers of unit variance."""
        return self.reduced(self.predicted_rad(law, values, pendulum) - self.sine_rad)


def waveform_of(pieces: PieceHarmonics) -> Waveform | None:
    """The waveform of a decay's pieces without the disturbed ones; None for too few of them."""
    order = np.argsort(-pieces.amplitude)
    amplitude, sine = pieces.amplitude[order], pieces.sine[order][:, _ODD]
    stated = pieces.covariance_sine[order][:, _ODD][:, :, _ODD]
    while len(amplitude) >= _MIN_PIECES:
        whitening = np.linalg.inv(np.linalg.cholesky(stated))
        residuals = np.einsum("nab,nb->na", whitening, _without_trend(amplitude, sine))
        scatter = _scatter_of(residuals)
        is_used = np.all(np.abs(residuals) < _OUTLIER_U * np.sqrt(np.diag(scatter)), axis=1)
        if np.all(is_used):
            root = np.linalg.inv(whitening)
            enlarged = root @ scatter @ np.swapaxes(root, 1, 2)
            return Waveform(amplitude, sine, enlarged, float(np.sqrt(np.trace(scatter) / len(_ODD))))
        amplitude, sine, stated = amplitude[is_used], sine[is_used], stated[is_used]
    return None


def _without_trend(amplitude: Floats, sine: Floats) -> Floats:
    """Harmonics less a smooth curve of them over the amplitudes."""
    x = np.log(amplitude)
    x = (x - x.mean()) / max(float(np.ptp(x)), 1e-9)
    terms = amplitude[:, None] * x[:, None] ** np.arange(_TREND_TERMS)
    return FactoredJacobian(terms).residual(sine)


def _scatter_of(residuals: Floats) -> Floats:
    """Covariance (4, 4) of whitened harmonics by their scatter, with the stated covariance as a prior.

    Where they scatter more than stated, as in air, the prior has their size: otherwise it would reduce the
    variance of a dozen pieces by a third.
    """
    # clipped, so that pieces far off are judged by the scatter of the others
    size = MAD_TO_SIGMA * np.median(np.abs(residuals), axis=0)
    clipped = np.clip(residuals, -_OUTLIER_U * size, _OUTLIER_U * size)
    scatter, dof, orders = clipped.T @ clipped, len(residuals) - _TREND_TERMS, len(_ODD)
    prior = max(1.0, float(np.trace(scatter)) / orders / dof) * np.eye(orders)
    # weights by a matrix from the data favour what happens to scatter little (Wishart's distribution)
    known = (dof + _STATED_PIECES) ** 2 / dof
    factor = (known - 1) / (known - orders) / ((known - orders + 1) / known)
    return np.asarray(factor * (scatter + _STATED_PIECES * prior) / (dof + _STATED_PIECES))


@dataclass(frozen=True)
class Evidence:
    """Evidence that restrains a fit in addition to the turning points."""

    waveform: Waveform | None = None
    drag_s: Estimate | None = None
    """Prior of a linear drag, from other sources than this decay."""
    drive: KnownDrive | None = None
    """Drive of the ground by an auxiliary seismometer, up to gains that are fitted."""
    knocks: tuple[int, ...] = ()
    """Numbers of the first half-cycles after knocks, at each of which the decay begins anew."""

    def residuals(self, law: Law, values: Mapping[str, float], pendulum: PendulumOnBall) -> Floats:
        """Distances of the law's waveform and drag from the evidence, in standard uncertainties."""
        parts = []
        if self.waveform is not None:
            parts.append(self.waveform.residuals(law, values, pendulum))
        if self.drag_s is not None and DRAG.key in values:
            value, u = self.drag_s
            parts.append(np.array([(values[DRAG.key] - value) / u]))
        return np.concatenate(parts) if parts else np.zeros(0)


NO_EVIDENCE = Evidence()
