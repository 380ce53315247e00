"""Causes in the processing: a finite record, a window or a fast sweep."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex

from modalax.diagnose.causes.base import KernelCause, WindowCause
from modalax.diagnose.causes.parameter import Parameter, strengths
from modalax.diagnose.causes.scene import Place, Scene

HANN_CURVATURE = 2 * np.pi**2 / 3  # a Hann window's autocorrelation is 1 - this (t/T)^2 at first
RIPPLE, RIPPLES = 0.25, 100  # distance of points in ripples of chi-square, and fewest points on either side
CUT, DECAYED = 2, 10.0  # variant of a record that ends in a step, and the decay beyond which no step is left


class ExponentialWindow(WindowCause):
    r"""The decay an impact window adds, :math:`H(s + \sigma)`."""

    slug = "exponential_window"
    advice = "repeat without the window, or with a longer record"
    summary = "decay added by an impact window"
    parameters = (Parameter("decay", "1/s", 0.0),)

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around the decay of the modes."""
        rate = 2 * np.pi * float(np.median(scene.frequency_hz * scene.damping_ratio))
        return np.array([[rate * x] for x in (1e-4, 0.1, 0.5, 2.0)])

    def shift(self, p: Array) -> Array:
        """Shift of the Laplace variable."""
        return p[0]


class Leakage(KernelCause):
    r"""Finite records of length T: the impulse response is seen through a window that falls with the delay.

    Random force through a boxcar window gives :math:`1 - t/T`, through a Hann window its autocorrelation; an impact
    record that is cut off ends at T; the last is what any smooth window does at first, :math:`H + \beta H''`. The
    variant is the third number of the place.
    """

    slug = "leakage"
    advice = "repeat with a record twice as long"
    fidelity = 0.02
    summary = "finite record length"
    cut_off = CUT
    parameters = (Parameter("inverse_record_length", "Hz", 1e-6, log=True),)

    def places(self, scene: Scene) -> list[Place]:
        """One a window."""
        return [Place((), (0, -1, k)) for k in range(4)]

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Around the line spacing, and where the response ends in a step, at every stage of the decay."""
        step = float(np.median(np.diff(scene.freq))) if len(scene.freq) > 1 else 1.0
        around = [step * x for x in (1.0, 0.1, 0.2, 0.4, 0.7, 1.5, 2.5, 5.0)]
        rates = _decays(scene)
        if place.index[2] == CUT and len(rates):
            # ripples of two lengths over one resonance are alike by exp(-decay |T1 - T2|), those far from it by less
            slow, fast = float(rates.min()), float(rates.max())
            lengths = [*np.geomspace(0.5 / fast, 1 / slow, 6), *(np.arange(1.1, DECAYED, 0.1) / slow)]
            around += [1 / T for T in lengths]
        return np.array(around)[:, None]

    def nearby(self, p: np.ndarray, place: Place, scene: Scene) -> np.ndarray:
        """Lines far from the resonances make chi-square ripple with the length of a record that ends in a step."""
        apart, rates = RIPPLE / (scene.freq[-1] - scene.freq[0]), _decays(scene)
        length = 1 / p[0]
        decayed = len(rates) and length * rates.min() > DECAYED  # nothing is cut off, and nothing ripples
        if place.index[2] != CUT or decayed:
            return np.zeros((0, 1))
        first, last = length - RIPPLES * apart, length + RIPPLES * apart
        if len(rates):
            first, last = min(first, 0.5 / rates.max()), max(last, DECAYED / rates.min())
        lengths = length + apart * np.arange(np.ceil((first - length) / apart), (last - length) / apart + 1)
        lengths = lengths[lengths > 0]
        return 1 / lengths[np.argsort(np.abs(lengths - length))][:, None]

    def likely(self, p: np.ndarray, scene: Scene) -> float:
        """Lines of a record lie one over its length apart; of one n times longer all but one of n were left out."""
        step = float(np.diff(scene.freq).min()) if len(scene.freq) > 1 else 0.0
        return 1 / max(1.0, step / float(p[0]))

    def report(self, p: np.ndarray, place: Place) -> dict[str, tuple[Any, str]]:
        """The length itself."""
        return {"record_length": (1 / p[0], "s")}

    def kernel(self, x: Array, where: Array, p: Array) -> Complex[Array, "..."]:
        r"""What :math:`1/x`, the transform of :math:`e^{-xt}`, becomes through the window."""
        T = 1 / p[0]
        ends = jnp.where(where[2] == CUT, _cut(x, T), 1 / x - HANN_CURVATURE * 2 / (x**3 * T**2))
        return jnp.where(where[2] == 0, _hann(x, T), jnp.where(where[2] == 1, _boxcar(x, T), ends))


def _decays(scene: Scene) -> np.ndarray:
    """Rates at which the modes in band decay [1/s]."""
    rates = 2 * np.pi * scene.frequency_hz * scene.damping_ratio
    return rates[(scene.frequency_hz > scene.freq[0]) & (scene.frequency_hz < scene.freq[-1]) & (rates > 0)]


def _cut(x: Array, T: Array) -> Array:
    r""":math:`\int_0^T e^{-xt}dt`."""
    return (1 - jnp.exp(-x * T)) / x


def _boxcar(x: Array, T: Array) -> Array:
    r""":math:`\int_0^T (1 - t/T) e^{-xt}dt`."""
    return 1 / x - (1 - jnp.exp(-x * T)) / (x**2 * T)


def _hann(x: Array, T: Array) -> Array:
    r""":math:`\int_0^T \rho(t/T) e^{-xt}dt`, :math:`\rho` the autocorrelation of a Hann window.

    :math:`\rho(u) = \frac23(1-u)(1 + \frac12\cos 2\pi u) + \frac{1}{2\pi}\sin 2\pi u`.
    """
    y = 2j * jnp.pi / T
    ramp = lambda z: _boxcar(z, T)
    cosine = 0.5 * (ramp(x - y) + ramp(x + y))
    sine = (_cut(x - y, T) - _cut(x + y, T)) / 2j
    return 2 / 3 * (ramp(x) + 0.5 * cosine) + sine / (2 * jnp.pi)


class FastSweep(KernelCause):
    r"""A linear sweep too fast for the resonances: the impulse response is seen times :math:`e^{jS t^2/2}`.

    :math:`\int_0^\infty e^{-xt + jSt^2/2}dt = \frac12\sqrt{\pi/b}\,\mathrm{erfcx}(x/(2\sqrt b))`, :math:`b = -jS/2`;
    for slow sweeps :math:`H - \frac j2 S H''`, which is the second variant.
    """

    slug = "fast_sweep"
    advice = "sweep in both directions, or at half the rate"
    fidelity = 0.03
    summary = "a sweep too fast for the resonances"
    parameters = (Parameter("sweep_rate", "Hz/s"),)

    def places(self, scene: Scene) -> list[Place]:
        """Exact, and to first order."""
        return [Place((), (0, -1, k)) for k in range(2)]

    def grid(self, scene: Scene, place: Place) -> np.ndarray:
        """Fractions of the rate that passes a half-power width in its own ring time."""
        width = float(np.median(scene.frequency_hz * scene.damping_ratio))
        return strengths(2 * np.pi * width**2, ((),), (1e-3, 0.05, 0.3, 1.0, 4.0))

    def kernel(self, x: Array, where: Array, p: Array) -> Complex[Array, "..."]:
        r"""What :math:`1/x` becomes."""
        rate = 2 * jnp.pi * p[0]
        b = -0.5j * jnp.where(jnp.abs(rate) < 1e-12, 1e-12, rate)
        root = jnp.sqrt(b)
        exact = 0.5 * jnp.sqrt(jnp.pi) / root * erfcx(x / (2 * root))
        return jnp.where(where[2] == 0, exact, 1 / x + 1j * rate / x**3)


def _weideman(count: int) -> tuple[float, np.ndarray]:
    """Coefficients of Weideman's rational approximation of the Faddeeva function (1994, SIAM J. Num. Anal. 31)."""
    m = 2 * count
    k = np.arange(-m + 1, m)
    L = np.sqrt(count / np.sqrt(2))
    t = L * np.tan(k * np.pi / (2 * m))
    f = np.concatenate([[0.0], np.exp(-(t**2)) * (L**2 + t**2)])
    a = np.real(np.fft.fft(np.fft.fftshift(f))) / (2 * m)
    return float(L), np.flipud(a[1 : count + 1])


_L, _A = _weideman(40)


def erfcx(z: Complex[Array, "..."]) -> Complex[Array, "..."]:
    r"""Scaled complementary error function :math:`e^{z^2}\mathrm{erfc}(z)` of complex numbers, to about 1e-12."""
    right = z.real >= 0
    w = 1j * jnp.where(right, z, -z)
    ratio = (_L + 1j * w) / (_L - 1j * w)
    value = 2 * jnp.polyval(jnp.asarray(_A), ratio) / (_L - 1j * w) ** 2 + (1 / np.sqrt(np.pi)) / (_L - 1j * w)
    square = jnp.where(right, 0.0, z**2)
    return jnp.where(right, value, 2 * jnp.exp(square) - value)


RECORDS: tuple[Any, ...] = (ExponentialWindow(), Leakage(), FastSweep())
