r"""Forces and sensors that are askew: a share of one also acts, or is seen, at another DoF.

A hammer that hits obliquely, a shaker that also pushes another point: the force of input i acts along
:math:`b_i + g b_d`, so that its column of the FRF matrix is :math:`H_{oi} + gH_{od}`. A sensor that is tilted moves as
another direction of its node in the same way, and so does a force: by one turned through :math:`\alpha` what is seen
is :math:`\cos\alpha\,H_{oi} + \sin\alpha\,H_{di}`, with :math:`g = \tan\alpha`. Such a share has no name in the
answer, but crosstalk, gains and masses imitate it. Each share is scored where the simulation is, linearised, beside an
inaccuracy that is tolerated; for the leading ones the general inaccuracy is fitted with the structure seen by the
channels so turned. Where that explains all by itself, only shares that promise something about its fit are looked at.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modalax._numerics.triangles import forward
from modalax.diagnose.causes.base import RARE
from modalax.diagnose.decision.beyond import OddChannel
from modalax.diagnose.modal_domain.fitting.attempts import explains
from modalax.diagnose.modal_domain.fitting.explanation import Explanation
from modalax.diagnose.modal_domain.fitting.fit import TEMPERATURES, Fit, fit, scale_of
from modalax.diagnose.modal_domain.fitting.linear import root_of_information
from modalax.diagnose.modal_domain.fitting.state import (
    Setting,
    State,
    evidence_of_free,
    in_features,
    slopes_at,
    state_at,
    whitened,
)
from modalax.diagnose.modal_domain.modes.features import whitener_of
from modalax.diagnose.modal_domain.odd_channels.odd_channel import volume
from modalax.diagnose.modal_domain.search.matched import ABOUT
from modalax.diagnose.modal_domain.search.screen import SIZES, cost_of_size, distances, tolerance
from modalax.diagnose.modal_domain.search.starts import PROMISING
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.modal_domain.structure.nodes import nodes_of

USUAL = 0.1  # usual share: the sine of six degrees
BLOCK = 100  # places at once
SHOWN = 1e-6  # motion of a DoF, relative to the largest, below which nothing shows there
SCREENED, TRIED = 6, 2  # places that are tried with finite shares, and that are fitted
STEPS, SETTLED = 5, 0.1  # most steps of a fit, and twice the nats that its last may gain
NEAR = 10.0  # chi-square by which a share may be behind the leading causes where the simulation is, and be fitted


def askew_channel(
    setting: Setting, explanations: Sequence[Explanation], dofs: Sequence[str], outputs: Sequence[str],
    inputs: Sequence[str],
) -> OddChannel | None:  # fmt: skip
    """The channel that is likelier to be askew than every explanation is to be true; None where there is none.

    Parameters
    ----------
    setting, explanations
        As of :func:`modalax.diagnose.modal_domain.odd_channels.odd_channel.odd_channel`.
    dofs, outputs, inputs
        Names of the simulation's DoFs and of the channels.
    """
    seen_by, setting = setting, replace(setting, whitener=whitener_of(setting.features), rest=0.0)
    # what causes leave may have made wide what no element explains
    rest = volume(setting.triangle) - volume(seen_by.triangle)
    try:
        state, shrink = tolerance(setting)
    except np.linalg.LinAlgError:  # a simulation of fewer modes than are measured
        return None
    places = _places(setting.coordinates, state, dofs, outputs, inputs)
    if not places:
        return None
    best, prior = explanations[0], math.log(RARE / len(places))
    if not best.causes and explains(best.fit):
        trials = _promising(seen_by, best.fit, places, prior)
    else:
        asked = _left_by(setting, shrink, best.fit) + 2 * (prior - best.log_posterior + best.fit.log_evidence) + NEAR
        near = [_nearest(setting, state, shrink, *p) for p in _leading(setting, state, shrink, places)]
        trials = [(p, share) for left, share, p in sorted(near, key=lambda t: t[0]) if left < asked]
    found = [(p, *_fitted(setting, p, share, prior + rest, best.log_posterior)) for p, share in trials[:TRIED]]
    if not found:
        return None
    place, share, value = max(found, key=lambda f: f[2])
    name, nats = (inputs if place.force else outputs)[place.channel], value - best.log_posterior
    return OddChannel(name, place.force, nats, dofs[place.dof], share, place.turns) if nats > 0 else None


@dataclass(frozen=True)
class Place:
    """A channel and a DoF at which a share of it may act or be seen.

    Attributes
    ----------
    force, channel, dof
        Whether it is an input, which one, and the DoF.
    usual
        A usual share.
    turns
        Whether the DoF is another direction of the channel's node, towards which it turns without growing.
    """

    force: bool
    channel: int
    dof: int
    usual: float
    turns: bool

    def at(self, setting: Setting, size: float) -> Setting:
        """The simulation by channels of which this one is askew, by a share over its usual size."""
        c = setting.coordinates
        rows = (c.inputs if self.force else c.outputs).copy()
        share = size * self.usual
        rows[self.channel] += share * c.shapes[self.dof]
        rows[self.channel] /= math.hypot(1.0, share) if self.turns else 1.0
        return replace(setting, coordinates=replace(c, inputs=rows) if self.force else replace(c, outputs=rows))


def _places(
    c: Coordinates, state: State, dofs: Sequence[str], outputs: Sequence[str], inputs: Sequence[str]
) -> list[Place]:
    """Every input with every other DoF, and every output with those of its node.

    Where there is another output in that direction, crosstalk is the same but for the cosine.
    A share of a rotation is a length, of which one moves the modes as much as one of a displacement does.
    """
    shapes = state.modes.vectors[state.pairs] @ c.shapes.T
    nodes, moves = nodes_of(tuple(dofs)), np.sqrt((np.abs(shapes) ** 2).mean(axis=0))
    near = lambda own, dof: nodes.of_dofs[own] == nodes.of_dofs[dof]
    turns = lambda own, dof: bool(near(own, dof) and max(nodes.axis[own], nodes.axis[dof]) < 3)
    usual = lambda own, dof: USUAL * (moves[own] / moves[dof] if nodes.axis[dof] > 2 else 1.0)
    shown = np.flatnonzero(moves > SHOWN * moves.max()).tolist()
    return [
        Place(force, k, dof, float(usual(dofs.index(name), dof)), turns(dofs.index(name), dof))
        for force, names in ((True, inputs), (False, outputs)) for k, name in enumerate(names) for dof in shown
        if dofs[dof] != name and (force or near(dofs.index(name), dof))
    ]  # fmt: skip


def _left_by(setting: Setting, shrink: np.ndarray, f: Fit) -> float:
    """Chi-square beyond the tolerated inaccuracy that causes leave, with what their sizes cost."""
    try:
        r = state_at(setting, np.zeros(len(setting.inaccuracy.group_of)), f.causes, f.u).difference
    except np.linalg.LinAlgError:
        return math.inf
    h = shrink @ r
    free = 2 * evidence_of_free(setting, f.causes)
    return float(r @ r - h @ h) - free + float(cost_of_size(f.u).sum())


def _moved(setting: Setting, state: State, place: Place) -> np.ndarray:
    """What a usual share adds to the residues of all modes, shape ``(m, o, i)``."""
    turned = place.at(setting, 1.0).coordinates
    return state.modes.residues(turned) - state.modes.residues(setting.coordinates)


def _columns(setting: Setting, state: State, places: list[Place]) -> np.ndarray:
    """Whitened derivatives by shares over their usual size, shape ``(m, places)``."""
    columns = []
    for k in range(0, len(places), BLOCK):
        moved = np.stack([_moved(setting, state, p)[state.together.every] for p in places[k : k + BLOCK]], axis=1)
        still = np.zeros(moved.shape[:2], complex)
        columns.append(in_features(setting, state, still, moved).reshape(-1, moved.shape[1]))
    return whitened(setting, np.concatenate(columns, axis=1), ())


def _leading(setting: Setting, state: State, shrink: np.ndarray, places: list[Place]) -> list[tuple[Place, float]]:
    """Those that gain most, linearised, and shares over their usual size."""
    G = _columns(setting, state, places)
    r, apart, own = state.difference, shrink @ G, shrink @ state.difference
    energy = 1 + np.maximum((G**2).sum(axis=0) - (apart**2).sum(axis=0), 0.0)
    size = (G.T @ r - apart.T @ own) / energy
    gain = size**2 * energy - np.log(energy)
    return [(places[k], float(size[k])) for k in np.argsort(-gain)[:SCREENED]]


def _promising(setting: Setting, f: Fit, places: list[Place], prior: float) -> list[tuple[Place, float]]:
    """Those that promise something beside a fit that explains the modes, the first first, and their shares."""
    pull, information = _pulls(setting, f, places)
    gain = 0.5 * (pull**2 / information - np.log(information)) + prior
    return [(places[k], float(pull[k] / information[k])) for k in np.argsort(-gain) if gain[k] > PROMISING]


def _nearest(
    setting: Setting, state: State, shrink: np.ndarray, place: Place, size: float
) -> tuple[float, float, Place]:
    """Least chi-square beyond the tolerated inaccuracy, the share over its usual size, and the place."""
    least, still = math.inf, state.modes.residues(setting.coordinates)
    for sizes in (np.array([-s for s in SIZES] + [*SIZES, size]), ABOUT, ABOUT**0.25):
        tried = sizes * (size if least < math.inf else 1.0)
        moved = [state.modes.residues(place.at(setting, u).coordinates) - still for u in tried]
        left = distances(setting, shrink, [(state.modes.poles, state.plain + by) for by in moved])
        left = left + cost_of_size(tried)
        if left.min() < least:
            least, size = float(left.min()), float(tried[np.argmin(left)])
    return least, size, place


def _pulls(setting: Setting, f: Fit, places: list[Place]) -> tuple[np.ndarray, np.ndarray]:
    """Slopes p of the log evidence by shares at places about a fit, and 1 + q, q its curvatures."""
    J = slopes_at(setting, f.state)
    target, W = f.state.difference + J @ f.sizes, J * scale_of(setting, f)
    half = forward(root_of_information(W, W.T @ W, np.ones(W.shape[1])), W.T)
    G = _columns(setting, f.state, places)
    apart, own = half @ G, half @ target
    return G.T @ target - apart.T @ own, 1 + np.maximum((G**2).sum(axis=0) - (apart**2).sum(axis=0), 0.0)


def _fitted(setting: Setting, place: Place, size: float, prior: float, best_else: float) -> tuple[float, float]:
    r"""The likeliest share beside the general inaccuracy, and its log probability.

    About a fit with the share ``u`` over its usual size the log evidence is
    :math:`L(u) + p\,\delta - \tfrac12 q\,\delta^2` of a share larger by :math:`\delta`, all parts of the inaccuracy
    following it. With the normal ``u`` before the data its integral is
    :math:`L(u) - \tfrac12u^2 + \tfrac12(p-u)^2/(1+q) - \tfrac12\ln(1+q)`, and the next ``u`` its top: Laplace's
    method, exact where the problem is linear.
    """
    f, value = None, -math.inf
    for _ in range(STEPS):
        at = place.at(setting, size)
        again = fit(at, start=f, temperatures=TEMPERATURES if f is None else (), best_else=best_else - prior)
        if again is None:
            break
        f = again
        pulls, informations = _pulls(at, f, [place])
        pull, information = float(pulls[0]) - size, float(informations[0])
        value = f.log_evidence - 0.5 * size**2 + 0.5 * pull**2 / information - 0.5 * math.log(information)
        size += pull / information
        if pull**2 < information * SETTLED:
            break
    return size * place.usual, value + prior
