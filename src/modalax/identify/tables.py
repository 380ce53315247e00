"""The result of a pole estimator: poles of every order, padded to one shape."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float


class PoleTable(eqx.Module):
    r"""Poles of all orders of a stabilization diagram.

    Attributes
    ----------
    poles
        :math:`\lambda`, shape ``(order, pole)`` [rad/s], padded to the largest order.
    valid
        Which entries of ``poles`` are poles; the others mean nothing, shape ``(order, pole)``.
    participation
        Modal participation over the references (inputs), of unit norm, shape ``(order, pole, i)``; None for
        estimators with a common denominator, which have none.
    orders
        The model orders, one for each row.
    method
        Name of the estimator.
    """

    poles: Complex[Array, "order pole"]
    valid: Bool[Array, "order pole"]
    participation: Complex[Array, "order pole i"] | None
    orders: tuple[int, ...] = eqx.field(static=True)
    method: str = eqx.field(static=True)

    @property
    def frequency_hz(self) -> Float[Array, "order pole"]:
        r"""Natural frequencies :math:`|\lambda|/2\pi` [Hz]."""
        return jnp.abs(self.poles) / (2 * jnp.pi)

    @property
    def damping_ratio(self) -> Float[Array, "order pole"]:
        r"""Damping ratios :math:`-\mathrm{Re}\lambda/|\lambda|` [-]; negative for unstable poles."""
        return -self.poles.real / jnp.maximum(jnp.abs(self.poles), jnp.finfo(float).tiny)

    def physical(
        self, lower_hz: float = 0.0, upper_hz: float = float("inf"), max_damping: float = 0.3
    ) -> Bool[Array, "order pole"]:
        """Whether each pole could be a mode: stable, damping ratio below ``max_damping``, and within a band [Hz]."""
        f, zeta = self.frequency_hz, self.damping_ratio
        return (
            self.valid & (self.poles.imag > 0) & (zeta > 0) & (zeta < max_damping) & (f >= lower_hz) & (f <= upper_hz)
        )

    def take(self, rows: slice) -> "PoleTable":
        """The table with some of its orders only."""
        part = None if self.participation is None else self.participation[rows]
        return PoleTable(self.poles[rows], self.valid[rows], part, self.orders[rows], self.method)
