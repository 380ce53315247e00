r"""The force of a joint's law with its harmonics, by a balance across the joint, many motions side by side.

The motion :math:`x_h + G_h\,f_h(x) = u_h` is sought from one that is given, by Newton's steps. What is compiled is the
force of the law and its slopes alone, for rows of one length; the steps are taken in NumPy.
"""

from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from modalax._numerics.checks import as_array
from modalax.diagnose.causes.base import ElementCause, JointCause
from modalax.diagnose.prediction.harmonics import HIGHEST, SAMPLES_A_HARMONIC
from modalax.simulate.aft import choose_harmonics, joint_forces
from modalax.simulate.balance import CLOSED, STEPS, TIGHT, Plan
from modalax.simulate.joints import Hysteretic

ROW = 16  # motions whose forces are evaluated together; where few are left to find, most of a longer row is idle
NEWTON = 20  # steps from each start
NEIGHBOURS = 4  # times that motions which were not found start from those on either side
BALANCED = 1e-6  # residual, over the motion without the force, below which a balance is as good as any measurement


@lru_cache(maxsize=256)
def has_law(cause: ElementCause) -> bool:
    """Whether harmonics are balanced: there is a force law in time, and no more than one slider to follow."""
    if not isinstance(cause, JointCause) or type(cause).law is JointCause.law:
        return False
    law = cause.law(jnp.ones(len(cause.parameters)))
    return not isinstance(law, Hysteretic) or sum(jnp.size(a) for a in jax.tree.leaves(law.initial_state())) == 1


def harmonics_of(cause: JointCause, p: np.ndarray, highest: int = HIGHEST) -> tuple[int, ...]:
    """Orders that are balanced: odd ones of a law that is odd; else all up to ``HIGHEST``, and the mean."""
    law = cause.law(as_array(p))
    return choose_harmonics((law,), highest if law.odd else HIGHEST)


@partial(jax.jit, static_argnames=("cause", "harmonics"))
def _forces(cause: Any, p: Any, y: Any, omega: Any, harmonics: Any) -> tuple[Any, Any]:
    """Forces of motions, each as reals, and their slopes by motion and parameters."""
    plan = Plan(1, harmonics, SAMPLES_A_HARMONIC * max(HIGHEST, *harmonics))

    def one(y: Any, omega: Any) -> tuple[Any, Any]:
        def force(v: Any) -> tuple[Any, Any]:
            law = cause.law(v[plan.size :])
            f = plan.real(joint_forces((law,), plan.complex(v[: plan.size]), omega, harmonics, plan.samples))
            return f, f

        slopes, f = jax.jacfwd(force, has_aux=True)(jnp.concatenate([y, p]))
        return f, slopes

    return jax.vmap(one)(y, omega)


class _Balance:
    """The equations of all motions, as reals, over the motions without the joint."""

    def __init__(self, cause: Any, p: np.ndarray, G: np.ndarray, free: np.ndarray, omega: np.ndarray, orders: Any):
        self.cause, self.p, self.omega, self.orders = cause, as_array(np.asarray(p, float)), omega, orders
        self.mean, self.count = int(0 in orders), len(orders)
        at = orders.index(1)
        self.fundamental = at, self.count + at - self.mean
        u = np.zeros((len(free), self.count), complex)
        u[:, at] = free
        self.u, self.G = self.real(u), G
        self.scale = np.where(np.abs(free) > 0, np.abs(free), 1.0)

    def real(self, q: np.ndarray) -> np.ndarray:
        """Real and then imaginary parts of harmonics, none of the mean."""
        return np.concatenate([q.real, q[:, self.mean :].imag], axis=1)

    def through(self, f: np.ndarray, k: np.ndarray) -> np.ndarray:
        """Motion by forces that are given as reals, of some motions, shape ``(k, real, column)``."""
        G, m = self.G[k][:, :, None], self.mean
        re, im = f[:, : self.count], np.pad(f[:, self.count :], ((0, 0), (m, 0), (0, 0)))
        return np.concatenate([G.real * re - G.imag * im, (G.imag * re + G.real * im)[:, m:]], axis=1)

    def at(self, y: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Residual and its slopes by the motion, the force and its slopes, of some motions."""
        rows = np.resize(np.arange(len(k)), -(-len(k) // ROW) * ROW).reshape(-1, ROW)
        made = [_forces(self.cause, self.p, y[r], self.omega[k[r]], self.orders) for r in rows]
        f, by = (np.concatenate([np.asarray(m[j]) for m in made])[: len(k)] for j in range(2))
        r = y + self.through(f[..., None], k)[..., 0] - self.u[k]
        return r, np.eye(y.shape[1]) + self.through(by[..., : y.shape[1]], k), f, by

    def left(self, r: np.ndarray, k: np.ndarray) -> np.ndarray:
        """Largest part of a residual, over the motion without the joint."""
        return np.nan_to_num(np.abs(r).max(axis=1, initial=0.0) / self.scale[k], nan=np.inf)

    def motion(self, y: np.ndarray) -> np.ndarray:
        """Harmonics out of reals."""
        q = np.zeros((len(y), self.count), complex)
        q.real, q.imag[:, self.mean :] = y[:, : self.count], y[:, self.count :]
        return q

    def beside(self, y: np.ndarray, left: np.ndarray, k: np.ndarray, before: bool) -> np.ndarray:
        """Motions to start from: that of the nearest one found before or behind, in size and time as without joint."""
        found = np.flatnonzero(left <= CLOSED)
        at = np.clip(np.searchsorted(found, k) - before, 0, len(found) - 1)
        ratio = self.motion(self.u[k])[:, self.fundamental[0]] / self.motion(self.u[found[at]])[:, self.fundamental[0]]
        turned = np.abs(ratio)[:, None] * np.exp(1j * np.angle(ratio)[:, None] * np.array(self.orders))
        return self.real(np.nan_to_num(turned) * self.motion(y[found[at]]))

    def search(self, y: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where damped Newton's steps from some motions end, and the residual left there."""
        y, (r, J, *_) = y.copy(), self.at(y, k)
        left = self.left(r, k)
        moving = np.flatnonzero(left > TIGHT)
        for _ in range(NEWTON):
            if not len(moving):
                break
            steps = _solved(J[moving], r[moving, :, None])[..., 0]
            before, from_ = left[moving], y[moving]
            pending = np.arange(len(moving))
            for length in STEPS:  # the full step where it serves nearly as well, so that the end is quadratic
                which = moving[pending]
                there = from_[pending] - length * steps[pending]
                r_there, J_there, *_ = self.at(there, k[which])
                size = self.left(r_there, k[which])
                better = size < left[which]
                y[which[better]], r[which[better]], J[which[better]] = there[better], r_there[better], J_there[better]
                left[which[better]] = size[better]
                pending = pending[~(size < 0.5 * before[pending])]
                if not len(pending):
                    break
            moving = moving[(left[moving] > TIGHT) & (left[moving] < before)]
        return y, left


def _solved(J: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions of linear equations side by side; NaN where there is none."""
    good = np.isfinite(J).all(axis=(1, 2)) & np.isfinite(right).all(axis=(1, 2))
    out = np.full(right.shape, np.nan)
    try:
        out[good] = np.linalg.solve(J[good], right[good])
    except np.linalg.LinAlgError:
        out[good] = np.linalg.pinv(J[good]) @ right[good]
    return out


def balanced(
    cause: JointCause, p: np.ndarray, G: np.ndarray, free: np.ndarray, omega: np.ndarray, near: np.ndarray,
    highest: int = HIGHEST, neighbours: int = NEIGHBOURS,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """The force of a law at the fundamental [N], its slopes, whether a motion was found, and that motion [m].

    Parameters
    ----------
    cause, p
        The law and its parameters.
    G
        Receptance across the place at the orders of :func:`harmonics_of`, shape ``(n, h)`` [m/N].
    free
        Motion across it without the joint [m], shape ``(n,)``.
    omega
        Circular frequency [rad/s], shape ``(n,)``.
    near
        Motion from which the search begins, shape ``(n, h)`` [m]; then its fundamental alone, that without the joint,
        and what was found of neighbours in the row.
    highest
        Highest of these orders.
    neighbours
        Times that motions which were not found start from those on either side.

    Returns
    -------
    tuple
        Shapes ``(n,)``, ``(parameter + 1, n)``, ``(n,)`` and ``(n, h)``. The last slope is by the logarithm of the
        motion without the joint.
    """
    b = _Balance(cause, p, G, free, omega, harmonics_of(cause, p, highest))
    alone = np.zeros_like(near)
    alone[:, b.fundamental[0]] = near[:, b.fundamental[0]]
    y, left = b.real(near), np.full(len(free), np.inf)
    with np.errstate(all="ignore"):
        for n in range(3 + 2 * neighbours):
            k = np.flatnonzero(left > CLOSED)
            if not len(k) or (n >= 3 and len(k) == len(y)):
                break
            start = (b.real(near), b.real(alone), b.u)[n][k] if n < 3 else b.beside(y, left, k, n % 2 == 0)
            there, size = b.search(start, k)
            better = size < left[k]
            y[k[better]], left[k[better]] = there[better], size[better]
        r, J, f, by = b.at(y, np.arange(len(y)))
        count = y.shape[1]
        right = np.concatenate([r[..., None], b.through(by[..., count:], np.arange(len(y))), -b.u[..., None]], axis=2)
        inner = _solved(J, right)  # one more Newton step in it
        told = np.concatenate([f[..., None], by[..., count:], np.zeros((*y.shape, 1))], axis=2)
        told = told - by[..., :count] @ inner
    re, im = (told[:, j] for j in b.fundamental)
    force, slopes = re[:, 0] + 1j * im[:, 0], (re[:, 1:] + 1j * im[:, 1:]).T
    sound = (left < BALANCED) & np.isfinite(force) & np.isfinite(slopes).all(axis=0)
    return force, slopes, sound, b.motion(y)
