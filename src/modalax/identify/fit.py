"""From measured FRFs to a modal model with error bars, in one call."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from modalax.data.causality import looks_conjugated
from modalax.data.frf import FRF
from modalax.data.measurement import Measurement
from modalax.identify.bias import predicted_damping_bias
from modalax.identify.fdpi import fdpi
from modalax.identify.lsce import lsce
from modalax.identify.lscf import lscf
from modalax.identify.mode_search import diagram_poles, likelihood_rounds, synthesis
from modalax.identify.noise import smooth_variance
from modalax.identify.plscf import plscf
from modalax.identify.refine import Refined
from modalax.identify.residues import residues as fit_residues
from modalax.identify.select import Selection, best_order, select
from modalax.identify.stabilize import Stability, stabilization
from modalax.identify.tables import PoleTable
from modalax.model.indicators import mpc
from modalax.model.modal import ModalModel

ESTIMATORS = {"lscf": lscf, "plscf": plscf, "lsce": lsce, "fdpi": fdpi}
POLES = 40  # poles of the highest order of a first diagram; doubled while the modes fill it


class Fit(eqx.Module):
    """Everything that :func:`fit` found.

    Attributes
    ----------
    frf
        The FRF in the band, as it was fitted.
    model
        The modal model, its modes by rising frequency; modes just outside the band may be among them.
    inside
        Which of the modes lie in the band, shape ``(n,)``.
    table, stability, selection
        The stabilization diagram, its flags, and what was taken from it.
    order
        The order whose poles agree best with their neighbours.
    refined
        The maximum-likelihood result with its error bars; None if it was not asked for.
    predicted_damping_bias
        Bias that noise gives the damping in the diagram's estimator, at ``order``, shape ``(n,)``; NaN where it
        cannot be predicted; None without a noise variance or for other estimators.
    mpc
        Modal phase collinearity of the shapes, or of the participation where there are more inputs than outputs (a
        roving hammer), shape ``(n,)``.
    stability_score
        Part of the orders at which each mode stands in the diagram, shape ``(n,)``; 0 for modes found in the
        residual only.
    energy
        Part of the FRFs' sum of squares that each mode makes, shape ``(n,)``.
    unexplained
        Part of the FRFs' sum of squares that the model does not make.
    """

    frf: FRF
    model: ModalModel
    inside: Bool[Array, " n"]
    table: PoleTable
    stability: Stability
    selection: Selection
    refined: Refined | None
    predicted_damping_bias: Float[Array, " n"] | None
    mpc: Float[Array, " n"]
    stability_score: Float[Array, " n"]
    energy: Float[Array, " n"]
    unexplained: Float[Array, ""]
    order: int = eqx.field(static=True)

    @property
    def score(self) -> Float[Array, " n"]:
        r"""How sure each mode is, the mean of three numbers from 0 to 1: shape ``(n,)``.

        .. math:: \tfrac13\Big(\text{stability} + \mathrm{MPC} + \frac{e_r}{e_r + u}\Big)

        The last compares the mode's part of the sum of squares, :math:`e_r`, with what all modes leave, :math:`u`. A
        mean, because a true mode may well lack one: a weak one energy, one of non-proportional damping collinearity,
        one that was found in the residual stability.
        """
        strength = self.energy / (self.energy + self.unexplained)
        return (self.stability_score + self.mpc + strength) / 3

    def synthesised(self) -> FRF:
        """The model's FRF at the lines of the fit."""
        return synthesis(self.model, self.frf)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, as written by ``modalax fit --json``; what does not exist is None."""
        refined = self.refined
        modes = [self._mode(int(r)) for r in np.flatnonzero(np.asarray(self.inside))]
        return {
            "modes": modes,
            "unexplained": float(self.unexplained),
            "band_hz": [float(self.frf.freq[0]), float(self.frf.freq[-1])],
            "form": self.frf.form,
            "outputs": list(self.frf.outputs),
            "inputs": list(self.frf.inputs),
            "method": self.table.method,
            "order": self.order,
            "refined": refined is not None and bool(refined.success),
            "reason": None if refined is None else refined.reason,
            "noise_scale": None if refined is None else float(refined.noise_scale),
            "whiteness_p": None if refined is None else float(refined.whiteness),
            "modes_outside_band_hz": [float(f) for f in self.model.frequency_hz[~np.asarray(self.inside)]],
        }

    def _mode(self, r: int) -> dict[str, Any]:
        model, refined = self.model, self.refined
        drive = model.drive_points()
        pick = lambda a: None if a is None or not np.isfinite(a[r]) else float(a[r])  # noqa: E731
        mass = np.asarray(model.modal_mass()) if drive else None
        a = np.asarray(model.modal_a()) if drive else None
        pair = lambda z: [float(z.real), float(z.imag)]  # noqa: E731
        return {
            "frequency_hz": float(model.frequency_hz[r]),
            "frequency_std_hz": None if refined is None else pick(refined.frequency_std_hz),
            "damping_ratio": float(model.damping_ratio[r]),
            "damping_ratio_std": None if refined is None else pick(refined.damping_std),
            "predicted_damping_bias": pick(self.predicted_damping_bias),
            "shape": [pair(z) for z in np.asarray(model.shapes[r])],
            "shape_std": None if refined is None else [pair(z) for z in np.asarray(refined.shape_std[r])],
            "participation": [pair(z) for z in np.asarray(model.participation[r])],
            "mpc": float(self.mpc[r]),
            "modal_mass_kg": None if mass is None else pair(mass[r]),
            "modal_mass_std_kg": None if refined is None else pick(refined.modal_mass_std),
            "modal_a": None if a is None else pair(a[r]),
            "drive_point": drive[0] if drive else None,
            "score": float(self.score[r]),
            "stability": float(self.stability_score[r]),
            "energy": float(self.energy[r]),
        }


def fit(
    frf: FRF | Measurement,
    method: str | None = None,
    order: int | None = None,
    refine: bool = True,
    band: tuple[float, float] | None = None,
    *,
    residuals: str = "complex",
    real_modes: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Fit:
    r"""Identify all modes in a band: stabilization diagram, selection, residues, maximum likelihood.

    Modes that last over the orders of the diagram are refined together; then modes that the residual asks for are
    added and modes without evidence dropped, until neither is left. Without a noise variance the noise is estimated
    from the residual, line by line and channel by channel, and the fit repeated with it. FRFs that are all but free of
    noise keep the diagram's poles where modes beyond the band are seen: the same modes then come out of any band.

    Parameters
    ----------
    frf
        The FRFs, or a measurement of one run.
    method
        ``lscf``, ``plscf``, ``lsce`` or ``fdpi``; pLSCF where there are several references, else LSCF.
    order
        Highest model order of the diagram; chosen by the number of modes found if None.
    refine
        Whether to go on to maximum likelihood; without it there are no error bars, and only the diagram counts.
    band
        Frequencies to fit [Hz]; all by default.
    residuals, real_modes
        As for :func:`residues`.
    progress
        Called with a word on each step.

    Returns
    -------
    Fit
        The modes with error bars, the diagram, and the unexplained part.

    Raises
    ------
    ValueError
        If the method is unknown, the band too short, or no mode was found; conjugated FRFs, which have none, are said
        to be.
    """
    tell = progress or (lambda text: None)
    frf = frf.frf if isinstance(frf, Measurement) else frf
    frf = frf if band is None else frf.band(*band)
    if not float(jnp.max(jnp.abs(frf.H))) > 0:
        raise ValueError("the FRFs are zero throughout the band; there is nothing to fit")
    turned = frf.shape[2] > frf.shape[1]
    name = method or ("plscf" if min(frf.shape[1:]) > 1 else "lscf")
    if name not in ESTIMATORS:
        raise ValueError(f"method is {name!r}; it must be one of {', '.join(ESTIMATORS)}")
    tell("stabilization diagram")
    data = frf.transpose() if turned and name in ("plscf", "lsce", "fdpi") else frf
    table, selection = _diagram(data, name, order)
    if selection.poles.size == 0:
        if looks_conjugated(frf):
            raise ValueError(
                "the FRFs look conjugated (time convention e^-jwt), so that every mode is unstable; fit their complex "
                "conjugate: frf.replace(H=frf.H.conj())"
            )
        raise ValueError(
            f"no mode lasts over the orders of the diagram between {float(frf.freq[0]):g} and "
            f"{float(frf.freq[-1]):g} Hz; widen the band or raise the order (now {table.orders[-1]})"
        )
    weighted = smooth_variance(frf)
    model = fit_residues(weighted, selection.poles, residuals=residuals, real_modes=real_modes)
    refined = None
    if refine:
        how = {"residuals": residuals, "real_modes": real_modes}
        refined = diagram_poles(weighted, model, selection.spread, tell, **how)
        refined = refined or likelihood_rounds(weighted, model, tell, **how)
        model = refined.model
    tell("summing up")
    return _summary(frf, weighted, model, refined, table, selection, data is not frf)


def _diagram(frf: FRF, name: str, order: int | None) -> tuple[PoleTable, Selection]:
    """Diagrams of rising highest order, until the modes no longer fill them."""
    lines, n_out, n_in = frf.shape
    size = n_in if name in ("plscf", "lsce") else 1
    lower, upper = float(frf.freq[0]), float(frf.freq[-1])
    margin = 0.05 * (upper - lower)
    poles = POLES
    while True:
        top = order if order is not None else max(2, min(poles // size, lines // 4 - 1))
        if name == "fdpi":
            top = order if order is not None else max(2, min(poles // 2, lines * n_in // (4 * min(n_out, poles))))
        first = 1 if name == "fdpi" else min(2, top)
        step = max(1, top // 40)
        table = ESTIMATORS[name](frf, sorted({*range(first, top + 1, step), top}))
        selection = select(table, band=(max(lower - margin, 0.0), upper + margin))
        full = 2.5 * selection.poles.size * (2 if name == "fdpi" else 1) > top * size
        if order is not None or not full or top >= lines // 4 - 1 or poles >= 4 * POLES:
            return table, selection
        poles *= 2


def _summary(
    frf: FRF, weighted: FRF, model: ModalModel, refined: Refined | None, table: PoleTable, selection: Selection,
    turned: bool,
) -> Fit:  # fmt: skip
    order = best_order(table, selection)
    f = np.asarray(model.frequency_hz)
    inside = (f >= float(frf.freq[0])) & (f <= float(frf.freq[-1]))
    total = float(jnp.sum(jnp.abs(frf.H) ** 2))
    made = synthesis(model, frf)
    seen = np.abs(np.asarray(selection.poles)[None, :] - np.asarray(model.poles)[:, None])
    near = seen.min(axis=1) < np.maximum(2 * np.abs(np.asarray(model.poles).real), 0.005 * np.abs(model.poles))
    score = np.where(near, np.asarray(selection.score)[seen.argmin(axis=1)], 0.0)
    return Fit(
        frf=frf,
        model=model,
        inside=jnp.asarray(inside),
        table=table,
        stability=stabilization(table),
        selection=selection,
        refined=refined,
        predicted_damping_bias=_bias(frf, weighted, made, model, table, order, turned),
        mpc=mpc(model.shapes if frf.shape[1] >= frf.shape[2] else model.participation),
        stability_score=jnp.asarray(score),
        energy=_energies(model, frf) / total,
        unexplained=jnp.sum(jnp.abs(frf.H - made.H) ** 2) / total,
        order=order,
    )


def _bias(
    frf: FRF, weighted: FRF, made: FRF, model: ModalModel, table: PoleTable, order: int, turned: bool
) -> Float[Array, " n"] | None:
    """Predicted bias of the diagram's own damping, where its estimator and the noise are known."""
    if table.method not in ("lscf", "plscf") or weighted.variance is None:
        return None
    clean = made.replace(variance=weighted.variance)
    clean = clean.transpose() if turned else clean
    bias = predicted_damping_bias(clean, model.poles, order, method=table.method, numerator=table.orders[-1])
    return jnp.where(bias.valid, bias.damping, jnp.nan)


def _energies(model: ModalModel, frf: FRF) -> Float[Array, " n"]:
    s = frf.added_decay + 1j * frf.omega
    power = {"receptance": 0, "mobility": 1, "accelerance": 2}[frf.form]
    kernel = jnp.sum(jnp.abs(s[:, None] ** power / (s[:, None] - model.poles)) ** 2, axis=0)
    return kernel * jnp.sum(jnp.abs(model.shapes) ** 2, axis=1) * jnp.sum(jnp.abs(model.participation) ** 2, axis=1)
