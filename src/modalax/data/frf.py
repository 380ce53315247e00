"""Measured frequency response functions: the values, their axis, their noise and their names."""

from collections import Counter
from collections.abc import Sequence
from functools import partial
from types import ModuleType
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_double, is_traced, require_finite
from modalax._numerics.cuts import cut
from modalax._numerics.known import Numbers, by_numpy, circular, ends_of, host
from modalax.data.checks import check_axis, check_beside, check_variance, over_samples
from modalax.data.dofs import as_names
from modalax.data.overview import of_frfs

Form = Literal["receptance", "mobility", "accelerance"]
DERIVATIVES: dict[str, int] = {"receptance": 0, "mobility": 1, "accelerance": 2}


def default_names(count: int, kind: str) -> tuple[str, ...]:
    """Names ``kind1``, ``kind2``, ... for channels that have none."""
    return tuple(f"{kind}{k + 1}" for k in range(count))


def check_form(form: str) -> str:
    """Return ``form`` if it is one of receptance, mobility, accelerance.

    Raises
    ------
    ValueError
        If ``form`` is another word.
    """
    if form not in get_args(Form):
        raise ValueError(f"form is {form!r}; it must be one of {', '.join(get_args(Form))}")
    return form


def check_names(names: Sequence[str], count: int, axis: str) -> tuple[str, ...]:
    """Return ``names`` as a tuple of ``count`` different strings.

    Raises
    ------
    ValueError
        If their number differs from ``count`` or a name stands twice.
    """
    if isinstance(names, str):
        raise ValueError(f"{axis} is the text {names!r}; it needs a list of names, one for each channel")
    names = tuple(str(n) for n in names)
    if len(names) != count:
        raise ValueError(f"{len(names)} names for {count} {axis}: {axis} needs one name for each channel")
    twice = sorted(name for name, times in Counter(names).items() if times > 1)
    if twice:
        raise ValueError(
            f"{axis} names {', '.join(twice[:6])} stand more than once; each channel needs a name of its own"
        )
    if any(not name.strip() for name in names):
        raise ValueError(f"{axis} holds an empty name; each channel needs a name of its own")
    return names


def band_slice(freq: Any, lower: float, upper: float) -> slice:
    """The lines of ``freq`` [Hz] within ``lower`` <= f <= ``upper`` [Hz].

    Raises
    ------
    ValueError
        If the lower limit is above the upper one, the band holds no line, or the frequencies are being traced.
    """
    if is_traced(freq):
        raise ValueError("how many lines a band holds is not known inside jit, vmap or grad; cut the band before")
    values = np.asarray(freq)
    if not lower < upper:
        raise ValueError(f"the band {lower:g} to {upper:g} Hz is empty; its first limit must be the smaller one")
    inside = np.flatnonzero((values >= lower * (1 - 1e-12)) & (values <= upper * (1 + 1e-12)))
    if inside.size == 0:
        raise ValueError(
            f"the band {lower:g} to {upper:g} Hz holds no line; the data covers {values[0]:g} to {values[-1]:g} Hz"
        )
    return slice(int(inside[0]), int(inside[-1]) + 1)


class FRF(eqx.Module):
    r"""One run of measured frequency response functions :math:`H_{oi}(\omega_f)`.

    Attributes
    ----------
    freq
        Frequency of each line, increasing, shape ``(f,)`` [Hz].
    H
        Response of output ``o`` to a unit force at input ``i``, shape ``(f, o, i)`` [m/N, (m/s)/N or (m/s^2)/N],
        for the time convention :math:`e^{+j\omega t}`.
    variance
        :math:`E|e|^2` of each complex sample (of the averaged FRF), shape ``(f, o, i)``, or None where unknown.
    coherence
        Ordinary coherence :math:`\gamma^2` of each sample, shape ``(f, o, i)``, or None.
    multiple_coherence
        Share of each response's power that all forces together explain, shape ``(f, o)``, where several act at once;
        None where it is not known. Files do not keep it.
    level
        Force amplitude of the run [N]; NaN where unknown.
    added_decay
        Decay rate that an exponential window added to every mode [1/s]; 0 where none. ``identify`` takes it out.
    form
        ``receptance``, ``mobility`` or ``accelerance``.
    outputs, inputs
        DoF names.
    averages
        Number of independent repeats behind ``variance``; None where it is exactly known or unknown.
    """

    freq: Float[Array, " f"]
    H: Complex[Array, "f o i"]
    variance: Float[Array, "f o i"] | None
    coherence: Float[Array, "f o i"] | None
    multiple_coherence: Float[Array, "f o"] | None
    level: Float[Array, ""]
    added_decay: Float[Array, ""]
    form: str = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    inputs: tuple[str, ...] = eqx.field(static=True)
    averages: int | None = eqx.field(static=True)

    def __init__(
        self,
        freq: Any,
        H: Any,
        *,
        form: str = "receptance",
        variance: Any = None,
        coherence: Any = None,
        multiple_coherence: Any = None,
        level: Any = float("nan"),
        added_decay: Any = 0.0,
        outputs: Sequence[str] | None = None,
        inputs: Sequence[str] | None = None,
        averages: int | None = None,
    ):
        check_axis(freq)
        self.freq = as_double(freq, "freq")
        self.H = as_double(H, "H", complex_=True)
        if self.H.ndim != 3 or self.freq.ndim != 1 or self.H.shape[0] != self.freq.shape[0]:
            raise ValueError(
                f"H has shape {self.H.shape} for {self.freq.shape[0]} frequency lines; it needs (f, o, i): "
                "frequency line, output, input"
            )
        require_finite(self.H, "H")
        check_beside(self.H.shape, coherence, level, added_decay, averages)
        self.variance = None if variance is None else over_samples(variance, "variance", self.H.shape)
        if self.variance is not None:
            check_variance(variance)
        self.coherence = None if coherence is None else over_samples(coherence, "coherence", self.H.shape)
        several = multiple_coherence
        self.multiple_coherence = None if several is None else as_double(several, "multiple_coherence")
        self.level = as_double(level, "level")
        self.added_decay = as_double(added_decay, "added_decay")
        self.form = check_form(form)
        _, n_out, n_in = self.H.shape
        self.outputs = check_names(default_names(n_out, "o") if outputs is None else outputs, n_out, "outputs")
        self.inputs = check_names(default_names(n_in, "i") if inputs is None else inputs, n_in, "inputs")
        self.averages = averages

    def __str__(self) -> str:
        """Lines, channels and what is known of the noise."""
        return of_frfs(self, "FRF")

    @property
    def omega(self) -> Float[Array, " f"]:
        """Circular frequency of each line [rad/s]."""
        return circular(self.freq)

    @property
    def ends(self) -> tuple[float, float]:
        """First and last frequency [Hz]."""
        return ends_of(self.freq)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of lines, outputs and inputs."""
        n_lines, n_out, n_in = self.H.shape
        return n_lines, n_out, n_in

    def replace(self, **changes: Any) -> "FRF":
        """A copy with some attributes changed and everything checked again."""
        fields = dict(
            freq=self.freq, H=self.H, variance=self.variance, coherence=self.coherence, level=self.level,
            added_decay=self.added_decay, form=self.form, outputs=self.outputs, inputs=self.inputs,
            averages=self.averages, multiple_coherence=self.multiple_coherence,
        )  # fmt: skip
        return FRF(**{**fields, **changes})

    def without_statistics(self) -> "FRF":
        """The FRF without variance, coherence and number of repeats, on which no compiled program shall depend."""
        return self.replace(variance=None, coherence=None, multiple_coherence=None, averages=None)

    def lines(self, which: Any) -> "FRF":
        """The FRF at some lines only (a slice, or increasing indices)."""
        take = lambda a: None if a is None else cut(a, which)
        names = ("freq", "H", "variance", "coherence", "multiple_coherence")
        return self.replace(**{name: take(getattr(self, name)) for name in names})

    def band(self, lower: float, upper: float) -> "FRF":
        """The lines with ``lower`` <= f <= ``upper`` [Hz].

        Raises
        ------
        ValueError
            If no line lies within.
        """
        return self.lines(band_slice(self.freq, lower, upper))

    def pick(self, outputs: Sequence[str] | None = None, inputs: Sequence[str] | None = None) -> "FRF":
        """Some outputs and inputs by name, in the order asked for.

        Raises
        ------
        ValueError
            If a name is not measured; the message lists those that are.
        """
        o = _indices(self.outputs, outputs, "output")
        i = _indices(self.inputs, inputs, "input")
        pairs = np.array(o)[:, None], np.array(i)
        take = lambda a: None if a is None else cut(a, (slice(None), *pairs))
        return self.replace(
            H=take(self.H), variance=take(self.variance), coherence=take(self.coherence),
            multiple_coherence=None if self.multiple_coherence is None else cut(self.multiple_coherence, np.s_[:, o]),
            outputs=[self.outputs[k] for k in o], inputs=[self.inputs[k] for k in i],
        )  # fmt: skip

    def drop(self, names: Sequence[str]) -> "FRF":
        """The FRF without some channels, by name; a name that is both an output and an input is left out as both.

        Raises
        ------
        ValueError
            If a name is not measured, or no output or input is left.
        """
        names = as_names(names)
        unknown = [n for n in names if n not in self.outputs and n not in self.inputs]
        if unknown:
            there = ", ".join(dict.fromkeys((*self.outputs, *self.inputs)))
            raise ValueError(f"no channel named {', '.join(map(repr, unknown))} to leave out; there are {there}")
        outputs, inputs = ([n for n in side if n not in names] for side in (self.outputs, self.inputs))
        if not outputs or not inputs:
            raise ValueError(
                f"without {', '.join(names)} there are {len(outputs)} outputs and {len(inputs)} inputs left"
            )
        return self.pick(outputs, inputs)

    def to_form(self, form: str) -> "FRF":
        r"""The FRF as receptance, mobility or accelerance, by factors :math:`s^{\pm n}`.

        :math:`s = j\omega`, or :math:`j\omega + \sigma` where an exponential window added the decay :math:`\sigma`:
        that is where the windowed record evaluates H.

        Raises
        ------
        ValueError
            If a line at 0 Hz would be divided by zero: drop that line first.
        """
        steps = DERIVATIVES[check_form(form)] - DERIVATIVES[self.form]
        if steps == 0:
            return self
        at_rest = not is_traced(self.freq, self.added_decay) and self.ends[0] == float(self.added_decay) == 0
        if steps < 0 and at_rest:
            raise ValueError(
                f"{self.form} at 0 Hz has no {form}: drop that line first, for example with .lines(slice(1, None))"
            )
        H, variance = _differentiated(self.H, self.variance, self.freq, self.added_decay, steps=steps)
        return self.replace(H=H, variance=variance, form=form)

    def transpose(self) -> "FRF":
        """Outputs and inputs exchanged; with reciprocity the same structure measured the other way round."""
        turn = lambda a: None if a is None else host(a).swapaxes(1, 2)
        return self.replace(
            H=turn(self.H), variance=turn(self.variance), coherence=turn(self.coherence),
            multiple_coherence=None, outputs=self.inputs, inputs=self.outputs,
        )  # fmt: skip

    def add_noise(self, key: jax.Array, relative: float, reference: str = "rms") -> "FRF":
        r"""The FRF with circular Gaussian noise :math:`e` added, and its variance recorded.

        Parameters
        ----------
        relative
            Noise level: standard deviation of the complex error divided by the reference.
        reference
            ``rms``: each channel's root mean square over the lines; ``peak``: its largest magnitude;
            ``local``: the magnitude of each sample.
        """
        if reference not in NOISE_REFERENCES:
            raise ValueError(f"reference is {reference!r}; it must be one of {', '.join(NOISE_REFERENCES)}")
        H, variance = _noisy(self.H, key, relative, reference)
        return self.replace(H=H, variance=variance)


NOISE_REFERENCES = ("rms", "peak", "local")


@partial(jax.jit, static_argnames="reference")
def _noisy(
    H: Complex[Array, "f o i"], key: jax.Array, relative: Any, reference: str
) -> tuple[Complex[Array, "f o i"], Float[Array, "f o i"]]:
    """The FRF with noise, and its variance."""
    size = jnp.abs(H)
    if reference == "rms":
        size = jnp.sqrt(jnp.mean(size**2, axis=0, keepdims=True))
    elif reference == "peak":
        size = jnp.max(size, axis=0, keepdims=True)
    sigma = jnp.broadcast_to(relative * size, H.shape)
    real, imag = jax.random.normal(key, (2, *H.shape))
    return H + sigma * (real + 1j * imag) / jnp.sqrt(2.0), sigma**2


@by_numpy
def _differentiated(
    xp: ModuleType, H: Any, variance: Any, freq: Any, decay: Any, *, steps: int
) -> tuple[Complex[Numbers, "f o i"], Float[Numbers, "f o i"] | None]:
    r"""H and its variance times :math:`s^n` and its square, with :math:`s = j\omega + \sigma`."""
    factor = (2j * np.pi * freq + decay)[:, None, None] ** steps
    return H * factor, None if variance is None else variance * xp.abs(factor) ** 2


def derivative(H: Complex[Array, "f o i"], freq: Float[Array, " f"], form: str) -> Complex[Array, "f o i"]:
    """Receptance at these frequencies [Hz] as another form."""
    steps = DERIVATIVES[check_form(form)]
    return _differentiated(H, None, freq, 0.0, steps=steps)[0] if steps else H


def _indices(names: tuple[str, ...], wanted: Sequence[str] | None, axis: str) -> list[int]:
    if wanted is None:
        return list(range(len(names)))
    wanted = as_names(wanted)
    missing = [w for w in wanted if w not in names]
    if missing:
        raise ValueError(f"no {axis} named {', '.join(map(repr, missing))}; there are {', '.join(names)}")
    return [names.index(w) for w in wanted]
