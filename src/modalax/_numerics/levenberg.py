"""Levenberg-Marquardt for objectives that return their own gradient and Gauss-Newton matrix."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int


class _State(eqx.Module):
    first: Bool[Array, ""]
    trial: Float[Array, " p"]
    value: Float[Array, ""]
    gradient: Float[Array, " p"]
    matrix: Float[Array, "p p"]
    damping: Float[Array, ""]
    predicted: Float[Array, ""]
    rejected: Int[Array, ""]
    steps: Int[Array, ""]
    finished: Bool[Array, ""]


class LevenbergMarquardt(optx.AbstractMinimiser):
    r"""Minimise :math:`c(y)` with :math:`(G + \mu\,\mathrm{diag}\,G)\,\delta = -g`.

    The objective returns ``(c, (g, G))``: its value, gradient and Gauss-Newton matrix as auxiliary output. So a
    least-squares problem with millions of residuals never holds a Jacobian: its parts are summed where they arise.

    Attributes
    ----------
    rtol
        Stop when a step would lower the cost by less than this part of one (half a squared standard deviation), or
        when no step lowers it any more.
    atol
        Added to ``rtol``, for costs that are not sums of squared standard deviations.
    max_steps
        Most steps. It may be an array, so that searches of different lengths share one compiled program, as those of
        different ``max_steps`` of :func:`optimistix.minimise` do not.
    """

    rtol: float = 1e-12
    atol: float = 0.0
    max_steps: Any = 256
    norm: Callable[..., Any] = optx.max_norm

    def init(self, fn: Any, y: Any, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: Any) -> _State:
        """Start with an empty state: the first step only evaluates."""
        p = y.shape[0]
        return _State(
            jnp.array(True), y, jnp.array(jnp.inf), jnp.zeros(p), jnp.eye(p), jnp.array(1e-3), jnp.array(jnp.inf),
            jnp.array(0), jnp.array(0), jnp.array(False),
        )  # fmt: skip

    def step(self, fn: Any, y: Any, args: Any, options: Any, state: _State, tags: Any) -> tuple[Any, _State, Any]:
        """Evaluate the trial point, keep it if it is better, and set up the next."""
        value, aux = fn(state.trial, args)
        gradient, matrix = aux
        good = jnp.isfinite(value) & (value <= state.value) & jnp.all(jnp.isfinite(matrix))
        gain = (state.value - value) / state.predicted
        y = jnp.where(good, state.trial, y)
        better = jnp.where(state.first, state.damping, state.damping * jnp.where(gain > 0.75, 0.1, 1.0))
        damping = jnp.clip(jnp.where(good, better, state.damping * 8.0), 1e-14, 1e14)
        drop = jnp.where(good & ~state.first, state.value - value, jnp.inf)
        value = jnp.where(good, value, state.value)
        gradient = jnp.where(good, gradient, state.gradient)
        matrix = jnp.where(good, matrix, state.matrix)
        rejected = jnp.where(good, 0, state.rejected + 1)
        scale = jnp.diag(matrix)
        scale = jnp.where(scale > 0, scale, 1.0)
        # In scaled variables the matrix has a unit diagonal, so one damping suits all unknowns.
        root = jnp.sqrt(scale)
        system = matrix / (root[:, None] * root[None, :]) + damping * jnp.eye(len(root))
        step = -jnp.linalg.solve(system, gradient / root)
        predicted = -(step @ (gradient / root)) - 0.5 * step @ (system @ step) + 0.5 * damping * step @ step
        # The cost is half a sum of squared standard deviations plus rounding relative to its own size.
        small = self.rtol + self.atol + 4e-16 * jnp.abs(value)
        finished = (jnp.abs(predicted) <= small) & (damping < 1.0) | (drop <= small) & (
            jnp.abs(predicted) <= 1e4 * small
        )
        size = jnp.max(jnp.abs(step / root))
        # Steps as small as rounding, or small ones that no damping improves: the minimum within rounding.
        finished = finished | (size <= 4e-15) & (damping < 1.0) | (rejected >= 4) & (size < 1e-9) | (rejected > 20)
        trial = y + step / root
        new = _State(
            jnp.array(False), trial, value, gradient, matrix, damping, predicted, rejected, state.steps + 1,
            finished & ~state.first,
        )  # fmt: skip
        return y, new, (gradient, matrix)

    def terminate(self, fn: Any, y: Any, args: Any, options: Any, state: _State, tags: Any) -> tuple[Any, Any]:
        """Whether the last step was small enough, or no further one is allowed."""
        done = state.finished | (state.steps < self.max_steps)
        reached = optx.RESULTS.nonlinear_max_steps_reached
        return state.finished, optx.RESULTS.where(done, optx.RESULTS.successful, reached)

    def postprocess(
        self, fn: Any, y: Any, aux: Any, args: Any, options: Any, state: _State, tags: Any, result: Any
    ) -> tuple[Any, Any, dict[str, Any]]:
        """Return the result unchanged."""
        return y, aux, {"value": state.value, "gradient": state.gradient, "predicted": state.predicted}
