"""The result of a fit: modes with standard deviations, flags and grades, and the residual."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from modalax.data.frf import FRF
from modalax.identify.mode_search import synthesis
from modalax.identify.refine import Refined
from modalax.identify.select import Selection
from modalax.identify.stabilize import Stability
from modalax.identify.summary import summary
from modalax.identify.tables import PoleTable
from modalax.model.modal import ModalModel


class Fit(eqx.Module):
    """Result of :func:`fit`.

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
    unexplained, noise
        Part of the FRFs' sum of squares that the model does not make, and the part of it that is noise: by the variance
        where it is known, else what changes from line to line.
    frequency_scatter_hz, damping_scatter
        How much each mode scatters over the higher orders of the diagram, shape ``(n,)``; NaN where it is not in them.
    grade
        How sure each mode is a mode, 0 to 1, shape ``(n,)``; see :func:`modalax.identify.flags.grades_of`.
    flags
        What is to be known of each mode before it is used, in words.
    notes
        Sentences on the measurement as a whole: lines left out, records too short, inputs that disagree.
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
    noise: Float[Array, ""]
    frequency_scatter_hz: Float[Array, " n"]
    damping_scatter: Float[Array, " n"]
    grade: Float[Array, " n"]
    order: int = eqx.field(static=True)
    flags: tuple[tuple[str, ...], ...] = eqx.field(static=True)
    notes: tuple[str, ...] = eqx.field(static=True)

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

    def __str__(self) -> str:
        """The table of modes."""
        return summary(self.to_dict())

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
            "unexplained_noise": float(self.noise),
            "unexplained_misfit": float(self.unexplained) - float(self.noise),
            "notes": list(self.notes),
            "band_hz": list(self.frf.ends),
            "form": self.frf.form,
            "outputs": list(self.frf.outputs),
            "inputs": list(self.frf.inputs),
            "method": self.table.method,
            "order": self.order,
            "refined": refined is not None and bool(refined.success),
            "reason": None if refined is None else refined.reason,
            "noise_scale": None if refined is None else float(refined.noise_scale),
            "whiteness_p": None if refined is None else float(refined.whiteness),
            "modes_outside_band_hz": np.asarray(self.model.frequency_hz)[~np.asarray(self.inside)].tolist(),
        }

    def _mode(self, r: int) -> dict[str, Any]:
        model, refined = self.model, self.refined
        drive = model.drive_points()
        at = lambda a: np.asarray(a)[r]
        pick = lambda a: None if a is None or not np.isfinite(at(a)) else float(at(a))
        mass = np.asarray(model.modal_mass()) if drive else None
        a = np.asarray(model.modal_a()) if drive else None
        pair = lambda z: [float(z.real), float(z.imag)]
        return {
            "frequency_hz": float(at(model.frequency_hz)),
            "frequency_std_hz": None if refined is None else pick(refined.frequency_std_hz),
            "damping_ratio": float(at(model.damping_ratio)),
            "damping_ratio_std": None if refined is None else pick(refined.damping_std),
            "predicted_damping_bias": pick(self.predicted_damping_bias),
            "shape": [pair(z) for z in at(model.shapes)],
            "shape_std": None if refined is None else [pair(z) for z in at(refined.shape_std)],
            "participation": [pair(z) for z in at(model.participation)],
            "mpc": float(at(self.mpc)),
            "modal_mass_kg": None if mass is None else pair(mass[r]),
            "modal_mass_std_kg": None if refined is None else pick(refined.modal_mass_std),
            "modal_a": None if a is None else pair(a[r]),
            "drive_point": drive[0] if drive else None,
            "flags": list(self.flags[r]),
            "grade": float(self.grade[r]),
            "frequency_scatter_hz": pick(self.frequency_scatter_hz),
            "damping_scatter": pick(self.damping_scatter),
            "score": float(self.score[r]),
            "stability": float(self.stability_score[r]),
            "energy": float(self.energy[r]),
        }
