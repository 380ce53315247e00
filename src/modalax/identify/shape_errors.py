"""Standard deviations of shapes and modal masses from those of the unknowns."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from modalax.identify.likelihood import Parts, unpack
from modalax.model.modal import ModalModel


def spread_rest(std: Float[Array, "n q"], pivot: Int[Array, " n"]) -> Array:
    """Standard deviations of participation at all references (0 at the pivot), from those of the unknowns."""
    free = (std.shape[1] - 2) // 2
    index = jnp.arange(free + 1)[None, :]
    source = jnp.clip(index - (index > pivot[:, None]), 0, max(free - 1, 0))
    rest = std[:, 2 : 2 + free] + 1j * std[:, 2 + free :]
    if not free:
        return jnp.zeros((std.shape[0], 1), jnp.complex128)
    return jnp.where(index == pivot[:, None], 0.0, jnp.take_along_axis(rest, source, axis=1))


def shape_errors(
    theta: Array,
    found: Parts,
    cov: Array,
    real_modes: bool,
    model: ModalModel,
    pivot: Array,
    turned: bool,
) -> tuple[Array, Array | None, Array]:
    r"""Errors of shapes (largest component 1) and modal masses by the delta method.

    Given :math:`\theta` the outputs are independent, so a function :math:`g` of everything has the variance
    :math:`v^T\mathrm{cov}(\theta)v + \sum_o g_{x_o}^T R_o^{-1}R_o^{-T} g_{x_o}` with
    :math:`v = g_\theta - \sum_o G_o^T g_{x_o}`. Also returns the evidence for each mode, the squares
    :math:`\sum_o x_o^T (R_o^{-1}R_o^{-T})^{-1} x_o` of its own components. With ``turned`` the participation is the
    shape, scaled to one at the pivot.
    """
    n, q = theta.shape
    c = 1 if real_modes else 2
    n_out = found.x.shape[0]

    def local(r: Array) -> tuple[Array, Array, Array]:
        x = jax.lax.dynamic_slice(found.x, (0, r * c), (n_out, c))
        inverse = jax.lax.dynamic_slice(found.inverse, (0, r * c, 0), (n_out, c, found.inverse.shape[2]))
        coupling = jax.lax.dynamic_slice(found.coupling, (0, r * c, 0), (n_out, c, n * q))
        return x, jnp.einsum("oak,obk->oab", inverse, inverse), coupling

    def as_complex(x: Array) -> Array:
        return x[:, 0] + 0j if c == 1 else x[:, 0] + 1j * x[:, 1]

    def spread(g: Array, g_theta: Array, own: Array, coupling: Array) -> Array:
        """Variance of functions with gradients ``g (k, o, c)`` in the shape and ``g_theta (k, p)``."""
        v = g_theta - jnp.einsum("koc,ocp->kp", g, coupling)
        return jnp.einsum("kp,pq,kq->k", v, cov, v) + jnp.einsum("koa,oab,kob->k", g, own, g)

    def one_mode(r: Array) -> tuple[Array, Array, Array]:
        x, own, coupling = local(r)
        top = jnp.argmax(jnp.abs(as_complex(x)))

        def shape(x: Array) -> Array:
            z = as_complex(x)
            z = z / z[top]
            return jnp.concatenate([z.real, z.imag])

        std = jnp.sqrt(spread(jax.jacfwd(shape)(x), jnp.zeros((2 * n_out, n * q)), own, coupling))

        def mass(x: Array, theta: Array) -> Array:
            poles, part = unpack(theta, pivot)
            z = as_complex(x)
            if c == 1:
                z = z / (2j * poles[r].imag)
            ratio = part[r, drive_i] / z[drive_o] if turned else z[drive_o] / z[top] / (part[r, drive_i] * z[top])
            return (ratio / (2j * poles[r].imag)).real[None]

        evidence = jnp.sum(x * jnp.linalg.solve(own, x[..., None])[..., 0])
        if not drives:
            return std[:n_out] + 1j * std[n_out:], jnp.zeros(()), evidence
        g, g_theta = jax.jacfwd(mass, argnums=(0, 1))(x, theta)
        return std[:n_out] + 1j * std[n_out:], jnp.sqrt(spread(g, g_theta.reshape(1, -1), own, coupling)[0]), evidence

    drives = model.drive_points()
    drive_o = model.outputs.index(drives[0]) if drives else 0
    drive_i = model.inputs.index(drives[0]) if drives else 0
    shape_std, mass_std, evidence = jax.lax.map(one_mode, jnp.arange(n))
    return shape_std, mass_std if drives else None, evidence
