"""A structure as mass, damping and stiffness matrices, and its receptance."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Bool, Complex, Float

from modalax._numerics.checks import as_array, as_double, is_traced, require_finite
from modalax._numerics.known import host
from modalax.data.dofs import as_names
from modalax.data.frf import FRF, check_names, default_names, derivative
from modalax.model.elements import Elements
from modalax.model.groups import Groups
from modalax.model.modal import ModalModel, claimed_std, in_order
from modalax.model.overview import of_structure
from modalax.model.solve import receptance_along

ROUNDING = 1e-13  # rounding error of an eigenvalue per DoF, relative to the sum of the magnitudes in it
PROPORTIONAL = 1e-12  # coupling of real modes by the damping below which there is none


class Structure(eqx.Module):
    r"""Linear structure :math:`M\ddot x + C\dot x + K x = F`; stiffness :math:`K + jD` if damping is hysteretic.

    Attributes
    ----------
    M, C, K
        Mass [kg], damping [N s/m] and stiffness [N/m], shape ``(n, n)``.
    dofs
        DoF names, ``n`` of them.
    frequency_std, damping_std
        Relative standard deviation that the author claims for each modal frequency and damping ratio: one number
        or one for each mode (0: taken as exact).
    stiffness_std, mass_std
        Relative general inaccuracy of stiffness and mass that the author claims, each one number (0: exact); None
        where nothing is claimed.
    pairs
        Pairs of DoF names between which springs, dampers and joints may sit; None: those that K couples.
    elements
        The elements that the stiffness and mass are made of, where a finite-element model tells them; None: unknown.
    groups
        Groups of elements that share a parameter, such as a Young's modulus, over ``dofs`` or over those of the
        ``elements``; None: unknown.
    D
        Structural (hysteretic) damping [N/m], shape ``(n, n)``: the imaginary part of the stiffness for
        :math:`\omega > 0`; zero unless given.
    """

    M: Float[Array, "n n"]
    C: Float[Array, "n n"]
    K: Float[Array, "n n"]
    frequency_std: Float[Array, "..."]
    damping_std: Float[Array, "..."]
    D: Float[Array, "n n"]
    stiffness_std: Float[Array, ""] | None
    mass_std: Float[Array, ""] | None
    elements: Elements | None
    groups: Groups | None
    dofs: tuple[str, ...] = eqx.field(static=True)
    pairs: tuple[tuple[str, str], ...] | None = eqx.field(static=True)

    def __init__(
        self,
        M: Any,
        C: Any,
        K: Any,
        dofs: Sequence[str] | None = None,
        *,
        frequency_std: Any = 0.0,
        damping_std: Any = 0.0,
        stiffness_std: Any = None,
        mass_std: Any = None,
        pairs: Sequence[Sequence[str]] | None = None,
        D: Any = None,
        elements: Elements | None = None,
        groups: Groups | None = None,
    ):
        self.M, self.C, self.K = (as_double(A, name) for A, name in ((M, "M"), (C, "C"), (K, "K")))
        self.D = as_array(np.zeros(self.K.shape)) if D is None else as_double(D, "D")
        n = self.M.shape[0] if self.M.ndim else 0
        if not n:
            raise ValueError(f"M has shape {self.M.shape}; a structure needs at least one degree of freedom, M (n, n)")
        for A, name in ((self.M, "M"), (self.C, "C"), (self.K, "K"), (self.D, "D")):
            if A.shape != (n, n):
                raise ValueError(f"{name} has shape {A.shape}; M, C and K need one shape (n, n), here ({n}, {n})")
            require_finite(A, name)
        self.dofs = check_names(default_names(n, "") if dofs is None else dofs, n, "dofs")
        self.frequency_std = claimed_std(frequency_std, "frequency_std", n)
        self.damping_std = claimed_std(damping_std, "damping_std", n)
        self.stiffness_std = None if stiffness_std is None else claimed_std(stiffness_std, "stiffness_std", 1)
        self.mass_std = None if mass_std is None else claimed_std(mass_std, "mass_std", 1)
        self.pairs = None if pairs is None else tuple(self._pair(pair) for pair in pairs)
        if elements is not None:
            elements.check_of(self.dofs)
        self.elements = elements
        if groups is not None:
            groups.check_of(n, *((len(elements.dofs),) if elements is not None and elements.dofs else ()))
        self.groups = groups

    def _pair(self, pair: Sequence[str]) -> tuple[str, str]:
        """Return a pair of two different DoFs of this structure; ``ValueError`` says what is wrong with any other."""
        if len(pair) != 2 or pair[0] == pair[1]:
            raise ValueError(f"pairs holds {list(pair)}; a pair is two different DoFs")
        return self.dofs[self.index(str(pair[0]))], self.dofs[self.index(str(pair[1]))]

    @classmethod
    def from_modes(
        cls,
        frequency_hz: Any,
        damping_ratio: Any,
        shapes: Any,
        modal_mass: Any,
        dofs: Sequence[str] | None = None,
        **claims: Any,
    ) -> "Structure":
        r"""Matrices of a complete set of real modes, :math:`M = P^{-T}\mathrm{diag}(m)P^{-1}` and so on.

        Parameters
        ----------
        frequency_hz, damping_ratio, modal_mass
            Shape ``(n,)`` [Hz], [-], [kg].
        shapes
            Shape ``(n, n)``, mode by row.
        """
        P = as_double(shapes, "shapes").T
        omega, zeta = 2 * jnp.pi * as_double(frequency_hz, "frequency"), as_double(damping_ratio, "damping ratio")
        mass = as_double(modal_mass, "modal_mass")
        inverse = jnp.linalg.inv(P)
        build = lambda d: inverse.T @ (d[:, None] * inverse)
        return cls(build(mass), build(2 * zeta * omega * mass), build(omega**2 * mass), dofs, **claims)

    def __str__(self) -> str:
        """Degrees of freedom, damping, and what is claimed and named."""
        return of_structure(self)

    def index(self, dof: str) -> int:
        """Position of a DoF by name; ``ValueError`` lists the names if there is no such one."""
        if dof not in self.dofs:
            raise ValueError(f"no DoF named {dof!r}; the structure has {', '.join(self.dofs)}")
        return self.dofs.index(dof)

    def replace(self, **changes: Any) -> "Structure":
        """A copy with some attributes changed and checked again; other DoFs, M or K have no known elements."""
        kept = not changes.keys() & {"dofs", "M", "K"}
        fields = dict(
            M=self.M, C=self.C, K=self.K, D=self.D, dofs=self.dofs, frequency_std=self.frequency_std,
            damping_std=self.damping_std, stiffness_std=self.stiffness_std, mass_std=self.mass_std, pairs=self.pairs,
            elements=self.elements if kept else None, groups=self.groups if kept else None,
        )  # fmt: skip
        return Structure(**{**fields, **changes})

    def along(self, omega: Any, rows: Any, columns: Any) -> Complex[Array, "f l r"]:
        r"""Receptance between directions, :math:`L (K + jD + j\omega C - \omega^2 M)^{-1} R` [m/N].

        Parameters
        ----------
        omega
            Circular frequencies, shape ``(f,)`` [rad/s].
        rows, columns
            Directions over the DoFs, shapes ``(l, n)`` and ``(n, r)``.
        """
        rows, columns = as_double(rows, "rows"), as_double(columns, "columns")
        return receptance_along(self.M, self.C, self.K, self.D, as_double(omega, "omega"), rows, columns)

    def receptance(self, omega: Any, outputs: Sequence[str], inputs: Sequence[str]) -> Complex[Array, "f o i"]:
        r""":math:`(K + jD + j\omega C - \omega^2 M)^{-1}` [m/N] at frequencies [rad/s] between DoFs by name."""
        eye = np.eye(len(self.dofs))
        o, i = [self.index(n) for n in outputs], [self.index(n) for n in inputs]
        return self.along(omega, eye[o], eye[:, i])

    def frf(
        self,
        freq: Any,
        *,
        form: str = "receptance",
        outputs: Sequence[str] | None = None,
        inputs: Sequence[str] | None = None,
    ) -> FRF:
        """The FRF at frequencies [Hz] between DoFs by name (all of them by default)."""
        freq = as_double(freq, "freq")
        outputs = self.dofs if outputs is None else as_names(outputs)
        inputs = self.dofs if inputs is None else as_names(inputs)
        H = derivative(self.receptance(2 * np.pi * host(freq), outputs, inputs), freq, form)
        return FRF(freq, H, form=form, outputs=outputs, inputs=inputs)

    def modal(self) -> ModalModel:
        r"""All modes: shapes :math:`\psi`, residues :math:`\psi\psi^T/a` with :math:`a = \psi^T(2\lambda M + C)\psi`.

        Free-body modes have no pole pair; they make the lower residual term :math:`\phi\phi^T/m`.

        Raises
        ------
        ValueError
            If M is singular, a mode is over-damped, a free-body mode is damped, or the damping is hysteretic, which has
            no poles.
        """
        if is_traced(self.M, self.C, self.K, self.D):
            raise ValueError("modal() works on numbers, not inside jit or grad; call it outside")
        if np.any(self.D):
            raise ValueError("a structure with hysteretic damping D has no poles; give modal damping ratios instead")
        M, C, K = (np.asarray(A) for A in (self.M, self.C, self.K))
        n = len(M)
        rank = np.linalg.matrix_rank(M)
        if rank < n:
            raise ValueError(f"M is singular: rank {rank} of {n}; condense the massless DoFs first")
        square, phi, free = real_modes(M, K)
        lower, phi, omega = phi[:, free] @ phi[:, free].T, phi[:, ~free], np.sqrt(square[~free])
        c = phi.T @ C @ phi
        _check_free(M, C, lower)
        size = len(omega)
        if np.abs(c - np.diag(np.diag(c))).max(initial=0.0) <= PROPORTIONAL * np.abs(c).max(initial=0.0):
            poles = -np.diag(c) / 2 + np.sqrt((np.diag(c) / 2) ** 2 - omega**2 + 0j)
            vectors = np.eye(size)
        else:  # states are the modal velocities and the modal displacements times their frequencies
            state = np.block([[np.zeros((size, size)), np.diag(omega)], [-np.diag(omega), -c]])
            poles, vectors = (np.asarray(part) for part in np.linalg.eig(state))
            up = np.imag(poles) > 0
            up = np.imag(poles) > 1e-9 * np.abs(poles)
            poles, vectors = poles[up], (vectors[:size] / omega[:, None])[:, up]
        vibrate = int((np.imag(poles) > 1e-9 * np.abs(poles)).sum())
        if vibrate != size:
            raise ValueError(
                f"{size} modes have stiffness but only {vibrate} vibrate; over-damped modes have no pole pair"
            )
        psi = (phi @ vectors).T
        psi = psi / np.take_along_axis(psi, np.abs(psi).argmax(axis=1)[:, None], axis=1)
        a = 2 * poles * ((psi @ M) * psi).sum(axis=1) + ((psi @ C) * psi).sum(axis=1)
        return in_order(
            ModalModel(
                poles, psi, psi / a[:, None], outputs=self.dofs, inputs=self.dofs, lower=lower,
                frequency_std=self.frequency_std, damping_std=self.damping_std,
            )
        )  # fmt: skip


def real_modes(
    M: Float[np.ndarray, "n n"], K: Float[np.ndarray, "n n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n n"], Bool[np.ndarray, " n"]]:
    r"""Undamped modes: eigenvalues [1/s^2], mass-normalised shapes by column, and which are free-body modes.

    Those are the modes whose eigenvalue is rounding: within :math:`10^{-13} n\sum_{ij}|\phi_iK_{ij}\phi_j|` of zero.
    """
    square, phi = scipy.linalg.eigh(K, M)
    size = np.einsum("ir,ij,jr->r", np.abs(phi), np.abs(K), np.abs(phi), optimize=True)
    free = np.abs(square) <= ROUNDING * len(M) * size
    return np.where(free, 0.0, square), phi, free


def _check_free(M: np.ndarray, C: np.ndarray, free: np.ndarray) -> None:
    """Refuse damping of free-body motions, whose products of shapes are given, against the ground."""
    if np.abs(C @ free @ M).max(initial=0.0) > 1e-9 * np.abs(C).max(initial=0.0):
        raise ValueError("a free-body mode is damped against the ground; it has no pole pair and no residual term")
