r"""The rest that no element explains: small changes of mass and stiffness between any two modes, sized by evidence.

A simulation differs from the structure also by what its author left out, such as another beam theory or a distributed
joint. With mode shapes known to a thousandth such a rest is seen, and must not be taken for a cause. It is the
non-parametric model of Soize (2000), :math:`\delta\,\omega_r\omega_s z_{rs}` in stiffness and :math:`\delta z_{rs}` in
mass, added to the covariance of the features once its size is learnt.
"""

from dataclasses import replace

import numpy as np

from modalax._numerics.triangles import forward
from modalax.diagnose.modal_domain.fitting.between_modes import OWN
from modalax.diagnose.modal_domain.fitting.fit import Fit, scale_of
from modalax.diagnose.modal_domain.fitting.inaccuracy import with_group
from modalax.diagnose.modal_domain.fitting.state import Setting, feature_slopes, slopes_at, whitened
from modalax.diagnose.modal_domain.modes.features import whitener_of
from modalax.diagnose.modal_domain.structure.slopes import pattern_slopes, slopes_of

SIZES = (0.0, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)  # relative sizes that are tried
BESIDE, NEXT = 8, 2  # modes above the band that those inside may be coupled with, and of these the ones told apart
ON_DIAGONAL = np.sqrt(OWN)  # change of a mode itself, relative to a coupling of two modes
BLOCK = 100  # patterns at once
KNOWN = 0.3  # standard deviation of the logarithm of its size once that is learnt


def rest_slopes(setting: Setting, f: Fit) -> np.ndarray:
    """Whitened derivatives by all couplings, shape ``(m, p)``."""
    c = setting.coordinates
    couples, scale = _couples(setting, f, BESIDE)
    t = slopes_of(c, f.state.modes, f.state.together.every)
    columns = []
    for kind in "KM":
        for start in range(0, len(couples), BLOCK):
            some = couples[start : start + BLOCK]
            patterns = np.zeros((len(some), c.size, c.size))
            for k, (r, s) in enumerate(some):
                size = (scale[r] * scale[s] if kind == "K" else 1.0) * (ON_DIAGONAL if r == s else 1.0)
                patterns[k, r, s] = patterns[k, s, r] = size
            moved = pattern_slopes(t, kind, patterns)
            columns.append(feature_slopes(setting, f.state, t, f.causes, f.u, *moved))
    return whitened(setting, np.concatenate(columns, axis=1), f.causes)


def learnt_rest(setting: Setting, fits: list[Fit], priors: list[float]) -> tuple[Setting, float]:
    """The setting with the rest about the likeliest of some fits, and its size: the mean square over what it may be."""
    best, found, chosen = -np.inf, np.zeros(len(SIZES)), None
    for f, prior in zip(fits, priors, strict=True):
        J = slopes_at(setting, f.state, f.causes, f.u)
        target = f.state.difference + J @ np.concatenate([f.sizes, f.u])
        scale = scale_of(setting, f)
        W = J * scale
        known = np.eye(len(target)) + W @ W.T
        rest = rest_slopes(setting, f)
        rest = rest @ rest.T
        values = np.array([_evidence(known + trial**2 * rest, target) for trial in SIZES])
        if values.max() + prior > best:
            best, found, chosen = float(values.max() + prior), values, rest
    if chosen is None:
        return setting, 0.0
    weight = np.exp(found - found.max())
    size = float(np.sqrt((weight * np.array(SIZES) ** 2).sum() / weight.sum()))
    return _allowing(setting, chosen, size), size


def with_rest(setting: Setting, f: Fit, size: float) -> Setting:
    """The setting with a rest of known size about a fit."""
    slopes = rest_slopes(setting, f)
    return _allowing(setting, slopes @ slopes.T, size)


def _allowing(setting: Setting, rest: np.ndarray, size: float) -> Setting:
    """The setting whose features scatter by so much more."""
    whitener = forward(_root(np.eye(len(rest)) + size**2 * rest), setting.triangle)
    return replace(setting, whitener=whitener, rest=float(np.hypot(setting.rest, size)))


def told_apart(setting: Setting, f: Fit) -> Setting:
    """The rest as changes of stiffness that are fitted beside all else, no longer a part of the covariance.

    FRFs hold more than the features of modes: without these changes a fit to lines would bend causes and elements.
    """
    a, c = setting.inaccuracy, setting.coordinates
    couples, scale = _couples(setting, f, NEXT)
    patterns = np.zeros((len(couples), c.size, c.size))
    for k, (r, s) in enumerate(couples):
        patterns[k, r, s] = patterns[k, s, r] = scale[r] * scale[s] * (ON_DIAGONAL if r == s else 1.0)
    known = with_group(a, "rest", patterns, np.sqrt(2) * setting.rest, KNOWN)
    return replace(setting, inaccuracy=known, whitener=whitener_of(setting.features), rest=0.0)


def beside(setting: Setting, f: Fit) -> Fit:
    """A fit of a setting in which the rest was part of the covariance, as a start where it is told apart."""
    a = setting.inaccuracy
    sizes = np.append(f.sizes, np.zeros(len(a.group_of) - len(f.sizes)))
    count = len(a.groups) - len(f.epsilon)
    return replace(
        f, sizes=sizes, epsilon=np.append(f.epsilon, a.usual[len(f.epsilon) :]),
        determined=np.append(f.determined, np.zeros(count)), state=replace(f.state, sizes=sizes),
    )  # fmt: skip


def _couples(setting: Setting, f: Fit, above: int) -> tuple[list[tuple[int, int]], np.ndarray]:
    """Modes that the rest couples, and the circular frequency that each counts with."""
    c = setting.coordinates
    inside = min(c.size, int(f.state.pairs.max(initial=0)) + 3)
    couples = [(r, s) for r in range(inside) for s in range(r, min(c.size, inside + above))]
    return couples, np.maximum(c.frequencies, 0.05 * c.frequencies[inside - 1])


def _evidence(covariance: np.ndarray, target: np.ndarray) -> float:
    L = _root(covariance)
    z = forward(L, target)
    return -0.5 * float(z @ z) - float(np.log(np.abs(np.diag(L))).sum())


def _root(covariance: np.ndarray) -> np.ndarray:
    """Triangular root of a covariance that is nowhere below 1, which rounding beside large parts of it may hide."""
    try:
        return np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(covariance)
        return np.linalg.qr((vectors * np.sqrt(np.maximum(values, 1.0))).T, mode="r").T
