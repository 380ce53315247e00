"""Standard deviations of shapes and modal masses on the host, by the delta method."""

from collections.abc import Sequence

import numpy as np

from modalax.identify.information import rows
from modalax.identify.kernels import others, unpack
from modalax.identify.maximum import Maximum


def shape_deviations(
    found: Maximum, cov: np.ndarray, inflate: float, outputs: Sequence[str], inputs: Sequence[str]
) -> tuple[np.ndarray, np.ndarray | None]:
    r"""Deviations of shapes (largest component 1), real and imaginary part as one number, and of modal masses.

    With ``found.samples.turned`` the shapes are the participation of the search, whose deviations are those of its
    unknowns. Masses are those at the first DoF that is both output and input; None without one.

    Parameters
    ----------
    found
        The search's end.
    cov
        Covariance of its non-linear unknowns.
    inflate
        Factor on the variances of the weights.
    outputs, inputs
        Names of the DoFs.
    """
    delta = _Delta(found, cov, inflate)
    driven = [name for name in inputs if name in outputs]
    rows_, columns = (inputs, outputs) if found.samples.turned else (outputs, inputs)
    mass = delta.mass(list(rows_).index(driven[0]), list(columns).index(driven[0])) if driven else None
    if not found.samples.turned:
        return delta.shapes(), mass
    n, q = found.at.theta.shape
    std = np.sqrt(np.maximum(np.diag(cov), 0.0)).reshape(n, q)
    free = q // 2 - 1
    spread = np.zeros((n, free + 1), complex)
    np.put_along_axis(spread, others(found.at.pivot, free + 1), std[:, 2 : 2 + free] + 1j * std[:, 2 + free :], 1)
    return spread, mass


class _Delta:
    """Shape components as real pairs, their covariance given the poles, and their change with these."""

    def __init__(self, found: Maximum, cov: np.ndarray, inflate: float):
        self.found, self.cov = found, cov
        self.modes = unpack(found.at.theta, found.at.pivot, found.samples.real_modes)
        self.n, self.c = self.modes.unit.shape
        p = found.at.theta.size
        x, own, coupling = [], [], []
        for row in rows(found.projection, found.at):
            parts = row.inverse.reshape(self.n, self.c, -1)
            x.append(row.x.reshape(self.n, self.c))
            own.append(inflate * parts @ np.swapaxes(parts, 1, 2))
            coupling.append(row.coupling.reshape(self.n, self.c, p))
        self.x, self.own, self.coupling = np.array(x), np.array(own), np.array(coupling)
        # As one complex number; that of a real mode is real, for its unit cancels in a shape.
        self.unit = np.array([1.0]) if self.c == 1 else np.array([1.0, 1j])
        self.z = self.x @ self.unit
        self.top = np.argmax(np.abs(self.z), axis=0)

    def shapes(self) -> np.ndarray:
        """Deviations, shape ``(n, o)``."""
        mode = np.arange(self.n)
        top = self.z[self.top, mode]
        std = np.zeros((self.n, len(self.z)), complex)
        at_top = self.own[self.top, mode], self.coupling[self.top, mode]
        for k in range(len(self.z)):
            # Changes of z / top with the component's own pair and with the largest one's.
            mine, its = self.unit / top[:, None], -self.z[k][:, None] * self.unit / top[:, None] ** 2
            g = np.stack([np.stack([a.real, a.imag], axis=1) for a in (mine, its)])
            v = -np.einsum("nec,ncp->nep", g[0], self.coupling[k]) - np.einsum("nec,ncp->nep", g[1], at_top[1])
            variance = np.sum((v.reshape(-1, v.shape[2]) @ self.cov).reshape(v.shape) * v, axis=2)
            for part, own in zip(g, (self.own[k], at_top[0]), strict=True):
                variance += np.einsum("nea,nab,neb->ne", part, own, part)
            variance[self.top == k] = 0.0
            std[:, k] = np.sqrt(np.maximum(variance[:, 0], 0)) + 1j * np.sqrt(np.maximum(variance[:, 1], 0))
        return std

    def mass(self, output: int, reference: int) -> np.ndarray:
        """Deviations of the real parts of modal masses at a drive point, shape ``(n,)``."""
        n, q = self.found.at.theta.shape
        pole, mode = self.modes.poles, np.arange(n)
        zeta = -pole.real / np.abs(pole)
        z, top, part = self.z[output], self.z[self.top, mode], self.modes.participation[:, reference]
        factor = 1.0 if self.c == 1 else 1 / (2j * pole.imag)
        turned = self.found.samples.turned
        mass = part / z * factor if turned else z / (top**2 * part) * factor
        theta = np.zeros((n, n, q), complex)
        if self.c == 2:  # the damped frequency changes with both unknowns of a pole
            theta[mode, mode, 0], theta[mode, mode, 1] = -mass, mass * zeta**2 / (1 - zeta**2)
        free = q // 2 - 1
        for k, other in enumerate(others(self.found.at.pivot, free + 1).T):
            change = np.where(other == reference, (mass if turned else -mass) / part, 0)
            theta[mode, mode, 2 + k], theta[mode, mode, 2 + free + k] = change, 1j * change
        gradient = theta.reshape(n, n * q).real
        steps = [(np.full(n, output), (-mass if turned else mass) / z)]
        if not turned:
            steps.append((self.top, -2 * mass / top))
        variance, seen = np.zeros(n), {}
        for where, change in steps:
            for r in mode:
                key = int(where[r]), int(r)
                seen[key] = seen.get(key, 0) + (change[r] * self.unit).real
        for (o, r), g in seen.items():
            gradient[r] -= g @ self.coupling[o, r]
            variance[r] += g @ self.own[o, r] @ g
        return np.sqrt(np.maximum(variance + np.sum((gradient @ self.cov) * gradient, axis=1), 0))
