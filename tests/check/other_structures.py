"""Structures as sums of modes, apart from the matrices of ``virtual_tests``: plates, rings, beams, shafts.

Shapes are closed-form functions of the place, so points are anywhere; some have slightly complex shapes.
"""

from dataclasses import dataclass

import numpy as np


def log_uniform(rng, low, high, size=None):
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


@dataclass(frozen=True)
class Modal:
    """Poles with Im > 0 ``(n,)``, residues of the receptance as shape times shape ``(n, dof)``, rigid body modes.

    Attributes
    ----------
    shapes
        Complex, scaled so that the residue of the receptance at a, b is ``shapes[a] shapes[b] / (2j w)``.
    rigid
        Real rigid-body shapes ``(k, dof)``; each adds ``r r^T / s^2``.
    """

    poles: np.ndarray
    shapes: np.ndarray
    rigid: np.ndarray
    names: tuple[str, ...]

    def residues(self, o, i) -> np.ndarray:
        scale = 1 / (2j * np.abs(self.poles))
        return scale[:, None, None] * self.shapes[:, o, None] * self.shapes[:, None, i]

    def receptance(self, freq: np.ndarray, o, i) -> np.ndarray:
        s = 2j * np.pi * freq
        A = self.residues(o, i)
        H = np.tensordot(1 / (s[:, None] - self.poles), A, 1)
        H += np.tensordot(1 / (s[:, None] - self.poles.conj()), A.conj(), 1)
        B = np.einsum("ko,ki->oi", self.rigid[:, o], self.rigid[:, i])
        return H + B / s[:, None, None] ** 2

    def changed(self, poles: np.ndarray) -> "Modal":
        return Modal(poles, self.shapes, self.rigid, self.names)


def names_of(rng, count: int) -> tuple[str, ...]:
    style = int(rng.integers(4))
    start = int(rng.choice([1, 1, 10, 101]))
    return tuple(
        (f"{start + k}:+Z", f"P{start + k}", f"wing:{start + k}:{'-' if k % 3 == 1 else '+'}Y", str(start + k))[style]
        for k in range(count)
    )


def plate(rng, count):
    """Simply supported plate, square or nearly: pairs of close modes."""
    ratio = 1.0 + (0.0 if rng.random() < 0.3 else rng.uniform(0.002, 0.6))
    x, y = rng.uniform(0.08, 0.92, (2, count))
    m, n = np.meshgrid(np.arange(1, 7), np.arange(1, 7))
    m, n = m.ravel(), n.ravel()
    f = m**2 + (n * ratio) ** 2
    order = np.argsort(f)[:24]
    m, n = m[order], n[order]
    return f[order], 2 * np.sin(np.pi * m[:, None] * x) * np.sin(np.pi * n[:, None] * y), np.zeros((0, count))


def free_beam(rng, count):
    """Free beam: bending modes, rigid body motion free or on soft springs."""
    roots = np.array([4.73004, 7.853205, 10.995608, 14.137166, *(np.pi * (np.arange(5, 12) + 0.5))])
    x = np.sort(rng.uniform(0.0, 1.0, count))
    sigma = (np.cosh(roots) - np.cos(roots)) / (np.sinh(roots) - np.sin(roots))
    u = roots[:, None] * x
    shapes = np.cosh(u) + np.cos(u) - sigma[:, None] * (np.sinh(u) + np.sin(u))
    rigid = np.stack([np.ones(count), np.sqrt(12) * (x - 0.5)])
    f = (roots / roots[0]) ** 2
    if rng.random() < 0.6:  # on soft springs, the rigid body motions are modes of low frequency
        low = rng.uniform(0.02, 0.12, 2)
        return np.concatenate([low, f]), np.concatenate([rigid, shapes]), np.zeros((0, count))
    return f, shapes, rigid


def ring(rng, count):
    """Ring with a small mass: pairs of modes that are hardly apart."""
    angle = rng.uniform(0, 2 * np.pi, count)
    n = np.repeat(np.arange(2, 9), 2)
    f = n * (n**2 - 1) / np.sqrt(n**2 + 1.0)
    split = np.where(np.arange(len(n)) % 2, 1 + log_uniform(rng, 0.003, 0.05, len(n)), 1.0)
    turn = rng.uniform(0, np.pi, len(n) // 2).repeat(2) + np.where(np.arange(len(n)) % 2, np.pi / 2, 0.0)
    shapes = np.sqrt(2) * np.cos(n[:, None] * angle + turn[:, None])
    return f / f[0] * split, shapes, np.zeros((0, count))


def cantilever(rng, count):
    """Clamped beam with bending in one plane and torsion seen by points off its axis."""
    roots = np.array([1.8751, 4.69409, 7.85476, 10.99554, *(np.pi * (np.arange(5, 10) - 0.5))])
    x, off = rng.uniform(0.1, 1.0, count), rng.choice([-1.0, 0.0, 1.0], count) * rng.uniform(0.3, 1.5)
    u = roots[:, None] * x
    sigma = (np.cosh(roots) + np.cos(roots)) / (np.sinh(roots) + np.sin(roots))
    bending = np.cosh(u) - np.cos(u) - sigma[:, None] * (np.sinh(u) - np.sin(u))
    k = np.arange(1, 6)
    torsion = off * np.sin((k[:, None] - 0.5) * np.pi * x)
    f = np.concatenate([(roots / roots[0]) ** 2, log_uniform(rng, 2.0, 12.0) * (2 * k - 1)])
    order = np.argsort(f)
    return f[order], np.concatenate([bending, torsion])[order], np.zeros((0, count))


def shaft(rng, count):
    """Disks on a shaft."""
    total = max(count, int(rng.integers(6, 14)))
    J = log_uniform(rng, 0.4, 2.5, total)
    k = log_uniform(rng, 0.3, 3.0, total)
    K = np.diag(k) + np.diag(np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    root = 1 / np.sqrt(J)
    w2, q = np.linalg.eigh(root[:, None] * K * root)
    where = np.sort(rng.choice(total, count, replace=False))
    return np.sqrt(w2), (root[:, None] * q).T[:, where], np.zeros((0, count))


KINDS = {"plate": plate, "free beam": free_beam, "ring": ring, "cantilever": cantilever, "shaft": shaft}


def draw_structure(rng, count: int, kind: str | None = None) -> Modal:
    kind = kind or str(rng.choice(list(KINDS)))
    f, shapes, rigid = KINDS[kind](rng, count)
    first = int(np.flatnonzero(f > 0.5 * np.median(f[:3]))[0])  # rigid body motion on springs is no elastic mode
    hz = log_uniform(rng, 3, 400) * f / f[first]
    style = rng.integers(3)
    if style == 0:
        zeta = np.full(len(f), log_uniform(rng, 0.002, 0.03))
    elif style == 1:  # in proportion to mass and stiffness
        a = log_uniform(rng, 0.002, 0.015)
        zeta = a * (hz[first] / hz + hz / hz[min(4, len(hz) - 1)])
    else:
        zeta = log_uniform(rng, 0.002, 0.02) * log_uniform(rng, 0.6, 1.6, len(f))
    zeta = np.clip(zeta, 0.0012, 0.06)
    w = 2 * np.pi * hz
    poles = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
    shapes = shapes.astype(complex) * log_uniform(rng, 0.05, 5.0)
    if rng.random() < 0.35:
        size = rng.uniform(0.01, 0.08)
        mean = np.sqrt(np.mean(np.abs(shapes) ** 2, axis=1, keepdims=True))
        shapes = shapes + 1j * size * mean * rng.normal(size=shapes.shape)
    return Modal(poles, shapes, rigid * np.abs(shapes).mean(), names_of(rng, count))
