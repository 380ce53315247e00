"""How FRFs are estimated from records: what may be chosen."""

from dataclasses import dataclass


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
