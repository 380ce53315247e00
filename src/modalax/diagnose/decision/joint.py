"""The verdict on a joint that was fitted over force levels together with the modes."""

from collections.abc import Sequence

from modalax.diagnose.thresholds import THRESHOLDS


def joint_verdict(
    names: Sequence[tuple[str, tuple[str, ...]]] | None, probability: float, placed: bool
) -> tuple[str, tuple[str, ...]]:  # fmt: skip
    """Decide, with reasons, where a joint explains the levels.

    Parameters
    ----------
    names
        Laws and places of the leading set; None where no set of laws explains the levels, but a joint without one does.
    probability
        Of that set among all sets of laws.
    placed
        Whether the joint can sit nowhere else.
    """
    if names is None:
        return "unknown", (
            "a joint whose stiffness and loss follow the amplitude explains the force levels and predicts the highest "
            "one, but none of the laws that were compared does",
        )
    laws = " and ".join(slug for slug, _ in names)
    reasons = []
    if probability < THRESHOLDS.certain:
        reasons.append(
            f"the laws {laws} have a probability of {probability:.3g} among those that were compared, less than "
            f"{THRESHOLDS.certain:g}"
        )
    if len(names) > 1:
        reasons.append(f"{laws} at one place may be one joint of another law")
    if not placed:
        reasons.append("where the joint sits is not shown: with the modes free, another place may do as well")
    if reasons:
        return "ambiguous", tuple(reasons)
    return "named", (f"the law {laws} has a probability of {probability:.3g} among those that were compared",)
