"""The residual of a hypothesis, prepared for scores: the starting point of every screening."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modalax.diagnose.causes.base import Cause
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.comparison import Comparison
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.fitting.residual import complex_of, laid_out
from modalax.diagnose.screening.products import Reduced, as_one, reduce
from modalax.diagnose.screening.screen import nuisance_of
from modalax.diagnose.screening.sensitivities import Residual
from modalax.diagnose.screening.shortlist import MANY, Sketch, likely_swaps, shortlist, sketch
from modalax.diagnose.setup.problem import bucket

SPARE = 4  # directions kept free for the parameters of causes already found


@dataclass(frozen=True)
class ScoreState:
    """Residual of a hypothesis, from which further causes are screened and fitted.

    Attributes
    ----------
    comparison, hypothesis
        Data and simulation, and the hypothesis; at first the simulation alone.
    sides
        Residuals with the runs apart (True) and together (False).
    reduced
        Products of these residuals for causes that are elements; empty where there are none.
    whole
        Whitened residual, complex, shape ``(run, f, o, i)``.
    drop
        Chi-square that the parameters would still take away if they moved to their best.
    shift
        That move of the modal parameters, in units of their spread, shape ``(2, n)``.
    """

    comparison: Comparison
    hypothesis: Hypothesis
    sides: dict[bool, Residual]
    reduced: dict[bool, Reduced]
    whole: np.ndarray
    drop: float
    shift: np.ndarray
    cache: dict[Any, Any] = field(default_factory=dict)

    def nearest(self, cause: Cause, places: list[Any]) -> list[Any]:
        """The places of a cause, of very many those that are worth a look, or those that the comparison asks for."""
        skew, swap = cause.shortlist_by == "coupling", cause.shortlist_by in ("exchange", "exchange of inputs")
        if self.comparison.only and cause.shortlist_by == "element":
            near = {p.index[:2] for p in self.comparison.only}
            return [p for p in places if p.index[:2] in near]
        between_dofs = bool(self.reduced) and cause.shortlist_by in ("element", "coupling")
        if len(places) <= MANY or not (swap or between_dofs):
            return places
        key = (cause.shortlist_by if swap else skew, *alike(places))
        if key not in self.cache:
            if swap:
                problem = self.comparison.problem
                every = (np.asarray(problem.data), np.asarray(problem.weight), self.whole)
                turned = cause.shortlist_by == "exchange of inputs"
                data, weight, residual = (np.swapaxes(x, 2, 3) if turned else x for x in every)
                self.cache[key] = likely_swaps(data, weight, residual, places)
            else:
                self.cache[key] = shortlist(self.reduced[True], self._few(), places, skew)
        return [places[k] for k in self.cache[key]]

    def _few(self) -> Sketch:
        if "few" not in self.cache:
            self.cache["few"] = sketch(self.reduced[True], self.sides[True].nuisance)
        return self.cache["few"]


def alike(places: Sequence[Place]) -> tuple[Any, ...]:
    """A key that is equal for lists of the same directions over the DoFs."""
    return (len(places), places[0].index, places[-1].index) if places else (0,)


def score_state_of(comparison: Comparison, h: Hypothesis, jacobian: np.ndarray | None = None) -> ScoreState:
    """Residual of a hypothesis, with the directions along which it may still move projected out of all scores.

    Parameters
    ----------
    comparison
        Data and simulation.
    h
        The hypothesis.
    jacobian
        Directions of its fitted parameters, shape ``(unknown, o, i, run f 2)``; None without causes.
    """
    assert h.theta is not None
    whole = comparison.residual(h)
    value = laid_out(whole)
    G = nuisance_of(h.theta, comparison)
    width = bucket(len(G) + SPARE)
    more = G[:0] if jacobian is None else jacobian[:width]
    # directions of length zero keep the shapes the same, before and after causes were found
    G = np.concatenate([G, more, np.zeros((max(width - len(G) - len(more), 0), *G.shape[1:]))])
    flat = G.reshape(len(G), -1)
    inner = np.linalg.inv(np.eye(len(G)) + flat @ flat.T)
    # as if the parameters stood exactly where chi-square is least: no score may live on their being slightly off
    slope = flat @ value.ravel()
    slope[: len(comparison.nuisance.live)] -= h.theta.ravel()[comparison.nuisance.live]
    value = value - ((inner @ slope) @ flat).reshape(value.shape)
    apart = Residual(value, G, inner)
    together = Residual(_pooled(comparison, value), _pooled(comparison, G), inner)
    theta = h.theta * comparison.nuisance.spread
    sides = {True: apart, False: together}
    reduced = {}
    if comparison.question == "fixed" and comparison.scene.scaled and comparison.problem.held is None:
        every = reduce(comparison.problem, theta, apart, h)
        reduced = {
            True: every,
            False: every if comparison.pooled is comparison.problem else as_one(every, comparison.pooled),
        }
    shift = np.zeros(h.theta.size)
    shift[comparison.nuisance.live] = (inner @ slope)[: len(comparison.nuisance.live)]
    drop = float(slope @ inner @ slope)
    return ScoreState(comparison, h, sides, reduced, whole, drop, shift.reshape(h.theta.shape))


def _pooled(comparison: Comparison, value: np.ndarray) -> np.ndarray:
    """All runs as one: what a direction that is the same in every run sees."""
    runs = comparison.problem.weight.shape[0]
    if comparison.pooled is comparison.problem:
        return value
    if runs == 1 or not value.size:
        return value[..., : value.shape[-1] // runs]
    weight, total = np.asarray(comparison.problem.weight), np.asarray(comparison.pooled.weight)
    z = (complex_of(value, runs) * weight).sum(axis=-4, keepdims=True) / np.where(total > 0, total, 1.0)
    return laid_out(z)
