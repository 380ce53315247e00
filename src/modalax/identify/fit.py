"""From measured FRFs to a modal model with error bars, in one call."""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from modalax._numerics.checks import as_array
from modalax._numerics.threads import one_thread
from modalax.data.frf import DERIVATIVES, FRF
from modalax.data.measurement import Measurement
from modalax.identify.band import usable_lines
from modalax.identify.bias import predicted_damping_bias
from modalax.identify.chosen import by_frequency, choice_of, chosen_poles, fit_chosen
from modalax.identify.cut_record import cut_notes
from modalax.identify.diagram import ESTIMATORS, diagram
from modalax.identify.flags import HEAVY, Modes, flags_of, grades_of, notes_of, stands_for_two
from modalax.identify.mode_search import diagram_poles, likelihood_rounds, synthesis, with_poles_beyond
from modalax.identify.neighbourhood import Left, judged, left_of, shared_of
from modalax.identify.noise import smooth_variance
from modalax.identify.one_mode import NOTHING_LEFT
from modalax.identify.quality import noise_part, quality_of, scatter_over_orders
from modalax.identify.record_kind import record_of
from modalax.identify.refine import HELD, Refined
from modalax.identify.residues import residues as fit_residues
from modalax.identify.result import Fit
from modalax.identify.select import Selection, best_order
from modalax.identify.settle import pairs_of_one, settle, settle_diagram, with_misfit, with_record, with_seconds
from modalax.identify.shared_noise import shared_notes
from modalax.identify.stabilize import stabilization
from modalax.identify.tables import PoleTable
from modalax.identify.untold_window import window_notes
from modalax.identify.wrong_form import form_notes
from modalax.model.entry import check_frf, check_measured, check_order, refuse_traced
from modalax.model.indicators import mpc
from modalax.model.modal import ModalModel

__all__ = ["ESTIMATORS", "Fit", "fit"]


@one_thread
def fit(
    frf: FRF | Measurement,
    method: str | None = None,
    order: int | None = None,
    refine: bool = True,
    band: tuple[float, float] | None = None,
    *,
    residuals: str = "complex",
    real_modes: bool = False,
    pick: Sequence[float] | None = None,
    drop: Sequence[float] | None = None,
    add: Sequence[float] | None = None,
    without: Sequence[str] | None = None,
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
    pick, drop, add
        Frequencies [Hz] of modes: to fit these alone, to leave out of those found, to put in beside them.
    without
        Names of outputs and inputs to leave out.
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
    check_frf(frf, "fit", several=True)
    refuse_traced(frf, "fit")
    frf = frf.frf if isinstance(frf, Measurement) else frf
    frf = frf if without is None else frf.drop(without)
    frf = frf if band is None else frf.band(*band)
    check_order(order)
    frf, notes = usable_lines(frf, choose=band is None)
    check_measured(frf)
    turned = frf.shape[2] > frf.shape[1]
    name = method or ("plscf" if min(frf.shape[1:]) > 1 else "lscf")
    if name not in ESTIMATORS:
        raise ValueError(f"method is {name!r}; it must be one of {', '.join(ESTIMATORS)}")
    tell("stabilization diagram")
    data = frf.transpose() if turned and name in ("plscf", "lsce", "fdpi") else frf
    table, selection = diagram(data, name, order)
    if selection.poles.size == 0:
        raise ValueError(
            f"no mode lasts over the orders of the diagram between {frf.ends[0]:g} and "
            f"{frf.ends[1]:g} Hz; widen the band or raise the order (now {table.orders[-1]})"
        )
    weighted = smooth_variance(frf)
    choice = choice_of(pick, drop, add, frf.ends)
    refined, left, apart = None, None, set[tuple[float, float]]()
    how = {"residuals": residuals, "real_modes": real_modes}
    if choice.pick is None and not refine:
        model, left = settle_diagram(weighted, selection.poles, apart, **how)
        if selection.sharp:
            poles, _ = with_poles_beyond(table, frf.ends, np.asarray(model.poles))
            model, left = fit_residues(weighted, poles, **how), None
    else:
        model = fit_residues(weighted, selection.poles, **how)
    if choice.pick is None and refine:  # what is picked is all there is to fit
        refined = diagram_poles(weighted, model, table, selection, tell, **how)
        refined = settle(weighted, refined or likelihood_rounds(weighted, model, tell, **how), tell, apart, **how)
        model = refined.model
    if choice.any:
        poles = chosen_poles(choice, model.poles, table)
        model, refined = fit_chosen(weighted, poles, tell, refine, **how)
        left = None
        if refined is not None:
            refined = by_frequency(refined)
            model = refined.model
    tell("summing up")
    return summed_up(frf, weighted, model, refined, table, selection, data is not frf, notes, apart, left)


def summed_up(
    frf: FRF, weighted: FRF, model: ModalModel, refined: Refined | None, table: PoleTable, selection: Selection,
    turned: bool, notes: list[str], apart: set[tuple[float, float]] | None = None, left: Left | None = None,
) -> Fit:  # fmt: skip
    """All that is told of a model: error bars that know misfit, flags, grades, and notes.

    Parameters
    ----------
    frf, weighted
        The FRFs as measured, and with the variance that weighs them.
    model, refined
        The modal model, and the refinement that it is of if there was one.
    table, selection, turned
        The diagram, what was taken from it, and whether outputs and inputs were exchanged for it.
    notes
        Sentences to put first.
    apart
        Pairs of close modes that were told apart before, as :func:`modalax.identify.settle.pairs_of_one` keeps them.
    left
        What the model leaves of the weighted FRFs, if that is known.
    """
    order = best_order(table, selection)
    f = np.asarray(model.frequency_hz)
    inside = (f >= frf.ends[0]) & (f <= frf.ends[1])
    total = float(np.sum(np.abs(np.asarray(frf.H)) ** 2))
    left = left_of(weighted, model) if left is None else left
    residual = left.residual
    judging = judged(weighted, residual)
    unexplained = float(np.sum(np.abs(residual) ** 2)) / total
    held = refined is not None and int(refined.reason_code) == HELD
    record = None if held else record_of(judging, model, residual, np.flatnonzero(inside))
    plain = record if record is not None and record.plain else None
    noise = noise_part(weighted, residual, even=plain is not None)
    seen = np.abs(np.asarray(selection.poles)[None, :] - np.asarray(model.poles)[:, None])
    near = seen.min(axis=1) < np.maximum(2 * np.abs(np.asarray(model.poles).real), 0.005 * np.abs(model.poles))
    score = np.where(near, np.asarray(selection.score)[seen.argmin(axis=1)], 0.0)
    collinearity = mpc(model.along_longer_side().shapes)
    scatter = scatter_over_orders(table, np.asarray(model.poles))
    quality = quality_of(judging, model, left)
    if held:  # what is left there comes from beyond the band, and says nothing against these poles
        quality = [q._replace(rest=NOTHING_LEFT) for q in quality]
        # Neither do the flanks; but inputs or outputs that disagree do so whatever lies beyond.
        refined = None if refined is None else with_misfit(refined, [q._replace(lines=None) for q in quality])
    elif refined is not None:
        refined = with_misfit(refined, quality)
        widths = (-np.asarray(model.poles.real) / (2 * np.pi)).tolist()
        two = [record is None and stands_for_two(q, w) for q, w in zip(quality, widths, strict=True)]
        refined = with_seconds(refined, quality, np.array(two))
    deviations = scatter if refined is None else (refined.frequency_std_hz, refined.damping_std)
    pairs = []
    if not held:
        background = np.asarray(model.damping_ratio) > HEAVY  # which no mode is a part of
        if selection.sharp:
            background |= ~np.asarray(inside)  # what the diagram has there besides modes
        gains = np.array([q.gain for q in quality])
        pairs = pairs_of_one(judging, model, gains, background, apart or set(), plain is not None, left)
    modes = Modes(
        judging, model, np.asarray(deviations[0]), np.asarray(deviations[1]), refined is not None, score,
        np.asarray(collinearity), quality, plain, pairs,
    )  # fmt: skip
    grades = grades_of(modes)
    return Fit(
        frf=frf,
        model=model,
        inside=as_array(inside),
        table=table,
        stability=stabilization(table),
        selection=selection,
        refined=None if refined is None else with_record(refined, record),
        predicted_damping_bias=_bias(frf, weighted, model, table, order, turned),
        mpc=collinearity,
        stability_score=as_array(score),
        energy=as_array(np.asarray(_energies(model, frf)) / total),
        unexplained=as_array(unexplained),
        noise=as_array(noise),
        frequency_scatter_hz=as_array(scatter[0]),
        damping_scatter=as_array(scatter[1]),
        grade=as_array(grades),
        order=order,
        flags=flags_of(modes),
        notes=(
            *notes,
            *form_notes(weighted, model, np.where(inside, grades, 0.0), unexplained - noise),
            *window_notes(judging, model, left),
            *cut_notes(weighted, model, np.where(inside, grades, 0.0)),
            *shared_notes(shared_of(weighted, residual)),
            *notes_of(modes, grades, noise, unexplained),
        ),
    )


def _bias(
    frf: FRF, weighted: FRF, model: ModalModel, table: PoleTable, order: int, turned: bool
) -> Float[Array, " n"] | None:
    """Predicted bias of the diagram's own damping, where its estimator and the noise are known."""
    if table.method not in ("lscf", "plscf") or weighted.variance is None:
        return None
    clean = synthesis(model, frf).replace(variance=weighted.variance)
    clean = clean.transpose() if turned else clean
    bias = predicted_damping_bias(clean, model.poles, order, method=table.method, numerator=table.orders[-1])
    return jnp.where(bias.valid, bias.damping, jnp.nan)


@eqx.filter_jit
def _energies(model: ModalModel, frf: FRF) -> Float[Array, " n"]:
    s = frf.added_decay + 1j * frf.omega
    power = DERIVATIVES[frf.form]
    kernel = jnp.sum(jnp.abs(s[:, None] ** power / (s[:, None] - model.poles)) ** 2, axis=0)
    return kernel * jnp.sum(jnp.abs(model.shapes) ** 2, axis=1) * jnp.sum(jnp.abs(model.participation) ** 2, axis=1)
