"""Screening of terms whose size in every channel is free: modes that the simulation lacks."""

import numpy as np

from modalax.diagnose.causes.base import PatternCause
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.fitting.residual import complex_of
from modalax.diagnose.screening.screen import Trial
from modalax.diagnose.screening.sensitivities import Residual
from modalax.diagnose.setup.problem import Problem

SETTLED = 1e-5  # change of a shape of length one at which it counts as found


def screen_pattern(cause: PatternCause, scene: Scene, residual: Residual, problem: Problem) -> Trial:
    """Find the shape parameters and the real size in every channel that explain most, by linear least squares.

    Parameters
    ----------
    cause
        Terms over frequency with shape parameters.
    scene
        What causes may look at.
    residual
        What is to be explained.
    problem
        Weights and lines.
    """
    s = 1j * np.asarray(problem.omega)
    weight = np.asarray(problem.weight)
    r = complex_of(residual.value, len(weight))
    best, found, at = -np.inf, None, None
    w2 = (weight**2).sum(axis=0)
    wr = (weight * r).sum(axis=0)
    drawn = []
    for q in cause.shapes(scene):
        B = np.asarray(cause.curves(s, q))
        drawn.append(B)
        gram = np.real(np.einsum("tf,uf,foi->oitu", B.conj(), B, w2))
        right = np.real(np.einsum("tf,foi->oit", B.conj(), wr))
        a = _solved(gram, right)
        a = a if cause.several else low_rank(a, gram)
        value = _explained(a, gram, right)
        if value > best:
            best, found, at = value, q, (a, gram, right)
    assert found is not None and at is not None
    sizes = at[0] if cause.several else settled_rank(*at)
    best = max(best, _explained(sizes, *at[1:]))
    extra = np.moveaxis(sizes, -1, 0)
    start = np.concatenate([np.ones(cause.terms), found])
    looked = np.prod([independent(_over_lines(curves, w2)) for curves in np.swapaxes(drawn, 0, 1)])
    return Trial(cause, Place(()), best, np.nan, start, extra=extra, trials=round(looked))


def _over_lines(curves: np.ndarray, weight2: np.ndarray) -> np.ndarray:
    """Correlation of curves (trial, f) as they stand in weighted lines, with real sizes."""
    scaled = curves * np.sqrt(weight2.mean(axis=(1, 2)))
    unit = scaled / np.maximum(np.linalg.norm(scaled, axis=1, keepdims=True), 1e-300)
    return np.real(unit @ unit.conj().T)


def independent(correlation: np.ndarray) -> float:
    r"""Number of independent scores that correlated ones behave like, :math:`(\sum\sqrt\lambda)^2/\sum\lambda`.

    Galwey (2009), Genetic Epidemiology 33:559, for the eigenvalues of the correlation matrix. One, of curves that are
    nothing at all lines, as that of a mode that a fit has moved out of all bounds.
    """
    values = np.maximum(np.linalg.eigvalsh(correlation), 0.0)
    return float(np.sqrt(values).sum() ** 2 / values.sum()) if values.any() else 1.0


def low_rank(a: np.ndarray, gram: np.ndarray) -> np.ndarray:
    """Sizes of rank one over outputs and inputs for each term, weighted alike (one mode has one shape)."""
    if min(a.shape[:2]) < 2:
        return a
    out = np.empty_like(a)
    for t in range(a.shape[-1]):
        row = np.sqrt(np.maximum(gram[..., t, t].mean(axis=1), 1e-300))
        col = np.sqrt(np.maximum(gram[..., t, t].mean(axis=0), 1e-300))
        U, d, V = np.linalg.svd(a[..., t] * row[:, None] * col[None], full_matrices=False)
        out[..., t] = d[0] * np.outer(U[:, 0], V[0]) / row[:, None] / col[None]
    return out


def settled_rank(a: np.ndarray, gram: np.ndarray, right: np.ndarray, rounds: int = 300) -> np.ndarray:
    r"""Sizes of rank one :math:`u_{to}v_{ti}` that explain most, however unlike the weights of the channels are.

    Outputs' and inputs' shapes are solved for in turn, which only ever gains (Gabriel and Zamir 1979, Technometrics
    21:489, for one term).

    Parameters
    ----------
    a
        Where to start, shape ``(o, i, t)``, in the units of the sizes.
    gram, right
        Products of the whitened terms with one another and with the residual, ``(o, i, t, t)`` and ``(o, i, t)``.
    """
    if min(a.shape[:2]) < 2:
        return a
    v = np.stack([np.linalg.svd(a[..., t])[2][0] for t in range(a.shape[-1])], axis=-1)
    u = np.zeros((a.shape[0], a.shape[-1]))
    for _ in range(rounds):
        before = v
        u = _solved(np.einsum("oitu,it,iu->otu", gram, v, v), np.einsum("oit,it->ot", right, v))
        v = _solved(np.einsum("oitu,ot,ou->itu", gram, u, u), np.einsum("oit,ot->it", right, u))
        size = np.maximum(np.linalg.norm(v, axis=0), 1e-300)
        u, v = u * size, v / size
        if np.abs(v - before).max() < SETTLED:
            break
    return u[:, None] * v[None]


def _explained(a: np.ndarray, gram: np.ndarray, right: np.ndarray) -> float:
    return float(2 * np.sum(a * right) - np.einsum("oit,oitu,oiu->", a, gram, a))


def _solved(gram: np.ndarray, right: np.ndarray) -> np.ndarray:
    ridge = 1e-12 * np.trace(gram, axis1=-2, axis2=-1)[..., None, None] + 1e-300
    return np.linalg.solve(gram + ridge * np.eye(gram.shape[-1]), right[..., None])[..., 0]
