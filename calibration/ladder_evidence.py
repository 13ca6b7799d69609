"""What a ladder says of the scale at zero, over all that may have bent it: models weighed by their evidence.

Along the motion the spot is ``origin + scale (t + skew t^2 + cubic t^3 + way hysteresis/2)``. Whether there
is a cubic part, and whether one of the steps is wrong, is not known; to choose one model and forget the
others makes the uncertainty of the scale too small where the choice is not clear. So each model has a prior
probability, its evidence (the probability of the measured places, over all values of its parameters) is
calculated, and the scale is the mean of the models' scales with the models' posterior probabilities as
weights; its variance holds the scatter of the models about it (J. A. Hoeting et al., Bayesian model
averaging, Stat. Sci. 14, 382, 1999). The models are linear and normal, so that all of it is in closed form.
"""

import math
from typing import Literal, NamedTuple

import numpy as np

from calibration.birge import birge_ratio
from processing.arrays import Floats

STEEPEST = 0.3
"""Standard deviation of the skew before the ladder is measured: a sensor tilted by 17 degrees."""
_BENDS = (0.0, 3e-4, 1e-3, 1e-2)
"""Standard deviation of the cubic part at the ladder's end, relative to the displacement there."""
_BENT = 0.2
"""Prior probability of any cubic part, shared by the sizes above."""
_WRONG = 0.01
"""Prior probability that a step is wrong."""
_WRONG_BY = (6.0, 60.0)
"""Standard deviations of a wrong step, in its stated uncertainties."""
_SAID = 0.5
"""Probability of a cubic part, or of a wrong step, above which a note says it."""
_WIDE = 1e6
"""Standard deviation of what nothing is known of, in units in which the ladder is about 1."""


class Along(NamedTuple):
    """A ladder along its motion, arrays (n,): carrier t, place in px, its standard uncertainty, way or None.

    `u_px` holds the reference's, `by_way` is what half the hysteresis, in its unit, adds to t.
    """

    t: Floats
    place_px: Floats
    u_px: Floats
    by_way: Floats | None


class ScaleEvidence(NamedTuple):
    """Scale in px per unit of t, its standard uncertainty, and the probabilities of what bends the ladder.

    `cubic` is the mean relative departure at the ladder's end and `u_cubic` its uncertainty where there is
    a cubic part, which has the probability `bent`. `wrong` (n,) is each step's probability to be wrong.
    `birge` enlarges the stated uncertainties, with `dof` degrees of freedom (infinite where it is 1).
    """

    scale: float
    u_scale: float
    bent: float
    cubic: float
    u_cubic: float
    wrong: Floats
    birge: float
    dof: float


class _Model(NamedTuple):
    """A model's evidence (logarithm), parameters, their covariance, chi-square of the steps."""

    log_evidence: float
    values: Floats
    covariance: Floats
    chi2: float


def scale_evidence(steps: Along, kind: Literal["tilt", "shift"], scale: float) -> ScaleEvidence:
    """The scale at zero from all models.

    Parameters
    ----------
    steps
        The ladder along its motion.
    kind
        Of a ladder of tilts the skew is that of a tilted sensor, about which something is known; a stage of
        shifts may be bent by anything.
    scale
        An estimate of it, px per unit of t, good to a percent.
    """
    first = _posterior(steps, kind, scale, 1.0)
    # nothing is known of a stage's skew, and it takes a step as the scale does
    count, used = len(steps.t), (2 if kind == "tilt" else 3) + (steps.by_way is not None)
    # only what no model explains is noise beyond the stated
    birge = birge_ratio(first.chi2, max(count - used - first.spent, 1))
    if birge == 1.0:
        return first.found
    dof = max(count - used, 1)
    plain = _fit(steps, kind, scale, 0.0, np.ones(count))
    birge = math.sqrt(max(plain.chi2 / dof, 1.0))
    return _posterior(steps, kind, scale, birge).found._replace(birge=birge, dof=float(dof))


def notes_of(evidence: ScaleEvidence) -> list[str]:
    """What is likely to bend the ladder, for the user."""
    notes = []
    if evidence.bent > _SAID:
        notes.append(
            f"not linear: a cubic part of {evidence.cubic:.2g} ± {evidence.u_cubic:.2g} of the way at the "
            f"ladder's end, probability {evidence.bent:.2g}; the scale is that at zero: look for what bends "
            "the reference or the light's path"
        )
    notes.extend(
        f"step {number} is probably wrong (probability {chance:.2g}) and hardly counts: measure it again"
        for number, chance in enumerate(evidence.wrong, 1)
        if chance > _SAID
    )
    return notes


class _Weighed(NamedTuple):
    found: ScaleEvidence
    chi2: float
    """Of the most probable model, which spends so many degrees of freedom more than the simplest."""
    spent: int


def _posterior(steps: Along, kind: Literal["tilt", "shift"], scale: float, birge: float) -> _Weighed:
    count = len(steps.t)
    enlarged = steps._replace(u_px=birge * steps.u_px)
    models, log_weights, steps_wrong, bends = [], [], [], []
    for bend in _BENDS:
        prior = 1.0 - _BENT if bend == 0.0 else _BENT / (len(_BENDS) - 1)
        # steps that scatter by more than stated cannot be told from wrong ones
        for wrong in range(-1, count if birge == 1.0 else 0):
            for by in _WRONG_BY if wrong >= 0 else (1.0,):
                factor = np.ones(count)
                factor[wrong if wrong >= 0 else 0] = by
                models.append(_fit(enlarged, kind, scale, bend, factor))
                chance = 1.0 - count * _WRONG if wrong < 0 else _WRONG / len(_WRONG_BY)
                log_weights.append(models[-1].log_evidence + math.log(prior * max(chance, _WRONG)))
                steps_wrong.append(wrong)
                bends.append(bend)
    logs = np.array(log_weights)
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    scales = np.array([model.values[1] for model in models])
    variances = np.array([model.covariance[1, 1] for model in models])
    mean = float(weight @ scales)
    variance = float(weight @ (variances + (scales - mean) ** 2))
    bent = np.array(bends) > 0.0
    share = float(weight[bent].sum())
    cubics = np.array([model.values[3] / model.values[1] for model in models])
    u_cubics = np.array([model.covariance[3, 3] / model.values[1] ** 2 for model in models])
    of_bent = weight[bent] / max(share, 1e-300)
    cubic = float(of_bent @ cubics[bent])
    u_cubic = math.sqrt(float(of_bent @ (u_cubics[bent] + (cubics[bent] - cubic) ** 2)))
    at = np.array(steps_wrong)
    best = int(np.argmax(logs))
    return _Weighed(
        ScaleEvidence(
            scale=mean,
            u_scale=math.sqrt(variance),
            bent=share,
            cubic=cubic,
            u_cubic=u_cubic,
            wrong=np.array([weight[at == k].sum() for k in range(count)]),
            birge=1.0,
            dof=math.inf,
        ),
        models[best].chi2,
        int(bends[best] > 0.0) + int(steps_wrong[best] >= 0),
    )


def _fit(steps: Along, kind: str, scale: float, bend: float, factor: Floats) -> _Model:
    """One model in closed form: the parameters are origin, scale, skew and cubic times scale, hysteresis.

    `factor` (n,) enlarges the steps' uncertainties.
    """
    t = steps.t
    end = float(np.abs(t).max())
    u = steps.u_px * factor
    columns = [np.ones_like(t), t, t**2, t * (t / end) ** 2]
    skew = scale * STEEPEST if kind == "tilt" else _WIDE * scale / end
    widths = [_WIDE * scale * end, _WIDE * scale, skew, bend * scale]
    if steps.by_way is not None:
        columns.append(scale * steps.by_way)
        widths.append(_WIDE * end / float(np.abs(steps.by_way).max()))
    width = np.array(widths)
    design = np.column_stack(columns) * width / u[:, None]
    seen = steps.place_px / u
    precision = design.T @ design + np.eye(len(width))
    values = np.linalg.solve(precision, design.T @ seen)
    left = seen - design @ values
    chi2 = float(left @ left)
    log_evidence = (
        -0.5 * (chi2 + float(values @ values))
        - 0.5 * float(np.linalg.slogdet(precision)[1])
        - float(np.log(u).sum())
    )
    covariance = np.linalg.inv(precision) * np.outer(width, width)
    return _Model(log_evidence, values * width, covariance, chi2)
