r"""How complex modes follow when the undamped modes have other frequencies or damping ratios than the matrices say.

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
    r"""The undamped modes beside the complex ones, for a share t of the viscous damping kept.

    To first order in the damping a complex shape stands off the undamped one by a part that grows with t, and its
    :math:`|\lambda|^2` and :math:`-2\,\mathrm{Re}\lambda/t` by parts that grow with :math:`t^2`.

    Attributes
    ----------
    k, c
        Of the undamped modes over those of the complex modes, shape ``(n,)``.
    shapes, participation
        Of the undamped modes in the lengths of the complex ones, shape ``(n, dof)``.
    """

    k: Float[Array, " n"]
    c: Float[Array, " n"]
    shapes: Complex[Array, "n dof"]
    participation: Complex[Array, "n dof"]

    def at(self, t: Any, k: Array, c: Array, shapes: Array, participation: Array) -> tuple[Array, ...]:
        """Stiffness, damping (still of all), shapes and participation with the share t of the viscous damping."""
        return (
            k * (1 + (1 - t**2) * (self.k - 1)), c * (1 + (1 - t**2) * (self.c - 1)),
            self.shapes + t * (shapes - self.shapes), self.participation + t * (participation - self.participation),
        )  # fmt: skip


def is_coupled(damping: np.ndarray) -> bool:
    """Whether damping in the coordinates of the undamped modes couples them."""
    own = np.sqrt(np.maximum(np.diag(damping), 1e-300))
    return bool(np.abs(damping / own[:, None] / own[None] - np.eye(len(own))).max(initial=0.0) >= COUPLED)


def uncoupled_of(
    stiffness: np.ndarray, damping: np.ndarray, poles: np.ndarray, shapes: np.ndarray, undamped: np.ndarray,
    inverse: np.ndarray,
) -> Uncoupled | None:  # fmt: skip
    """The undamped modes beside complex ones; None where dampers do not couple them.

    Parameters
    ----------
    stiffness, damping
        In the coordinates of the undamped modes, mass one, shape ``(n, n)``.
    poles, shapes
        Of the complex modes, shapes ``(n,)`` and ``(n, dof)``.
    undamped, inverse
        Undamped shapes of mass one, shape ``(dof, n)``, and the inverse of that.
    """
    if not is_coupled(damping):
        return None
    share = shapes @ inverse.T  # of each undamped mode in each complex one
    own = scipy.optimize.linear_sum_assignment(-(np.abs(share) ** 2))[1]
    length = share[np.arange(len(own)), own][:, None]
    alike = undamped.T[own]
    return Uncoupled(
        *map(jnp.asarray, (
            np.diag(stiffness)[own] / np.abs(poles) ** 2, np.diag(damping)[own] / (-2 * poles.real),
            alike * length, alike / length / (2j * poles.imag[:, None]),
        )),
    )  # fmt: skip


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
    k, c = np.abs(poles[kept]) ** 2, -2 * poles[kept].real
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
