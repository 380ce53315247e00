r"""Best linear approximation of a slightly non-linear structure, with noise and non-linear distortion told apart.

With a random-phase multisine the FRF of one realisation is :math:`G_{BLA} + G_S + N_G`: the best linear approximation,
a stochastic non-linear distortion that changes with the phases drawn, and noise that changes from period to period.

J. Schoukens, R. Pintelon, T. Dobrowiecki, J. Schoukens, Linear approximation of weakly nonlinear MIMO systems, IEEE
Transactions on Instrumentation and Measurement 54 (2005); R. Pintelon, J. Schoukens, System Identification: A
Frequency Domain Approach, 2nd ed., Wiley-IEEE, 2012, sec. 4.3.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Complex, Float, Int

from modalax._numerics.checks import as_array, as_double
from modalax.data.frf import FRF
from modalax.data.multisine import check_lines
from modalax.data.overview import of_best_linear
from modalax.data.records import quantity


class DetectionLines(eqx.Module):
    r"""Response at lines that were not excited, which holds distortion and noise only.

    Attributes
    ----------
    freq
        Frequency of each line, shape ``(g,)`` [Hz].
    power
        :math:`|X|^2` of the response's complex amplitude, averaged over periods before and over realisations after
        squaring, shape ``(g, o)`` [square of the response's unit]. A sine of amplitude A has :math:`|X| = A`.
    noise
        What noise contributes to that, shape ``(g, o)``; None where there was one period.
    """

    freq: Float[Array, " g"]
    power: Float[Array, "g o"]
    noise: Float[Array, "g o"] | None

    @property
    def distortion(self) -> Float[Array, "g o"]:
        """Power less noise, at least 0 [square of the response's unit]; all the power where noise is unknown."""
        return self.power if self.noise is None else jnp.maximum(self.power - self.noise, 0.0)


class BestLinear(eqx.Module):
    r"""Best linear approximation with its uncertainty split in two.

    Attributes
    ----------
    frf
        :math:`G_{BLA}` at the excited lines. Its ``variance`` is that of noise and distortion together, which is what
        to weigh a fit by; ``averages`` belongs to it.
    noise_variance
        Part of it due to noise, shape ``(f, o, i)``; None where there was one period.
    distortion_variance
        Part of it due to non-linearity, at least 0, shape ``(f, o, i)``; None where the noise is unknown.
    even, odd
        Lines that were not excited, between the first and last that were; odd ones exist on a random-odd grid only.
    """

    frf: FRF
    noise_variance: Float[Array, "f o i"] | None
    distortion_variance: Float[Array, "f o i"] | None
    even: DetectionLines
    odd: DetectionLines

    def __str__(self) -> str:
        """The FRF, and how large noise and distortion are beside it."""
        return of_best_linear(self)


def bla_robust(
    force: Any,
    response: Any,
    fs: float,
    lines: Any,
    *,
    unit: str,
    level: Any = float("nan"),
    outputs: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
) -> BestLinear:
    r"""Best linear approximation from several realisations of several periods each (robust method).

    The scatter of the M realisations' FRFs gives the total variance of their mean,
    :math:`\sum_m|G_m - \bar G|^2/(M(M-1))`; the scatter of periods within each gives the part of noise; the
    difference is distortion. Any multisine grid will do, and any non-linearity whose response to a periodic force has
    the same period.

    Parameters
    ----------
    force
        Forces of each realisation and period in the steady state, shape ``(r, p, t, i)`` [N]. With ``i`` inputs,
        every ``i`` following realisations, the experiments of one :func:`modalax.data.multisine.multisine`, make
        one FRF.
    response
        Responses, shape ``(r, p, t, o)`` [``unit``].
    fs
        Sampling rate [Hz].
    lines
        Excited harmonics of the period, shape ``(k,)``.
    unit
        Unit of the responses: ``m``, ``m/s``, ``m/s^2`` or ``g``; it decides the form of the FRF.
    level, outputs, inputs
        As in :class:`modalax.data.FRF`.

    Raises
    ------
    ValueError
        If shapes do not fit or there are fewer than two realisations for each input.
    """
    force, response = as_double(force, "force"), as_double(response, "response")
    if force.ndim != 4 or response.ndim != 4 or force.shape[:3] != response.shape[:3]:
        raise ValueError(
            f"force has shape {force.shape} and response {response.shape}; they need (r, p, t, i) and (r, p, t, o) "
            "with one r, p and t: realisation, period, sample, channel"
        )
    count, _, samples, n_in = force.shape
    which = check_lines(lines, samples)
    draws = count // n_in
    if count % n_in or draws < 2:
        raise ValueError(
            f"{count} realisations for {n_in} inputs; at least 2 for each input are needed, and the same number for "
            "each (one realisation on a random-odd grid: use bla_fast)"
        )
    form, factor = quantity(unit)
    gaps = _left_out(which, 0), _left_out(which, 1)
    mean, total, noise, distortion, rest = _robust(force, response, which, gaps, factor)
    even, odd = (_detection_lines(gap, fs / samples, *powers) for gap, powers in zip(gaps, rest, strict=True))
    frf = FRF(
        which * fs / samples, mean, form=form, variance=total, level=level, outputs=outputs, inputs=inputs,
        averages=draws,
    )  # fmt: skip
    return BestLinear(frf, noise, distortion, even, odd)


def bla_fast(
    force: Any,
    response: Any,
    fs: float,
    lines: Any,
    *,
    unit: str,
    nearest: int = 4,
    level: Any = float("nan"),
    outputs: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
) -> BestLinear:
    r"""Best linear approximation from one realisation on a random-odd grid (fast method).

    Noise comes from the scatter of the periods. Odd distortion at an excited line is taken to be what the odd lines
    around it that were left out show, the mean of the ``nearest`` ones; even distortion stays on even lines and adds
    nothing. So the variance has about ``nearest`` degrees of freedom for the part of distortion.

    Parameters
    ----------
    force
        Force of each period in the steady state, shape ``(p, t)`` [N].
    response
        Responses, shape ``(p, t, o)`` [``unit``].
    fs, lines, unit, level, outputs, inputs
        As for :func:`bla_robust`.
    nearest
        Number of odd detection lines averaged for each excited line.

    Raises
    ------
    ValueError
        If shapes do not fit, there is one period only, an even line is excited, or fewer than ``nearest`` odd lines
        are left out between the excited ones.
    """
    force, response = as_double(force, "force"), as_double(response, "response")
    if force.ndim != 2 or response.ndim != 3 or force.shape != response.shape[:2]:
        raise ValueError(
            f"force has shape {force.shape} and response {response.shape}; they need (p, t) and (p, t, o) with one p "
            "and t: period, sample, output"
        )
    periods, samples = force.shape
    which = check_lines(lines, samples)
    gaps = _left_out(which, 0), _left_out(which, 1)
    left_out = gaps[1]
    if periods < 2:
        raise ValueError("1 period; at least 2 are needed to tell noise from distortion")
    if (which % 2 == 0).any():
        raise ValueError(f"line {which[which % 2 == 0][0]} is excited and even; the fast method needs odd lines only")
    if left_out.size < nearest:
        raise ValueError(
            f"{left_out.size} odd lines are left out between the excited ones, at least {nearest} are needed: excite a "
            "random-odd grid"
        )
    form, factor = quantity(unit)
    around = np.argsort(np.abs(which[:, None] - left_out), axis=1, kind="stable")[:, :nearest]
    H, noise, distortion, total, rest = _fast(force, response, which, gaps, around, factor)
    even, odd = (_detection_lines(gap, fs / samples, *powers) for gap, powers in zip(gaps, rest, strict=True))
    frf = FRF(
        which * fs / samples, H, form=form, variance=total, level=level, outputs=outputs, inputs=inputs,
        averages=nearest + 1,
    )  # fmt: skip
    return BestLinear(frf, noise, distortion, even, odd)


@jax.jit
def _robust(
    force: Float[Array, "r p t i"],
    response: Float[Array, "r p t o"],
    lines: Int[ArrayLike, " k"],
    gaps: tuple[Int[ArrayLike, " g"], Int[ArrayLike, " h"]],
    factor: Any,
) -> tuple[Array, Array, Array | None, Array | None, list[tuple[Array, Array | None]]]:
    """Mean FRF, its variance in all, of noise and of distortion, and the powers at the lines in the gaps."""
    F, X = _amplitudes(force), factor * _amplitudes(response)
    H, noise = _realisations(F[:, :, lines], X[:, :, lines])
    draws = len(H)
    mean = H.mean(axis=0)
    total = jnp.sum(_square(H - mean), axis=0) / (draws * (draws - 1))
    noise = None if noise is None else noise.mean(axis=0) / draws
    distortion = None if noise is None else jnp.maximum(total - noise, 0.0)
    return mean, total, noise, distortion, [_unexplained(F, X, mean, lines, gap) for gap in gaps]


@jax.jit
def _fast(
    force: Float[Array, "p t"],
    response: Float[Array, "p t o"],
    lines: Int[ArrayLike, " k"],
    gaps: tuple[Int[ArrayLike, " g"], Int[ArrayLike, " h"]],
    around: Int[ArrayLike, "k n"],
    factor: Any,
) -> tuple[Array, Array, Array, Array, list[tuple[Array, Array | None]]]:
    """FRF, its variance by noise, by distortion and in all, and the powers at the lines in the gaps."""
    F, X = _amplitudes(force[None, :, :, None]), factor * _amplitudes(response[None])
    H, noise = _realisations(F[:, :, lines], X[:, :, lines])
    even, odd = (_unexplained(F, X, H[0], lines, gap) for gap in gaps)
    # Clipped after averaging only: clipping each line would make the mean of nothing positive.
    assert noise is not None and odd[1] is not None  # There are two periods or more.
    power = jnp.maximum((odd[0] - odd[1])[around].mean(axis=1), 0.0)
    distortion = power[:, :, None] / _square(F[0, :, lines].mean(axis=1))[:, None]
    return H[0], noise[0], distortion, noise[0] + distortion, [even, odd]


def _square(x: Complex[Array, "..."]) -> Float[Array, "..."]:
    return x.real**2 + x.imag**2


def _amplitudes(record: Float[Array, "r p t c"]) -> Complex[Array, "r p f c"]:
    """Complex amplitude of every line of each period."""
    return jnp.fft.rfft(record, axis=2) * (2 / record.shape[2])


def _realisations(
    F: Complex[Array, "r p f i"], X: Complex[Array, "r p f o"]
) -> tuple[Complex[Array, "m f o i"], Float[Array, "m f o i"] | None]:
    """FRF of each realisation and the variance that noise gives it, from the scatter of its periods."""
    _, periods, _, n_in = F.shape
    # (m, e, p, f, c): the experiments e of one realisation m have one force matrix, F[e, i].
    F, X = (a.reshape(-1, n_in, *a.shape[1:]) for a in (F, X))
    inverse = jnp.linalg.inv(jnp.einsum("mefi->mfie", F.mean(axis=2)))
    H = jnp.einsum("mefo,mfei->mfoi", X.mean(axis=2), inverse)
    if periods == 1:
        return H, None
    rest = X - jnp.einsum("mfoi,mepfi->mepfo", H, F)
    scatter = jnp.sum(_square(rest), axis=2) / (periods * (periods - 1))
    return H, jnp.einsum("mefo,mfei->mfoi", scatter, _square(inverse))


def _left_out(lines: Int[np.ndarray, " k"], parity: int) -> Int[np.ndarray, " g"]:
    """Even (0) or odd (1) lines between the first and the last excited one that were not excited."""
    inside = np.arange(lines[0], lines[-1] + 1)
    return np.setdiff1d(inside[inside % 2 == parity], lines)


def _detection_lines(
    which: Int[np.ndarray, " g"], spacing: float, power: Float[Array, "g o"], noise: Float[Array, "g o"] | None
) -> DetectionLines:
    """The response at lines that were not excited."""
    return DetectionLines(as_array(which * spacing), power, noise)


def _unexplained(
    F: Complex[Array, "r p f i"],
    X: Complex[Array, "r p f o"],
    H: Complex[Array, "k o i"],
    lines: Int[Array, " k"],
    which: Int[Array, " g"],
) -> tuple[Float[Array, "g o"], Float[Array, "g o"] | None]:
    """Power of the response beyond what the force on the lines ``which`` explains, and how much of it is noise.

    A shaker that the structure loads puts some force even on lines that its signal leaves out; its effect is taken out
    to first order, with the FRF interpolated between the excited lines.
    """
    between = jax.vmap(lambda h: jnp.interp(which, lines, h), in_axes=1, out_axes=1)(H.reshape(len(lines), -1))
    rest = X[:, :, which] - jnp.einsum("goi,rpgi->rpgo", between.reshape(-1, *H.shape[1:]), F[:, :, which])
    mean = rest.mean(axis=1, keepdims=True)
    periods = rest.shape[1]
    noise = None
    if periods > 1:
        noise = jnp.mean(jnp.sum(_square(rest - mean), axis=1) / (periods * (periods - 1)), axis=0)
    return jnp.mean(_square(mean[:, 0]), axis=0), noise
