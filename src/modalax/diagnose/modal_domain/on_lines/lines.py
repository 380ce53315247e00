"""The lines of the FRFs that fits to modes are taken on to."""

from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.modal_domain.fitting.state import Setting
from modalax.diagnose.modal_domain.modes.free_residues import Channels

WORK = 3e9  # products for one set of derivatives; of larger problems every so many lines are taken
WORK_BETWEEN = 3e8  # the same where modes are off as those of no elements, of which lines tell no more than modes do


@dataclass(frozen=True)
class Lines:
    """FRFs that a fit is taken on to.

    Attributes
    ----------
    s
        Laplace variable [rad/s], shape ``(f,)``.
    H, weight
        In the form of the measurement, and one over the variance of a real part, shape ``(f, o, i)``.
    order
        Derivatives of the displacement that were measured.
    left
        Chi-square per sample that the measurement's own modes leave.
    whole
        All lines, where these are every so many of them; else None.
    """

    s: np.ndarray
    H: np.ndarray
    weight: np.ndarray
    order: int
    left: float = 1.0
    whole: "Lines | None" = None

    @property
    def samples(self) -> int:
        """Real numbers that count."""
        return 2 * int(np.count_nonzero(self.weight))


def lines_of(channels: Channels, setting: Setting, left: float = 1.0) -> Lines:
    """The FRFs that the modes were identified from; of very many every so many lines."""
    c = setting.coordinates
    o, i = len(c.outputs), len(c.inputs)
    work = len(setting.inaccuracy.group_of) * c.size * (c.size * min(o, i) + o * i)
    most = WORK_BETWEEN if setting.inaccuracy.between_modes else WORK
    step = max(1, int(np.ceil(len(channels.s) * work / most)))
    H, weight = (a.reshape(-1, o, i) for a in (channels.data, channels.weight))
    every = Lines(channels.s, H, weight, channels.order, left)
    return every if step == 1 else replace(every, s=every.s[::step], H=H[::step], weight=weight[::step], whole=every)
