"""Gain of an extended simulation on data that it was not fitted to."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Gain:
    """Prediction of the held-out block by the simulation and by the extended one.

    Attributes
    ----------
    held_out
        What was held out, in words.
    chi2_before, chi2_after
        Per real sample; 1 is what noise alone gives.
    log_likelihood_gain, log_likelihood_gain_std
        In nats, with its standard deviation by resampling blocks of lines.
    missed
        How much worse the parameters of a fit to all data explain the rest than those fitted to the rest alone, as a
        normal variable of the same chance under noise. Not small where the causes are not the true ones.
    chi2_within
        Per real sample of the block after a fit to all data.
    chi2_plain
        Per real sample, by the general inaccuracy alone where causes were found beyond it; by the linear structure
        where a joint was found.
    chi2_unforeseen
        Per real sample, allowing for the errors of all that was fitted without the block; NaN where that is not told.
    preferred
        By how many standard deviations, from blocks of its lines, the block is likelier by ``chi2_plain``'s prediction.
    """

    held_out: str
    chi2_before: float
    chi2_after: float
    log_likelihood_gain: float
    log_likelihood_gain_std: float
    missed: float = 0.0
    chi2_within: float = float("nan")
    chi2_plain: float = float("nan")
    preferred: float = float("inf")
    chi2_unforeseen: float = float("nan")

    def to_dict(self) -> dict[str, Any]:
        """As in the answer's file."""
        return {
            "held_out": self.held_out, "chi2_before": self.chi2_before, "chi2_after": self.chi2_after,
            "log_likelihood_gain": self.log_likelihood_gain,
            "log_likelihood_gain_std": self.log_likelihood_gain_std,
        }  # fmt: skip
