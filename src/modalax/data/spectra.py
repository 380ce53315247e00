r"""From blocks of samples to averaged spectra, and from those to FRFs with their variance.

The model is :math:`x = H(f - n_f) + n_x` for the measured forces f and responses x of each block and line.
"""

from types import ModuleType

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

from modalax._numerics.known import Numbers, by_numpy, solved

ESTIMATORS = ("H1", "H2", "Hv")


class Spectra(eqx.Module):
    r"""Averaged one-sided spectral densities of forces f and responses x.

    Attributes
    ----------
    freq
        Frequency of each line, shape ``(f,)`` [Hz].
    force
        :math:`S_{ff} = E[f f^H]`, shape ``(f, i, i)`` [N^2/Hz].
    cross
        :math:`S_{xf} = E[x f^H]`, shape ``(f, o, i)`` [response times N/Hz].
    response
        :math:`S_{xx} = E|x|^2` of each output, shape ``(f, o)`` [response^2/Hz].
    averages
        Number of independent blocks averaged; no integer where blocks overlap.
    """

    freq: Float[Numbers, " f"]
    force: Complex[Numbers, "f i i"]
    cross: Complex[Numbers, "f o i"]
    response: Float[Numbers, "f o"]
    averages: float = eqx.field(static=True)


def spectral_lines(samples: int, fs: float) -> Float[np.ndarray, " f"]:
    """Frequency lines [Hz] of a block of ``samples``, without 0 Hz and half the sampling rate, which have no phase."""
    return np.arange(1, (samples + 1) // 2) * fs / samples


@by_numpy
def spectra(
    xp: ModuleType,
    force: Float[Numbers, "m t i"],
    response: Float[Numbers, "m t o"],
    window: Float[Numbers, " t"],
    *,
    fs: float,
    averages: float,
) -> Spectra:
    """Average the spectra of blocks, each multiplied by the window first, at :func:`spectral_lines`.

    Parameters
    ----------
    force, response
        Blocks of samples, shapes ``(m, t, i)`` and ``(m, t, o)``.
    window
        Factors ``(t,)``; ones where the blocks are windowed already or need none.
    fs
        Sampling rate [Hz].
    averages
        Number of independent blocks that they are worth; ``m`` unless they overlap.
    """
    samples = force.shape[1]
    lines = slice(1, (samples + 1) // 2)
    F, X = (xp.fft.rfft(a * window[:, None], axis=1)[:, lines] for a in (force, response))
    density, conjugate = 2 / (fs * xp.sum(window**2)), xp.swapaxes(F.conj(), 0, 1)
    return Spectra(
        freq=xp.asarray(spectral_lines(samples, fs)),
        force=density * (xp.transpose(F, (1, 2, 0)) @ conjugate) / len(F),
        cross=density * (xp.transpose(X, (1, 2, 0)) @ conjugate) / len(F),
        response=density * xp.mean(X.real**2 + X.imag**2, axis=0),
        averages=averages,
    )


def input_noise(xp: ModuleType, s: Spectra, estimator: str) -> Float[Numbers, "f o"]:
    r"""Share :math:`\lambda` of each force's power that the estimator takes to be noise.

    0 for H1. For Hv the smallest eigenvalue of the coherency matrix of the forces and one response,

    .. math:: \begin{bmatrix} C_{ff} & c_{fx} \\ c_{xf} & 1 \end{bmatrix},

    and for H2, whose responses are exact, that of its Schur complement :math:`C_{ff} - c_{fx}c_{xf}`. With one input
    these are :math:`1 - |\gamma|` and :math:`1 - \gamma^2`.
    """
    C, c = _coherency(xp, s)
    if estimator == "H1":
        return xp.zeros(c.shape[:2])
    if C.shape[-1] == 1:
        gamma2 = xp.minimum(c[..., 0].real ** 2 + c[..., 0].imag ** 2, 1.0)
        return 1 - (gamma2 if estimator == "H2" else xp.sqrt(gamma2))
    forces = xp.broadcast_to(C[:, None], (*c.shape[:2], *C.shape[1:]))
    if estimator == "H2":
        return xp.linalg.eigvalsh(forces - c.conj()[..., :, None] * c[..., None, :])[..., 0]
    top = xp.concatenate([forces, c.conj()[..., :, None]], axis=-1)
    bottom = xp.concatenate([c, xp.ones((*c.shape[:2], 1))], axis=-1)[..., None, :]
    return xp.linalg.eigvalsh(xp.concatenate([top, bottom], axis=-2))[..., 0]


@by_numpy
def estimate(
    xp: ModuleType, s: Spectra, *, estimator: str = "H1"
) -> tuple[Complex[Numbers, "f o i"], Float[Numbers, "f o i"]]:
    r"""FRF of an estimator and its variance, the noise of the forces taken out of their spectra.

    .. math:: H = S_{xf} G, \qquad \mathrm{var}\,H_{oi} = \frac{S_{ee,o}\,G_{ii}}{M - n_i}, \qquad
              G = (S_{ff} - \lambda\,\mathrm{diag}\,S_{ff})^{-1},

    with :math:`\lambda` by :func:`input_noise` for each output, :math:`S_{ee}` the power of :math:`e = x - Hf` and
    :math:`n_i` inputs. H1 has noise on the responses only, H2 on the forces only, Hv on both with equal shares of
    each channel's power (total least squares, for one input the geometric mean of H1 and H2). Noise of different
    channels is taken as uncorrelated.

    For H1 with one input the variance is :math:`\frac{1-\gamma^2}{\gamma^2}\frac{|H|^2}{M-1}`, an unbiased estimate
    with :math:`2(M - n_i)` degrees of freedom for Gaussian noise; for H2 and Hv it holds to first order in the share
    of noise. It is infinite where there are no more blocks than inputs.

    References
    ----------
    G. T. Rocklin, J. Crowley, H. Vold, A comparison of H1, H2, and Hv frequency response functions, IMAC 3, 1985.
    J. S. Bendat, A. G. Piersol, Random Data, 4th ed., Wiley, 2010, sections 7.3 and 9.1.
    """
    if estimator not in ESTIMATORS:
        raise ValueError(f"estimator is {estimator!r}; it must be one of {', '.join(ESTIMATORS)}")
    C, c = _coherency(xp, s)
    size_f, size_x = _sizes(xp, s)
    share = input_noise(xp, s, estimator)
    if estimator == "H1":
        share = share[:, :1]  # One inverse serves every output.
    inputs = C.shape[-1]
    forces = C[:, None] - share[..., None, None] * xp.eye(inputs)
    inverse = 1 / forces if inputs == 1 else solved(xp, forces, xp.broadcast_to(xp.eye(inputs), forces.shape))
    h = (c[:, :, None, :] @ inverse)[:, :, 0]
    unit = xp.where(s.response > 0, 1.0, 0.0)
    left = unit - 2 * xp.sum(h * c.conj(), axis=-1).real + xp.sum((h @ C) * h.conj(), axis=-1).real
    freedom = max(s.averages - inputs, 0.0)
    spread = xp.diagonal(inverse, axis1=-2, axis2=-1).real
    scale = size_x[:, :, None] / size_f[:, None, :]
    variance = scale**2 * xp.maximum(left, 0.0)[..., None] * spread / freedom
    return scale * h, variance


@by_numpy
def ordinary_coherence(xp: ModuleType, s: Spectra) -> Float[Numbers, "f o i"]:
    r"""Ordinary coherence of each response and force, :math:`\gamma^2_{oi} = |S_{xf,oi}|^2/(S_{xx,o} S_{ff,ii})`."""
    c = _coherency(xp, s)[1]
    return c.real**2 + c.imag**2


@by_numpy
def multiple_coherence(xp: ModuleType, s: Spectra) -> Float[Numbers, "f o"]:
    r"""Share of each response's power that all forces together explain, :math:`S_{xf}S_{ff}^{-1}S_{fx}/S_{xx}`."""
    C, c = _coherency(xp, s)
    h = solved(xp, xp.broadcast_to(C[:, None], (*c.shape, C.shape[-1])), c.conj()[..., None])[..., 0]
    return xp.sum(c * h, axis=-1).real


def _sizes(xp: ModuleType, s: Spectra) -> tuple[Float[Numbers, "f i"], Float[Numbers, "f o"]]:
    """Root of each channel's power; 1 for a channel without any."""
    root = lambda power: xp.sqrt(xp.where(power > 0, power, 1.0))
    return root(xp.diagonal(s.force, axis1=1, axis2=2).real), root(s.response)


def _coherency(xp: ModuleType, s: Spectra) -> tuple[Complex[Numbers, "f i i"], Complex[Numbers, "f o i"]]:
    """Spectra of channels each scaled to power 1."""
    size_f, size_x = _sizes(xp, s)
    return s.force / (size_f[:, :, None] * size_f[:, None, :]), s.cross / (size_x[:, :, None] * size_f[:, None, :])
