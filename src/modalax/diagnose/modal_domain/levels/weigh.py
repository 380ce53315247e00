r"""A law at a place weighed on all samples, beside what is not known of the place and of the law.

The motion across a joint is that of the corrected simulation, whose shapes are known to some accuracy only: their
errors at the joint, mode by mode, are free within the posterior of the general inaccuracy. A describing function leaves
out what higher harmonics do: the force of a law is free by a relative error, learnt by its evidence.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.modal_domain.fitting.fit import Fit, scale_of
from modalax.diagnose.modal_domain.fitting.linear import root_of_information
from modalax.diagnose.modal_domain.fitting.state import Setting, slopes_at
from modalax.diagnose.modal_domain.levels.change import Base, Levels, change_by, projected
from modalax.diagnose.modal_domain.levels.laws import (
    LawFit,
    derivatives_of,
    force_at,
    scattered,
    stiffness_of,
    with_fewer,
)
from modalax.diagnose.modal_domain.levels.motion import motion_of, motions_of, softened
from modalax.diagnose.modal_domain.structure.slopes import factored_slopes, slopes_of

TOLERANCES = (0.0, 0.003, 0.01, 0.02, 0.03, 0.045, 0.065, 0.1, 0.2)  # relative errors of a law's force that are tried
ASIDE = 0.02  # chance of a line on another branch of the motion than the law's
PRICE = math.log(ASIDE / (1 - ASIDE))
STEPS = 4  # points of a Gauss-Newton search
BENT = 1e-5  # relative change of a parameter by which they are taken
MOVED = 1e-3  # change of a shape at the joint, relative to its largest, by which derivatives are taken
STEEP = 30.0  # relative change of a law's force over that of a parameter, beyond which a line is at a fold
SHOWN = 1e-3  # size of an error of the shapes, relative to the largest, from which it counts


class Shapes:
    """Errors of the corrected simulation's shapes, as changes of the direction of a place.

    A place of direction ``b`` sees mode ``k`` by ``b' v_k``; an error of that is a change of ``b`` along the mode.
    """

    def __init__(self, setting: Setting, f: Fit, base: Base):
        self.setting, self.fit = setting, f
        M, _, K = base.matrices
        J = slopes_at(setting, f.state, f.causes, f.u)
        s = scale_of(setting, f)
        L = root_of_information(J, J.T @ J, s)
        count = len(setting.inaccuracy.group_of)
        self.half = (s[:, None] * np.linalg.inv(L).T)[:count]  # covariance of the sizes: half half'
        turned = f.state.modes.vectors[f.state.pairs]
        # residues are y x', so that vectors carry a common phase; turned to the real axis they are shapes
        angle = 0.5 * np.angle((turned**2).sum(axis=1))
        vectors = (turned * np.exp(-1j * angle)[:, None]).real
        self.phase, self.moves = angle, np.linalg.pinv(vectors)  # b + moves[:, k] d has mode k moved by d
        self.epsilon = float(f.epsilon[0])
        self.stillness = np.eye(len(M)) - vectors.T @ self.moves.T

    def columns(self, b: np.ndarray) -> np.ndarray:
        """Changes of a direction by one standard deviation each, shape ``(columns, n)``."""
        setting, f = self.setting, self.fit
        c = replace(setting.coordinates, outputs=b[None])
        t = slopes_of(c, f.state.modes, f.state.pairs)
        parts = [factored_slopes(t, kind, patterns)[1][:, :, 0] for kind, patterns in setting.patterns(f.causes, f.u)]
        D = (np.concatenate(parts, axis=1) * np.exp(-1j * self.phase)[:, None]).real @ self.half
        u, size, _ = np.linalg.svd(D, full_matrices=False)
        keep = size > SHOWN * max(size[0], 1e-300)
        moves = (self.moves @ (u * size)[:, keep]).T
        rest = self.epsilon * (b @ self.stillness)  # all modes that were not measured together
        return np.concatenate([moves, rest[None]])


@dataclass(frozen=True)
class Weighed:
    """A law at a place after weighing.

    Attributes
    ----------
    fit
        With the parameters, covariance and chi-square beside all that is free.
    sharp
        Covariance of the parameters were the shapes known.
    log_evidence
        Up to what all hypotheses share.
    tolerance
        Relative error of the law's force, learnt.
    aside
        Lines of all inputs that were set aside.
    b
        Direction of the place as fitted.
    """

    fit: LawFit
    sharp: np.ndarray
    log_evidence: float
    tolerance: float
    aside: int
    b: np.ndarray


def weigh(
    levels: Levels, base: Base, shapes: Shapes, b: np.ndarray, f: LawFit, within: bool = True
) -> Weighed | None:  # fmt: skip
    """Fit a law at a place again, on all samples; None where it cannot be predicted there.

    ``within`` tells whether the linear model has the spring that may slip.
    """
    law, moves = f.law, shapes.columns(b)
    log = np.array([q.log for q in law.parameters])
    low = np.array([q.lower for q in law.parameters])
    z, p, best = np.zeros(len(moves)), f.p, None
    told = motion_of(levels, base, b, law, within)
    for _ in range(STEPS):
        now = b + z @ moves
        step = MOVED * np.abs(b).max() / np.maximum(np.abs(moves).max(axis=1), 1e-300)
        every = np.concatenate([now[None], now + step[:, None] * moves])
        P = projected(levels, base, every)
        motions = [told.along(one, levels.force) for one in motions_of(levels, base, every, P)]
        m = motions[0]
        N, by = derivatives_of(law, m, p)
        by = off_folds(N, by, p)
        more = (stiffness_of(law, m, p, m.amplitude * (1 + BENT)) - N) / np.maximum(BENT * m.amplitude, 1e-300)
        forces = [force_at(one, N + more * (one.amplitude - m.amplitude)) for one in motions]
        made = [change_by(base, d, q) for d, q in zip(every, forces, strict=True)]
        columns = [(y - made[0]) / h for y, h in zip(made[1:], step, strict=True)]
        q = forces[0]
        for k in range(len(p)):
            columns.append(change_by(base, now, force_at(m, N + BENT * p[k] * by[..., k]) - q) / BENT)
        left_out = change_by(base, now, force_at(m, with_fewer(law, m, p)) - q)
        e = levels.H[1:] - levels.H[:1] - made[0]
        if not all(np.isfinite(y).all() for y in (*columns, left_out, e)):
            break
        G, parts = _products(levels, base, now, P.Q[0], np.stack([*columns, left_out, e]))
        chi2, evidence, rho, aside, x, cov, sharp = _best(G, parts, P.Q[0], q, scattered(law, m, p), z, len(moves))
        evidence -= 0.5 * len(p) * math.log(levels.samples)
        size = np.where(log, 1.0, np.abs(p))
        d = np.clip(x[len(moves) :], -0.5, 0.5)
        new = np.where(log, p * np.exp(d), np.maximum(p + d * np.abs(p), low))
        if best is not None and evidence < best.log_evidence:
            break
        own, sharp = cov[len(moves) :, len(moves) :] * np.outer(size, size), sharp * np.outer(size, size)
        best = Weighed(LawFit(law, p, own, chi2), sharp, evidence, rho, aside, now)
        z, p = x[: len(moves)], new
    return best


def off_folds(N: np.ndarray, by: np.ndarray, p: np.ndarray) -> np.ndarray:
    r"""Derivatives of describing functions with those at a fold cut to where :math:`|p\,dN/dp|` is ``STEEP`` times N.

    There the motion jumps: the slope grows without bound and holds over no deviation, so that one line would seem to
    tell the parameters better than all others.

    Parameters
    ----------
    N, by
        Describing functions [N/m], of any shape, and their derivatives by the parameters, shape ``N.shape + (p,)``.
    p
        Parameters, shape ``(p,)``.
    """
    most, own = STEEP * np.abs(N)[..., None] + np.zeros(by.shape), np.abs(p * by)
    return by * np.divide(most, own, out=np.ones(by.shape), where=most < own)


def _products(levels: Levels, base: Base, b: np.ndarray, Q: np.ndarray, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inner products of columns, the lowest level free, and the forces that they are like, ``(k, f, i, level - 1)``."""
    w = levels.weight
    rest = w[1:] * (X - (w[1:] * X).sum(axis=1, keepdims=True) / np.maximum(w.sum(axis=0), 1e-300))
    flat = len(X), -1
    G = (X.reshape(flat).conj() @ rest.reshape(flat).T).real
    t = np.einsum("fo,klfoi->kfil", (base.out @ b).conj(), rest, optimize=True)
    return G, np.linalg.solve(Q[None], t[..., None])[..., 0]


def _best(
    G: np.ndarray, forces: np.ndarray, Q: np.ndarray, q: np.ndarray, loose: np.ndarray, z: np.ndarray, free: int
) -> tuple[float, float, float, int, np.ndarray, np.ndarray, np.ndarray]:
    """Chi-square, log evidence, tolerance and lines set aside here, and the next point with its covariance.

    That holds how harmonics left out, the last column but one, move all parameters together. Last comes the covariance
    of the law's parameters alone, were the shapes known.
    """
    best = None
    for rho in TOLERANCES:
        soft, aside = set_aside(Q, rho**2 * np.abs(q) ** 2 + loose, np.abs(q), forces[-1])
        lost = np.einsum("afik,fikl,bfil->ab", forces.conj(), Q - soft, forces, optimize=True).real
        A = G - lost
        volume = float((np.linalg.slogdet(soft)[1] - np.linalg.slogdet(Q)[1]).sum()) + aside * PRICE
        prior = np.concatenate([np.ones(free), np.zeros(len(A) - 2 - free)])
        old = np.concatenate([z, np.zeros(len(A) - 2 - free)])
        inner = A[:-2, :-2] + np.diag(prior)
        right = A[:-2, -1] - prior * old
        size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
        unit = inner / size[:, None] / size
        cov = np.linalg.pinv(unit, rcond=1e-12) / size[:, None] / size
        sharp = np.linalg.pinv(unit[free:, free:], rcond=1e-12) / size[free:, None] / size[free:]
        dx, moved = cov @ right, cov @ A[:-2, -2]
        bend = np.eye(free) + A[:free, :free]
        chi2 = float(A[-1, -1] + z @ z)
        evidence = -0.5 * chi2 + volume - 0.5 * float(np.linalg.slogdet(bend)[1])
        if best is None or evidence > best[1]:
            best = chi2, evidence, rho, aside, old + dx, cov + np.outer(moved, moved), sharp
    assert best is not None
    return best


def set_aside(Q: np.ndarray, variance: np.ndarray, q: np.ndarray, left: np.ndarray) -> tuple[np.ndarray, int]:
    """Information on forces without that of lines that a law does not explain, and how many these are.

    A motion near the onset of a law, or next to a fold, may have settled on another branch.
    """
    soft, free = softened(Q, variance), softened(Q, variance + (q + np.abs(left)) ** 2)
    value = [
        np.linalg.slogdet(S)[1] - 0.5 * np.einsum("fik,fikl,fil->fi", left.conj(), S, left, optimize=True).real
        for S in (soft, free)
    ]
    aside = value[1] + PRICE > value[0]
    return np.where(aside[..., None, None], free, soft), int(aside.sum())
