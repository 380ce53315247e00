r"""Delays: phases of residues that fall in proportion to frequency.

For real modes the residues of the receptance lie on the imaginary axis, and a delay :math:`\tau` of a channel turns
them by :math:`-\omega_r\tau`. Complex modes scatter about the axis, the more the weaker a channel takes part in the
mode; how much, the angles themselves tell once the best delay is taken out. Structural damping turns all modes by one
small angle, about the loss of the structure, which is allowed for.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.special import binom
from scipy.stats import t as student

from modalax.check.finding import Finding, Picture, sureness
from modalax.check.phases import ANGLE, complexity, undirected
from modalax.check.study import CLEAR, Study

# A delay is told from this angle at the band's end on [rad], and below this chance of scatter alone, by so many times
# less where few angles tell it; modes it takes, and angles of other channels that count beside each of its own.
SMALLEST_ANGLE, CHANCE, TRIALS, FEWEST_MODES, BESIDE = 0.025, 3e-6, 20, 3, 4
# Angles of all channels from which on their scatter is known and a single mode tells a delay.
ENOUGH = 5.0
# Half turns at the highest mode up to which a delay is told by its size, and up to which by how closely angles line up
# with it that do not without; modes that this takes, chance of it below which it is told, and by how much less angles
# scatter than with a smaller delay.
NEAR, FAR, LINED_UP, BY_CHANCE, CLOSER = 0.95, 20.0, 4, 1e-3, 2.0
# No scatter is larger than this [rad] where a delay can be read; a channel that takes less part tells nothing.
MOST_SCATTER, MOST_PART = 0.2, 30.0


class Phases(NamedTuple):
    """Undirected angles off the imaginary axis by mode and output, ``(n, o)``; inf as noise where there is none.

    Attributes
    ----------
    omega
        Of the modes, ``(n,)``.
    angle, noise
        Angle and its standard deviation from noise [rad].
    part
        How much more a channel scatters that takes little part in a mode, 1 and more.
    """

    omega: np.ndarray
    angle: np.ndarray
    noise: np.ndarray
    part: np.ndarray


class Known(NamedTuple):
    """Loss factor over two, circular frequency of the band's end, scatter of the phases and how many angles tell it."""

    loss: float
    top: float
    scatter: float
    count: float


class Late(NamedTuple):
    """A delay [s], its standard deviation, its score, 1 at the chance at which it is told, and the angles' scatter."""

    tau: float
    std: float
    score: float
    scatter: float


def delay(study: Study) -> Iterator[Finding]:
    """Outputs, or the force, that come late or early by a constant time."""
    if not study.explained:
        return
    phases = _phases(study)
    if not len(phases.omega):
        return
    loss = float(np.median(study.modes.width / study.modes.frequency / 2))
    known = Known(loss, 2 * np.pi * study.freq[-1], *complexity(study))
    driven = (
        sorted({p.o for p in study.drive_points}) if len({p.i for p in study.drive_points}) == study.H.shape[3] else []
    )
    for where, late in _of_two(phases, known) if len(study.outputs) == 2 else _of_many(phases, known, driven):
        names = () if where is None else (study.outputs[where],)
        yield _finding(study, phases, where, names, late)


def _of_many(phases: Phases, known: Known, driven: list[int]) -> Iterator[tuple[int | None, Late]]:
    """A delay of all by the middle of the channels, then of single channels off the middle of the others."""
    middle, spread = _middles(phases)
    # A whole column of residues turns with the place that is driven: how far that scatters only a sensor there tells.
    seen = np.isfinite(phases.noise[:, driven])
    part = np.where(seen, phases.part[:, driven], np.inf).min(axis=1, initial=np.inf)
    told = _late(phases.omega, middle, np.where(np.isfinite(part), spread, np.inf), part, known) if driven else None
    alone = _late(phases.omega, middle, spread, np.ones_like(middle), known._replace(count=0.0))
    common = max((x for x in (told, alone) if x is not None), key=lambda x: x.score, default=None)
    if common is not None:
        yield None, common
    left = list(range(phases.angle.shape[1]))
    while len(left) > 1:
        # Beside a channel that is late the others look early: one at a time is found and left out.
        found = {o: late for o in left if (late := _off_others(phases, o, left, known)) is not None}
        if not found:
            return
        worst = max(found, key=lambda o: found[o].score)
        yield worst, found[worst]
        left.remove(worst)


def _off_others(phases: Phases, o: int, left: list[int], known: Known) -> Late | None:
    """The delay of one channel off the middle of the others that are left; None if there is none."""
    others = [k for k in left if k != o]
    middle, spread = _middles(Phases(phases.omega, *(a[:, others] for a in phases[1:])))
    own = undirected(phases.angle[:, o] - middle)
    noise = np.hypot(phases.noise[:, o], spread)
    return _late(phases.omega, own, noise, phases.part[:, o], known._replace(loss=0.0))


def _of_two(phases: Phases, known: Known) -> Iterator[tuple[int | None, Late]]:
    """Of two channels the one that is off the axis; both, if they are off alike."""
    known = known._replace(count=0.0)
    each = [_late(phases.omega, phases.angle[:, o], phases.noise[:, o], phases.part[:, o], known) for o in range(2)]
    first, second = each
    if first is not None and second is not None:
        apart = abs(first.tau - second.tau)
        if apart < max(4 * np.hypot(first.std, second.std), SMALLEST_ANGLE / known.top):
            yield None, first if first.score > second.score else second
        return
    for o, late in enumerate(each):
        if late is not None:
            yield o, late


def _phases(study: Study) -> Phases:
    """Angles of all modes and outputs, the columns' middle."""
    omega, residues, std = study.summed
    std, values = np.hypot(std, study.unsure), 1j * residues
    with np.errstate(divide="ignore", invalid="ignore"):
        noise = np.where(np.abs(residues) > CLEAR * std, std / np.abs(residues), np.inf)
        typical = np.sqrt(np.mean(np.abs(residues) ** 2, axis=1, keepdims=True))
        part = np.where(np.isfinite(noise), np.maximum(typical / np.abs(residues), 1.0), 1.0)
        # Of close modes only the sum is known; where they cancel, its angle is of their difference.
        size = np.stack([np.abs(study.residues[g]).sum(axis=0) for g in study.groups]) if len(omega) else np.abs(values)
        noise = np.where((np.abs(residues) > 0.7 * size) & (part < MOST_PART), noise, np.inf)
    # Of a peak that the band's end cuts, what lies beyond turns the residue as well.
    poles, ends = study.modes.poles, 2 * np.pi * study.freq[[0, -1]]
    cut = [np.min(np.abs(poles[g].imag[:, None] - ends) + 2 * poles[g].real[:, None]) < 0 for g in study.groups]
    noise = np.where(np.array(cut, bool)[:, None, None], np.inf, noise)
    angle, spread, parts = [], [], []
    for o in range(values.shape[1]):
        middle, wide = _weighted(np.angle(values[:, o]), noise[:, o])
        angle.append(middle)
        spread.append(wide)
        weight = 1 / np.where(np.isfinite(noise[:, o]), part[:, o], np.inf) ** 2
        best = weight.max(axis=1, initial=1e-300)
        parts.append(np.where(best > 1e-300, 1 / np.sqrt(np.maximum(best, 1e-300)), 1.0))
    phases = Phases(omega, *(np.stack(rows, axis=1) for rows in (angle, spread, parts)))
    seen = np.isfinite(phases.noise)
    # What most channels see at phases of their own is no mode that tells a delay.
    off = np.abs(undirected(phases.angle - _middles(phases)[0][:, None]))
    agree = (seen & (off < MOST_SCATTER)).sum(axis=1) > 0.5 * seen.sum(axis=1)
    use = seen.any(axis=1) & (agree | (seen.sum(axis=1) < 3))
    return Phases(*(a[use] for a in phases))


def _weighted(angle: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of undirected angles along the last axis, and its standard deviation; inf where there is none."""
    weight = 1 / (noise**2 + ANGLE**2)
    middle = 0.5 * np.angle(np.sum(weight * np.exp(2j * angle), axis=-1))
    total = weight.sum(axis=-1)
    with np.errstate(divide="ignore"):
        return middle, np.where(total > 0, 1 / np.sqrt(total), np.inf)


def _middles(phases: Phases) -> tuple[np.ndarray, np.ndarray]:
    """Angle of each mode that is nearest to those of all channels, and its standard deviation."""
    weight = 1 / (phases.noise**2 + (0.05 * phases.part) ** 2)
    gaps = np.abs(undirected(phases.angle[:, :, None] - phases.angle[:, None, :]))
    total = np.einsum("nab,nb->na", gaps, weight)
    total = np.where(np.isfinite(phases.noise), total, np.inf)
    rows = np.arange(len(gaps))
    best = np.argmin(total, axis=1)
    centre = phases.angle[rows, best]
    # About it, the mean of those that are near: a channel that is late is not.
    off = undirected(phases.angle - centre[:, None])
    near = np.abs(off) < 3 * np.median(np.abs(off), axis=1, keepdims=True) + 3 * ANGLE
    weight = np.where(near, weight, 0.0)
    mean = (weight * off).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300)
    one = np.where(np.isfinite(phases.noise) & near, 1 / (phases.noise**2 + ANGLE**2), 0.0).sum(axis=1)
    with np.errstate(divide="ignore"):
        return undirected(centre + mean), np.where(one > 0, 1 / np.sqrt(one), np.inf)


def _late(omega, angle, noise, part, known: Known) -> Late | None:
    """Delay that explains angles which scatter no further once it is taken out; None if there is none."""
    use = np.isfinite(noise)
    omega, angle, noise, part = omega[use], angle[use], noise[use], part[use]
    count = len(omega)
    if count < (1 if known.count > ENOUGH else FEWEST_MODES):
        return None
    known = known._replace(count=min(known.count, BESIDE * count))
    near = _near(omega, angle, noise, part, known)
    far = _far(omega, angle, noise, part, known) if count >= LINED_UP else None
    return far if near is None or (far is not None and near.scatter > CLOSER * max(far.scatter, ANGLE)) else near


class Aligned(NamedTuple):
    """A delay that lines up angles: the delay and its deviation [s], scatter and weight of the angles, what is left."""

    tau: float
    std: float
    scatter: float
    weight: np.ndarray
    rest: np.ndarray


def _aligned(omega, angle, noise, part, known: Known, reach: float) -> Aligned:
    """The delay that lines up undirected angles best, up to so many half turns at the highest mode."""
    grid = np.linspace(-1, 1, 2 * int(np.ceil(120 * reach)) + 1) * reach * np.pi / omega.max()
    rough = 1 / (noise**2 + (0.05 * part) ** 2)
    left = np.sum(rough * np.sin(angle + np.outer(grid, omega)) ** 2, axis=1)
    tau = float(grid[np.argmin(left)])
    scatter, std, weight, rest = known.scatter, 0.0, rough, angle
    for _ in range(4):
        rest = undirected(angle + omega * tau)
        scatter = _scatter(rest, noise, part, known)
        weight = 1 / (noise**2 + ANGLE**2 + (scatter * part) ** 2)
        # One angle common to all modes, known to be about the loss of the structure, takes part of what is there.
        share = 1 / (weight.sum() + 1 / max(known.loss, 1e-9) ** 2)
        slope = weight * (omega - share * np.sum(weight * omega))
        normal = np.sum(slope * omega)
        tau -= float(np.sum(slope * rest) / normal)
        std = float(1 / np.sqrt(normal))
    return Aligned(tau, std, scatter, weight, undirected(angle + omega * tau))


def _far(omega, angle, noise, part, known: Known) -> Late | None:
    """A delay of more than half a turn: angles that one lines up, as it hardly ever does by chance."""
    tau, std, scatter, _, rest = _aligned(omega, angle, noise, part, known, FAR)
    if scatter > MOST_SCATTER or abs(tau) * omega.max() < NEAR * np.pi:
        return None
    score = float(np.log(_by_chance(rest, FAR)) / np.log(BY_CHANCE))
    return Late(tau, std, score, scatter) if score > 1 else None


def _by_chance(rest: np.ndarray, reach: float) -> float:
    r"""Chance at which some delay, up to so many half turns, lines up as many angles as closely as these.

    Of n angles spread evenly over half a turn k lie within :math:`a` of zero, one of them by the delay itself, with a
    chance of :math:`\binom nk(2a/\pi)^{k-1}` for each half turn of the fastest that is tried. Modes in which a channel
    hardly takes part may scatter: any k from ``LINED_UP`` on will do.
    """
    n = len(rest)
    within = 2 * np.maximum(np.sort(np.abs(rest)), ANGLE) / np.pi
    many = np.arange(min(LINED_UP, n), n + 1)
    return float(np.min(2 * reach * binom(n, many) * within[many - 1] ** (many - 1)))


def _near(omega, angle, noise, part, known: Known) -> Late | None:
    """A delay of less than half a turn, which differs from none by many deviations."""
    count = len(omega)
    tau, std, scatter, weight, rest = _aligned(omega, angle, noise, part, known, NEAR)
    if scatter > MOST_SCATTER or abs(tau) * known.top < SMALLEST_ANGLE:
        return None
    if abs(tau) * omega.max() > np.pi / 2 and _by_chance(rest, NEAR) > 10 * BY_CHANCE:
        return None
    # Scatter that is itself estimated from few angles makes long tails; noise that is known does not.
    estimated = float(np.sum(weight**2 * (scatter * part) ** 2) / np.sum(weight))
    freedom = min((count - 1 + known.count) / max(estimated, 1e-3) ** 2, 1e4)
    # With few angles some delay of many lines them up; with those of all channels the scatter is known.
    needed = float(student.isf(CHANCE / (2 if known.count else 2 * TRIALS), freedom))
    score = abs(tau) / std / needed
    return Late(tau, std * float(student.isf(0.025, freedom)) / 1.96, score, scatter) if score > 1 else None


def _scatter(rest: np.ndarray, noise: np.ndarray, part: np.ndarray, known: Known) -> float:
    """Scatter of complex modes that makes the squares left here, and what all channels tell, as many as expected."""
    low, high = 1e-3, 2.0
    freedom = len(rest) - 1 + known.count

    def above(s: float) -> bool:
        squares = float(np.sum(rest**2 / (noise**2 + ANGLE**2 + (s * part) ** 2)))
        return squares + known.count * (known.scatter / s) ** 2 > freedom

    for _ in range(40):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if above(middle) else (low, middle)
    return high


def _finding(study: Study, phases: Phases, where: int | None, names: tuple[str, ...], late: Late) -> Finding:
    tau, std, score = late.tau, late.std, late.score
    frequency = phases.omega / (2 * np.pi)
    shown = _middles(phases)[0] if where is None else phases.angle[:, where]
    line = np.array([0.0, frequency.max()])
    told = names[0] if names else "all outputs"
    top = study.freq[-1]
    return Finding(
        "delay", names, sure=sureness(score, 1.0), size=tau, unit="s", interval=(tau - 1.96 * std, tau + 1.96 * std),
        evidence=f"the phases of the modes at {told} fall in proportion to frequency, as a delay of {tau:.4g} s makes "
        f"them ({np.degrees(2 * np.pi * tau * top):.3g} degrees at {top:.4g} Hz)",
        advice="check filters, sampling clocks and converters of these channels against the force's; a known delay can "
        "be taken out by exp(j 2 pi f tau)",
        picture=Picture(
            [("residues", frequency, np.degrees(shown)), ("delay", line, -np.degrees(2 * np.pi * line * tau))],
            "Frequency [Hz]", "Angle off the imaginary axis [deg]", dots=True,
        ),
    )  # fmt: skip
