r"""Places and elements ranked by the sizes of a change at which the structure has the measured frequencies.

With a change of rank one :math:`u\,bb^T` of the stiffness, in modal coordinates of circular frequencies
:math:`\omega_k`, the structure has a mode of :math:`\lambda = \omega^2` exactly where
:math:`f(\lambda) = 1 + u\sum_k b_k^2/(\omega_k^2 - \lambda) = 0`, and with one of the mass where
:math:`1 - u\lambda\sum_k b_k^2/(\omega_k^2 - \lambda) = 0` (Golub 1973, section 5). So each measured frequency tells at
once which size of each place it asks for, however far it has moved, and at the right place all ask for one.

How near the structure with a change of some size has a mode to a measured frequency, its modes tell that are counted:
:math:`f` is the product of all :math:`\lambda_k - \lambda` after the change over that before, so that where it is
negative, one mode more or less lies below :math:`\lambda` than before, and never two (Sylvester's law of inertia).
Between two values of :math:`\lambda` whose counts differ, there is a mode, also one that the place hardly moves.
"""

from collections.abc import Iterator

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.modes.features import Features
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates, Modes

# Relative change of a squared frequency that an inaccuracy of the elements may make, and what is left of it once the
# elements follow other modes; times it from which on a mode is as little explained as any.
CLOSE, FOLLOWED, FAR = 0.03, 0.01, 4.0
NEARER = FAR * 0.6 ** np.arange(14)[::-1]  # distances, over that change, within which a mode is sought
LIGHT = -0.95  # least mass over that of the structure at a place; below it nothing is left there
RIGID = 1e-6  # square of a frequency, relative to the lowest measured, below which a mode is that of a rigid body
UNSTABLE = -1.0  # stiffness over that of the structure at a place, below which it does not stand
DAMPERS = np.geomspace(0.03, 1000.0, 50)  # sizes of dampers, over the usual one
# Sizes of lumps, over the usual one, and of elements' stiffness, relative to the whole; and then about the best.
LUMPS, RELATIVE = np.geomspace(0.5, 500.0, 18), np.array([-0.97, -0.93, -0.87, -0.75, -0.5, 0.8, 2.0, 5.0, 15.0, 50.0])
LEADING = 60  # elements whose sizes are then sought nearer
ABOUT = np.array([0.8, 0.87, 0.93, 0.97, 1.03, 1.07, 1.15, 1.24])
LIKELY = 0.3  # of logarithms of dampings that are off
UNDAMPED = 1e-9  # least damping ratio that counts
TOGETHER = 1000  # places that are looked at together


def missed_frequencies(
    features: Features, modes: Modes, candidates: list[Change], sizes: np.ndarray, close: float = CLOSE
) -> tuple[np.ndarray, np.ndarray]:
    """Least sum of squared, bounded misses of the measured frequencies by each candidate, and its size.

    Of candidates of another kind the sum is infinite.

    Parameters
    ----------
    modes
        Of the structure that is changed.
    sizes
        Over the usual ones, tried for each besides those that a frequency asks for, shape ``(s,)``.
    close
        Relative miss of a squared frequency that counts as one.
    """
    out, found = np.full(len(candidates), np.inf), np.zeros(len(candidates))
    shapes, squares = np.concatenate([modes.low[0], modes.high[0]]), np.concatenate([modes.low[1], modes.high[1]])
    around = np.concatenate([-NEARER[::-1], [0.0], NEARER])
    at = np.abs(features.poles)[:, None] ** 2 * (1 + close * around)
    below = (squares < at[..., None]).sum(axis=-1)
    apart = squares - at[..., None]
    apart = np.where(np.abs(apart) < 1e-9 * at[..., None], 1e-9 * at[..., None], apart)
    misses = np.concatenate([[0.0], NEARER]) ** 2
    firm = squares > RIGID * at.min()
    for kind, which, b2 in _directions(candidates, shapes):
        flexible = np.tensordot(b2, 1 / apart, (1, 2))  # (place, mode, distance)
        if kind == "M":
            flexible *= -at
        own, least = (b2.sum(axis=1), LIGHT) if kind == "M" else ((b2[:, firm] / squares[firm]).sum(axis=1), UNSTABLE)
        here = flexible[:, :, len(NEARER)]
        asked = -1 / np.where(here == 0, 1e-300, here)
        tried = np.concatenate([np.broadcast_to(sizes, (len(which), len(sizes))), asked], axis=1)
        for u in tried.T[:, :, None, None]:
            fewer = (u > 0) == (kind == "K")
            counted = below + np.where(fewer, -1, 1) * (1 + u * flexible < 0)
            within = counted[:, :, len(NEARER) + 1 :] > counted[:, :, len(NEARER) - 1 :: -1]
            nearest = np.where(within.any(axis=2), within.argmax(axis=2), len(NEARER))
            missed = misses[nearest].sum(axis=1)
            missed = np.where(u[:, 0, 0] * own < least, np.inf, missed)
            better = missed < out[which]
            out[which], found[which] = (np.where(better, a, b[which]) for a, b in ((missed, out), (u[:, 0, 0], found)))
    return out, found


def missed_dampings(features: Features, modes: Modes, which: np.ndarray, candidates: list[Change]) -> np.ndarray:
    r"""Least sum of squared, bounded misses of the measured decay rates by a damper at each place, shape ``(p,)``.

    A damper ``c`` along ``b`` adds :math:`c\,|\lambda (b^Tv)^2|` to the decay rate of a mode ``v`` of the pole
    :math:`\lambda`, as long as it leaves the shapes as they are. Of candidates that are no dampers the sum is infinite.

    Parameters
    ----------
    which
        Mode of the simulation in the place of each measured one, shape ``(k,)``.
    """
    out = np.full(len(candidates), np.inf)
    dampers = [k for k, c in enumerate(candidates) if c.kind == "C" and c.direction is not None]
    poles, rate = modes.poles[which], np.maximum(-modes.poles[which].real, UNDAMPED * np.abs(modes.poles[which]))
    measured = np.maximum(-features.poles.real, UNDAMPED * np.abs(features.poles))
    for start in range(0, len(dampers), TOGETHER):
        some = dampers[start : start + TOGETHER]
        b = np.array([np.sqrt(candidates[k].scale) * candidates[k].direction for k in some])
        added = np.abs(poles * (b @ modes.vectors[which].T) ** 2)
        off = np.log((rate + added[..., None, :] * DAMPERS[:, None]) / measured) / LIKELY
        out[some] = (np.minimum(np.abs(off), FAR) ** 2).sum(axis=-1).min(axis=-1)
    return out


def _directions(candidates: list[Change], shapes: np.ndarray) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Kind, numbers of some candidates of rank one, and squares of their directions by shapes ``(place, shape)``."""
    for kind in "KM":
        one = [k for k, c in enumerate(candidates)
               if c.kind == kind and c.direction is not None and c.pattern is None]  # fmt: skip
        for start in range(0, len(one), TOGETHER):
            which = one[start : start + TOGETHER]
            directions = np.array([np.sqrt(candidates[k].scale) * candidates[k].direction for k in which])
            yield kind, np.array(which), (directions @ shapes.T) ** 2


def missed_by_elements(f: Features, c: Coordinates, elements: list[Change]) -> tuple[np.ndarray, np.ndarray]:
    """Least sum of squared, bounded misses of the measured frequencies by changes of whole elements, and their sizes.

    As masses that move in several directions, they are of no rank one: what is tried are sizes one by one.
    """
    asked = np.abs(f.poles)[:, None] ** 2
    out, found = np.full(len(elements), np.inf), np.zeros(len(elements))

    def tried(k: int, sizes: np.ndarray) -> None:
        for u, squares in _squares(c, elements[k], sizes):
            apart = np.abs(np.maximum(squares, 0.0) / asked - 1).min(axis=1) / CLOSE
            missed = float((np.minimum(apart, FAR) ** 2).sum())
            if missed < out[k]:
                out[k], found[k] = missed, u

    for k, cause in enumerate(elements):
        tried(k, LUMPS if cause.kind == "M" else RELATIVE / cause.scale)
    for k in np.argsort(out)[:LEADING]:
        tried(int(k), ABOUT * (found[k] or 1.0))
    return out, found


def _squares(c: Coordinates, cause: Change, sizes: np.ndarray) -> Iterator[tuple[float, np.ndarray]]:
    """Size, and squared circular frequencies of the simulation with it, of a change of mass or stiffness."""
    A, change = np.diag(c.frequencies**2), cause.matrix
    if cause.kind == "K":
        yield from ((float(u), np.linalg.eigvalsh(A + u * change)) for u in sizes)
        return
    b, V = np.linalg.eigh(change)
    for u in sizes[sizes * b.max() > -0.95]:
        half = V / np.sqrt(1 + u * b) @ V.T
        yield float(u), np.linalg.eigvalsh(half @ A @ half)
