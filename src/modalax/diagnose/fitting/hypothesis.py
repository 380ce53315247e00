"""Hypotheses, which are causes at places with parameters, and their unknowns in the variables of the search."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from modalax.diagnose.causes.base import Cause, JointCause
from modalax.diagnose.causes.mains_hum import MainsHum
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.causes.signals import HumLines

HIGHEST = 69.0  # logarithm up to which a parameter and its powers are numbers


@dataclass(frozen=True)
class Hypothesis:
    """Causes at places, with parameters that were fitted.

    Attributes
    ----------
    causes, places, extras, params
        One entry a cause.
    theta
        Modal nuisances in units of their spread, shape ``(2, n)``.
    chi2
        Smallest chi-square, prior terms included.
    covariance
        Of the searched parameters (logarithms where a parameter is searched so), nuisances integrated out.
    freedom
        Number of unknowns that the causes cost.
    reason
        Why the search ended.
    hum
        Lines that mains hum reaches, left out of the fit; None without hum.
    fidelity
        Relative error of the predicted effect of a joint once higher harmonics are in it; None where only the
        fundamental is balanced, so that the causes tell theirs.
    since
        Chi-square left when harmonics were found, before the last causes were added; None without such causes.
    """

    causes: tuple[Cause, ...] = ()
    places: tuple[Place, ...] = ()
    extras: tuple[Any, ...] = ()
    params: tuple[np.ndarray, ...] = ()
    theta: np.ndarray | None = None
    chi2: float = np.inf
    covariance: np.ndarray | None = None
    freedom: float = 0.0
    reason: str = ""
    hum: HumLines | None = None
    fidelity: float | None = None
    since: float | None = None

    @property
    def names(self) -> frozenset[tuple[str, tuple[Any, ...]]]:
        """Slugs and places, as the answer tells them."""
        return frozenset((c.slug, p.where) for c, p in self.parts)

    @property
    def parts(self) -> list[tuple[Cause, Place]]:
        """Every cause with its place, hum included."""
        hum: list[tuple[Cause, Place]] = [(MainsHum(), Place(()))] if self.hum is not None else []
        return [*zip(self.causes, self.places, strict=True), *hum]

    @property
    def kind(self) -> tuple[Any, ...]:
        """Causes, and which of them have further data: hypotheses of one kind are fitted side by side."""
        return self.causes, tuple(e is None for e in self.extras)

    @property
    def per_run(self) -> bool:
        """Whether any effect depends on the run."""
        return any(c.per_run for c in self.causes)

    @property
    def joints(self) -> list[int]:
        """Numbers of the causes that are joints with a force law."""
        return [k for k, c in enumerate(self.causes) if isinstance(c, JointCause)]

    @property
    def undetermined(self) -> list[int]:
        """Numbers of the causes of whose parameters none is larger than its own standard deviation.

        Of a joint, which has another law for a limit, each parameter counts by itself. Of any other cause a product may
        be known where its factors are not, as that of noise and impedance where a shaker drops out.
        """
        found, first = [], 0
        for k, (cause, p) in enumerate(zip(self.causes, self.params, strict=False)):
            own = slice(first, first := first + len(p))
            if not len(p) or self.covariance is None:
                continue
            size = np.abs(p / slopes(cause, p))
            variances, some = self.covariance[own, own], size > 0  # what is zero is no larger than any deviation
            relative = variances[np.ix_(some, some)] / np.outer(size[some], size[some])
            alone = isinstance(cause, JointCause) or not np.isfinite(relative).all()
            each = np.diag(relative) if alone else np.linalg.eigvalsh(relative)
            found += [k] if (each > 1).all() and (np.diag(variances)[~some] > 0).all() else []
        return found

    @property
    def limits(self) -> dict[int, str]:
        """Laws that joints cannot be told from, since the data determine none of their parameters."""
        laws = {k: law for k in self.undetermined if isinstance(law := self.causes[k], JointCause)}
        simpler = {k: law.simpler(self.params[k]) for k, law in laws.items()}
        return {k: found[0].slug for k, found in simpler.items() if found is not None}

    @property
    def at_limits(self) -> list[tuple[str, tuple[Any, ...]]]:
        """Slugs and places with :attr:`limits` in the place of such joints; empty where there is none."""
        limits = self.limits
        return [(limits.get(k, c.slug), p.where) for k, (c, p) in enumerate(self.parts)] if limits else []

    @property
    def told(self) -> float:
        """Relative error of the predicted effect by one harmonic, as the laws tell it."""
        return max((c.fidelity for c in self.causes), default=0.0)

    @property
    def index(self) -> np.ndarray:
        """Places as numbers, shape ``(cause, 3)``."""
        return np.array([p.index for p in self.places], dtype=np.int64).reshape(-1, 3)

    def with_cause(self, cause: Cause, place: Place, extra: Any, p: np.ndarray) -> "Hypothesis":
        """The hypothesis with one more cause, not fitted yet; what is known of a joint's harmonics stays known."""
        since = self.chi2 if self.fidelity is not None and self.since is None else self.since
        return replace(
            self, causes=(*self.causes, cause), places=(*self.places, place), extras=(*self.extras, extra),
            params=(*self.params, np.asarray(p, float)), chi2=np.inf, covariance=None, since=since,
        )  # fmt: skip


def with_item(items: tuple, k: int, new: Any) -> tuple:
    """The items with another one at number k."""
    return (*items[:k], new, *items[k + 1 :])


def to_search(cause: Cause, p: np.ndarray) -> np.ndarray:
    """Parameters ``(parameter,)`` in the variables of the search, which are logarithms where a parameter says so."""
    return np.array([q.searched(v) for q, v in zip(cause.parameters, p, strict=True)])


def from_search(cause: Cause, u: Any) -> Any:
    """Parameters from the variables of the search, shape ``(..., parameter)``: NumPy's of NumPy's, else JAX's."""
    log, relative = (np.array([getattr(q, kind) for q in cause.parameters], bool) for kind in ("log", "relative"))
    xp: Any = np if isinstance(u, np.ndarray) else jnp
    if not len(log):
        return u
    within = xp.minimum(xp.where(log | relative, u, 0.0), HIGHEST)
    value = xp.where(log, xp.exp(within), u)
    return xp.where(relative, xp.expm1(within), value) if relative.any() else value


def slopes(cause: Cause, p: np.ndarray) -> np.ndarray:
    """Derivatives of parameters by the variables of the search, both of shape ``(parameter,)``."""
    return np.array([q.slope(v) for q, v in zip(cause.parameters, p, strict=True)])


def split(causes: Sequence[Cause], u: Any) -> list[Any]:
    """Searched unknowns of each cause."""
    out, k = [], 0
    for cause in causes:
        n = len(cause.parameters)
        out.append(u[k : k + n])
        k += n
    return out


def bounds_of(causes: Sequence[Cause]) -> tuple[np.ndarray, np.ndarray]:
    """Limits of the searched unknowns."""
    every = [q for cause in causes for q in cause.parameters]
    return np.array([q.searched(q.lower) for q in every]), np.array([q.searched(q.upper) for q in every])


def searched(h: Hypothesis) -> np.ndarray:
    """All unknowns of a hypothesis as searched."""
    parts = [to_search(c, p) for c, p in zip(h.causes, h.params, strict=True)]
    return np.concatenate([np.zeros(0), *parts])
