"""Maximum-likelihood refinement of poles, participation, shapes and residual terms together."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from modalax._numerics.checks import as_array, is_traced
from modalax._numerics.known import host, joined
from modalax._numerics.levenberg import LevenbergMarquardt
from modalax.data.frf import FRF
from modalax.identify.kernels import GROWING, UNDAMPED
from modalax.identify.likelihood import Parts, frozen_slots, make_problem, objective, pack, parts, unpack
from modalax.identify.overview import of_refined
from modalax.identify.residues import model_of
from modalax.identify.sample_weights import check_size, sigma_of
from modalax.identify.shape_errors import shape_errors, spread_rest
from modalax.model.entry import check_frf
from modalax.model.modal import ModalModel

REASONS = (
    "the likelihood has a maximum here",
    "the search ran out of steps; start nearer, or fit fewer modes",
    "the likelihood of the start is not finite for this data",
    "a mode lost its damping: the data shows no resonance at its frequency",
    "a mode left the neighbourhood of its start, the frequency moved by more than five half-bandwidths",
    "no single linear model explains all FRFs: the poles of some modes are fitted where these modes dominate",
    "the poles are those of the diagram, which knows them better than a modal model of the band fits the FRFs",
)
REACH = 2.0  # distance from the band, in half-bandwidths, beyond which a mode keeps the damping of its start
MANY = 20  # number of rows from which on the scatter of their scores shows how much rows differ
CORRELATED = 1e-3  # p-value of the whiteness test below which lines are taken to be correlated
OUT_OF_STEPS, CONTRADICTION, HELD = 1, 5, 6  # indices of their reasons
COVARIANCES = ("gauss-newton", "sandwich", "robust")
ALLOWED = 5.0  # standard deviations of chi-square by which it may be too large before errors are scaled by it
UNIT = 1e-9  # standard deviation assumed where none is known, relative to the FRF


class Refined(eqx.Module):
    r"""Result of :func:`refine`.

    Attributes
    ----------
    model
        The modal model of largest likelihood, shapes with their largest component 1.
    frequency_std_hz, damping_std
        Standard deviation of each natural frequency [Hz] and damping ratio [-], shape ``(n,)``.
    shape_std
        Standard deviation of real and imaginary part of each shape component, as one complex number, ``(n, o)``.
    modal_mass_std
        Standard deviation of the real part of the modal mass [kg], shape ``(n,)``; None without a drive point.
    covariance
        Covariance of :math:`(\ln\omega, \ln\zeta)` of all modes, shape ``(2 n, 2 n)``.
    noise_scale
        Root of the residual's sum of squares a degree of freedom: near 1 where the variances are right; where there
        was none, the standard deviation of the FRF's complex samples itself.
    evidence
        By how much the sum of squares would rise without each mode, shape ``(n,)``: about twice the number of
        outputs for a mode that is not there.
    chi2, dof
        Sum of squares of the whitened residual (real and imaginary parts), and its degrees of freedom.
    whiteness
        p-value of the hypothesis that the whitened residual is uncorrelated from line to line.
    log_likelihood
        Up to a constant of the data.
    residual
        Whitened residual, complex with unit variance, shape ``(f, o, i)``.
    success
        Whether a maximum was found, or what stands for one where no linear model makes all FRFs.
    reason_code
        Index of the reason in ``REASONS``.
    steps
        Iterations.
    """

    model: ModalModel
    frequency_std_hz: Float[Array, " n"]
    damping_std: Float[Array, " n"]
    shape_std: Array
    modal_mass_std: Float[Array, " n"] | None
    covariance: Float[Array, "p p"]
    evidence: Float[Array, " n"]
    noise_scale: Float[Array, ""]
    chi2: Float[Array, ""]
    dof: Float[Array, ""]
    whiteness: Float[Array, ""]
    log_likelihood: Float[Array, ""]
    residual: Array
    success: Bool[Array, ""]
    reason_code: Int[Array, ""]
    steps: Int[Array, ""]

    def __str__(self) -> str:
        """The table of modes, how the search ended and how well the model fits."""
        return of_refined(self)

    @property
    def reason(self) -> str:
        """Why the search ended, in words."""
        return REASONS[int(self.reason_code)]


def refine(
    frf: FRF,
    model: ModalModel,
    *,
    residuals: str = "complex",
    real_modes: bool = False,
    weights: str | Float[Array, "f o i"] = "auto",
    covariance: str = "gauss-newton",
    scale_errors: str = "auto",
    max_steps: int = 60,
    slots: int | None = None,
) -> Refined:
    r"""Maximise the likelihood of the noise-weighted FRFs, :math:`\min_\theta \sum 2|H - \hat H(\theta)|^2/\sigma^2`.

    Shapes and residual terms are eliminated where they are linear (variable projection), so the search runs over
    :math:`\ln\omega`, :math:`\ln\zeta` and participation only, all real; stability of the poles is built in.
    Modes that start more than two half-bandwidths outside the band keep their damping, which the band does not tell.

    Parameters
    ----------
    frf
        The FRF in the band, with its variance where there is one.
    model
        The start: poles and participation count, its shapes do not. Unstable poles start from 0.1 % damping.
    residuals, real_modes, weights
        As for :func:`residues`.
    covariance
        ``gauss-newton`` (inverse information: right for the stated noise), ``sandwich`` (right for other noise
        too, as long as the samples are independent), or ``robust`` (the larger of the two; and where the residual is
        not white, also that of scores summed over neighbouring lines, or over whole rows where there are many).
    scale_errors
        ``auto``: errors are scaled by the residual where there is no variance, or where the residual is larger than
        the variance explains (by more than five standard deviations); ``never``; ``always``.
    max_steps
        Most iterations.
    slots
        Number of modes to compile for, so that fits of fewer modes share one compiled function; the number of modes
        if None.

    Returns
    -------
    Refined
        With standard deviations of everything, tests of the residual, and a reason if it failed.

    Raises
    ------
    ValueError
        If there are more unknowns than samples, an option is unknown, or an input is not in the model.

    Notes
    -----
    Golub and Pereyra (1973); Kaufman (1975); Guillaume, Verboven and Vanlanduit (1998) for modal analysis. White
    (1982) for the sandwich; Newey and West (1987), Liang and Zeger (1986) for its sums over lines and rows. The roles
    of outputs and inputs are exchanged where there are more inputs than outputs.
    """
    check_frf(frf, "refine")
    if covariance not in COVARIANCES:
        raise ValueError(f"covariance is {covariance!r}; it must be gauss-newton, sandwich or robust")
    if scale_errors not in ("auto", "never", "always"):
        raise ValueError(f"scale_errors is {scale_errors!r}; it must be auto, never or always")
    check_size(frf, model.poles.shape[0], residuals)
    model = _at_inputs(model, frf.inputs)
    sigma = sigma_of(frf, weights)
    known = frf.variance is not None and isinstance(weights, str) and weights != "unit"
    if not known:  # far below the data, so that the search ends at rounding whatever the unit
        sigma = sigma * UNIT * jnp.sqrt(jnp.mean(jnp.abs(frf.H / sigma) ** 2))
    frf, turned = frf.without_statistics(), frf.shape[2] > frf.shape[1]
    if turned:
        frf, model, sigma = frf.transpose(), model.transpose(), jnp.swapaxes(sigma, 1, 2)
    n = model.poles.shape[0]
    empty = max((slots or n) - n, 0)
    expected = {"auto": ALLOWED if known else -np.inf, "never": np.inf, "always": -np.inf}[scale_errors]
    asked = Asked(COVARIANCES.index(covariance), expected, known, max_steps)
    result = _refine(
        frf, _padded(model, empty), sigma, residuals, real_modes, jax.tree.map(jnp.asarray, asked), turned,
        _is_shared(sigma), as_array(np.repeat([1.0, 0.0], [n, empty])),
    )  # fmt: skip
    result = _cut(result, n) if empty else result
    return _turned(result) if turned else result


class Asked(NamedTuple):
    """What is asked of a refinement and does not change its program: all are arrays of one number.

    Attributes
    ----------
    covariance
        Index of its kind in ``COVARIANCES``.
    expected
        Standard deviations by which the residual may be larger than the variance explains before it scales the errors.
    known
        Whether there is a variance.
    max_steps
        Most iterations.
    """

    covariance: Any
    expected: Any
    known: Any
    max_steps: Any


def _is_shared(sigma: Array) -> bool:
    """Whether the deviations of all outputs are multiples of one another, as those of a single one are."""
    if sigma.shape[1] == 1:
        return True
    if is_traced(sigma):
        return False
    ratio = np.asarray(sigma) / np.asarray(sigma)[:, :1]
    return bool(np.allclose(ratio, ratio[:1, :, :1], rtol=1e-9, atol=0))


def _padded(model: ModalModel, empty: int) -> ModalModel:
    if not empty:
        return model
    pad = lambda a, value: joined([a, *[value] * empty])
    one = lambda a: np.ones((1, *a.shape[1:]), a.dtype)
    return model.replace(
        poles=pad(model.poles, host(model.poles)[:1]), shapes=pad(model.shapes, one(model.shapes)),
        participation=pad(model.participation, one(model.participation)), frequency_std=0.0, damping_std=0.0,
    )  # fmt: skip


def _at_inputs(model: ModalModel, inputs: tuple[str, ...]) -> ModalModel:
    """The model with the participation of these inputs alone; as it is where there are as many."""
    if model.participation.shape[1] == len(inputs):
        return model
    return ModalModel(model.poles, model.shapes, model.participation_at(inputs), outputs=model.outputs, inputs=inputs)


def _cut(result: Refined, n: int) -> Refined:
    """The result without the empty slots that only pad its arrays."""
    m = result.model
    model = m.replace(
        poles=m.poles[:n], shapes=m.shapes[:n], participation=m.participation[:n], frequency_std=0.0, damping_std=0.0
    )
    mass = None if result.modal_mass_std is None else result.modal_mass_std[:n]
    return dataclasses.replace(
        result, model=model, frequency_std_hz=result.frequency_std_hz[:n], damping_std=result.damping_std[:n],
        shape_std=result.shape_std[:n], modal_mass_std=mass, covariance=result.covariance[: 2 * n, : 2 * n],
        evidence=result.evidence[:n],
    )  # fmt: skip


@eqx.filter_jit
def _refine(
    frf: FRF, model: ModalModel, sigma: Array, residuals: str, real_modes: bool, asked: Asked, turned: bool,
    shared: bool, active: Array,
) -> Refined:  # fmt: skip
    omega0 = jnp.abs(model.poles)
    zeta0 = jnp.where(model.poles.real < 0, jnp.maximum(-model.poles.real / omega0, UNDAMPED), GROWING)
    poles = -zeta0 * omega0 + 1j * omega0 * jnp.sqrt(1 - zeta0**2)
    pivot = jax.lax.stop_gradient(jnp.argmax(jnp.abs(model.participation), axis=1))
    reach = REACH * zeta0 * omega0
    outside = (omega0 + reach < jnp.min(frf.omega)) | (omega0 - reach > jnp.max(frf.omega))
    problem = make_problem(frf, sigma, pivot, residuals, real_modes, active, shared, outside.astype(float))
    part = model.participation.real.astype(jnp.complex128) if real_modes else model.participation
    start = pack(poles, part, pivot)
    solution = optx.minimise(
        objective, LevenbergMarquardt(max_steps=asked.max_steps), start.ravel(), args=problem, has_aux=True,
        max_steps=None, throw=False,
    )  # fmt: skip
    theta = solution.value.reshape(start.shape)
    poles, participation = unpack(theta, pivot)
    found = parts(theta, problem)
    used = jnp.sum(problem.weight[:, : problem.samples] > 0)
    empty = jnp.sum(1 - active)
    unknowns = found.x.size + theta.size - empty * (theta.shape[1] + (1 if real_modes else 2) * found.x.shape[0])
    dof = jnp.maximum(used - unknowns, 1).astype(float)
    chi2 = 2 * jnp.sum(found.cost)
    variance = chi2 / dof
    inflate = jnp.where(variance > 1 + asked.expected * jnp.sqrt(2 / dof), variance, 1.0)
    residual = _complex_rows(found.residual[:, : problem.samples], frf)
    whiteness = whiteness_of(residual)
    cov = _covariance(found, asked.covariance, frozen_slots(problem, theta), inflate, whiteness)
    full = _rescaled(found, inflate)
    q = theta.shape[1]
    pick = (jnp.arange(theta.shape[0])[:, None] * q + jnp.arange(2)[None, :]).ravel()
    std = jnp.sqrt(jnp.maximum(jnp.diag(cov), 0.0)).reshape(theta.shape)
    refined = model_of(found.x, problem, poles, participation, frf)
    shape_std, mass_std, evidence = shape_errors(theta, full, cov, problem.real_modes, refined, pivot, turned)
    if turned:  # the shapes asked for are the participation here, whose errors the covariance holds
        shape_std = spread_rest(std, pivot)
    code = _reason(solution, start, theta, chi2, active, frf.omega)
    return Refined(
        model=refined,
        frequency_std_hz=jnp.exp(theta[:, 0]) / (2 * jnp.pi) * std[:, 0],
        damping_std=jnp.exp(theta[:, 1]) * std[:, 1],
        shape_std=shape_std,
        modal_mass_std=mass_std,
        covariance=cov[pick][:, pick],
        evidence=evidence,
        noise_scale=jnp.sqrt(variance) * jnp.where(asked.known, 1.0, jnp.sqrt(jnp.mean(sigma**2))),
        chi2=chi2,
        dof=dof,
        whiteness=whiteness,
        log_likelihood=-0.5 * chi2 + jnp.sum(jnp.log(jnp.where(problem.weight > 0, problem.weight, 1.0))),
        residual=residual,
        success=code == 0,
        reason_code=code,
        steps=solution.stats["num_steps"],
    )


def _rescaled(found: Parts, inflate: Array) -> Parts:
    return eqx.tree_at(lambda p: p.inverse, found, found.inverse * jnp.sqrt(inflate))


def _covariance(
    found: Parts, kind: Int[Array, ""], frozen: Float[Array, "p p"], inflate: Array, whiteness: Array
) -> Float[Array, "p p"]:
    r"""Inverse of the Gauss-Newton matrix :math:`S`, :math:`S^{-1} B S^{-1}` with the scores' :math:`B`, or both.

    The robust one has the correlations of the sandwich and the largest variance of each unknown.
    """
    S = jnp.sum(found.matrix, axis=0) + frozen
    root = jnp.sqrt(jnp.where(jnp.diag(S) > 0, jnp.diag(S), 1.0))
    inverse = jnp.linalg.inv(S / (root[:, None] * root[None, :])) / (root[:, None] * root[None, :])
    plain = inverse * inflate
    sandwich = inverse @ jnp.sum(found.scores, axis=0) @ inverse

    def robust() -> Array:
        outer = found.gradient.T @ found.gradient if len(found.gradient) >= MANY else jnp.sum(found.lagged, axis=0)
        either = jnp.where(whiteness < CORRELATED, inverse @ outer @ inverse, sandwich)
        own = jnp.where(jnp.diag(either) > 0, jnp.diag(either), 1.0)
        grow = jnp.sqrt(jnp.maximum(jnp.diag(plain) / own, 1.0))
        return either * grow[:, None] * grow[None, :]

    return jax.lax.switch(kind, [lambda: plain, lambda: sandwich, robust])


def _turned(result: Refined) -> Refined:
    """The result for exchanged roles, turned back: the participation there are shapes here."""
    return eqx.tree_at(
        lambda r: (r.model, r.residual),
        result,
        (result.model.transpose().normalised("max"), jnp.swapaxes(result.residual, 1, 2)),
    )


def _complex_rows(residual: Float[Array, "o m"], frf: FRF) -> Array:
    f, o, i = frf.shape
    half = f * i
    z = (residual[:, :half] + 1j * residual[:, half:]) / jnp.sqrt(2.0)
    return jnp.moveaxis(z.reshape(o, f, i), 0, 1)


def whiteness_of(residual: Array, lags: int = 3) -> Float[Array, ""]:
    r"""Portmanteau test, :math:`2N\sum_k|\rho_k|^2 \sim \chi^2` over the first lags of every channel (Box-Pierce)."""
    n = residual.shape[0]
    power = jnp.maximum(jnp.sum(jnp.abs(residual) ** 2, axis=0), 1e-300)
    rho = jnp.stack([jnp.sum(residual[k:] * residual[: n - k].conj(), axis=0) / power for k in range(1, lags + 1)])
    statistic = 2 * n * jnp.sum(jnp.abs(rho) ** 2)
    return jax.scipy.stats.chi2.sf(statistic, 2.0 * lags * power.size)


def _reason(
    solution: optx.Solution, start: Array, theta: Array, chi2: Array, active: Array, omega: Array
) -> Int[Array, ""]:
    moved = jnp.abs(theta[:, 0] - start[:, 0]) > 5 * jnp.maximum(jnp.exp(start[:, 1]), jnp.exp(theta[:, 1])) + 0.02
    finished = solution.result == optx.RESULTS.successful
    # A mode that lies outside the band, and did from the start, the data need not tell.
    began, inside = (
        (active > 0) & (log > jnp.log(jnp.min(omega))) & (log < jnp.log(jnp.max(omega)))
        for log in (start[:, 0], theta[:, 0])
    )
    lost = jnp.any(inside & (theta[:, 1] <= jnp.log(UNDAMPED)))
    code = jnp.where(jnp.any(moved & (began | inside)), 4, 0)
    code = jnp.where(lost, 3, code)
    code = jnp.where(finished, code, 1)
    return jnp.where(jnp.isfinite(chi2) & jnp.all(jnp.isfinite(theta)), code, 2)
