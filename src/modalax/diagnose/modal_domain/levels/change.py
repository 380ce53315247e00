r"""The change of a response from level to level as the force of one joint, place by place.

Whatever law a joint between two points has, its first harmonic is one complex force ``q`` per unit excitation, and the
response changes along one vector:

.. math:: H_l = H_1 - g\,q_l,\qquad g = \Phi_o D^{-1}b,\qquad x_l = b^T H_1 - (b^T D^{-1} b)\,q_l,

``D`` the dynamic stiffness that describes the lowest level (or, of levels little apart, their mean), ``x`` the
displacement across the joint. So at each line the change is projected on ``g`` with a free force for each input and
level; nothing is assumed about the law, and the lowest level need not be linear: ``q`` over ``x`` is the change of the
equivalent stiffness from that level.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.modal_domain.causes import shown, with_sizes
from modalax.diagnose.modal_domain.coordinates import Coordinates
from modalax.diagnose.modal_domain.fit import Fit
from modalax.diagnose.modal_domain.state import Setting, matrices_of

LINES = 256  # lines solved at once
BLOCK = 2e6  # numbers of a product of places, lines and outputs at once


@dataclass(frozen=True)
class Levels:
    """Runs brought together by force level, by rising force.

    Attributes
    ----------
    force
        Shape ``(level,)`` [N].
    H, weight
        FRFs in the form of the measurement, and one over the variance of a real part, shape ``(level, f, o, i)``.
    share
        Of the levels above the lowest in what the linear model describes, shape ``(level - 1,)``; all 0 where it
        describes the lowest.
    """

    force: np.ndarray
    H: np.ndarray
    weight: np.ndarray
    share: np.ndarray

    def thinned(self, step: int) -> "Levels":
        """Every so many lines."""
        return Levels(self.force, self.H[:, ::step], self.weight[:, ::step], self.share)

    @property
    def samples(self) -> int:
        """Real numbers in the changes from level to level."""
        live = self.weight > 0
        return 2 * int(live.sum() - live.any(axis=0).sum())


def by_level(H: np.ndarray, sigma: np.ndarray, level: np.ndarray, used: np.ndarray) -> Levels | None:
    """Bring runs of one force level together; None where there are fewer than two levels.

    Parameters
    ----------
    used
        Which runs the linear model was fitted to.
    """
    known = np.isfinite(level)
    force = np.unique(level[known])
    if len(force) < 2 or not known.all():
        return None
    weight = np.where(sigma > 0, 2 / np.maximum(sigma, 1e-300) ** 2, 0.0)
    total = np.stack([weight[level == f].sum(axis=0) for f in force])
    mean = np.stack([(weight * H)[level == f].sum(axis=0) for f in force]) / np.maximum(total, 1e-300)
    own = np.array([weight[used][level[used] == f].sum() for f in force])
    return Levels(force, mean, total, (own / own.sum())[1:])


@dataclass(frozen=True)
class Base:
    """The linear model of the lowest level.

    Attributes
    ----------
    s
        Laplace variable [rad/s], shape ``(f,)``.
    out, inn
        Responses of the outputs to forces along the modal coordinates, in the form of the measurement, ``(f, o, n)``,
        and of the coordinates to forces at the inputs, ``(f, n, i)``; faults of channels are in both.
    matrices
        Mass, damping and stiffness in modal coordinates.
    """

    s: np.ndarray
    out: np.ndarray
    inn: np.ndarray
    matrices: tuple[np.ndarray, np.ndarray, np.ndarray]

    def thinned(self, step: int) -> "Base":
        """Every so many lines."""
        return Base(self.s[::step], self.out[::step], self.inn[::step], self.matrices)

    def across(self, b: np.ndarray, times: float = 1.0, step: int = 1) -> np.ndarray:
        """Receptance across places ``(p, n)``, shape ``(f, p)`` [m/N], at every so many lines, times a factor."""
        M, C, K = self.matrices
        parts = []
        for s in np.array_split(times * self.s[::step], max(1, len(self.s) // LINES)):
            Z = K + s[:, None, None] * C + s[:, None, None] ** 2 * M
            parts.append(np.einsum("pn,fnp->fp", b, np.linalg.solve(Z, np.broadcast_to(b.T, (len(s), *b.T.shape)))))
        return np.concatenate(parts)


def base_of(setting: Setting, f: Fit, freq: np.ndarray, order: int) -> Base:
    """The model that a fit leaves, at given lines [Hz], in the form of ``order`` derivatives of the displacement."""
    c: Coordinates = setting.coordinates
    M, C, K = matrices_of(setting, f.sizes, f.causes, f.u)
    s = 2j * np.pi * freq
    both = np.concatenate([c.outputs, c.inputs]).T
    parts = np.array_split(s, max(1, len(s) // LINES))
    stiff = [K + t[:, None, None] * C + t[:, None, None] ** 2 * M for t in parts]
    solved = np.concatenate([np.linalg.solve(Z, np.broadcast_to(both, (len(Z), *both.shape))) for Z in stiff])
    count = len(c.outputs)
    out, inn = solved[:, :, :count].transpose(0, 2, 1), solved[:, :, count:]
    out = out * s[:, None, None] ** order
    for cause, u in with_sizes(f.causes, f.u):
        if cause.local:
            continue
        if cause.slug == "force_gain":
            inn = cause.transform(u, s, inn)
        else:
            out = cause.transform(u, s, out)
    return Base(s, out, inn, (M, C, K))


def frf_by(setting: Setting, f: Fit, freq: np.ndarray, order: int) -> np.ndarray:
    """FRFs ``(f, o, i)`` of the model that a fit leaves, faults of channels included."""
    inside = [(c, u) for c, u in with_sizes(f.causes, f.u) if c.local or c.hysteretic]
    sizes = np.concatenate([u for _, u in inside]) if inside else np.zeros(0)
    base = base_of(setting, replace(f, causes=tuple(c for c, _ in inside), u=sizes), freq, order)
    H = setting.coordinates.outputs @ base.inn * base.s[:, None, None] ** order
    return shown(f.causes, f.u, base.s, H)


@dataclass(frozen=True)
class Projection:
    """Changes projected on places: chi-square is ``least + (q - force)* Q (q - force)`` at every line and input.

    Attributes
    ----------
    force
        Force of the joint per unit excitation at the levels above the lowest, shape ``(p, f, i, level - 1)``.
    Q
        Its information, shape ``(p, f, i, level - 1, level - 1)``.
    least
        Chi-square that the best forces leave, shape ``(p,)``.
    """

    force: np.ndarray
    Q: np.ndarray
    least: np.ndarray


def unexplained(levels: Levels) -> float:
    """Chi-square of the changes from level to level."""
    w, H = levels.weight, levels.H
    mean = (w * H).sum(axis=0) / np.maximum(w.sum(axis=0), 1e-300)
    return float((w * np.abs(H - mean) ** 2).sum())


def _blocks(levels: Levels, base: Base, b: np.ndarray) -> Iterator[Projection]:
    w, H = levels.weight, levels.H
    total = np.maximum(w.sum(axis=0), 1e-300)
    rest = w * (H - (w * H).sum(axis=0) / total)
    count = len(levels.force) - 1
    start = unexplained(levels)
    for part in np.array_split(b, max(1, int(b.shape[0] * base.out.shape[0] * base.out.shape[1] / BLOCK))):
        g = (base.out @ part.T).transpose(0, 2, 1)  # (f, p, o)
        size = np.abs(g) ** 2
        Q = np.empty((*g.shape[:2], w.shape[3], count, count))
        r = np.empty((*g.shape[:2], w.shape[3], count), complex)
        for k in range(count):
            r[..., k] = g.conj() @ rest[k + 1]
            for m in range(k, count):
                own = w[k + 1] * (k == m) - w[k + 1] * w[m + 1] / total
                Q[..., k, m] = Q[..., m, k] = size @ own
        Q += (1e-12 * np.trace(Q, axis1=-2, axis2=-1)[..., None, None] + 1e-300) * np.eye(count)
        q = -np.linalg.solve(Q, r[..., None])[..., 0]
        gained = -(q.conj() * r).real.sum(axis=(0, 2, 3))
        yield Projection(q.transpose(1, 0, 2, 3), Q.transpose(1, 0, 2, 3, 4), start - gained)


def projected(levels: Levels, base: Base, b: np.ndarray) -> Projection:
    """Project on places of directions ``b``, shape ``(p, n)``; the response of the lowest level itself is free."""
    blocks = list(_blocks(levels, base, b))
    return Projection(*(np.concatenate([getattr(p, name) for p in blocks]) for name in ("force", "Q", "least")))


def change_by(base: Base, b: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Change of the response, ``(level - 1, f, o, i)``, by a joint of direction ``b``, force ``(f, i, level - 1)``."""
    g = base.out @ b
    return -np.einsum("fo,fil->lfoi", g, force)


def left_by(levels: Levels, base: Base, b: np.ndarray) -> np.ndarray:
    """Chi-square that the best forces at each place leave, shape ``(p,)``."""
    return np.concatenate([p.least for p in _blocks(levels, base, b)])
