r"""A shortlist of places, where there are very many.

A joint of any law acts, line by line, like a spring and a damper, whose sizes follow the level. What free springs and
dampers, apart for each run, would explain at every pair of DoFs costs little: the change :math:`-Z H_b b^TH` of the
receptance is quadratic in the direction b, so that its product with the residual is
:math:`b^T\left(\sum -Z^* (H_i^H)\,S\right)b`, one DoF x DoF matrix for all pairs at once, and so are the products with
the nuisances. Its length needs :math:`\sum_o w^2|H_o b|^2` at every line; that is taken at the lines that matter most
and over random sums of the outputs, which keeps lengths and angles (Johnson and Lindenstrauss 1984). The length only
decides which places are looked at; what is said of these is exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modalax.diagnose.causes.scene import Place
from modalax.diagnose.fitting.residual import complex_of
from modalax.diagnose.screening.products import Reduced, ends

MANY = 450  # places beyond which only a shortlist is screened
KEPT = 100  # places on the shortlist
LINES, SUMS = 96, 32  # lines and random sums of outputs from which lengths are taken


@dataclass(frozen=True)
class Sketch:
    """Some lines and random sums of the outputs: receptances ``(run, line, i, sum, dof)``, and the nuisances there.

    ``back`` has the shape ``(k, run, line, dof, i)``; each line stands for ``count`` lines.
    """

    lines: np.ndarray
    count: np.ndarray
    H: np.ndarray
    back: np.ndarray
    inner: np.ndarray


def shortlist(reduced: Reduced, few: Sketch, places: Sequence[Place], skew: bool = False) -> np.ndarray:
    """Numbers of the places at which a spring and a damper in each run would explain most.

    Parameters
    ----------
    few
        Of the same residual.
    skew
        Whether the places are those of a skew coupling between two DoFs instead.
    """
    if len(places) <= MANY:
        return np.arange(len(places))
    return np.sort(np.argsort(-gains_at(reduced, few, *ends(places), skew))[:KEPT])


def likely_swaps(data: np.ndarray, weight: np.ndarray, residual: np.ndarray, places: Sequence[Place]) -> np.ndarray:
    """Numbers of the pairs of outputs whose exchange would bring the data nearest to what was expected.

    Parameters
    ----------
    data, weight, residual
        Measured receptances, their weights and what is left times the weights, complex, shape ``(run, f, o, i)``.
    """
    if len(places) <= MANY:
        return np.arange(len(places))
    a, b = ends(places)
    rows = lambda x: x.transpose(2, 0, 1, 3).reshape(x.shape[2], -1)
    w2 = rows(weight**2)
    expected = rows(data - residual / np.where(weight > 0, weight, 1.0))
    crossed = w2 @ np.abs(expected.T) ** 2 - 2 * np.real((w2 * rows(data).conj()) @ expected.T)
    more = crossed - np.diagonal(crossed)[:, None]
    return np.sort(np.argsort(more[a, b] + more[b, a])[:KEPT])


def gains_at(reduced: Reduced, few: Sketch, a: np.ndarray, b: np.ndarray, skew: bool = False) -> np.ndarray:
    """Chi-square that free springs and dampers would take away at each place (dampers alone in a skew coupling)."""
    runs, dofs = reduced.weight2.shape[0], np.arange(reduced.shapes.shape[1])
    motion = reduced.motion(dofs, np.full(len(dofs), -1)).transpose(1, 2, 0)  # (f, i, dof)
    products, across = [], []
    powers = (1,) if skew else (0, 1)
    counts = np.stack([few.count * reduced.omega[few.lines] ** (2 * power) for power in powers])
    square = [_length(few.H[run], counts, motion[few.lines], a, b, skew) for run in range(runs)]
    for power in powers:
        pushed = (-((1j * reduced.omega) ** power)[:, None, None] * motion).conj()
        for run in range(runs):
            seen = few.count[:, None, None] * pushed[few.lines]
            products.append(_form(pushed, reduced.S[run], a, b, skew))
            across.append([_form(seen, back, a, b, skew) for back in few.back[:, run]])
    lengths = np.stack(square, axis=1).reshape(len(products), -1)  # by power, then by run
    p, d = np.stack(products, axis=-1), np.maximum(lengths.T, 1e-300)
    gram = d[..., None] * np.eye(p.shape[1])
    if len(few.inner):
        T = np.moveaxis(np.array(across), -1, 0)  # (place, q, k)
        gram = gram - np.einsum("pqk,kl,prl->pqr", T, few.inner, T, optimize=True)
    gram = gram / np.sqrt(d)[:, :, None] / np.sqrt(d)[:, None, :] + 1e-9 * np.eye(p.shape[1])
    p = p / np.sqrt(d)
    return np.einsum("pq,pq->p", p, np.linalg.solve(gram, p[..., None])[..., 0])


def _form(pushed: np.ndarray, back: np.ndarray, a: np.ndarray, b: np.ndarray, skew: bool) -> np.ndarray:
    """The quadratic form of motions ``(f, i, dof)`` and of what comes back from the outputs, ``(f, dof, i)``."""
    n = pushed.shape[-1]
    form = np.real(pushed.reshape(-1, n).T @ back.transpose(0, 2, 1).reshape(-1, n))
    return _at(form, a, b, skew)


def _at(form: np.ndarray, a: np.ndarray, b: np.ndarray, skew: bool) -> np.ndarray:
    """A quadratic form at the directions of places."""
    second = np.maximum(b, 0)
    if skew:
        return form[second, a] - form[a, second]
    mixed = form[second, second] - form[a, second] - form[second, a]
    return form[a, a] + np.where(b >= 0, mixed, 0.0)


def sketch(reduced: Reduced, nuisance: np.ndarray) -> Sketch:
    """Take some lines and sums; ``nuisance`` are whitened directions that do not count, ``(k, o, i, run f 2)``."""
    rng = np.random.default_rng(0)
    n_out, runs = len(reduced.outputs), reduced.weight2.shape[0]
    lines, count = _lines_that_matter(reduced)
    signs = rng.choice([-1.0, 1.0], (SUMS, n_out)) / np.sqrt(SUMS) if n_out > SUMS else np.eye(n_out)
    weight = np.sqrt(reduced.weight2[:, lines])
    sums = signs * np.moveaxis(weight, (1, 0, 3), (0, 1, 2))[:, :, :, None]  # (line, run, i, sum, o)
    H = np.stack([reduced.summed(int(k), s.reshape(-1, n_out)) for k, s in zip(lines, sums, strict=True)])
    H = np.moveaxis(H.reshape(*sums.shape[:-1], -1), 1, 0)
    G = complex_of(nuisance, runs)[:, :, lines] if len(nuisance) else np.zeros((0, *weight.shape), complex)
    G = np.einsum("so,krfoi->krfis", signs, G, optimize=True)
    back = np.einsum("rfisd,krfis->krfdi", H.conj(), G, optimize=True)
    flat = (np.sqrt(count)[None, None, :, None, None] * G).reshape(len(G), -1)
    inner = np.linalg.inv(np.eye(len(G)) + np.real(flat.conj() @ flat.T))
    return Sketch(lines, count, H, back, inner)


def _length(
    H: np.ndarray, counts: np.ndarray, motion: np.ndarray, a: np.ndarray, b: np.ndarray, skew: bool
) -> np.ndarray:
    """Squared lengths of the changes of one run, whose receptances are ``H``, shape ``(line, i, sum, dof)``.

    One row for each row of ``counts``: what a line counts for a spring, and for a damper.
    """
    other, total = np.maximum(b, 0), np.zeros((len(counts), len(a)))
    for line in range(len(H)):
        value = np.zeros(len(a))
        for i in range(H.shape[1]):
            cross = H[line, i].conj().T @ H[line, i]
            own, m = np.real(np.diagonal(cross)), motion[line, i]
            if skew:
                value += own[a] * np.abs(m[other]) ** 2 + own[other] * np.abs(m[a]) ** 2
                value -= 2 * np.real(m[other].conj() * m[a] * cross[a, other])
            else:
                pair = own[a] + np.where(b >= 0, own[other] - 2 * np.real(cross[a, other]), 0.0)
                value += np.abs(m[a] - np.where(b >= 0, m[other], 0.0)) ** 2 * pair
        for row, count in zip(total, counts[:, line], strict=True):
            row += count * value
    return total


def _lines_that_matter(reduced: Reduced) -> tuple[np.ndarray, np.ndarray]:
    """Some lines, more of them where changes are large, and how many each stands for."""
    number = len(reduced.omega)
    if number <= LINES:
        return np.arange(number), np.ones(number)
    weight2 = reduced.weight2.sum(axis=(0, 2, 3))
    size = weight2 * (np.abs(reduced.gains) ** 2).sum(axis=1) ** 2
    chance = 0.7 * size / max(size.sum(), 1e-300) + 0.3 * (weight2 > 0) / max((weight2 > 0).sum(), 1)
    chance = chance / chance.sum()
    taken = np.searchsorted(np.cumsum(chance), (np.arange(LINES) + 0.5) / LINES).clip(0, number - 1)
    lines, hits = np.unique(taken, return_counts=True)
    return lines, hits / (LINES * chance[lines])
