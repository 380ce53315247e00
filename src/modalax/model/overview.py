"""What a structure, a modal model or modes beside others hold, as text for ``print``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from modalax._numerics.checks import is_traced
from modalax._numerics.text import text_table
from modalax.data.overview import channels_text, counted, shortened

if TYPE_CHECKING:
    from modalax.model.correlation import Correlation
    from modalax.model.matching import Matched
    from modalax.model.modal import ModalModel
    from modalax.model.receptance import Modified
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
        *channels_text(model.outputs, model.inputs),
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


def of_modified(structure: "Modified", names: Sequence[str]) -> str:
    """The structure before, and what was put onto it where."""
    if is_traced(*jax.tree_util.tree_leaves(structure)) or structure.b.ndim != 2:
        return repr(structure)
    said = [str(structure.base)]
    for row, element in zip(np.asarray(structure.b), structure.changes, strict=True):
        at = " - ".join(names[int(k)] for k in np.argsort(-row, kind="stable") if row[k])
        sizes = ", ".join(f"{name} = {_size(value)}" for name, value in vars(element).items())
        said.append(f"  with {type(element).__name__}({sizes}) at {at}")
    return "\n".join(said)


def _size(value: Any) -> str:
    return f"{float(np.asarray(value)):.6g}" if np.ndim(value) == 0 else repr(value)


def of_matched(matched: "Matched") -> str:
    """A line a DoF, as its ``report`` has them."""
    lines = matched.report()
    left = [f"  ... and {len(lines) - ROWS} more"] if len(lines) > ROWS else []
    shown = [f"  {line}" for line in lines[:ROWS]]
    return "\n".join([f"{counted(len(lines), 'measured DoF')} matched to nodes of the model", *shown, *left])


def of_correlation(found: "Correlation") -> str:
    """A table of pairs: frequencies, their difference and MAC."""
    header = ["Measured [Hz]", "Mode of the model", "Model [Hz]", "Change [%]", "MAC"]
    rows = [
        [f"{f:.6g}", str(k + 1), f"{g:.6g}", f"{100 * c:+.2f}", f"{m:.3f}"] if k >= 0 else [f"{f:.6g}", *4 * ["-"]]
        for f, k, g, c, m in zip(
            found.frequency_hz, found.pairs, found.model_frequency_hz, found.change, found.pair_mac, strict=True
        )
    ]
    measured, modes = found.mac.shape
    title = f"{counted(int(np.sum(found.pairs >= 0)), 'pair')} of {measured} measured modes and {modes} of the model"
    return "\n".join([title, *([text_table(header, rows)] if rows else [])])
