"""Fits with the modes that a user picks, drops or adds by their frequency."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from modalax.data.frf import FRF
from modalax.identify.host import refine_on_host
from modalax.identify.noise import residual_sigma
from modalax.identify.refine import Refined
from modalax.identify.residues import residues
from modalax.identify.select import select_near
from modalax.identify.tables import PoleTable
from modalax.model.modal import ModalModel, in_order, poles_from

REACH = 0.02  # largest distance of a mode from the frequency that was named, relative to it
DAMPING = 0.01  # damping ratio from which an added mode starts where the diagram has no pole near
AGAIN = 2  # refinements with the noise estimated from the residual, where it is not known


class Choice(NamedTuple):
    """Frequencies [Hz] of the modes to keep alone (``pick``), to leave out (``drop``) and to put in (``add``)."""

    pick: Sequence[float] | None = None
    drop: Sequence[float] = ()
    add: Sequence[float] = ()

    @property
    def any(self) -> bool:
        """Whether anything was chosen."""
        return self.pick is not None or len(self.drop) > 0 or len(self.add) > 0


def choice_of(pick: Any, drop: Any, add: Any, band: tuple[float, float]) -> Choice:
    """A choice of modes by frequency.

    Raises
    ------
    ValueError
        If a frequency is no number in the band, or modes are both picked and dropped.
    """
    lists = [None if f is None else [float(v) for v in np.atleast_1d(f)] for f in (pick, drop, add)]
    for what, values in zip(("pick", "drop", "add"), lists, strict=True):
        for f in values or ():
            if not band[0] <= f <= band[1]:
                raise ValueError(f"{what} names {f:g} Hz; the band is {band[0]:g} to {band[1]:g} Hz")
    if lists[0] is not None and lists[1]:
        raise ValueError("pick keeps only the modes named, so drop has nothing to do; give one of the two")
    return Choice(lists[0], lists[1] or (), lists[2] or ())


def chosen_poles(choice: Choice, poles: Any, table: PoleTable) -> np.ndarray:
    """The poles [rad/s] of the modes chosen, by rising frequency.

    Parameters
    ----------
    choice
        What is asked for.
    poles
        Poles found so far, in and beyond the band.
    table
        The diagram, where modes picked or added are looked for.

    Raises
    ------
    ValueError
        If no mode is near a frequency picked or dropped; the message lists those there are.
    """
    poles = np.asarray(poles)
    if choice.pick is not None:
        poles = np.asarray(select_near(table, choice.pick, reach=REACH).poles)
    for f in choice.drop:
        have = np.abs(poles) / (2 * np.pi)
        near = int(np.argmin(np.abs(have - f))) if len(have) else 0
        if not len(have) or abs(have[near] - f) > REACH * f:
            listed = ", ".join(f"{h:.5g}" for h in have)
            raise ValueError(f"no mode within {REACH:.0%} of {f:g} Hz to drop; modes found: {listed} Hz")
        poles = np.delete(poles, near)
    poles = np.concatenate([poles, [_added(f, table, poles) for f in choice.add]])
    if not len(poles):
        raise ValueError("every mode is dropped; keep at least one")
    return poles[np.argsort(np.abs(poles))]


def _added(frequency: float, table: PoleTable, poles: np.ndarray) -> complex:
    """A pole at a frequency: of the diagram where it has one that is not taken, else lightly damped."""
    try:
        pole = complex(select_near(table, [frequency], reach=0.25 * REACH).poles[0])
        if not len(poles) or np.abs(poles - pole).min() > abs(pole.real):
            return pole
    except ValueError:
        pass
    zeta = float(np.median(-poles.real / np.abs(poles))) if len(poles) else DAMPING
    return complex(poles_from([frequency], [max(zeta, 1e-4)])[0])


def fit_chosen(
    frf: FRF, poles: Any, tell: Callable[[str], None], refined: bool, **options: Any
) -> tuple[ModalModel, Refined | None]:
    """The modal model of given poles, and its maximum likelihood if ``refined``; no mode is added or dropped.

    The modes stand in the order of the poles given, also where they change places in frequency.

    Parameters
    ----------
    frf
        The FRF, with its variance where it is known; else the noise is estimated from the residual.
    options
        ``residuals`` and ``real_modes``, as for :func:`modalax.identify.residues.residues`.
    """
    model = residues(frf, poles, **options)
    if not refined:
        return model, None
    tell(f"maximum likelihood of the {len(poles)} modes chosen")
    known = frf.variance is not None
    found = refine_on_host(frf, model, covariance="gauss-newton" if known else "robust", **options)
    sigma: Any = "auto"
    for _ in range(0 if known else AGAIN):
        sigma = residual_sigma(frf, found, sigma)
        found = refine_on_host(frf, found.model, weights=sigma, covariance="robust", **options)
    return found.model, found


def by_frequency(refined: Refined) -> Refined:
    """The result with its modes by rising frequency."""
    order = np.argsort(np.asarray(refined.model.frequency_hz))
    pairs = (2 * order[:, None] + np.arange(2)).ravel()
    mass = refined.modal_mass_std
    return dataclasses.replace(
        refined, model=in_order(refined.model), frequency_std_hz=refined.frequency_std_hz[order],
        damping_std=refined.damping_std[order], shape_std=refined.shape_std[order],
        modal_mass_std=None if mass is None else mass[order], evidence=refined.evidence[order],
        covariance=refined.covariance[pairs][:, pairs],
    )  # fmt: skip
