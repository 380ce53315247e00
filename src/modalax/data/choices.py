"""How FRFs are estimated from records: what may be chosen."""

import warnings
from dataclasses import dataclass, fields

EVERY = {"kind", "estimator", "band"}
USED = {
    "hits": {"block", "trigger", "pretrigger", "contact", "remainder", "keep_all", "roving"},
    "multisine": {"period", "skip"},
    "stepped": set(),
    "sweep": set(),
    "blocks": set(),
    "random": {"block", "overlap", "window"},
}
OPTIONS = {"contact": "force-window", "remainder": "exponential", "keep_all": "keep-all"}


@dataclass(frozen=True)
class Reduction:
    """How FRFs are estimated from records; what is None is chosen from the records, and a warning says how.

    Attributes
    ----------
    kind
        ``hits``, ``multisine``, ``stepped`` (a sine, step by step), ``sweep``, ``blocks`` (each record a block) or
        ``random``.
    block
        Length of a block of random excitation, or kept of each hit [s].
    overlap, window
        Of blocks of random excitation: share that the next repeats, taper by its name in ``scipy.signal``.
    estimator
        ``H1``, ``H2`` or ``Hv``.
    band
        Lines to keep [Hz].
    period
        Samples of one period of a periodic force.
    skip
        Periods left out at the start.
    trigger, pretrigger
        Threshold of a hit as a share of the largest force; time before it [s].
    contact
        Duration of the force window from the trigger on [s]; none if None.
    remainder
        What an exponential window leaves at the end of a block, such as 0.01; none if None.
    keep_all
        Keep double hits and overloads.
    roving
        Hits at each point, where the hammer goes from point to point; 0: all at one point.
    """

    kind: str | None = None
    block: float | None = None
    overlap: float = 0.5
    window: str = "hann"
    estimator: str = "H1"
    band: tuple[float, float] | None = None
    period: int | None = None
    skip: int | None = None
    trigger: float = 0.2
    pretrigger: float | None = None
    contact: float | None = None
    remainder: float | None = None
    keep_all: bool = False
    roving: int = 0


def tell_unused(how: Reduction, kind: str) -> None:
    """Warn of choices that do nothing for a kind of excitation.

    Raises
    ------
    ValueError
        If a roving hammer is asked for and the excitation is no hits.
    """
    if how.roving and kind != "hits":
        raise ValueError(f"--roving is for hits; the excitation asked for is {kind}: leave one of the two out")
    set_apart = [f.name for f in fields(how) if getattr(how, f.name) != f.default]
    idle = [f"--{OPTIONS.get(name, name)}" for name in set_apart if name not in EVERY | USED[kind]]
    if idle:
        verb = "does" if len(idle) == 1 else "do"
        warnings.warn(f"{', '.join(idle)} {verb} nothing for excitation by {kind}", stacklevel=3)
