r"""A stabilization diagram of FRFs too large for memory, read some outputs at a time.

The normal matrix of pLSCF is a sum over the outputs, :math:`\sum_o D_o^H (I - QQ^H) D_o`, so that it is all that has to
be kept: with ``i`` inputs and order ``n`` it has ``i (n + 1)`` rows, whatever the number of outputs.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from modalax._numerics.checks import as_array, require_finite
from modalax._numerics.known import Numbers
from modalax.identify.lscf import ARC, RIDGE
from modalax.identify.moments import factor_of_normal, normal_from_moments, with_spare
from modalax.identify.polynomial import poles_of_factor
from modalax.identify.select import Selection, select
from modalax.identify.tables import PoleTable
from modalax.identify.zoom import check_orders, on_circle, zoom

CHUNK_MB = 64.0  # memory of the FRFs that are read at once; the products of it take about six times as much
MARGIN = 0.05  # part of the band by which a mode may lie outside


def outputs_in_turn(H: Any, run: int = 0, chunk_mb: float = CHUNK_MB) -> Iterable[np.ndarray]:
    """Some outputs after the other of an array that is sliced from a file, such as of Zarr, HDF5 or a memory map.

    Parameters
    ----------
    H
        FRFs, shape ``(run, f, o, i)``.
    run
        Which run.
    chunk_mb
        Memory of the FRFs that are read at once [MB].
    """
    _, lines, outputs, inputs = H.shape
    several = max(1, int(chunk_mb * 1e6 / (16 * lines * inputs)))
    for first in range(0, outputs, several):
        yield np.asarray(H[run, :, first : first + several, :])


def diagram_of_chunks(
    freq: Any, chunks: Iterable[np.ndarray], orders: int | Sequence[int], arc: float = ARC
) -> tuple[PoleTable, Selection]:
    """Poles by pLSCF of FRFs that come some outputs at a time, and the stable ones among them.

    The same as :func:`modalax.identify.plscf` with ``solver="moments"`` gives for all outputs together, and
    :func:`modalax.identify.select`. Shapes follow channel by channel from :func:`modalax.identify.residues`.

    Parameters
    ----------
    freq
        Frequency lines [Hz], shape ``(f,)``.
    chunks
        FRFs of some outputs and all inputs each, shape ``(f, o, i)``, as of :func:`outputs_in_turn`.
    orders
        Degrees of the matrix polynomial; order ``n`` with ``i`` inputs has ``n i`` poles.
    arc
        Part of the unit circle that the band covers.

    Raises
    ------
    ValueError
        If there are no chunks, they do not fit together, values are not finite, or there are too few lines.
    """
    freq = np.asarray(freq, dtype=float)
    found = check_orders(orders, len(freq), (freq[0], freq[-1]))
    omega = 2 * np.pi * freq
    G, energy, inputs = np.zeros(()), np.zeros(()), 0
    for k, H in enumerate(chunks):
        if H.ndim != 3 or len(H) != len(freq) or (inputs and H.shape[2] != inputs):
            raise ValueError(
                f"chunk {k + 1} has shape {H.shape}; it needs (f, o, i) with {len(freq)} lines"
                + (f" and {inputs} inputs" if inputs else "")
            )
        require_finite(H, f"chunk {k + 1}")
        inputs = H.shape[2]
        more, power = _normal(H, omega, found[-1], arc)
        G, energy = G + more, energy + power
    if not inputs:
        raise ValueError("there are no FRFs; at least one chunk of outputs is needed")
    zoomed = zoom(omega, arc, False)
    R, added = factor_of_normal(np, G, energy, found[-1], RIDGE)
    table = poles_of_factor(as_array(R), found, inputs, "a0", False, zoomed, "plscf", as_array(added))
    margin = MARGIN * (freq[-1] - freq[0])
    return table, select(table, band=(max(freq[0] - margin, 0.0), freq[-1] + margin))


def _normal(H: np.ndarray, omega: np.ndarray, order: int, arc: float) -> tuple[Numbers, Numbers | float]:
    zoomed = zoom(omega, arc, False)
    u = on_circle(np, omega, zoomed.centre, zoomed.step)
    return normal_from_moments(np, H, np.ones(len(omega)), u, order, with_spare(order, len(omega)), False)
