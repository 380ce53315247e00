"""The result of a pole estimator: poles of every order, padded to one shape."""

from types import ModuleType
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from modalax._numerics.known import Numbers, by_numpy
from modalax.identify.overview import of_poles


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

    def __str__(self) -> str:
        """Estimator, orders and number of poles."""
        return of_poles(self)

    @property
    def frequency_hz(self) -> Float[Array, "order pole"]:
        r"""Natural frequencies :math:`|\lambda|/2\pi` [Hz]."""
        return _frequency_and_damping(self.poles)[0]

    @property
    def damping_ratio(self) -> Float[Array, "order pole"]:
        r"""Damping ratios :math:`-\mathrm{Re}\lambda/|\lambda|` [-]; negative for unstable poles."""
        return _frequency_and_damping(self.poles)[1]

    def physical(
        self, lower_hz: float = 0.0, upper_hz: float = float("inf"), max_damping: float = 0.3
    ) -> Bool[Array, "order pole"]:
        """Whether each pole could be a mode: stable, damping ratio below ``max_damping``, and within a band [Hz]."""
        return _physical(self.poles, self.valid, lower_hz, upper_hz, max_damping)

    def take(self, rows: slice) -> "PoleTable":
        """The table with some of its orders only."""
        part = None if self.participation is None else self.participation[rows]
        return PoleTable(self.poles[rows], self.valid[rows], part, self.orders[rows], self.method)


def frequency_and_damping(xp: ModuleType, poles: Complex[Numbers, "..."]) -> tuple[Numbers, Numbers]:
    """Natural frequencies [Hz] and damping ratios of poles."""
    size = xp.abs(poles)
    return size / (2 * np.pi), -poles.real / xp.maximum(size, np.finfo(float).tiny)


_frequency_and_damping = by_numpy(frequency_and_damping)


@by_numpy
def _physical(
    xp: ModuleType, poles: Numbers, valid: Numbers, lower_hz: Any, upper_hz: Any, max_damping: Any
) -> Bool[Numbers, "..."]:
    f, zeta = frequency_and_damping(xp, poles)
    return valid & (poles.imag > 0) & (zeta > 0) & (zeta < max_damping) & (f >= lower_hz) & (f <= upper_hz)
