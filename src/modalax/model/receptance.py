r"""Receptance of any structure along directions, and what a local linear change does to it.

A change of impedance :math:`Z(\omega)` between the directions :math:`b` turns the receptance :math:`H` into

.. math:: H' = H - H b\,(1 + Z\,b^T H b)^{-1} Z\,b^T H,

safe at :math:`Z = 0`, where its derivative is :math:`-H b\,Z' b^T H`. It needs the receptance at a few DoFs only, so it
works on matrices and on modal models alike.
"""

import abc
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float
from typing_extensions import override

from modalax._numerics.checks import as_array, as_double, is_traced
from modalax._numerics.cuts import cut
from modalax._numerics.known import Numbers, by_numpy, host, joined
from modalax.data.dofs import as_names
from modalax.data.frf import FRF, derivative
from modalax.model.modal import ModalModel
from modalax.model.overview import of_modified
from modalax.model.structure import Structure


def dof_names(structure: "AnyStructure") -> tuple[str, ...]:
    """Names of the DoFs over which directions are given: outputs, then inputs that are no outputs, of a modal model."""
    if isinstance(structure, ModalModel):
        return structure.outputs + tuple(n for n in structure.inputs if n not in structure.outputs)
    if isinstance(structure, Modified):
        return dof_names(structure.base)
    return structure.dofs


def directions(structure: "AnyStructure", places: Sequence[Sequence[str]]) -> Float[Array, "j n"]:
    """Directions of places: ``[a, b]`` is +1 at a and -1 at b (relative displacement), ``[a]`` is a to the ground.

    Raises
    ------
    ValueError
        If a place has no DoF, more than two, the same one twice, or an unknown one.
    """
    names = dof_names(structure)
    b = np.zeros((len(places), len(names)))
    for row, place in zip(b, places, strict=True):
        if isinstance(place, str) or len(place) not in (1, 2) or len(set(place)) != len(place):
            raise ValueError(
                f"place {place!r} must be [dof, dof], two different ones, or [dof] for a joint to the ground"
            )
        for name, sign in zip(place, (1.0, -1.0), strict=False):
            if name not in names:
                raise ValueError(f"no DoF named {name!r}; the structure has {', '.join(names)}")
            row[names.index(name)] = sign
    return as_array(b)


def seen_at(model: ModalModel, dofs: Sequence[str]) -> ModalModel:
    """The modal model with these DoFs as outputs and inputs alike; pairs that were not measured by reciprocity.

    Raises
    ------
    ValueError
        If a DoF is unknown, or there is no drive point that scales one which was only measured or only driven.
    """
    names = tuple(dofs)
    unknown = [n for n in names if n not in dof_names(model)]
    if unknown:
        raise ValueError(f"no DoF named {', '.join(unknown)}; the model has {', '.join(dof_names(model))}")
    return model.replace(
        shapes=model.shapes_at(names), participation=model.participation_at(names), outputs=names, inputs=names,
        upper=model._residual(model.upper, names, names), lower=model._residual(model.lower, names, names),
    )  # fmt: skip


def receptance(structure: "AnyStructure", omega: Any, rows: Any, columns: Any) -> Complex[Array, "f l r"]:
    r"""Receptance :math:`L\,H(\omega)\,R` [m/N] of a structure of any kind along directions.

    Parameters
    ----------
    omega
        Circular frequencies, shape ``(f,)`` [rad/s].
    rows, columns
        Directions over :func:`dof_names`, shapes ``(l, n)`` and ``(n, r)``.

    Raises
    ------
    ValueError
        If a modal model lacks the drive point that scales a DoF which was only measured or only driven.
    """
    if isinstance(structure, ModalModel):
        return _of_modal_model(structure, as_double(omega, "omega"), as_array(rows), as_array(columns))
    return structure.along(omega, rows, columns)


def _of_modal_model(
    model: ModalModel, omega: Float[Array, " f"], rows: Float[Array, "l n"], columns: Float[Array, "n r"]
) -> Complex[Array, "f l r"]:
    names = dof_names(model)
    used = tuple(n for n, needed in zip(names, _used(rows, 0), strict=True) if needed)
    driven = tuple(n for n, needed in zip(names, _used(columns, 1), strict=True) if needed)
    left = cut(rows, (slice(None), np.array([names.index(n) for n in used], int)))
    right = cut(columns, np.array([names.index(n) for n in driven], int))
    terms = (model._residual(term, used, driven) for term in (model.upper, model.lower))
    return _along(omega, model.poles, model.shapes_at(used), model.participation_at(driven), *terms, left, right)


@by_numpy
def _along(
    xp: ModuleType,
    omega: Any,
    poles: Any,
    shapes: Any,
    participation: Any,
    upper: Any,
    lower: Any,
    left: Any,
    right: Any,
) -> Complex[Numbers, "f l r"]:
    """Receptance of modes and residual terms along directions at the DoFs that these use."""
    psi, part = shapes @ left.T, participation @ right
    s = 1j * omega
    residues = (psi[:, :, None] * part[:, None, :]).reshape(len(poles), -1)
    # rows and columns are real, so conjugating the products conjugates the modes
    H = 1 / (s[:, None] - poles) @ residues + 1 / (s[:, None] - poles.conj()) @ residues.conj()
    upper, lower = left @ upper @ right, left @ lower @ right
    still = (s == 0)[:, None, None]
    at_rest = xp.where(lower == 0, 0.0, np.inf)
    H = H.reshape(len(omega), *upper.shape) + upper
    return H + xp.where(still, at_rest, lower / xp.where(still, 1.0, s[:, None, None] ** 2))


def _used(weights: Any, axis: int) -> list[bool]:
    """Which DoFs have any weight; all of them where the weights are traced."""
    if is_traced(weights):
        return [True] * weights.shape[1 - axis]
    return [bool(u) for u in np.any(np.asarray(weights) != 0, axis=axis)]


@by_numpy
def _modified(xp: ModuleType, H_oi: Any, H_ob: Any, H_bb: Any, H_bi: Any, Z: Any) -> Complex[Numbers, "f o i"]:
    r"""Receptance after changes of impedance Z [N/m], :math:`H_{oi} - H_{ob}(1 + Z H_{bb})^{-1} Z H_{bi}` [m/N]."""
    inner = np.eye(Z.shape[-1]) + Z @ H_bb
    return H_oi - H_ob @ xp.linalg.solve(inner, Z @ H_bi)


class Change(eqx.Module):
    """A local linear element on a direction."""

    @abc.abstractmethod
    def impedance(self, omega: Float[Numbers, " f"]) -> Complex[Numbers, " f"]:
        """Force over relative displacement Z [N/m] at circular frequencies [rad/s]."""


class Spring(Change):
    r"""A spring, :math:`Z = k` [N/m]; negative to take stiffness away."""

    k: Any

    @override
    def impedance(self, omega: Float[Numbers, " f"]) -> Complex[Numbers, " f"]:
        return self.k + 0j * omega


class Damper(Change):
    r"""A viscous damper, :math:`Z = j\omega c`, c in [N s/m]."""

    c: Any

    @override
    def impedance(self, omega: Float[Numbers, " f"]) -> Complex[Numbers, " f"]:
        return 1j * omega * self.c


class Mass(Change):
    r"""A lumped mass, :math:`Z = -\omega^2 m`, m in [kg]."""

    m: Any

    @override
    def impedance(self, omega: Float[Numbers, " f"]) -> Complex[Numbers, " f"]:
        return -(omega**2) * self.m + 0j


class TunedMass(Change):
    r"""An attached oscillator, :math:`Z = -\omega^2 m\frac{k + j\omega c}{k + j\omega c - \omega^2 m}`.

    Attributes
    ----------
    m, k, c
        Mass [kg], stiffness [N/m] and damping [N s/m] of the oscillator.
    """

    m: Any
    k: Any
    c: Any = 0.0

    @classmethod
    def at(cls, m: Any, frequency_hz: Any, damping_ratio: Any) -> "TunedMass":
        """An oscillator by its own frequency [Hz] and damping ratio when its base is held."""
        own = 2 * jnp.pi * frequency_hz
        return cls(m, m * own**2, 2 * damping_ratio * own * m)

    @override
    def impedance(self, omega: Float[Numbers, " f"]) -> Complex[Numbers, " f"]:
        link, inertia = self.k + 1j * omega * self.c, -(omega**2) * self.m
        return inertia * link / (link + inertia)


class Modified(eqx.Module):
    """A structure with local linear changes, known by its receptance.

    Attributes
    ----------
    base
        The structure before.
    b
        Direction of each change over the DoFs of ``base``, shape ``(j, n)``.
    changes
        The elements.
    """

    base: "Structure | ModalModel | Modified"
    b: Float[Array, "j n"]
    changes: tuple[Change, ...]

    def __str__(self) -> str:
        """The structure before, and what was put onto it where."""
        return of_modified(self, dof_names(self.base))

    def along(self, omega: Any, rows: Any, columns: Any) -> Complex[Array, "f l r"]:
        """Receptance [m/N] between directions, as :func:`receptance`."""
        omega, rows, columns = as_double(omega, "omega"), as_array(rows), as_array(columns)
        o, i = rows.shape[0], columns.shape[1]
        rows, columns = joined([rows, self.b]), joined([columns.T, self.b]).T
        H = host(receptance(self.base, omega, rows, columns))
        Z = _diagonals([change.impedance(host(omega)) for change in self.changes])
        return _modified(H[:, :o, :i], H[:, :o, i:], H[:, o:, i:], H[:, o:, :i], Z)

    def frf(
        self,
        freq: Any,
        *,
        form: str = "receptance",
        outputs: Sequence[str] | None = None,
        inputs: Sequence[str] | None = None,
    ) -> FRF:
        """The FRF at frequencies [Hz] between DoFs by name (all of them by default)."""
        return frf(self, freq, form=form, outputs=outputs, inputs=inputs)


@by_numpy
def _diagonals(xp: ModuleType, each: Any) -> Complex[Numbers, "f j j"]:
    """Matrices with one value each on their diagonals."""
    return xp.stack(each, axis=-1)[:, :, None] * np.eye(len(each))


AnyStructure = Structure | ModalModel | Modified


def change(structure: AnyStructure, place: Sequence[str], element: Change) -> Modified:
    """The structure with ``element`` at ``place``: ``[dof, dof]``, or ``[dof]`` to the ground (for a mass: the DoF)."""
    return Modified(structure, directions(structure, [place]), (element,))


def frf(
    structure: AnyStructure,
    freq: Any,
    *,
    form: str = "receptance",
    outputs: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
) -> FRF:
    """The FRF of a structure of any kind at frequencies [Hz] between DoFs by name (all of them by default)."""
    freq, names = as_double(freq, "freq"), dof_names(structure)
    outputs = names if outputs is None else as_names(outputs)
    inputs = names if inputs is None else as_names(inputs)
    rows, columns = directions(structure, [[n] for n in outputs]), directions(structure, [[n] for n in inputs]).T
    H = derivative(receptance(structure, 2 * np.pi * host(freq), rows, columns), freq, form)
    return FRF(freq, H, form=form, outputs=outputs, inputs=inputs)
