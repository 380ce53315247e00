r"""Change of complex modes when frequencies or damping ratios of the undamped modes differ from the matrices.

The author of a simulation claims a spread of each undamped mode's frequency and damping ratio. Where dampers couple
these modes, every complex mode follows each of them a little, in pole and in shape. With :math:`K_p` and
:math:`\Gamma_{pp}` of the undamped mode p changed and its coupling :math:`\Gamma_{ps}` kept, first-order perturbation
of the state matrix (Fox and Kapoor 1968, AIAA J. 6:2426, for undamped systems; Adhikari 1999, AIAA J. 37:1452) gives

.. math:: y_s\,dA\,x_r = -y_{sp}\,x_{pr}\,(dK_p + \lambda_r\,d\Gamma_{pp}),\qquad
          d\lambda_r = y_r\,dA\,x_r,\qquad dx_r = \sum_{s\ne r}\frac{y_s\,dA\,x_r}{\lambda_r - \lambda_s}\,x_s .

Where a share of the viscous damping goes, so does its coupling: :class:`Uncoupled`.
"""

import itertools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, Complex, Float

Triple = tuple[np.ndarray, np.ndarray, np.ndarray]  # poles, shapes and participation of modes
COUPLED = 1e-6  # coupling of two modes' damping over the geometric mean of their own, below which there is none
MOST = 100  # modes beyond which this is left out


class Mixing(eqx.Module):
    """Derivatives by log frequency and log damping ratio of each undamped mode (the first two axes).

    Attributes
    ----------
    k, c
        Of the logarithms of each complex mode's stiffness and damping, shape ``(2, n, n)``.
    shapes, participation
        Beside what a real mode would do, shape ``(2, n, n, dof)``.
    centre
        Logarithmic changes about which these hold, shape ``(2, n)``.
    """

    k: Float[Array, "2 n n"]
    c: Float[Array, "2 n n"]
    shapes: Complex[Array, "2 n n dof"]
    participation: Complex[Array, "2 n n dof"]
    centre: Float[Array, "2 n"]


class Uncoupled(eqx.Module):
    r"""The undamped modes, and those with part of the coupling, for interpolation towards the complex ones.

    With a share t of what couples the modes kept and each mode's own damping whole, a complex shape stands off the
    undamped one by a part that grows with t to first order, and its :math:`|\lambda|^2` and
    :math:`-2\,\mathrm{Re}\lambda` by parts that grow with :math:`t^2`. Interpolation in these goes through the
    undamped modes at t = 0, those at ``middle``, and all of the coupling at t = 1, so it is exact there
    (:func:`through`).

    Attributes
    ----------
    k, c
        At t = 0 and ``middle`` over those of the complex modes, shape ``(2, n)``.
    shapes, participation
        At t = 0, ``middle`` and 1, in the lengths of the complex ones, shape ``(3, n, dof)``.
    middle
        The share of coupling in the second of these.
    """

    k: Float[Array, "2 n"]
    c: Float[Array, "2 n"]
    shapes: Complex[Array, "3 n dof"]
    participation: Complex[Array, "3 n dof"]
    middle: Float[Array, ""]

    def at(self, t: Any, k: Array, c: Array, shapes: Array, participation: Array) -> tuple[Array, ...]:
        """Stiffness, damping (still of all), shapes and participation with the share t of the coupling."""
        m = self.middle
        first, square = through(t, m), through(t**2, m**2)
        near = [jnp.tensordot(first, a, 1) + t * (now - a[2]) for a, now in (
            (self.shapes, shapes), (self.participation, participation),
        )]  # fmt: skip
        return k * (square[:2] @ self.k + square[2]), c * (square[:2] @ self.c + square[2]), *near


def through(t: Any, m: Any) -> Array:
    """Weights of values at 0, m and 1 for the parabola through them at t (Lagrange)."""
    return jnp.stack([(t - m) * (t - 1) / m, t * (t - 1) / (m * (m - 1)), t * (t - m) / (1 - m)])


def is_coupled(damping: np.ndarray) -> bool:
    """Whether damping in the coordinates of the undamped modes couples them."""
    own = np.sqrt(np.maximum(np.diag(damping), 1e-300))
    return bool(np.abs(damping / own[:, None] / own[None] - np.eye(len(own))).max(initial=0.0) >= COUPLED)


def uncoupled_of(
    damping: np.ndarray, squares: np.ndarray, undamped: np.ndarray, inverse: np.ndarray, coupled: Triple,
    middle: Triple, at: float,
) -> Uncoupled:  # fmt: skip
    """Make the undamped modes and those with a share of the coupling, in the lengths of the complex ones.

    Parameters
    ----------
    damping, squares
        Of the undamped modes, mass one, shape ``(n,)``.
    undamped, inverse
        Undamped shapes of mass one, shape ``(dof, n)``, and the inverse of that.
    coupled, middle
        Poles, shapes and participation of the complex modes with all of the coupling and with the share ``at`` of it,
        shapes ``(n,)`` and ``(n, dof)``.
    """
    poles, shapes, participation = coupled
    own, length = _own(shapes, inverse)
    theirs, lengths = _own(middle[1], inverse)
    order = np.argsort(theirs)[own]  # those that are most of the same undamped mode
    scale = length / lengths[order]
    alike = undamped.T[own]
    return Uncoupled(
        *map(jnp.asarray, (
            np.stack([squares[own], np.abs(middle[0][order]) ** 2]) / np.abs(poles) ** 2,
            np.stack([damping[own], -2 * middle[0][order].real]) / _rate(poles),
            np.stack([alike * length, middle[1][order] * scale, shapes]),
            np.stack([alike / length / (2j * poles.imag[:, None]), middle[2][order] / scale, participation]),
            at,
        )),
    )  # fmt: skip


def _rate(poles: np.ndarray) -> np.ndarray:
    """Damping of each mode, which others are told relative to; one where there is none, of which nothing is."""
    rate = -2 * poles.real
    return np.where(rate == 0, 1.0, rate)


def _own(shapes: np.ndarray, inverse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest undamped mode in each complex one, and its share, shapes ``(n,)`` and ``(n, 1)``."""
    share = shapes @ inverse.T
    own = scipy.optimize.linear_sum_assignment(-(np.abs(share) ** 2))[1]
    return own, share[np.arange(len(own)), own][:, None]


def mixing_of(
    stiffness: np.ndarray, damping: np.ndarray, poles: np.ndarray, right: np.ndarray, left: np.ndarray,
    kept: np.ndarray, shapes: np.ndarray, centre: np.ndarray,
) -> Mixing | None:  # fmt: skip
    """Derivatives of the kept complex modes; None where modes are not coupled, very many, or not all kept.

    Parameters
    ----------
    stiffness, damping
        In the coordinates of the undamped modes, mass one, shape ``(n, n)``.
    poles, right, left
        All eigenvalues and the displacement parts of right (columns) and velocity parts of left eigenvectors (rows),
        shapes ``(2n,)``, ``(n, 2n)``, ``(2n, n)``.
    kept
        Numbers of the n modes that are stored, by rising frequency.
    shapes
        Undamped mode shapes, shape ``(dof, n)``.
    centre
        Logarithmic changes that the matrices hold already, shape ``(2, n)``.
    """
    n = len(stiffness)
    if not is_coupled(damping) or n > MOST or len(kept) != n:
        return None
    away = poles[None] - poles[:, None]  # (s, r)
    near = np.abs(away) < 1e-12 * np.abs(poles).max()
    away = np.where(near, 1.0, away)
    disp, part = (right.T @ shapes.T), (left @ shapes.T)  # every eigenvector at the DoFs
    k, c = np.abs(poles[kept]) ** 2, _rate(poles[kept])
    out = [np.zeros((2, n, n)), np.zeros((2, n, n)), *(np.zeros((2, n, n, len(shapes)), complex) for _ in range(2))]
    for kind, p in itertools.product(range(2), range(n)):
        change = (2 * stiffness[p, p] if kind == 0 else 0.0) + poles * damping[p, p]  # of each mode r
        product = -left[:, p][:, None] * right[p][None] * change[None]  # y_s dA x_r
        moved = np.diag(product)[kept]
        onto = np.where(near, 0.0, product / away)
        to_shape = onto[:, kept].T @ disp
        onto_left = np.where(near, 0.0, product.T / away)  # y_r dA x_s over lambda_r - lambda_s
        to_part = onto_left[:, kept].T @ part
        # lengths are arbitrary: keep that of the shape, and leave out what the gain of a real mode does by itself
        flat = (onto[:, kept].T @ right.T, right.T[kept])
        length = np.einsum("rq,rq->r", flat[1].conj(), flat[0]) / np.einsum("rq,rq->r", flat[1].conj(), flat[1])
        out[0][kind, p] = 2 * np.real(poles[kept].conj() * moved) / k
        out[1][kind, p] = -2 * moved.real / c
        out[2][kind, p] = to_shape - length[:, None] * disp[kept]
        out[3][kind, p] = to_part + (length + moved.imag / poles[kept].imag)[:, None] * part[kept]
    return Mixing(*map(jnp.asarray, (*out, centre)))
