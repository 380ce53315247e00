"""Stabilization diagrams of the whole band and of parts of it, and the stable modes in them."""

import jax
import numpy as np
import scipy.special
from jaxtyping import Complex, Float

from modalax._numerics.checks import as_array
from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify.fdpi import fdpi
from modalax.identify.kernels import kernels, residual_terms
from modalax.identify.lsce import lsce
from modalax.identify.lscf import lscf
from modalax.identify.neighbourhood import line_noise
from modalax.identify.plscf import plscf
from modalax.identify.projection import orthonormal, stacked
from modalax.identify.select import Selection, select
from modalax.identify.tables import PoleTable

ESTIMATORS = {"lscf": lscf, "plscf": plscf, "lsce": lsce, "fdpi": fdpi}
POLES = 40  # poles of the highest order of a first diagram; doubled while its modes do not explain the FRFs
FULL, FEW = 5, 16  # poles for each mode found, below which there is no room for more, and orders that do not tell that
SMALL = 2**15  # samples up to which a further diagram costs next to nothing
LEFT = 1.2  # what modes leave over what noise would, above which further ones are looked for
CHANNELS, AROUND = 250, 30  # channels, at most about, that are asked for it, and lines on either side that tell noise
# Operations of an orthogonal factorisation from which on moments are asked for, differences from line to line that tell
# noise from FRFs, and noise over the largest sample from which on moments, which see 1e-8 of it, lose no digit in use.
LONG, DIFFERENCES, NOISY = 1e9, 6, 1e-4
LINES, PARTS = 400, 8  # lines for each part of the band that gets a diagram of its own, and most parts
FEWEST = 6  # lines that the lowest order of a diagram, 2, needs
STILL = 0.1  # part of the distance between the poles of an order that a mode moves at most to the next order
LASTING = 0.6  # part of the orders at which a mode must stand that only a higher order or a part of the band shows


def diagram(frf: FRF, name: str, order: int | None) -> tuple[PoleTable, Selection]:
    """The diagram of the whole band, and the modes of it and of overlapping parts of the band.

    One strong resonance, or many modes, can hide a clear one from the polynomials of the whole band; in a part of it
    there is room. Of a mode that stands in both the pole that changes less from order to order is taken. Parts that the
    modes found so far explain are not looked at, nor any where an order is given or the poles of the whole band repeat
    to the last digits.

    Parameters
    ----------
    frf
        The FRFs.
    name
        Which estimator, a key of ``ESTIMATORS``.
    order
        Highest model order; chosen by the number of modes found if None.
    """
    table, selection = _whole(frf, name, order)
    lines = len(frf.freq)
    parts = min(lines // LINES, PARTS)
    if order is not None or parts < 2 or selection.sharp:
        return table, selection
    size = 2 * lines // (parts + 1)
    starts = np.linspace(0, lines - size, parts).astype(int)
    for k, start in enumerate(starts):
        part = frf.lines(slice(int(start), int(start) + size))
        if explained(part, np.asarray(selection.poles)):
            continue
        found = _whole(part, name, None)[1]
        # Of the overlap with its neighbours a part answers for the nearer half, up to the ends of the band.
        quarter = size // 4
        lower = float(part.freq[0 if k == 0 else quarter])
        upper = float(part.freq[-1 if k == len(starts) - 1 else size - quarter])
        selection = _merged(selection, found, lower, upper)
    return table, selection


def _merged(whole: Selection, part: Selection, lower: float, upper: float) -> Selection:
    """The modes of one diagram with those between two frequencies [Hz] that another tells better or alone."""
    poles, shares = np.array(whole.poles), None if whole.participation is None else np.array(whole.participation)
    fields = {name: np.array(getattr(whole, name)) for name in ("score", "spread", "order")}
    others, parts = np.asarray(part.poles), None if part.participation is None else np.asarray(part.participation)
    own = {name: np.asarray(getattr(part, name)) for name in fields}
    for k, pole in enumerate(others):
        if not lower <= abs(pole) / (2 * np.pi) <= upper or own["score"][k] < LASTING:
            continue
        apart = np.abs(poles - pole) / np.maximum(np.abs(poles.real), abs(pole.real)) if len(poles) else np.array([9.0])
        near = int(np.argmin(apart))
        if apart[near] > 1:
            poles = np.append(poles, pole)
            fields = {name: np.append(a, own[name][k]) for name, a in fields.items()}
            shares = None if shares is None or parts is None else np.concatenate([shares, parts[k : k + 1]])
        elif own["spread"][k] < fields["spread"][near]:
            poles[near], fields["spread"][near], fields["order"][near] = pole, own["spread"][k], own["order"][k]
            if shares is not None and parts is not None:
                shares[near] = parts[k]
    rank = np.argsort(np.abs(poles))
    return Selection(
        as_array(poles[rank]), None if shares is None else as_array(shares[rank]),
        as_array(fields["score"][rank]), as_array(fields["spread"][rank]), as_array(fields["order"][rank]),
    )  # fmt: skip


def _whole(frf: FRF, name: str, order: int | None) -> tuple[PoleTable, Selection]:
    """Diagrams of rising highest order, until the modes leave noise only or twice the order shows none further.

    Nor is twice the order looked at where the modes are far from filling a diagram of ``FEW`` orders or more; with many
    references the first has few. Of a ``SMALL`` set it is looked at again as long as it shows further ones. The first
    diagram's modes stay. A higher order has more poles that are none, and so little room between them that one
    continues another by chance; of its modes those count that stand still in it.
    """
    table, found = _at(frf, name, POLES, order)
    poles = 2 * POLES
    while order is None and poles <= 4 * POLES:
        room = FULL * found.poles.size <= poles / 2 and len(table.orders) >= FEW
        room = room and (poles == 2 * POLES or frf.H.size > SMALL)
        if room or explained(frf, np.asarray(found.poles)):
            break
        further, seen = _at(frf, name, poles, None)
        if further.orders[-1] == table.orders[-1]:
            break
        more = _merged(found, standing(frf, further, seen), 0.0, np.inf)
        if more.poles.size <= found.poles.size:
            break
        table, found, poles = further, more, 2 * poles
    return table, found


def explained(frf: FRF, poles: Complex[np.ndarray, " n"]) -> bool:
    """Whether modes of about these poles, with residues of each channel's own, leave noise only.

    What modes, changes of their poles and residual terms leave is compared with ``LEFT`` times the noise around each
    line, read off the changes from line to line: the mean over the channels, of large sets over some spread evenly. The
    noise may depend on frequency; a second fit weighs the lines by what the first one tells of it.
    """
    s, power, lines = float(frf.added_decay) + 1j * np.asarray(frf.omega), DERIVATIVES[frf.form], len(frf.freq)
    width = s[-1].imag - s[0].imag
    near = poles[(poles.imag > s[0].imag - width) & (poles.imag < s[-1].imag + width)]
    columns = stacked(np.concatenate([kernels(s, power, near), residual_terms(s, power, "complex")], axis=1).T).T
    free = 1 - columns.shape[1] / (2 * lines)
    if free < 0.5:
        return False
    data = np.asarray(frf.H).reshape(lines, -1)
    data = stacked(data[:, :: 1 + data.shape[1] // CHANNELS].T).T
    course, parts = np.ones(lines), np.zeros(0)
    for _ in range(2):
        weight = np.tile(1 / np.sqrt(course), 2)[:, None]
        A = weight * columns
        Q, _ = orthonormal(A / np.linalg.norm(A, axis=0))
        left = weight * data
        left = left - Q @ (Q.T @ left)
        left = left[:lines] + 1j * left[lines:]
        noise = line_noise(left)
        # The powers of complex noise are exponentially distributed: their median is ln 2 of their mean.
        size = np.maximum(np.median(noise, axis=0) / np.log(2), 1e-300)
        level = _around(np.mean(noise / size, axis=1))
        parts = np.abs(left) ** 2 / (size * level[:, None])
        course = course * level
    return float(np.mean(parts)) <= LEFT * free


def _around(values: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
    """Medians over ``AROUND`` lines on either side, fewer towards the ends, relative to the middle one of them."""
    last, reach = len(values) - 1, min(AROUND, (len(values) - 1) // 2)
    windows = np.lib.stride_tricks.sliding_window_view(values, 2 * reach + 1)
    ends = [(np.median(values[: 2 * k + 1]), np.median(values[last - 2 * k :])) for k in range(reach)]
    level = np.array([*(low for low, _ in ends), *np.median(windows, axis=1), *(high for _, high in ends[::-1])])
    return np.maximum(level / max(float(np.median(level)), 1e-300), 1e-12)


def standing(frf: FRF, table: PoleTable, selection: Selection) -> Selection:
    """The modes that move less than ``STILL`` of the distance between poles from one order to the next.

    Poles that no mode holds spread evenly over the band at each order. The nearest of the next order is then up to half
    a distance away, a quarter in the median, however dense they are.
    """
    lower, upper = frf.ends
    f = np.asarray(table.poles).imag / (2 * np.pi)
    count = dict(zip(table.orders, np.sum(np.asarray(table.valid) & (f >= lower) & (f <= upper), axis=1), strict=True))
    moved = np.asarray(selection.spread) * np.abs(np.asarray(selection.poles)) / (2 * np.pi)
    distance = np.array([(upper - lower) / max(count[int(n)], 1) for n in np.asarray(selection.order)])
    still = np.flatnonzero(moved < STILL * distance)
    return jax.tree.map(lambda a: as_array(np.asarray(a)[still]), selection)


def _noisy(frf: FRF, size: int, order: int) -> bool:
    """Whether a large set holds so much noise that squaring its condition number loses no digit in use."""
    lines, n_out, n_in = frf.shape
    if 8.0 * n_out * n_in * size * lines * (order + 1) ** 2 < LONG or lines <= DIFFERENCES:
        return False
    data = np.asarray(frf.H).reshape(lines, -1)
    data = data[:, :: 1 + data.shape[1] // CHANNELS]
    # Independent noise is multiplied by the sum of squared binomial coefficients, what is smooth next to vanishes.
    noise = np.median(np.abs(np.diff(data, DIFFERENCES, axis=0))) / np.sqrt(
        scipy.special.binom(2 * DIFFERENCES, DIFFERENCES)
    )
    return bool(noise > NOISY * np.max(np.abs(data)))


def _at(frf: FRF, name: str, poles: int, order: int | None) -> tuple[PoleTable, Selection]:
    """The diagram up to so many poles, or up to an order."""
    lines, n_out, n_in = frf.shape
    size = n_in if name in ("plscf", "lsce") else 1
    lower, upper = frf.ends
    if order is None and name != "fdpi" and lines < FEWEST:
        raise ValueError(f"the band {lower:g} to {upper:g} Hz holds {lines} lines; a fit needs at least {FEWEST}")
    margin = 0.05 * (upper - lower)
    top = max(2, min(poles // size, lines // 4 - 1))
    if name == "fdpi":
        top = max(2, min(poles // 2, lines * n_in // (4 * min(n_out, poles))))
    top = top if order is None else order
    first = 1 if name == "fdpi" else min(2, top)
    orders = sorted({*range(first, top + 1, max(1, top // 40)), top})
    by_moments = name in ("lscf", "plscf") and _noisy(frf, size, top)
    table = ESTIMATORS[name](frf, orders, **({"solver": "moments"} if by_moments else {}))
    return table, select(table, band=(max(lower - margin, 0.0), upper + margin))
