"""The cause that leads where the general inaccuracy alone is far from the measured modes, before all else is tried."""

from collections.abc import Callable
from itertools import islice

from modalax.diagnose.deadline import Deadline
from modalax.diagnose.modal_domain.attempts import attempt, explains
from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.exact_places import Finer, Found, made_exact
from modalax.diagnose.modal_domain.explanation import ranked_by
from modalax.diagnose.modal_domain.fit import Fit
from modalax.diagnose.modal_domain.prior import Prior
from modalax.diagnose.modal_domain.starts import FITTED, starts
from modalax.diagnose.modal_domain.state import Setting

UNLIKE = 10.0  # chi-square per feature beside the general inaccuracy from which on a cause is tried before all else
MOSTLY = 0.25  # share of what the simulation leaves, below which a change of the structure explains most of it


def far_off(null: Fit) -> bool:
    """Whether the general inaccuracy alone does not come near to the measured modes."""
    return null.chi2 > UNLIKE * null.state.difference.size


def leading(
    setting: Setting, null: Fit | None, candidates: list[Change], late: Deadline, tell: Callable[[str], None],
    finer: Finer | None,
) -> tuple[Setting, list[Change], Found]:  # fmt: skip
    """The leading causes by finite changes, where one of them explains what the inaccuracy is far from; else nothing.

    Others are then looked for beside it and in its place, and no inaccuracy is, that would do without it.
    """
    if null is None or not far_off(null):
        return setting, candidates, {}
    prior, found = Prior(candidates), {(): null}
    try:
        tell(f"screening {len(candidates)} causes and places")
        for cause, u, start in islice(starts(setting, null, candidates, prior.each(candidates), far=MOSTLY), FITTED):
            attempt(setting, found, (cause,), cause.of_size(u), start, basin=UNLIKE)
            if late():
                break
        exact, there, found = made_exact(setting, candidates, found, finer, tell)
        if explains(ranked_by(found, Prior(there))[0].fit):
            return exact, there, found
    except KeyboardInterrupt:
        late.stop()
    return setting, candidates, {}
