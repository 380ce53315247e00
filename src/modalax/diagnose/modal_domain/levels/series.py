r"""Laws of joints that sit behind the structure's own compliance, exact in all harmonics where that is static.

Across a joint between light parts the motion is no sine: at the third harmonic and above the structure answers as a
spring, :math:`x_h = -g f_h`. Then :math:`u = x + g f` is a sine, whatever the law, and a law in ``x`` is another in
``u``: that of the joint and the compliance in series. A stop of stiffness ``k`` becomes one of :math:`k/(1 + gk)` with
the same free way. So places and laws are looked for; those found are told with each harmonic as the structure answers
it (:mod:`~modalax.diagnose.modal_domain.levels.balance`). A slider that takes a stiff spring out of the structure is
not to be had behind a compliance, since :math:`1 - gk` is next to nothing. The other laws are taken by their first
harmonic.
"""

from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np

from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.causes.joints import CubicStiffness, GapContact, QuadraticDamping

POINTS = 64  # of half a cycle
LEAST_CUBE = -0.12  # of the softening at which a spring behind a compliance snaps, -4/27
STEPS = 12  # to the displacement behind a compliance
SERIES = (CubicStiffness, GapContact, QuadraticDamping)  # laws that are told behind a compliance
LEAST = 0.02  # of a compliance that is left behind a stop


def in_series(law: JointCause, A: Any, omega: Any, p: Any, g: Any) -> Any:
    """Describing function [N/m] in the sine ``u`` of amplitude ``A`` [m], behind a compliance ``g`` [m/N].

    Laws that are not told behind a compliance are taken as they are.
    """
    if isinstance(law, GapContact):
        return law.impedance(A, omega, jnp.stack([p[0] / (1 + g * p[0]), p[1]]))
    if isinstance(law, CubicStiffness):
        size = p[0] * A**2
        return size * jnp.interp(g * size, *_cube()) + 0j
    if isinstance(law, QuadraticDamping):
        size = p[0] * omega**2 * A
        at, real, imag = _drag()
        return size * (jnp.interp(g * size, at, real) + 1j * jnp.interp(g * size, at, imag))
    return law.impedance(A, omega, p)


@lru_cache(maxsize=1)
def _cube() -> tuple[np.ndarray, np.ndarray]:
    r"""Equivalent stiffness of :math:`k x^3` behind a compliance, over :math:`kU^2`, against :math:`gkU^2`."""
    at = np.concatenate([np.linspace(LEAST_CUBE, 0.0, 20)[:-1], np.geomspace(1e-3, 1e6, 200)])
    tau = np.pi * (np.arange(POINTS) + 0.5) / POINTS
    u = np.cos(tau)
    x = u / (1 + np.maximum(at, 0.0)[:, None] * u**2) ** (1 / 3)
    for _ in range(STEPS):
        square = at[:, None] * x * x
        x -= (x + square * x - u) / (1 + 3 * square)
    return at, 2 * np.mean(x * x * x * u, axis=1)


@lru_cache(maxsize=1)
def _drag() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""The same of drag :math:`c v|v|`, over :math:`c\omega^2U`, against :math:`gc\omega^2U`: real and imaginary part.

    Harmonic balance of :math:`\xi_h = -\mu\varphi_h(\xi)`, ``x`` over its first amplitude ``a`` and
    :math:`\mu = gc\omega^2a`, in odd harmonics.
    """
    tau = 2 * np.pi * np.arange(256) / 256
    orders = np.array([3, 5, 7])
    wave = np.exp(1j * np.outer(orders, tau))
    xi, at, out = np.zeros(len(orders), complex), [0.0], [8j / (3 * np.pi)]
    for mu in np.geomspace(1e-3, 20.0, 160):
        first = 0j
        for _ in range(400):
            v = (1j * np.exp(1j * tau)).real + (1j * orders * xi @ wave).real
            f = v * np.abs(v)
            first = 2 / 256 * np.sum(f * np.exp(-1j * tau))
            move = -mu * 2 / 256 * (wave.conj() @ f) - xi
            xi = xi + move / (1 + 4j / np.pi * mu * orders)
            if np.abs(move).max() < 1e-10:
                break
        behind = 1 + mu * first
        at.append(float(mu * np.abs(behind)))
        out.append(first / behind / np.abs(behind))
    return np.array(at), np.real(out), np.imag(out)


def apart(law: JointCause, p: np.ndarray, g: float) -> np.ndarray:
    """Parameters of the joint itself from those that it and the compliance in series seem to have."""
    if isinstance(law, GapContact):
        return np.array([p[0] / max(1 - g * p[0], LEAST), p[1]])
    return p
