"""Stability of the poles of a diagram from one order to the next."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from modalax.identify.tables import PoleTable


class Stability(eqx.Module):
    """Flags of a stabilization diagram, all of shape ``(order, pole)``.

    Attributes
    ----------
    frequency, damping, shape
        Whether a pole agrees with one of the order below in frequency; also in damping; and in participation
        (always true where the estimator has none).
    physical
        Whether it could be a mode at all: stable, under-damped, in the upper half plane.
    """

    frequency: Bool[Array, "order pole"]
    damping: Bool[Array, "order pole"]
    shape: Bool[Array, "order pole"]
    physical: Bool[Array, "order pole"]

    @property
    def stable(self) -> Bool[Array, "order pole"]:
        """Whether each pole is stable in frequency, damping and shape."""
        return self.physical & self.frequency & self.damping & self.shape


@eqx.filter_jit
def stabilization(
    table: PoleTable,
    *,
    frequency_tol: float | Float[Array, ""] = 0.01,
    damping_tol: float | Float[Array, ""] = 0.05,
    shape_tol: float | Float[Array, ""] = 0.05,
    max_damping: float | Float[Array, ""] = 0.3,
) -> Stability:
    r"""Compare every pole with the nearest one of the order below.

    Parameters
    ----------
    table
        Poles of rising orders.
    frequency_tol, damping_tol
        Largest relative change that counts as stable [-].
    shape_tol
        Largest :math:`1 - \mathrm{MAC}` of the participation factors.
    max_damping
        Poles with a larger damping ratio are no modes.
    """
    physical = table.valid & (table.poles.imag > 0) & (table.damping_ratio > 0) & (table.damping_ratio < max_damping)

    def compare(new: Array, old: Array, old_ok: Array, new_w: Array, old_w: Array) -> tuple[Array, Array, Array]:
        distance = jnp.where(old_ok[None, :], jnp.abs(new[:, None] - old[None, :]), jnp.inf)
        near = old[jnp.argmin(distance, axis=1)]
        found = jnp.any(old_ok)
        size = jnp.maximum(jnp.abs(near), 1e-300)
        df = jnp.abs(jnp.abs(new) - jnp.abs(near)) / size
        zeta_new, zeta_old = -new.real / jnp.maximum(jnp.abs(new), 1e-300), -near.real / size
        dz = jnp.abs(zeta_new - zeta_old) / jnp.maximum(jnp.abs(zeta_old), 1e-300)
        w = old_w[jnp.argmin(distance, axis=1)]
        mac = jnp.abs(jnp.sum(w.conj() * new_w, axis=1)) ** 2
        frequency = found & (df < frequency_tol)
        return frequency, frequency & (dz < damping_tol), found & (1 - mac < shape_tol)

    w = jnp.ones((*table.poles.shape, 1)) if table.participation is None else table.participation
    flags = jax.vmap(compare)(table.poles[1:], table.poles[:-1], physical[:-1], w[1:], w[:-1])
    first = jnp.zeros((1, table.poles.shape[1]), bool)
    frequency, damping, shape = (jnp.concatenate([first, f]) & physical for f in flags)
    return Stability(frequency, damping, shape, physical)
