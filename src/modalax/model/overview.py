"""What a structure or a modal model holds, as text for ``print``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import jax
import numpy as np

from modalax._numerics.checks import is_traced
from modalax._numerics.text import text_table
from modalax.data.overview import counted, shortened

if TYPE_CHECKING:
    from modalax.model.modal import ModalModel
    from modalax.model.structure import Structure

ROWS = 40  # modes that a table shows before it leaves some out


def of_modes(model: "ModalModel") -> str:
    """Channels and a table of modes: frequency, damping ratio and, where a drive point tells it, modal mass."""
    if is_traced(*jax.tree_util.tree_leaves(model)) or model.poles.ndim != 1:
        return repr(model)
    frequency, damping = np.asarray(model.frequency_hz), np.asarray(model.damping_ratio)
    mass = np.asarray(model.modal_mass()) if model.drive_points() else None
    header = ["Mode", "Frequency [Hz]", "Damping [%]", *(["Modal mass [kg]"] if mass is not None else [])]
    rows = [
        [str(r + 1), f"{frequency[r]:.6g}", f"{100 * damping[r] + 0.0:.4g}"]
        + ([] if mass is None else [_mass(complex(mass[r]))])
        for r in range(min(len(frequency), ROWS))
    ]
    left = len(frequency) - len(rows)
    terms = (("above", model.upper), ("below", model.lower))
    residuals = [side for side, term in terms if np.asarray(term).any()]
    said = [
        f"Modal model of {counted(len(frequency), 'mode')}",
        f"  {counted(len(model.outputs), 'output')}: {shortened(model.outputs)}",
        f"  {counted(len(model.inputs), 'input')}: {shortened(model.inputs)}",
        f"  residual terms of modes {' and '.join(residuals)} the band" if residuals else "",
        *_claims(("frequency", model.frequency_std), ("damping ratio", model.damping_std)),
        text_table(header, rows) if rows else "",
        f"... and {counted(left, 'more mode')}" if left else "",
    ]
    return "\n".join(filter(None, said))


def of_structure(structure: "Structure") -> str:
    """Degrees of freedom, damping, and what its author claims and names."""
    if is_traced(*jax.tree_util.tree_leaves(structure)) or structure.M.ndim != 2:
        return repr(structure)
    size = len(structure.dofs)
    matrices = (("viscous", structure.C), ("hysteretic", structure.D))
    damping = [kind for kind, matrix in matrices if np.asarray(matrix).any()]
    claims = (
        ("frequency", structure.frequency_std), ("damping ratio", structure.damping_std),
        ("stiffness", structure.stiffness_std), ("mass", structure.mass_std),
    )  # fmt: skip
    said = [
        f"Structure of {'1 degree' if size == 1 else f'{size} degrees'} of freedom: {shortened(structure.dofs)}",
        f"  {' and '.join(damping)} damping" if damping else "  no damping",
        *_claims(*claims),
    ]
    if structure.elements is not None:
        said.append(f"  made of {counted(len(structure.elements.places), 'element')} of stiffness")
    if structure.groups is not None:
        said.append(
            f"  {counted(len(structure.groups.names), 'group')} of elements: {shortened(structure.groups.names)}"
        )
    if structure.pairs is not None:
        said.append(f"  {counted(len(structure.pairs), 'pair')} named between which springs and joints may sit")
    return "\n".join(said)


def _claims(*claims: tuple[str, object]) -> Sequence[str]:
    """What the author claims: relative standard deviations, the largest of each quantity."""
    sizes = {name: float(np.max(np.asarray(std), initial=0.0)) for name, std in claims if std is not None}
    said = [f"{name} {100 * size:.3g} %" for name, size in sizes.items() if size]
    return [f"  claimed inaccuracy (standard deviation): {', '.join(said)}"] if said else []


def _mass(value: complex) -> str:
    """A modal mass, complex where the shape is; a dash for a mode that does not move its drive point."""
    if not np.isfinite(value):
        return "-"
    return f"{value.real:.4g}" if abs(value.imag) <= 1e-6 * abs(value) else f"{value:.4g}"
