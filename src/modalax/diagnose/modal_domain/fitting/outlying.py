r"""Elements that are off by far more than the others: what stands out among errors that are taken to be alike.

Errors of all elements are normal with one size before the data. Where the data put a few at many times the size that
the others show, one size is wrong for all: that of the others is :math:`1.48` times the median of :math:`|\epsilon_e|`
of those that are known (Hampel 1974), and an element stands out where that size makes its own too unlikely to be one of
so many (Student 1908).
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.special

from modalax._numerics.text import percent
from modalax.diagnose.modal_domain.fitting.fit import Fit, scale_of
from modalax.diagnose.modal_domain.fitting.linear import root_of_information
from modalax.diagnose.modal_domain.fitting.state import Setting, slopes_at

KNOWN = 0.3  # standard deviation of an element's error, relative to that of all before the data, that tells it
FEWEST = 5  # others that are known where their size is
NORMAL = 1.4826  # standard deviation of normal numbers over the median of their sizes
APART = 3.5  # of that from which an element is left out of the others
MOST = 4  # elements of each kind that are told
CHANCE = 1e-4  # that any of so many errors is as large, below which one stands out


@dataclass(frozen=True)
class Outlying:
    """The number of an element among those of its kind, and its relative error with the standard deviation."""

    number: int
    size: float
    std: float


def outlying(setting: Setting, f: Fit, name: str) -> list[Outlying]:
    """Elements whose ``stiffness`` or ``mass`` stands out of the general inaccuracy of a fit, the surest first."""
    a = setting.inaccuracy
    if not a.places.get(name):
        return []
    own, s = np.flatnonzero(a.group_of == a.groups.index(name)), scale_of(setting, f)
    J = slopes_at(setting, f.state, f.causes, f.u)
    half = scipy.linalg.solve_triangular(root_of_information(J, J.T @ J, s), np.diag(s), lower=True)
    std, size = np.sqrt((half[:, own] ** 2).sum(axis=0)), f.sizes[own]
    known = std < KNOWN * s[own]
    if not known.any():
        return []
    others = known & (np.abs(size) < APART * max(NORMAL * float(np.median(np.abs(size[known]))), 1e-300))
    if np.count_nonzero(others) < FEWEST:
        return []
    freedom = int(np.count_nonzero(others))
    usual = np.sqrt((size[others] ** 2).mean())
    tails = 2 * scipy.special.stdtr(freedom, -np.abs(size) / np.hypot(usual, std))
    far = np.flatnonzero(known & ~others & (tails * np.count_nonzero(known) < CHANCE))
    found = [Outlying(int(k), float(size[k]), float(std[k])) for k in far]
    return sorted(found, key=lambda o: -abs(o.size) / np.hypot(usual, o.std))


def outlying_said(setting: Setting, f: Fit) -> list[str]:
    """A sentence on the elements that stand out of a fit's inaccuracy of stiffness or mass; none if none do."""
    told = [
        f"{name} at {' - '.join(setting.inaccuracy.places[name][o.number])} by {'-' if o.size < 0 else '+'}"
        f"{percent(abs(o.size))} (± {percent(o.std)})"
        for name in ("stiffness", "mass") for o in outlying(setting, f, name)[:MOST]
    ]  # fmt: skip
    who = "a few elements are" if len(told) > 1 else "one element is"
    return [f"{who} off by far more than the others: {'; '.join(told)}"] if told else []
