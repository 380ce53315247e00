"""Checks that measurements and simulations must pass before anything is concluded from them."""

from typing import Any

import jax
import numpy as np

from modalax._numerics.checks import is_traced
from modalax.data.causality import looks_conjugated
from modalax.data.frf import FRF
from modalax.data.measurement import Measurement
from modalax.model.modal import ModalModel
from modalax.model.structure import Structure

FEWEST_LINES = 8  # about what one resonance peak needs; fewer leave nothing to compare
UNEQUAL = 1e-6  # asymmetry relative to the largest entry that rounding to seven digits explains
NEGATIVE = 1e-9  # size of a negative eigenvalue, relative to the largest one, that rounding explains


def check_measured(measured: FRF | Measurement) -> None:
    """Refuse FRFs that are zero throughout or in the other time convention.

    Raises
    ------
    ValueError
        The message says which, and what to do.
    """
    if not float(np.max(np.abs(np.asarray(measured.H)), initial=0.0)) > 0:
        raise ValueError("the FRFs are zero throughout the band; there is nothing to fit or to compare")
    if looks_conjugated(measured):
        raise ValueError(
            "the FRFs look conjugated (time convention e^-jwt), so that every mode would be unstable; take their "
            "complex conjugate: .replace(H=measured.H.conj())"
        )


def check_frf(data: Any, what: str, several: bool = False) -> None:
    """Refuse what is no FRF, such as an array; with ``several``, a measurement is none of that.

    Raises
    ------
    ValueError
        The message says how to make one.
    """
    if isinstance(data, FRF) or (several and isinstance(data, Measurement)):
        return
    if isinstance(data, Measurement):
        raise ValueError(f"{what} needs an FRF, not a Measurement; .run(0) is the FRF of its first run")
    kind = "array" if hasattr(data, "shape") else type(data).__name__
    raise ValueError(
        f"{what} needs an FRF, not {'an' if kind == 'array' else 'a'} {kind}; modalax.FRF(freq, H) makes one"
    )


def refuse_traced(data: Any, what: str) -> None:
    """Raise ``ValueError`` inside jit, vmap or grad, where a choice that depends on values cannot be made."""
    if is_traced(*jax.tree_util.tree_leaves(data)):
        raise ValueError(
            f"{what} chooses modes by their values, which are not known inside jit, vmap or grad; call it outside, or "
            "trace lscf, plscf, residues and refine"
        )


def check_simulation(simulation: Any, *kinds: type) -> None:
    """Raise ``ValueError`` for what is none of the kinds of simulation that can be compared with a measurement."""
    if not isinstance(simulation, kinds):
        raise ValueError(
            f"a simulation is a {', '.join(kind.__name__ for kind in kinds[:-1])} or {kinds[-1].__name__}, not a "
            f"{type(simulation).__name__}; the measurement comes first, the simulation second"
        )


def check_order(order: Any) -> None:
    """Raise ``ValueError`` for a model order that is no whole number above zero; None leaves the order open."""
    if order is None:
        return
    if isinstance(order, bool) or not isinstance(order, int | float | np.number) or not (order == int(order) >= 1):
        raise ValueError(f"order is {order}; it needs a whole number, at least 1")


def check_comparable(measured: Any, simulation: Any) -> None:
    """Refuse data and simulations from which no difference can be concluded.

    Raises
    ------
    ValueError
        If there are too few lines to tell, the FRFs are zero or conjugated, a variance is zero, or a matrix is not
        symmetric or not that of a passive structure.
    """
    if not isinstance(measured, FRF | Measurement):
        raise ValueError(f"a measurement is a Measurement or an FRF, not a {type(measured).__name__}; see modalax.load")
    lines = len(measured.freq)
    if lines < FEWEST_LINES:
        raise ValueError(
            f"{lines} frequency lines are too few to conclude anything; at least {FEWEST_LINES} are needed"
        )
    check_measured(measured)
    if measured.variance is not None:
        some = np.asarray(measured.variance)[..., int(measured.ends[0] == 0) :, :, :]  # a line at 0 Hz is left out
        exact = int(np.sum(some == 0))
        if exact:
            raise ValueError(
                f"variance is 0 at {exact} of {some.size} samples, but no measurement is exact; leave the "
                "variance out to have the noise estimated"
            )
    if isinstance(simulation, Structure):
        check_passive(simulation)
    elif isinstance(simulation, ModalModel):
        growing = np.flatnonzero(np.asarray(simulation.poles).real > 0)
        if growing.size:
            raise ValueError(
                f"mode {growing[0] + 1} of the simulation has a negative damping ratio, so its vibration would grow"
            )


def check_passive(structure: Structure) -> None:
    r"""Refuse matrices of no passive structure: M, C, D, K symmetric, nothing negative in any direction.

    All may be singular: a rigid-body motion has no stiffness, and a DoF may have no mass.

    Raises
    ------
    ValueError
        Naming the matrix, with the largest difference or the smallest eigenvalue.
    """
    for name in ("M", "C", "D", "K"):
        A = np.asarray(getattr(structure, name))
        size, odd = np.abs(A).max(), np.abs(A - A.T).max()
        if odd > UNEQUAL * size:
            raise ValueError(
                f"{name} is not symmetric (entries differ by up to {odd:.3g} of {size:.3g}); a structure without "
                "gyroscopic or follower forces has symmetric matrices"
            )
        values = np.linalg.eigvalsh((A + A.T) / 2)
        if values[0] < -NEGATIVE * np.abs(values).max() or (name == "M" and not values[-1] > 0):
            raise ValueError(
                f"{name} has the eigenvalue {values[0]:.3g}; it must be positive or zero in every direction"
                f"{', and not zero throughout' if name == 'M' else ''}: is its sign wrong?"
            )
