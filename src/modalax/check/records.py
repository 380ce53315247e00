"""Time records of one input, as blocks."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from modalax.data.excitation import excitation_of
from modalax.data.measurement import Measurement

# Decay of the force spectrum within the band [dB], and the band of usual analysers as a share of the sampling rate.
ROLLOFF, BAND = 26.0, 1 / 2.56
# Lines where the force has less than this share of its middling power are not excited.
EXCITED = 1e-4


@dataclass(frozen=True)
class Records:
    """Blocks of time: hits of a hammer, periods, or blocks of another excitation, at one input.

    Attributes
    ----------
    force
        Shape ``(block, t)`` [N].
    response
        Shape ``(block, t, o)`` [``unit`` of the response].
    fs
        Sampling rate [Hz].
    outputs, input
        Names of the channels.
    form
        What the responses over the force are: receptance (m), mobility (m/s) or accelerance (m/s^2, g).
    kind
        ``hits``, ``periods`` (of a force that repeats), ``random`` (blocks that overlap by half), or ``blocks``.
    """

    force: Float[np.ndarray, "m t"]
    response: Float[np.ndarray, "m t o"]
    fs: float
    outputs: tuple[str, ...]
    input: str = "force"
    form: str = "accelerance"
    kind: str = ""

    def __post_init__(self):
        if self.force.ndim != 2 or self.response.ndim != 3 or self.force.shape != self.response.shape[:2]:
            raise ValueError(
                f"force has shape {self.force.shape} and response {self.response.shape}; needed are (block, t) and "
                "(block, t, output) of the same blocks and samples"
            )
        if not np.isfinite(self.force).all() or not np.isfinite(self.response).all():
            raise ValueError("the records hold values that are not finite")

    @property
    def hits(self) -> bool:
        """Whether the force is a pulse in every block."""
        return (self.kind or excitation_of(self.force).kind) == "hits"

    def spectra(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lines [Hz], and the spectra of force ``(block, f)`` and responses ``(block, f, o)``."""
        samples = self.force.shape[1]
        window = np.hanning(samples + 1)[:-1] if self.kind == "random" else np.ones(samples)
        F = np.fft.rfft((self.force - np.median(self.force, axis=1, keepdims=True)) * window, axis=1)
        still = self.response - np.median(self.response, axis=1, keepdims=True)
        return np.fft.rfftfreq(samples, 1 / self.fs), F, np.fft.rfft(still * window[:, None], axis=1)

    def measurement(self, each: bool = False) -> Measurement:
        """FRFs by H1, with their variance where there are repeats; with ``each``, every block is a run."""
        freq, F, X = self.spectra()
        power = np.mean(np.abs(F) ** 2, axis=0)
        low, top = useful_band(freq, power, self.fs)
        keep = (freq >= low) & (freq <= top)
        keep &= power > EXCITED * np.median(power[keep])
        names = dict(outputs=self.outputs, inputs=(self.input,), form=self.form)
        if each:
            H = X[:, keep] / F[:, keep, None]
            return Measurement(freq[keep], H[..., None], **names)
        H = np.mean(X * F.conj()[:, :, None], axis=0) / power[:, None]
        extra = {}
        # Blocks that overlap by half under a Hann window hold hardly less than as many of their own.
        m = len(F)
        if m > 1:
            left = np.mean(np.abs(X - H * F[:, :, None]) ** 2, axis=0) * m / (m - 1)
            variance = left / (m * power[:, None])
            extra = {"variance": variance[None, keep, :, None], "averages": m}
        return Measurement(freq[keep], H[None, keep, :, None], **names, **extra)


def useful_band(freq: np.ndarray, power: np.ndarray, fs: float) -> tuple[float, float]:
    """Frequencies between which the force has energy [Hz], at most the band of usual analysers."""
    smooth = _smooth(power)
    loudest = int(np.argmax(smooth[1:])) + 1
    weak = np.flatnonzero(smooth < smooth[loudest] * 10 ** (-ROLLOFF / 10))
    below, above = weak[weak < loudest], weak[weak > loudest]
    end = BAND * fs
    return float(freq[below[-1] + 1] if len(below) else freq[1]), float(min(end, freq[above[0]] if len(above) else end))


def _smooth(power: np.ndarray) -> np.ndarray:
    width = max(1, len(power) // 100)
    kernel = np.ones(2 * width + 1) / (2 * width + 1)
    return np.convolve(np.pad(power, width, mode="edge"), kernel, "valid")
