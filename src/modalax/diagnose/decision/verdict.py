"""The verdict: clean, named, ambiguous or unknown."""

from modalax.diagnose.causes.base import ElementCause
from modalax.diagnose.decision.posterior import Ranked
from modalax.diagnose.fitting.hypothesis import Hypothesis

CERTAIN = 0.95  # posterior from which a single name is given
RIVAL = 0.005  # posterior below which a rival is not worth naming
LEFT = 0.002  # chance under noise below which a residual is said to hold something more
LEFT_BY_SEVERAL = 0.01  # the same where several causes are needed
PLACED = 0.5  # posterior of each place beyond which sure names are given: likelier there than anywhere else
ELSEWHERE = 0.05  # probability from which another place is told beside the named one


def _verdict(ranked: list[Ranked], left: float) -> str:
    """Named only if the names are sure, each place likelier than all others, and nothing hints at something more.

    Two causes together can imitate a third thing, the more so at one place: they must leave less behind.
    """
    best = ranked[0]
    slugs = sorted(slug for slug, _ in best.names)
    if left < LEFT or (len(slugs) > 1 and left < LEFT_BY_SEVERAL):
        return "unknown"
    alike = [r for r in ranked if sorted(slug for slug, _ in r.names) == slugs]
    placed = all(sum(r.probability for r in alike if one in r.names) > PLACED for one in best.names)
    sure = sum(r.probability for r in alike) >= CERTAIN and placed and not _one_joint(best.best)
    return "named" if sure else "ambiguous"


def _one_joint(h: Hypothesis) -> bool:
    """Whether several elements sit at one place: together they may be one joint of a law that no one listed."""
    at = [p.where for c, p in zip(h.causes, h.places, strict=True) if isinstance(c, ElementCause)]
    return len(set(at)) < len(at)


def rivals(verdict: str, ranked: list[Ranked]) -> list[Ranked]:
    """Sets worth telling beside the leading one: other places of what is named, else the next best at least."""
    if verdict == "named":
        return [r for r in ranked[1:] if r.probability >= ELSEWHERE]
    return [r for r in ranked[1:] if r.probability >= RIVAL] or ranked[1:2]
