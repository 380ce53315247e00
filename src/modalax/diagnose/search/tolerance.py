r"""What further causes beside a joint must explain before they count: more than the inexactness of its law.

The predicted effect of a joint has a relative error :math:`\varepsilon`: of one harmonic (:attr:`Hypothesis.told`), or
of the harmonics left out (:attr:`Hypothesis.fidelity`). Of a strong effect, :math:`\Delta\chi^2` large, this leaves up
to :math:`\varepsilon^2\Delta\chi^2`, in a shape that some other cause will always take up in part. What further causes
take off within that is therefore no evidence for them.
"""

from collections.abc import Sequence
from dataclasses import replace

from modalax.diagnose.fitting.hypothesis import Hypothesis


def tolerated(h: Hypothesis, null_chi2: float) -> float:
    """Chi-square that the inexactness of the laws of a hypothesis may leave.

    Parameters
    ----------
    h
        Fitted causes.
    null_chi2
        Chi-square of the simulation alone.
    """
    if h.fidelity is None:
        return h.told**2 * max(null_chi2 - h.chi2, 0.0)
    since = h.chi2 if h.since is None else h.since  # what was added then has explained the rest
    return h.fidelity**2 * max(null_chi2 - since, 0.0) + h.told**2 * max(since - h.chi2, 0.0)


def uncounted(h: Hypothesis, fitted: Sequence[Hypothesis], null_chi2: float) -> float:
    """Part of the chi-square that a set takes off which its inexact cause alone may leave by its inexactness.

    Parameters
    ----------
    h
        Fitted causes; of one alone all counts.
    fitted
        All hypotheses that were fitted, the cause alone among them.
    null_chi2
        Chi-square of the simulation alone.
    """
    if len(h.parts) < 2:
        return 0.0
    inexact = {part for part in h.parts if part[0].fidelity > 0}
    alone = [one for one in fitted if len(one.parts) == 1 and one.parts[0] in inexact]
    return max((min(tolerated(one, null_chi2), max(one.chi2 - h.chi2, 0.0)) for one in alone), default=0.0)


def widened(h: Hypothesis, null_chi2: float) -> Hypothesis:
    r"""The hypothesis with the inexactness of its law in its covariance, where one harmonic alone was balanced.

    An error :math:`\varepsilon` of an effect d standard deviations long moves a parameter by up to
    :math:`\varepsilon d` of its own. With more harmonics the covariance holds what is left out already.

    Parameters
    ----------
    h
        Fitted causes.
    null_chi2
        Chi-square of the simulation alone.
    """
    if h.fidelity is not None or h.covariance is None or not h.joints:
        return h
    return replace(h, covariance=h.covariance * (1 + tolerated(h, null_chi2)))
