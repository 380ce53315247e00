r"""The general inaccuracy of a simulation: every element of stiffness, mass and damping is off by a few per cent.

A part is an element of the simulation, read off its matrices, off by :math:`\epsilon z` with ``z`` standard normal; the
sizes :math:`\epsilon` of stiffness, mass and damping are claimed by the author or learnt. Damping is off mode by mode,
by a factor :math:`e^{\epsilon z}` so that it stays positive. Between modes it is off as well (Soize 2000), usually by a
tenth of that, with a size of its own: modes that are hardly coupled do not tell how well their damping is known. Close
modes are turned into one another by what elements are off by, and what their dampings differ by then couples them: by
an angle :math:`\theta`, :math:`\tan2\theta=2\sigma_{rs}/(\omega_s^2-\omega_r^2)`, with :math:`\sigma_{rs}` the usual
size of the change between them, modal dampings :math:`c_r` and :math:`c_s` couple by
:math:`\tfrac12\sin2\theta\,(c_r-c_s)`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from modalax.diagnose.modal_domain.causes.given_elements import mass_patterns, stiffness_patterns
from modalax.diagnose.modal_domain.fitting.between_modes import RIGID, between_modes
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.modal_domain.structure.elements import Part
from modalax.diagnose.modal_domain.structure.factored import Factored, factored
from modalax.diagnose.modal_domain.structure.modes_only import ModesOnly, Simulation
from modalax.diagnose.modal_domain.structure.nodes import Nodes, nodes_of
from modalax.diagnose.modal_domain.structure.parts import apart, coupled_rows, ends_of, parts_of
from modalax.diagnose.modal_domain.structure.turns import nodes_at
from modalax.model import Structure

# Sizes where nothing is claimed, and the spread of their logarithms. Frequencies of finite-element models are off by
# 1 to 5 % before updating and by 0.1 to 1 % after it (Mottershead and Friswell 1993; Simoen, De Roeck and Lombaert
# 2015), damping ratios by 30 % and more.
USUAL = {"stiffness": 0.01, "mass": 0.005, "damping": 0.3}
UNKNOWN = 2.0  # standard deviation of the logarithm of a size that nobody claims
CLAIMED = 0.7  # the same of a size that the author claims, who may be wrong by a factor of two
BETWEEN = 0.1  # damping between modes, relative to that of the modes themselves
CLOSE = 0.01  # coupling of turned modes, over what their dampings are off by, from which on it has a pattern of its own
NEGLIGIBLE = 1e-12  # modal damping [1/s] of a mode without any
TAILS = 2.0  # times the band's end up to which modes are off in damping by themselves: :func:`own_damping`
NEAR = 8  # modes above each one that it may be coupled with by damping
KINDS = {"stiffness": "K", "mass": "M", "damping": "C", "damping between modes": "C", "rest": "K",
         "stiffness throughout": "K", "mass throughout": "M", "damping throughout": "C", "stiffness within": "K",
         "mass within": "M"}  # fmt: skip
WITHIN = {name: f"{name} within" for name in ("stiffness", "mass")}  # groups of what elements are off unevenly
TOLD = ("stiffness", "mass", "damping")  # what an answer tells
THROUGHOUT = {name: f"{name} throughout" for name in TOLD}  # groups of one pattern: all by one factor


@dataclass(frozen=True)
class Inaccuracy:
    """Patterns of change and the sizes that they are expected to have.

    Attributes
    ----------
    groups
        What is off: ``stiffness``, ``mass``, ``damping``, ``damping between modes``, and where the data ask for them
        ``stiffness throughout``, ``mass throughout``, ``damping throughout``, ``stiffness within`` and ``mass within``.
    patterns
        Of each group, in modal coordinates, shape ``(p, n, n)``; a size of 1 is a change by the whole.
    usual, spread
        Expected sizes, and standard deviations of their logarithms, shape ``(groups,)``.
    claimed
        Of which groups the author claims a size.
    positive
        Of each pattern, whether its size is the logarithm of a factor: a mode's own damping, or all of a matrix.
    factors
        The patterns of each group by their directions; found where they are not given.
    elements
        Of ``stiffness`` and ``mass``, where a matrix shows elements in pieces, the number of each pattern's element.
    places
        Of each pattern of ``stiffness`` and ``mass`` that was read off a matrix, the DoFs that tell where it is.
    kilograms
        What each such pattern of ``mass`` weighs, shape ``(p,)`` [kg].
    between_modes
        Whether stiffness and mass are off as those of no elements: :mod:`.between_modes`.
    """

    groups: tuple[str, ...]
    patterns: tuple[np.ndarray, ...]
    usual: np.ndarray
    spread: np.ndarray
    claimed: tuple[bool, ...]
    positive: np.ndarray
    factors: tuple[Factored, ...] = ()
    elements: Mapping[str, np.ndarray] = field(default_factory=dict)
    places: Mapping[str, Sequence[tuple[str, ...]]] = field(default_factory=dict)
    kilograms: np.ndarray = field(default_factory=lambda: np.zeros(0))
    between_modes: bool = False

    def __post_init__(self) -> None:
        more = map(factored, self.patterns[len(self.factors) :])
        object.__setattr__(self, "factors", (*self.factors, *more))

    @property
    def group_of(self) -> np.ndarray:
        """Group of each pattern, all in one row."""
        return np.repeat(np.arange(len(self.patterns)), [len(p) for p in self.patterns])


def inaccuracy_of(simulation: Simulation, c: Coordinates, highest: float) -> Inaccuracy:
    """Patterns of a structure whose band ends at ``highest`` [rad/s]."""
    shared = {name: np.zeros((0, c.size, c.size)) for name in WITHIN}
    elements: dict[str, np.ndarray] = {}
    places: dict[str, list[tuple[str, ...]]] = {}
    if isinstance(simulation, ModesOnly):
        (stiffness, mass), kilograms = between_modes(c, highest), np.zeros(0)
    else:
        stiffness, mass, kilograms = _of_elements(simulation, c, shared, elements, places)
    claims = {"stiffness": _claim(simulation, "stiffness_std"), "mass": _claim(simulation, "mass_std"),
              "damping": _claim(simulation, "damping_std")}  # fmt: skip
    frequency = _claim(simulation, "frequency_std")
    if frequency > 0 and claims["stiffness"] == 0:
        inside = (c.frequencies < highest) & (c.frequencies > RIGID * highest)
        share = np.einsum("pkk->kp", stiffness)[inside] / np.maximum(c.frequencies[inside, None] ** 2, 1e-300)
        moved = np.median(np.sqrt((share**2).sum(axis=1))) if inside.any() else 1.0
        claims["stiffness"] = 1.9 * frequency / max(moved, 1e-3)  # a third of it in mass takes the rest
    if claims["stiffness"] > 0 and claims["mass"] == 0:
        known = claims["stiffness"] / 3
    else:
        known = USUAL["mass"]
    usual = np.array([claims[g] or (known if g == "mass" else USUAL[g]) for g in TOLD])
    told = np.array([claims[g] > 0 for g in TOLD])
    own, turned, between = _damping(c, highest, _turned(c, (stiffness, mass), usual))
    parts = (stiffness, False), (mass, False), (own, True), (turned, False), (between, False)
    positive = np.repeat([factor for _, factor in parts], [len(p) for p, _ in parts])
    patterns = stiffness, mass, np.concatenate([own, turned]), between
    every = Inaccuracy(
        (*TOLD, "damping between modes"), patterns, np.append(usual, usual[-1]),
        np.append(np.where(told, CLAIMED, UNKNOWN), UNKNOWN), (*told.tolist(), False), positive, elements=elements,
        places=places, kilograms=kilograms, between_modes=isinstance(simulation, ModesOnly),
    )  # fmt: skip
    for name, couplings in shared.items():
        k = TOLD.index(name)
        every = with_group(every, WITHIN[name], couplings, usual[k], every.spread[k], bool(told[k]))
    return every


def _of_elements(
    simulation: Structure, c: Coordinates, shared: dict[str, np.ndarray], elements: dict[str, np.ndarray],
    places: dict[str, list[tuple[str, ...]]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Patterns of stiffness and mass by their elements, and masses [kg]; what is told of each is added.

    That is what neighbours share, of which element each is, and where. Elements that are told share nothing.
    """
    nodes = nodes_at(simulation)
    stiffness, mass = stiffness_patterns(simulation, c), mass_patterns(simulation, c)
    if stiffness is None:
        pieces = _pieces(np.asarray(simulation.K), nodes, mass=False)
        (stiffness, shared["stiffness"]), elements["stiffness"] = _patterns(pieces, c), _elements(pieces)
        places["stiffness"] = _named(pieces, simulation, nodes)
    if mass is None:
        pieces = _pieces(np.asarray(simulation.M), nodes, mass=True)
        (mass, shared["mass"]), elements["mass"] = _patterns(pieces, c), _elements(pieces)
        places["mass"] = _named(pieces, simulation, nodes)
        return stiffness, mass, _translated(pieces, nodes)
    return stiffness, mass, np.zeros(0)


def forces_of_errors(
    simulation: Structure, sizes: dict[str, np.ndarray], shapes: np.ndarray, squares: np.ndarray
) -> np.ndarray:
    r"""Forces :math:`(\delta K - \omega_r^2\,\delta M)\phi_r` of errors of single elements in some modes ``(n, r)``.

    Parameters
    ----------
    sizes
        Relative errors of ``stiffness`` and ``mass``, of each pattern.
    shapes, squares
        Modes over the DoFs that elements know, shape ``(n, r)``, and their squared circular frequencies.
    """
    told, nodes, out = simulation.elements, nodes_at(simulation), np.zeros_like(shapes)
    for name, matrix, scale in (("stiffness", simulation.K, np.ones_like(squares)), ("mass", simulation.M, -squares)):
        if told is not None:
            F = np.asarray(getattr(told, name))
            out += np.einsum("e,enr,erk->nk", sizes[name], F, F.transpose(0, 2, 1) @ shapes, optimize=True) * scale
            continue
        for p, size in zip(_pieces(np.asarray(matrix), nodes, name == "mass"), sizes[name], strict=True):
            out[p.dofs] += size * (p.matrix @ shapes[p.dofs]) * scale
    return out


def claims_of(a: Inaccuracy) -> dict[str, float]:
    """Sizes that the author claims, by the group that they are of."""
    return {name: float(u) for name, u, told in zip(a.groups, a.usual, a.claimed, strict=True) if told}


def with_group(
    a: Inaccuracy, group: str, patterns: np.ndarray, usual: float, spread: float, claimed: bool = False,
    positive: bool = False,
) -> Inaccuracy:  # fmt: skip
    """An inaccuracy with a further group, where that has any pattern."""
    if not len(patterns):
        return a
    return replace(
        a, groups=(*a.groups, group), patterns=(*a.patterns, patterns), usual=np.append(a.usual, usual),
        spread=np.append(a.spread, spread), claimed=(*a.claimed, claimed),
        positive=np.append(a.positive, np.full(len(patterns), positive)),
    )  # fmt: skip


def _named(pieces: list[Part], simulation: Structure, nodes: Nodes) -> list[tuple[str, ...]]:
    """Where each is, as causes are told: at two DoFs of one direction, or at one."""
    axis, out = nodes_of(simulation.dofs).axis, []
    for p in pieces:
        ends = ends_of(p, nodes) if len(p.nodes) > 1 else ()
        out.append(tuple(simulation.dofs[k] for k in ends or (p.dofs[np.argmin(axis[p.dofs])],)))
    return out


def _translated(pieces: list[Part], nodes: Nodes) -> np.ndarray:
    """Mass [kg] of each as it moves in the direction in which it has most."""
    out = []
    for p in pieces:
        axis, sign = nodes.axis[p.dofs], nodes.sign[p.dofs]
        each = [sign[axis == x] @ p.matrix[np.ix_(axis == x, axis == x)] @ sign[axis == x] for x in set(axis[axis < 3])]
        out.append(max(each, default=0.0))
    return np.array(out)


def _pieces(matrix: np.ndarray, nodes: Nodes, mass: bool) -> list[Part]:
    """What of the elements of a matrix may each be off by itself."""
    return [q for p in parts_of(matrix, nodes, mass=mass) for q in apart(p, nodes, mass=mass)]


def _elements(pieces: list[Part]) -> np.ndarray:
    """The number of the element that each piece is of: those between the same nodes are of one."""
    keys = [p.nodes or (-1, k) for k, p in enumerate(pieces)]
    numbers = {key: k for k, key in enumerate(dict.fromkeys(keys))}
    return np.array([numbers[key] for key in keys])


def _patterns(parts: list[Part], c: Coordinates) -> tuple[np.ndarray, np.ndarray]:
    """Change of each part by the whole, and of what neighbouring nodes share of elements that cannot be read off."""
    own = np.stack([c.shapes[p.dofs].T @ p.matrix @ c.shapes[p.dofs] for p in parts])
    rows = [(a @ c.shapes, b @ c.shapes) for a, b in coupled_rows(parts)]
    both = [(np.outer(a, b) + np.outer(b, a)) / np.sqrt(2) for a, b in rows]
    return own, np.array(both).reshape(-1, c.size, c.size)


def _claim(simulation: Simulation, name: str) -> float:
    value = np.asarray(0.0 if getattr(simulation, name) is None else getattr(simulation, name), float)
    return float(np.sqrt(np.mean(value**2))) if value.size else 0.0


def _turned(c: Coordinates, patterns: tuple[np.ndarray, np.ndarray], usual: np.ndarray) -> np.ndarray:
    r"""Usual coupling of two modes' dampings by turning them, over what one of them is off by, shape ``(n, n)``.

    It is :math:`\tfrac12\sin2\theta\sqrt{2+(c_r-c_s)^2/(c_rc_s\epsilon^2)}`, as both are off by :math:`\epsilon`.
    """
    squares, damping = c.frequencies**2, np.maximum(np.diag(c.damping), NEGLIGIBLE)
    stiffness, mass = (u * np.sqrt(np.einsum("prs,prs->rs", p, p)) for u, p in zip(usual, patterns, strict=False))
    twice = 2 * np.hypot(stiffness, np.sqrt(np.multiply.outer(squares, squares)) * mass)
    apart = np.maximum(np.abs(np.subtract.outer(squares, squares)), 1e-300)
    unlike = np.subtract.outer(damping, damping) ** 2 / np.multiply.outer(damping, damping) / usual[2] ** 2
    return 0.5 * twice / np.hypot(twice, apart) * np.sqrt(2 + unlike)


def _damping(c: Coordinates, highest: float, turned: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Patterns of each mode's damping, of couplings of close modes, and of such between all, shapes ``(p, n, n)``.

    Of modes in the band and others near them. ``turned`` is what close modes have, as :func:`_turned` tells it, over
    what their own dampings are off by. What couples modes in the simulation, as its own dampers do, is off like these.
    """
    own = np.sqrt(np.maximum(np.diag(c.damping), NEGLIGIBLE))
    inside = int(np.count_nonzero(c.frequencies < highest))
    pairs = [(r, s) for r in range(min(inside + 1, c.size)) for s in range(r + 1, min(c.size, r + NEAR + 1))]
    every = np.zeros((len(pairs), c.size, c.size))
    for k, (r, s) in enumerate(pairs):
        every[k, r, s] = every[k, s, r] = own[r] * own[s]
    shares = np.array([turned[pair] for pair in pairs])
    close = shares > CLOSE
    simulated = np.array([c.damping[r, s] / max(own[r] * own[s], NEGLIGIBLE) for r, s in pairs])
    between = np.hypot(BETWEEN, simulated)[:, None, None] * every
    return own_damping(c, highest), shares[close, None, None] * every[close], between


def own_damping(c: Coordinates, highest: float) -> np.ndarray:
    r"""Patterns of damping of each mode by itself, shape ``(p, n, n)`` [1/s].

    Of those up to ``TAILS`` times the band's end ``highest`` [rad/s], and of two beyond the band at least. A mode r
    times as high turns its share of the FRF there by :math:`2\zeta r/(r^2 - 1)`: each tail is small, all together show
    in sums over neighbouring lines.
    """
    inside, near = (int(np.count_nonzero(c.frequencies < top * highest)) for top in (1.0, TAILS))
    few = min(max(inside + 2, near), c.size)
    alone = np.zeros((few, c.size, c.size))
    for r in range(few):
        alone[r, r, r] = max(c.damping[r, r], NEGLIGIBLE)
    return alone
