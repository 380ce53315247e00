"""Roving-hammer tests: signs of the hits, places of the sensors and copied records, found from the data alone."""

from itertools import product

import numpy as np
from jaxtyping import Complex, Float

STARTS = 8  # eigenvectors whose signs the search starts from


def hit_signs(
    H: Complex[np.ndarray, "f o i"], shapes: Float[np.ndarray, "n i"]
) -> tuple[Float[np.ndarray, " i"], float, Float[np.ndarray, " i"]]:
    r"""Signs of the hit directions that make the FRFs agree with mode shapes of a model.

    A hit in the negative direction turns the sign of its whole FRF. Every line of a sound test is a sum of the
    structure's modes, so with the right signs :math:`s_i = \pm 1` the rows :math:`H_{foi}s_i` lie in the span of the
    shapes. With :math:`P` the projector off that span, the part that does not is

    .. math:: J(s) = s^T W s, \qquad W_{ij} = P_{ij}\,\mathrm{Re}\sum_{f,o} H_{foi}H_{foj}^* ,

    which is made smallest over all signs: from the signs of the eigenvectors of the smallest eigenvalues of the
    scaled :math:`W`, then by single flips while they help. The shapes need no frequencies and no scale, only to hold
    the modes that respond in the band.

    Parameters
    ----------
    H
        FRFs of a band, shape ``(f, o, i)``.
    shapes
        Real shapes of the modes of that band at the hit points along the hit axes, shape ``(n, i)``, ``n < i``.

    Returns
    -------
    tuple
        The signs, shape ``(i,)``, most of them +1 (one sign common to all hits has no effect on J and stays open);
        the fraction of the energy of H outside the span of the shapes; and for each hit the correlation of its FRFs
        with what the shapes make of those of all other hits: near 1 its sign is sure, near 0 it is undecided.

    Raises
    ------
    ValueError
        If the numbers of hits differ, or there are not fewer shapes than hits.
    """
    n, hits = shapes.shape
    if H.shape[2] != hits or n >= hits:
        raise ValueError(
            f"{n} shapes at {hits} points for {H.shape[2]} hits; needed are one point for each hit and fewer shapes "
            "than hits"
        )
    rows = H.reshape(-1, hits)
    basis, _ = np.linalg.qr(shapes.T)
    gram = np.real(rows.T @ rows.conj())
    W = (np.eye(hits) - basis @ basis.T) * gram
    size = np.sqrt(np.maximum(np.diag(W), np.finfo(float).tiny))
    _, vectors = np.linalg.eigh(W / np.outer(size, size))
    starts = [np.where(v < 0, -1.0, 1.0) for v in vectors.T[:STARTS]]
    signs = min((_flip_while_it_helps(W, s) for s in [*starts, np.ones(hits)]), key=lambda s: float(s @ W @ s))
    signs = signs if signs.sum() >= 0 else -signs
    return signs, float(signs @ W @ signs) / float(np.trace(gram)), _agreement(W, gram, basis, signs)


def _agreement(W: np.ndarray, gram: np.ndarray, basis: np.ndarray, signs: np.ndarray) -> np.ndarray:
    """Correlation of each hit with its prediction from the others, as a row of the projector has it."""
    P = np.eye(len(signs)) - basis @ basis.T
    away = P - np.diag(np.diag(P))
    signed = gram * np.outer(signs, signs)
    predicted = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", away, signed, away), np.finfo(float).tiny))
    return (np.diag(W) - signs * (W @ signs)) / (predicted * np.sqrt(np.diag(gram)))


def _gain_of_flips(W: np.ndarray, signs: np.ndarray) -> np.ndarray:
    """Change of J when each sign alone is turned."""
    return 4 * (np.diag(W) - signs * (W @ signs))


def _flip_while_it_helps(W: np.ndarray, signs: np.ndarray) -> np.ndarray:
    signs = signs.copy()
    while True:
        gain = _gain_of_flips(W, signs)
        best = int(np.argmin(gain))
        if gain[best] >= -1e-12 * np.trace(W):
            return signs
        signs[best] *= -1


def reciprocal_places(
    H: Complex[np.ndarray, "f o i"],
) -> tuple[tuple[int, ...], Float[np.ndarray, " o"], Float[np.ndarray, "o o"]]:
    r"""Where the sensors sit among the hit points, and in which direction they count, by reciprocity.

    If sensor ``o`` sits at hit point :math:`p_o` and counts along the hits (:math:`\sigma_o = 1`) or against them
    (-1), its response to a hit at the place of sensor ``q`` is that of sensor ``q`` to a hit at its own place. Points
    and signs are those that make the mismatch of all pairs of sensors

    .. math:: E_{oq} = \frac{\sum_f w_f|\sigma_o H_{o,p_q} - \sigma_q H_{q,p_o}|^2}
              {\sum_f w_f(|H_{o,p_q}|^2 + |H_{q,p_o}|^2)}

    smallest in sum, with :math:`w_f` the inverse energy of the line, so that no resonance decides alone. The sign
    that all sensors have in common follows from passivity: at its own place a sensor that counts along the hits has
    :math:`\mathrm{Im}\,H \ge 0` in accelerance; the sum over the lines decides.

    Parameters
    ----------
    H
        Accelerances of a band, every hit in the positive direction of its axis (:func:`hit_signs`), shape
        ``(f, o, i)``, of two or three sensors.

    Returns
    -------
    tuple
        The hit point nearest to each sensor, its sign, and the mismatch of each pair, shape ``(o, o)``: 0 is
        perfect, 1 unrelated, 2 the opposite.

    Raises
    ------
    ValueError
        If there are not two or three sensors: one has no partner, and the search over places grows as hits to the
        power of sensors.
    """
    lines, sensors, hits = H.shape
    if sensors not in (2, 3):
        raise ValueError(f"{sensors} sensors; reciprocity is searched for 2 or 3, pick some of them")
    weighted = H / np.linalg.norm(H.reshape(lines, -1), axis=1)[:, None, None]
    pairs = [(o, q) for o in range(sensors) for q in range(o + 1, sensors)]
    likeness = {(o, q): _likeness(weighted[:, o], weighted[:, q]) for o, q in pairs}
    best, least = ((0,) * sensors, (1.0,) * sensors), np.inf
    for signs in ((1.0, *rest) for rest in product((1.0, -1.0), repeat=sensors - 1)):
        total = sum(
            (_over_axes(1 - signs[o] * signs[q] * likeness[o, q], o, q, sensors) for o, q in pairs),
            start=np.zeros((hits,) * sensors),
        )
        if total.min() < least:
            least = float(total.min())
            best = tuple(int(k) for k in np.unravel_index(np.argmin(total), total.shape)), signs
    places, signs = best
    loss = np.imag(H)[:, range(sensors), places]
    common = np.sign(np.sum(np.array(signs) * loss.sum(axis=0) / np.abs(loss).sum(axis=0)))
    table = np.zeros((sensors, sensors))
    for o, q in pairs:
        table[o, q] = table[q, o] = 1 - signs[o] * signs[q] * likeness[o, q][places[o], places[q]]
    return places, common * np.array(signs), table


def _likeness(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Real correlation of the FRFs crosswise, ``[place of the first sensor, place of the second]``, from -1 to 1."""
    cross = np.real(second.conj().T @ first)
    own, other = np.sum(np.abs(second) ** 2, axis=0), np.sum(np.abs(first) ** 2, axis=0)
    return 2 * cross / (own[:, None] + other[None])


def _over_axes(table: np.ndarray, o: int, q: int, sensors: int) -> np.ndarray:
    """A table of two sensors' places, shaped to be added over the places of all."""
    return np.expand_dims(table, tuple(k for k in range(sensors) if k not in (o, q)))


def copied_hits(records: Float[np.ndarray, "i channel t"]) -> list[tuple[int, int]]:
    """Pairs of hits whose time records are the same to the last digit: the second is a copy, not a measurement.

    Parameters
    ----------
    records
        Time records, shape ``(hit, channel, sample)``.
    """
    first: dict[bytes, int] = {}
    pairs = []
    for k, record in enumerate(np.ascontiguousarray(records)):
        earlier = first.setdefault(record.tobytes(), k)
        if earlier != k:
            pairs.append((earlier, k))
    return pairs
