r"""Stability of periodic motion by Hill's method: growth of small disturbances :math:`e^{\lambda t}p(t)`.

The disturbance p has the period of the motion and is held by its harmonics, so that :math:`\lambda` solves a quadratic
eigenvalue problem. Of its many copies, one in each harmonic, those of least imaginary part are kept.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_double
from modalax.model.receptance import AnyStructure, directions
from modalax.model.structure import Structure
from modalax.simulate.aft import Harmonics, joint_forces, to_complex, to_real
from modalax.simulate.joints import Joint


def floquet_exponents(
    structure: AnyStructure,
    joints: tuple[Joint, ...],
    places: Any,
    freq: Any,
    q: Any,
    harmonics: Harmonics,
    *,
    samples: int = 128,
) -> Complex[Array, "s e"]:
    r"""Floquet exponents :math:`\lambda` [1/s] of each motion, two per DoF; stable where all real parts are negative.

    Joint forces are linearised along the motion; for a joint with memory that is the change from one closed loop to the
    next, so its disturbances are taken as slow against a cycle. Structural damping D acts on each harmonic as
    :math:`jD`, and on the mean, where it has no meaning, as the viscous damping :math:`D/\omega` of the motion.

    Parameters
    ----------
    structure
        Matrices. Modes that a modal model leaves out have a compliance but no motion, so it is refused.
    freq, q, harmonics
        Frequency, shape ``(s,)`` [Hz], and joint displacement, ``(s, j, h)`` [m], of each motion, as from
        :func:`modalax.simulate.follow_branch`.

    Raises
    ------
    ValueError
        If the structure is not given by matrices.
    """
    if not isinstance(structure, Structure):
        raise ValueError(f"stability needs matrices, a Structure, and was given a {type(structure).__name__}")
    n, top = len(structure.dofs), max(harmonics)
    full = tuple(range(top + 1))
    b = np.asarray(directions(structure, places))
    M, C, K, D = (np.asarray(A) for A in (structure.M, structure.C, structure.K, structure.D))
    size = 2 * top + 1
    turn = np.zeros((size, size))  # d/dt of (mean, cosines, sines), over omega
    for k in range(1, top + 1):
        turn[k, top + k], turn[top + k, k] = k, -k
    quarter, mean = np.sign(turn), np.diag(np.eye(size)[0])  # j times each harmonic
    # sines are minus the imaginary parts
    sign = np.concatenate([np.ones(top + 1), -np.ones(top)])

    def one(freq: Float[Array, ""], q: Complex[Array, "j h"]) -> Complex[Array, " e"]:
        omega = 2 * jnp.pi * freq
        rate = omega * turn
        hill = jnp.kron(M, rate @ rate) + jnp.kron(C, rate) + jnp.kron(K, np.eye(size)) + jnp.kron(D, quarter)
        for joint, direction, own in zip(joints, b, q, strict=True):
            whole = jnp.zeros((1, top + 1), complex).at[0, jnp.array(harmonics)].set(own)

            def force(y: Float[Array, " r"], joint: Joint = joint) -> Float[Array, " r"]:
                return to_real(joint_forces((joint,), to_complex(y, 1, full), omega, full, samples), full)

            slope = jax.jacfwd(force)(to_real(whole, full)) * sign[:, None] * sign[None]
            hill = hill + jnp.kron(np.outer(direction, direction), slope)
        damping = 2 * jnp.kron(M, rate) + jnp.kron(C, np.eye(size)) + jnp.kron(D / omega, mean)
        inertia = np.kron(np.linalg.inv(M), np.eye(size))
        eye, zero = np.eye(n * size), np.zeros((n * size, n * size))
        state = jnp.block([[zero, eye], [-inertia @ hill, -inertia @ damping]])
        exponents = jnp.linalg.eigvals(state)
        return exponents[jnp.argsort(jnp.abs(exponents.imag))[: 2 * n]]

    return jax.jit(jax.vmap(one))(as_double(freq, "freq"), as_double(q, "q", complex_=True))
