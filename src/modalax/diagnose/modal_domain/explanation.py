"""What may explain measured modes, and how likely each explanation is."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.fit import Fit
from modalax.diagnose.modal_domain.prior import Prior


@dataclass(frozen=True)
class Explanation:
    """A set of causes, fitted.

    Attributes
    ----------
    log_posterior
        Log evidence and log prior.
    probability
        Among all explanations that were fitted.
    misfit
        Chi-square per feature of the modes that was left, before all lines were looked at.
    """

    fit: Fit
    log_posterior: float
    probability: float
    misfit: float = 1.0

    @property
    def causes(self) -> tuple[Change, ...]:
        """What stands out."""
        return self.fit.causes


def ranked_by(found: Mapping[tuple[Change, ...], Fit], prior: Prior) -> list[Explanation]:
    """Explanations by falling probability, of fits by their causes."""
    left = {key: f.chi2 / max(f.state.difference.size, 1) for key, f in found.items()}
    return weighed([Explanation(f, f.log_evidence + prior.of(key), 0.0, left[key]) for key, f in found.items()])


def weighed(explanations: Sequence[Explanation]) -> list[Explanation]:
    """Explanations by falling probability, which follows from what each is worth."""
    top = max(e.log_posterior for e in explanations)
    total = sum(math.exp(e.log_posterior - top) for e in explanations)
    ranked = [replace(e, probability=math.exp(e.log_posterior - top) / total) for e in explanations]
    return sorted(ranked, key=lambda e: -e.log_posterior)
