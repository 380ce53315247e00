r"""The change of a response from level to level as the force of one joint, place by place.

Whatever law a joint between two points has, its first harmonic is one complex force ``q`` per unit excitation, and the
response differs along one vector from that of any linear structure that has the joint in it with some stiffness, or
not at all:

.. math:: H_l = H - g\,q_l,\qquad g = \Phi_o D^{-1}b,\qquad x_l = b^T D^{-1}\Phi_i^T - d\,q_l,
          \qquad d = b^T D^{-1} b,

``D`` the dynamic stiffness of the linear model, ``H`` its response, ``x`` the displacement across the joint. So at each
line the change from the lowest level is projected on ``g`` with a free force for each input and level; nothing is
assumed about the law. What the lowest level itself asks for beyond the model, :math:`q_1`, is projected likewise, so
that the model need not describe it: with :math:`x_1` across the place, the structure as it is there has the receptance
:math:`d\,x_1/(x_1 + d\,q_1)` across it, and :math:`q_l - q_1` over :math:`x_l` is the change of the equivalent
stiffness from that level.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from modalax.diagnose.modal_domain.causes.change import shown, with_sizes
from modalax.diagnose.modal_domain.causes.line_forces import LineForce, added_stiffness, loaded
from modalax.diagnose.modal_domain.fitting.fit import Fit
from modalax.diagnose.modal_domain.fitting.inaccuracy import TOLD, WITHIN
from modalax.diagnose.modal_domain.fitting.state import Setting, matrices_of
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.thresholds import THRESHOLDS

LINES = 256  # lines solved at once
PRETENDED = 0.01  # chance that noise alone makes a force seen at any line of a place
COUPLED = 2  # steps to what damping couples modes by
LOSS = 1e-9j  # loss factor of all stiffness, so that no multiple of a line meets a mode without any damping
BLOCK = 2e6  # numbers of a product of places, lines and outputs at once


@dataclass(frozen=True)
class Levels:
    """Runs brought together by force level, from that of the linear model on by rising or by falling force.

    Attributes
    ----------
    force
        Shape ``(level,)`` [N].
    H, weight
        FRFs in the form of the measurement, and one over the variance of a real part, shape ``(level, f, o, i)``.
    """

    force: np.ndarray
    H: np.ndarray
    weight: np.ndarray

    def thinned(self, step: int) -> "Levels":
        """Every so many lines."""
        return Levels(self.force, self.H[:, ::step], self.weight[:, ::step])

    def of_runs(self, level: np.ndarray) -> np.ndarray:
        """Which of these levels each run of a level [N] belongs to."""
        return np.abs(self.force[:, None] - level).argmin(axis=0)

    @property
    def samples(self) -> int:
        """Real numbers in the changes from level to level."""
        live = self.weight > 0
        return 2 * int(live.sum() - live.any(axis=0).sum())


def by_level(H: np.ndarray, sigma: np.ndarray, level: np.ndarray, first: float = 0.0) -> Levels | None:
    """Bring runs of one force level together, in order from ``first`` [N]; None where there are fewer than two."""
    known = np.isfinite(level)
    force = np.unique(level[known])
    if len(force) < 2 or not known.all():
        return None
    force = force[np.argsort(np.abs(force - first))]
    weight = np.where(sigma > 0, 2 / np.maximum(sigma, 1e-300) ** 2, 0.0)
    total = np.stack([weight[level == f].sum(axis=0) for f in force])
    mean = np.stack([(weight * H)[level == f].sum(axis=0) for f in force]) / np.maximum(total, 1e-300)
    return Levels(force, mean, total)


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
    H
        FRF of that model, shape ``(f, o, i)``.
    matrices
        Mass, damping and stiffness in modal coordinates.
    forces
        Linear forces at one place each that are no part of these, with their sizes.
    scatter
        Relative standard deviation of natural frequencies beyond the band, as the general inaccuracy makes them.
    """

    s: np.ndarray
    out: np.ndarray
    inn: np.ndarray
    H: np.ndarray
    matrices: tuple[np.ndarray, np.ndarray, np.ndarray]
    forces: tuple[tuple[LineForce, np.ndarray], ...] = ()
    scatter: float = 0.0

    def thinned(self, step: int) -> "Base":
        """Every so many lines."""
        every = slice(None, None, step)
        return replace(self, s=self.s[every], out=self.out[every], inn=self.inn[every], H=self.H[every])

    def across(self, b: np.ndarray, times: float = 1.0, step: int = 1) -> np.ndarray:
        """Receptance across places ``(p, n)``, shape ``(f, p)`` [m/N], at every so many lines, times a factor."""
        M, C, K = self.matrices
        parts = []
        for s in np.array_split(times * self.s[::step], max(1, len(self.s) // LINES)):
            Z = (1 + LOSS) * K + s[:, None, None] * C + s[:, None, None] ** 2 * M + added_stiffness(self.forces, s)
            parts.append(np.einsum("pn,fnp->fp", b, np.linalg.solve(Z, np.broadcast_to(b.T, (len(s), *b.T.shape)))))
        return np.concatenate(parts)

    def at_harmonics(self, b: np.ndarray, orders: np.ndarray) -> np.ndarray:
        """Receptance across places ``(p, n)`` at multiples ``(h,)`` of each line, shape ``(f, p, h)`` [m/N].

        By undamped modes, and step by step what damping couples them by.
        """
        if self.forces:
            return np.stack([self.across(b, float(h)) for h in orders], axis=-1)
        M, C, K = self.matrices
        squares, shapes = scipy.linalg.eigh(K, M)
        seen, coupled = b @ shapes, shapes.T @ C @ shapes
        own = np.diag(coupled).copy()
        coupled[np.diag_indices_from(coupled)] = 0.0
        parts = []
        for line in np.array_split(self.s, max(1, len(self.s) // LINES)):
            s = (line[:, None] * orders)[:, None, :, None]
            Z = (1 + LOSS) * squares + s * own + s**2
            x = seen[:, None] / Z  # (f, p, h, n)
            for _ in range(COUPLED):
                x = (seen[:, None] - s * (x @ coupled)) / Z
            parts.append((x * seen[:, None]).sum(axis=-1))
        return np.concatenate(parts)


def base_of(setting: Setting, f: Fit, freq: np.ndarray, order: int) -> Base:
    """The model that a fit leaves, at given lines [Hz], in the form of ``order`` derivatives of the displacement."""
    c: Coordinates = setting.coordinates
    M, C, K = matrices_of(setting, f.sizes, f.causes, f.u)
    s = 2j * np.pi * freq
    forces = tuple((k, x) for k, x in with_sizes(f.causes, f.u) if isinstance(k, LineForce))
    both = np.concatenate([c.outputs, c.inputs, *(cause.basis.T for cause, _ in forces)]).T
    parts = np.array_split(s, max(1, len(s) // LINES))
    stiff = [K + t[:, None, None] * C + t[:, None, None] ** 2 * M for t in parts]
    solved = np.concatenate([np.linalg.solve(Z, np.broadcast_to(both, (len(Z), *both.shape))) for Z in stiff])
    count, end = len(c.outputs), len(c.outputs) + len(c.inputs)
    outer, inn = solved[:, :, :count], solved[:, :, count:end]
    if forces:
        outer, inn = loaded(forces, s, solved[:, :, end:], outer, inn)
    form = s[:, None, None] ** order
    out = outer.transpose(0, 2, 1) * form
    H = shown(f.causes, f.u, s, c.outputs @ inn * form)
    for cause, u in with_sizes(f.causes, f.u):
        if cause.local:
            continue
        if cause.at_inputs:
            inn = cause.transform(u, s, inn)
        else:
            out = cause.transform(u, s, out)
    off = dict(zip(setting.inaccuracy.groups, f.epsilon, strict=True))
    scatter = 0.5 * float(np.linalg.norm([off.get(name, 0.0) for name in (*TOLD[:2], *WITHIN.values())]))
    return Base(s, out, inn, H, (M, C, K), forces, scatter)


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
    first
        Force that the lowest level asks for beyond the linear model, less what noise pretends, shape ``(p, f, i)``.
    """

    force: np.ndarray
    Q: np.ndarray
    least: np.ndarray
    first: np.ndarray


def unexplained(levels: Levels) -> float:
    """Chi-square of the changes from level to level."""
    w, H = levels.weight, levels.H
    mean = (w * H).sum(axis=0) / np.maximum(w.sum(axis=0), 1e-300)
    return float((w * np.abs(H - mean) ** 2).sum())


def levels_differ(H: np.ndarray, sigma: np.ndarray, level: np.ndarray) -> bool:
    """Whether runs at several force levels differ by more than an error of their noise could be."""
    levels = by_level(H, sigma, level)
    return levels is not None and unexplained(levels) > THRESHOLDS.as_noise * levels.samples


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
        own = size @ w[0] + 1e-300
        first = g.conj() @ (w[0] * (base.H - H[0])) / own  # (f, p, i)
        for k in range(len(part)):
            square = np.maximum(np.abs(first[:, k]) ** 2, 1e-300)
            first[:, k] *= beyond_noise(first[:, k], 2 / own[:, k]) / square
        yield Projection(q.transpose(1, 0, 2, 3), Q.transpose(1, 0, 2, 3, 4), start - gained, first.transpose(1, 0, 2))


def beyond_noise(force: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Squares of forces less that of the noise, where they are more than noise makes at any of so many."""
    square = np.abs(force) ** 2
    return np.where(square > np.log(square.size / PRETENDED) * noise, square - noise, 0.0)


def projected(levels: Levels, base: Base, b: np.ndarray) -> Projection:
    """Project on places of directions ``b``, shape ``(p, n)``; the response of the lowest level itself is free."""
    blocks = list(_blocks(levels, base, b))
    return Projection(
        *(np.concatenate([getattr(p, name) for p in blocks]) for name in ("force", "Q", "least", "first"))
    )


def change_by(base: Base, b: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Change of the response, ``(level - 1, f, o, i)``, by a joint of direction ``b``, force ``(f, i, level - 1)``."""
    g = base.out @ b
    return -np.einsum("fo,fil->lfoi", g, force)
