r"""The modal arrays of a simulation of any kind.

Every place that a cause can sit at is a direction over DoFs, and the receptance between directions is read from
these arrays, so that neither the number of DoFs nor the kind of simulation matters to a cause.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_double
from modalax._numerics.known import Numbers, by_numpy
from modalax.diagnose.causes.base import HystereticCause
from modalax.diagnose.setup.complex_modes import Mixing, Uncoupled, is_coupled, mixing_of, uncoupled_of
from modalax.model import ModalModel, Structure

BESIDE = 0.05  # share of the coupling next to none and all in which complex modes are not computed
RIGID_SHIFT = 1e-4  # a free structure is held by springs that put its rigid modes at this fraction of the band's start


class ModalForm(eqx.Module):
    r"""Modal arrays of a simulation, :math:`H_{de}(s) = \sum_r \psi_{rd} L_{re} u_r(s) + \psi_{rd}^* L_{re}^* v_r(s)`.

    With :math:`D_r = s^2 + c_r s + k_r` the two gains of a mode are :math:`u_r = (s - \lambda_r^*)/D_r` and
    :math:`v_r = (s - \lambda_r)/D_r`: :math:`1/(s-\lambda_r)` and its partner as long as nothing is changed, and the
    right answer when only :math:`c_r` or :math:`k_r` changes while mass and shape stay.

    Attributes
    ----------
    poles
        :math:`\lambda_r` [rad/s], shape ``(n,)``.
    shapes, participation
        :math:`\psi_{rd}` and :math:`L_{rd}` at every DoF, shape ``(n, dof)``.
    stiffness, damping
        :math:`k_r = |\lambda_r|^2` [1/s^2] and :math:`c_r = -2\,\mathrm{Re}\lambda_r` [1/s], shape ``(n,)``.
    hysteresis
        :math:`h_r` [1/s^2] of structural damping, shape ``(n,)``; its coupling between modes is left out.
    upper, lower
        Residual terms between DoFs, shape ``(dof, dof)``; zero where there are none.
    frequency_std, damping_std
        Relative standard deviation that the author claims, shape ``(n,)``.
    dofs
        Names of the DoFs.
    scaled
        Whether the receptance between any two DoFs is known (a modal model without drive point knows only
        the measured ones).
    mixing
        How the complex modes follow the undamped ones, where dampers couple these and their spread is claimed.
    uncoupled
        The undamped modes, where dampers couple them.
    """

    poles: Complex[Array, " n"]
    shapes: Complex[Array, "n dof"]
    participation: Complex[Array, "n dof"]
    stiffness: Float[Array, " n"]
    damping: Float[Array, " n"]
    hysteresis: Float[Array, " n"]
    upper: Complex[Array, "dof dof"]
    lower: Complex[Array, "dof dof"]
    frequency_std: Float[Array, " n"]
    damping_std: Float[Array, " n"]
    dofs: tuple[str, ...] = eqx.field(static=True)
    scaled: bool = eqx.field(static=True)
    mixing: Mixing | None = None
    uncoupled: Uncoupled | None = None

    def adapted(self, theta: Float[Array, "2 n"]) -> tuple[Array, Array, Array, Array]:
        """Stiffness, damping, shapes and participation with logarithmic changes of frequencies and damping ratios."""
        mixing = self.mixing
        if mixing is None:
            k, c = self.stiffness * jnp.exp(2 * theta[0]), self.damping * jnp.exp(theta[0] + theta[1])
            return k, c, self.shapes, self.participation

        def by(a: Array) -> Array:
            return jnp.tensordot(theta - mixing.centre, a, 2)

        return (
            self.stiffness * jnp.exp(by(mixing.k)), self.damping * jnp.exp(by(mixing.c)),
            self.shapes + by(mixing.shapes), self.participation + by(mixing.participation),
        )  # fmt: skip

    def index(self, dof: str) -> int:
        """Position of a DoF by name; ``ValueError`` lists the names if there is no such one."""
        if dof not in self.dofs:
            raise ValueError(
                f"the measurement has a DoF {dof!r} that the simulation lacks; it has {', '.join(self.dofs)}"
            )
        return self.dofs.index(dof)

    @property
    def frequency_hz(self) -> np.ndarray:
        """Natural frequencies [Hz]."""
        return np.sqrt(np.asarray(self.stiffness)) / (2 * np.pi)


def kept_coupling(causes: Iterable[tuple[Any, Any]]) -> Any:
    """Share of the damping coupling between modes that causes with these parameters leave."""
    return math.prod(cause.viscous(p) for cause, p in causes if isinstance(cause, HystereticCause))


def modal_form_of(
    simulation: Structure | ModalModel, lowest_hz: float, centre: np.ndarray | None = None, coupling: Any = None
) -> ModalForm:  # fmt: skip
    """The modal arrays of a simulation.

    Parameters
    ----------
    lowest_hz
        Start of the band, for the shift of rigid modes [Hz].
    centre
        Logarithmic changes of the undamped modes' frequencies and damping ratios about which complex modes that follow
        them are to be exact, shape ``(2, n)``; 0 by default, and without a meaning where there is no mixing.
    coupling
        Share of what couples the modes' damping at which complex modes are to be exact, beside all of it and none; one
        half by default, and where it is next to these.

    Raises
    ------
    ValueError
        If it is neither a structure nor a modal model, or its mass matrix is singular.
    """
    if isinstance(simulation, Structure):
        n = len(simulation.dofs)
        about = np.zeros((2, n)) if centre is None else np.asarray(centre)[:, :n]
        modal_form = _from_structure(simulation, lowest_hz, about, coupling)
        followed = modal_form.mixing is not None or not about.any()
        return modal_form if followed else _from_structure(simulation, lowest_hz, np.zeros((2, n)), coupling)
    if isinstance(simulation, ModalModel):
        return _from_modal(simulation)
    raise ValueError(f"a simulation is a Structure or a ModalModel, not a {type(simulation).__name__}")


def _from_structure(structure: Structure, lowest_hz: float, centre: np.ndarray, coupling: Any) -> ModalForm:
    M, C, K = (np.asarray(A) for A in (structure.M, structure.C, structure.K))
    n = len(M)
    if np.linalg.matrix_rank(M) < n:
        raise ValueError(f"M is singular: rank {np.linalg.matrix_rank(M)} of {n}; condense the massless DoFs first")
    # In the coordinates of the undamped modes the state matrix is well scaled and nearly block diagonal.
    symmetric = 0.5 * (K + K.T)
    squares, phi = scipy.linalg.eigh(symmetric, 0.5 * (M + M.T))
    # The weakest spring that still parts a rigid mode's double zero eigenvalue.
    shift = (RIGID_SHIFT * 2 * np.pi * max(lowest_hz, 1e-3)) ** 2 if squares[0] < 1e-9 * abs(squares[-1]) else 0.0
    mass = phi.T @ M @ phi
    stiff = np.linalg.solve(mass, phi.T @ K @ phi) + shift * np.eye(n)
    damp = np.linalg.solve(mass, phi.T @ C @ phi)
    stiff[np.diag_indices(n)] *= np.exp(2 * centre[0])
    damp[np.diag_indices(n)] *= np.exp(centre[0] + centre[1])
    found = _complex_modes(stiff, damp, phi, mass)
    claims = [np.broadcast_to(np.asarray(std), (n,)) for std in (structure.frequency_std, structure.damping_std)]
    pair = int((~found.real).sum())
    f_std, d_std = (_in_order(std[:pair], found.real) for std in claims)
    mixing = uncoupled = None
    if not found.real.any():
        back = found.left @ np.linalg.inv(mass)
        mixing = mixing_of(stiff, damp, found.values, found.right.T, back, found.kept, phi, centre)
        if mixing is not None:  # in the lengths that are stored
            by = found.turn
            mixing = eqx.tree_at(
                lambda m: (m.shapes, m.participation), mixing, (mixing.shapes / by, mixing.participation * by)
            )
        uncoupled = _uncoupled(found, stiff, damp, phi, mass, coupling)
    return _build(
        found.poles, found.shapes, found.part, structure.dofs, frequency_std=f_std, damping_std=d_std,
        hysteresis=_nearest(structure, phi, squares, mass, found.poles, found.real), mixing=mixing,
        uncoupled=uncoupled,
    )  # fmt: skip


def _uncoupled(
    found: "_Complex", stiff: np.ndarray, damp: np.ndarray, phi: np.ndarray, mass: np.ndarray, coupling: Any
) -> Uncoupled | None:
    """Undamped modes and those with a share of the coupling; None without coupling, or where these have real poles."""
    if not is_coupled(damp):
        return None
    own = np.diag(np.diag(damp))
    share = 0.5 if coupling is None or not BESIDE < coupling < 1 - BESIDE else float(coupling)
    less = _complex_modes(stiff, own + share * (damp - own), phi, mass)
    if less.real.any():
        return None
    return uncoupled_of(np.diag(damp), np.diag(stiff), phi, np.linalg.inv(phi), found.modes, less.modes, share)


@dataclass(frozen=True)
class _Complex:
    """All eigenvalues with displacement parts of right and left eigenvectors in rows, and the modes that are kept.

    ``kept`` are the numbers of the modes by rising frequency, ``real`` tells those with a real pole, stored as half a
    pair with itself; ``poles``, ``shapes`` and ``part`` are theirs, with 1 at the largest entry of a shape, which was
    ``turn``.
    """

    values: np.ndarray
    right: np.ndarray
    left: np.ndarray
    kept: np.ndarray
    real: np.ndarray
    poles: np.ndarray
    shapes: np.ndarray
    part: np.ndarray
    turn: np.ndarray

    @property
    def modes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Poles, shapes and participation."""
        return self.poles, self.shapes, self.part


def _complex_modes(stiff: np.ndarray, damp: np.ndarray, phi: np.ndarray, mass: np.ndarray) -> _Complex:
    n = len(stiff)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-stiff, -damp]])
    unit = np.sqrt(np.abs(np.diag(stiff)).max())
    scale = np.r_[np.full(n, 1.0), np.full(n, unit)]
    values, vectors = np.linalg.eig(state * scale[None] / scale[:, None])
    left = np.linalg.inv(vectors)[:, n:] / unit
    right = vectors[:n].T
    upper = values.imag > 1e-10 * unit
    real = np.abs(values.imag) <= 1e-10 * unit
    keep = np.concatenate([np.flatnonzero(upper), np.flatnonzero(real)])
    half = np.where(real[keep], 0.5, 1.0)[:, None]
    poles = np.where(real[keep], values[keep].real + 0j, values[keep])
    shapes = right[keep] @ phi.T
    part = half * (left[keep] @ np.linalg.inv(mass) @ phi.T)
    turn = np.take_along_axis(shapes, np.abs(shapes).argmax(axis=1)[:, None], axis=1)
    order = np.argsort(np.abs(poles))
    return _Complex(
        values, right, left, keep[order], real[keep][order], poles[order], (shapes / turn)[order],
        (part * turn)[order], turn[order],
    )  # fmt: skip


def _nearest(
    structure: Structure, phi: np.ndarray, squares: np.ndarray, mass: np.ndarray, poles: np.ndarray, real: np.ndarray
) -> np.ndarray:
    """Structural damping of each pole, that of the undamped mode next to it in frequency."""
    modal = np.einsum("dr,de,er->r", phi, np.asarray(structure.D), phi) / np.diag(mass)
    own = np.abs(np.abs(poles)[:, None] - np.sqrt(np.abs(squares))[None]).argmin(axis=1)
    return np.where(real, 0.0, modal[own])


def _in_order(std: np.ndarray, real: np.ndarray) -> np.ndarray:
    """Claims a vibrating mode, put where those modes stand among real poles."""
    out = np.zeros(len(real))
    out[~real] = std[: int((~real).sum())]
    return out


def _from_modal(model: ModalModel) -> ModalForm:
    dofs = model.outputs + tuple(name for name in model.inputs if name not in model.outputs)
    known = bool(model.drive_points())
    if known:
        a = np.asarray(model.modal_a())[:, None]
    else:
        a = np.ones((len(model.poles), 1))
    shapes = np.asarray(model.shapes)
    part = np.asarray(model.participation)
    only_driven = [model.inputs.index(name) for name in dofs[len(model.outputs) :]]
    shapes_all = np.concatenate([shapes, part[:, only_driven] * a], axis=1)
    part_all = np.stack(
        [
            part[:, model.inputs.index(name)] if name in model.inputs else shapes_all[:, k] / a[:, 0]
            for k, name in enumerate(dofs)
        ],
        axis=1,
    )
    return _build(
        np.asarray(model.poles), shapes_all, part_all, dofs,
        frequency_std=np.asarray(model.frequency_std), damping_std=np.asarray(model.damping_std),
        upper=np.asarray(model._residual(model.upper, dofs, dofs)),
        lower=np.asarray(model._residual(model.lower, dofs, dofs)), scaled=known,
    )  # fmt: skip


def _build(
    poles: Any, shapes: Any, part: Any, dofs: tuple[str, ...], *, frequency_std: Any, damping_std: Any,
    hysteresis: Any = None, upper: Any = None, lower: Any = None, scaled: bool = True, mixing: Mixing | None = None,
    uncoupled: Uncoupled | None = None,
) -> ModalForm:  # fmt: skip
    zero = np.zeros((len(dofs), len(dofs)))
    cast = lambda a, name: as_double(a, name, complex_=True)
    poles = cast(poles, "poles")
    stiffness, damping = _equations(poles)
    return ModalForm(
        poles, cast(shapes, "shapes"), cast(part, "participation"), stiffness, damping,
        as_double(np.zeros(poles.shape) if hysteresis is None else hysteresis, "hysteresis"),
        cast(zero if upper is None else upper, "upper"), cast(zero if lower is None else lower, "lower"),
        as_double(frequency_std, "frequency_std"), as_double(damping_std, "damping_std"), tuple(dofs), scaled, mixing,
        uncoupled,
    )  # fmt: skip


@by_numpy
def _equations(xp: ModuleType, poles: Any) -> tuple[Float[Numbers, " m"], Float[Numbers, " m"]]:
    """Stiffness and damping of the modal equations."""
    return xp.abs(poles) ** 2, -2 * poles.real
