"""Noise for the weights of a fit: given, smoothed, or estimated from the residual."""

from typing import Any

import numpy as np
from jaxtyping import Array, Float

from modalax._numerics.checks import as_array
from modalax.data.frf import DERIVATIVES, FRF
from modalax.identify.kernels import kernels, residual_terms
from modalax.identify.refine import UNIT, Refined

STEPS = 60  # steps in which the two parts of a variance are fitted
SEVERAL = 2**21  # samples above which channels share the course of proportional noise
WORK = 2**29  # samples times squares of modes above which they do so too, for the refinement's sake
LEAST = 0.2  # part of the noise that is taken to be left at least
DEPENDENT = 1e-8  # part of a column that those before it leave, below which it fits nothing of its own
SAMPLES = 32  # samples on either side of a line, at least, from which its noise is estimated
ENOUGH = 32  # repeats from which on a variance needs no smoothing


def smooth_variance(frf: FRF) -> FRF:
    r"""The FRF with a variance fit for weights: smoothed along frequency where few repeats made it noisy.

    A variance from ``M`` repeats has a relative standard deviation of :math:`1/\sqrt{M-1}`; as a weight it would
    let lines dominate that are quiet by chance. Averages over ``2 w + 1`` lines bring it down to that of at least
    ``ENOUGH`` repeats. An all-zero variance is no variance.
    """
    if frf.variance is None or not bool((frf.variance > 0).any()):
        return frf.replace(variance=None)
    if frf.averages is None or frf.averages >= ENOUGH:
        return frf
    half = int(np.ceil(0.5 * ENOUGH / max(frf.averages - 1, 1)))
    return frf.replace(variance=_running_mean(np.asarray(frf.variance), half))


def residual_sigma(frf: FRF, refined: Refined, sigma: Any, proportional: bool = False) -> Float[Array, "f o i"]:
    r"""Standard deviation of each sample from the residual: a size a channel times a course, and a part of the FRF.

    .. math:: v_{kc} = a_c\,g_k + b\,|\hat H_{kc}|^2

    The course :math:`g` over frequency is a running mean square over the lines, shared by the channels of the longer
    axis, where :func:`several` and not ``proportional`` by all. With ``proportional`` the second term, noise or model
    error in proportion to the response, is fitted too, by maximum likelihood of the residual's power (where
    :func:`several` with the mean response over the longer axis for that of each channel); else :math:`b = 0`, the safer
    choice while modes are still missing.

    Noise and model error are not told apart. A floor at a tenth of the typical deviation keeps lines from dominating
    that the model passes through by chance.

    Notes
    -----
    A non-negative factorisation in Itakura and Saito's divergence, by the multiplicative steps of Fevotte, Bertin and
    Durrieu (2009).
    """
    H = np.asarray(frf.H)
    scale = UNIT * np.sqrt(np.mean(np.abs(H) ** 2))
    if not isinstance(sigma, str):
        weight = np.asarray(sigma)
        scale = weight * UNIT * np.sqrt(np.mean(np.abs(H / weight) ** 2))
    s, poles = float(frf.added_decay) + 1j * np.asarray(frf.omega), np.asarray(refined.model.poles)
    weigh = sigma if not isinstance(sigma, str) else 1.0
    left = left_by_fit(s, DERIVATIVES[frf.form], poles, H.shape, weigh)
    return as_array(sigma_of_error(H, np.asarray(refined.residual) * scale, proportional, len(poles), left))


def several(samples: int, modes: int) -> bool:
    """Whether weights of each channel's own, or a search for the last digit, would take a refinement too long."""
    return samples > SEVERAL or samples * modes**2 > WORK


def left_by_fit(
    s: np.ndarray, power: int, poles: np.ndarray, shape: tuple[int, ...], sigma: Any = 1.0, residuals: str = "complex"
) -> Float[np.ndarray, "f 1 1"]:
    r"""Part of the noise's power that a fit of some modes leaves around each line, the rest being fitted.

    A residual has the variance :math:`(1-h_k)\sigma_k^2` with the leverage :math:`h_k` of its line, which is that of
    the residual terms, of the residues, :math:`n_o+n_i-1` complex numbers a mode for :math:`n_on_i` channels, and of
    the pole, which all channels share. What a fit leaves of more than ``SAMPLES`` outputs or inputs is error of the
    model more than noise, and is taken as it is.

    Parameters
    ----------
    s, power, residuals
        Where the FRFs were measured [1/s], shape ``(f,)``, their number of time derivatives, and the residual terms.
    poles
        Of the modes, shape ``(n,)`` [rad/s].
    shape
        Of the FRFs, ``(f, o, i)``.
    sigma
        Standard deviations that weighed the samples, of that shape.
    """
    if max(shape[1:]) > SAMPLES:
        return np.ones((shape[0], 1, 1))
    terms, n = residual_terms(s, power, residuals), len(poles)
    channels = shape[1] * shape[2]
    part = np.repeat([1.0, (shape[1] + shape[2] - 1) / channels, 1 / channels], [terms.shape[1], 2 * n, 2 * n])
    weight = np.sqrt(np.mean(1 / np.broadcast_to(sigma, shape) ** 2, axis=(1, 2)))
    columns = np.concatenate([terms, kernels(s, power, poles)], axis=1) * weight[:, None]
    columns = np.concatenate([columns.real, columns.imag])
    Q, R = np.linalg.qr(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
    own = Q**2 @ (part * (np.abs(np.diag(R)) > DEPENDENT))
    half = _window(shape)
    return np.maximum(_running_mean(1 - own.reshape(2, -1).mean(axis=0), half), LEAST)[:, None, None]


def _window(shape: tuple[int, ...]) -> int:
    """Lines on either side over which the course of noise is a mean over ``SAMPLES`` or more; FRFs of some shape."""
    return max(8, shape[0] // 60, min(SAMPLES // max(shape[1:]), shape[0] // 8))


def sigma_of_error(
    H: np.ndarray, error: np.ndarray, proportional: bool = False, modes: int = 1, left: Any = 1.0
) -> np.ndarray:
    """Standard deviation of each sample ``(f, o, i)`` from what some modes leave; see :func:`residual_sigma`.

    The part of the noise that they leave around each line is ``left``, from :func:`left_by_fit`.
    """
    power = np.abs(error) ** 2 / left
    axis = 2 if H.shape[2] > H.shape[1] else 1  # the longer axis, whose channels share a course over frequency
    half = _window(power.shape)
    size = np.maximum(np.median(power, axis=(0, 3 - axis), keepdims=True), 1e-300)
    many = several(power.size, modes)
    # While modes are sought the channels of a large set share one course, so that they have a basis in common.
    over = (1, 2) if many and not proportional else axis
    course = _running_mean(np.mean(power / size, axis=over, keepdims=True), half)
    course = np.maximum(course, 1e-2 * np.median(course, axis=0, keepdims=True))
    rounding = (1e-13 * np.abs(H).max()) ** 2 + 1e-300
    variance = np.broadcast_to(course * size, power.shape)
    if proportional and many:
        variance = _alike(power + rounding, np.abs(H - error) ** 2, course, size, axis, half)
    elif proportional:
        variance = _two_parts(power + rounding, np.abs(H - error) ** 2, course, axis, half)
    variance = np.maximum(variance, rounding)
    return np.sqrt(variance)


def _alike(
    power: np.ndarray, response: np.ndarray, course: np.ndarray, size: np.ndarray, axis: int, half: int
) -> np.ndarray:
    """Variances :math:`a_c(g_k + b h_k)` with the mean response :math:`h` of the channels of the longer axis.

    Weights whose course the channels share cost a refinement as much as one channel; of so many the mean is known well.
    """
    mean = lambda a: np.mean(a / size, axis=axis, keepdims=True)
    shared = _two_parts(mean(power), mean(response), course, axis, half)
    return shared * (size * np.mean(power / (shared * size), axis=(0, 3 - axis), keepdims=True))


def _two_parts(power: np.ndarray, response: np.ndarray, course: np.ndarray, axis: int, half: int) -> np.ndarray:
    """Variances ``a g + b response`` of the largest likelihood for exponentially distributed powers.

    The course is piecewise linear between nodes ``half`` lines apart, so that every step raises the likelihood.
    """
    lines = np.arange(len(power))
    nodes = np.linspace(0, len(power) - 1, max(2, round(len(power) / half)))
    hats = np.array([np.interp(lines, nodes, row) for row in np.eye(len(nodes))]).T
    height = np.array([np.mean(course[np.abs(lines - k) <= half], axis=0) for k in nodes])
    course = np.tensordot(hats, height, 1)
    size = np.mean(power / course, axis=0, keepdims=True)
    part = 0.1 * np.mean(power) / np.mean(response)
    inverse, ratio = np.empty_like(power), np.empty_like(power)

    def divide() -> None:
        """One over the variance, and the power over its square."""
        np.multiply(course, size, out=inverse)
        np.multiply(response, part, out=ratio)
        np.add(inverse, ratio, out=inverse)
        np.reciprocal(inverse, out=inverse)
        np.multiply(inverse, inverse, out=ratio)
        np.multiply(ratio, power, out=ratio)

    for _ in range(STEPS):
        divide()
        part *= np.sqrt(np.vdot(ratio, response) / np.vdot(response, inverse))
        divide()
        size = size * np.sqrt(
            np.sum(ratio * course, axis=0, keepdims=True) / np.sum(inverse * course, axis=0, keepdims=True)
        )
        divide()
        up, down = (np.sum(t * size, axis=axis, keepdims=True) for t in (ratio, inverse))
        height = height * np.sqrt(np.tensordot(hats.T, up, 1) / np.tensordot(hats.T, down, 1))
        course = np.tensordot(hats, height, 1)
        course = np.maximum(course, 1e-2 * np.median(course, axis=0, keepdims=True))
    return course * size + part * response


def _running_mean(values: np.ndarray, half: int) -> np.ndarray:
    """Mean over up to ``half`` neighbours on either side, fewer at the ends."""
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    n = len(values)
    low = np.maximum(np.arange(n) - half, 0)
    high = np.minimum(np.arange(n) + half + 1, n)
    return (total[high] - total[low]) / (high - low).reshape(-1, *[1] * (values.ndim - 1))
