"""Several runs of the same FRFs, for example at rising force levels."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_double, is_traced, require_finite, require_range
from modalax._numerics.cuts import cut
from modalax._numerics.known import circular, ends_of, stacked
from modalax.data.checks import check_axis, check_beside, check_variance, over_samples
from modalax.data.frf import (
    FRF,
    band_slice,
    check_form,
    check_names,
    default_names,
)
from modalax.data.overview import counted, of_frfs


class Measurement(eqx.Module):
    r"""FRFs of several runs on one frequency axis and one set of channels.

    Attributes
    ----------
    freq
        Frequency of each line, increasing, shape ``(f,)`` [Hz].
    H
        FRF of each run, shape ``(run, f, o, i)`` [m/N, (m/s)/N or (m/s^2)/N].
    variance
        :math:`E|e|^2` of each complex sample, shape ``(run, f, o, i)``, or None where unknown.
    coherence
        Ordinary coherence, shape ``(run, f, o, i)``, or None.
    level
        Force amplitude of each run, shape ``(run,)`` [N]; NaN where unknown.
    force
        Force amplitude of each run at each line, shape ``(run, f)`` [N], or None where the force was the same at all
        lines. A shaker's controller seldom holds the force constant through a resonance, and a non-linear joint
        responds to the force at each line.
    added_decay
        Decay rate that an exponential window added [1/s].
    form, outputs, inputs, averages
        As in :class:`FRF`.
    """

    freq: Float[Array, " f"]
    H: Complex[Array, "run f o i"]
    variance: Float[Array, "run f o i"] | None
    coherence: Float[Array, "run f o i"] | None
    level: Float[Array, " run"]
    force: Float[Array, "run f"] | None
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
        level: Any = None,
        force: Any = None,
        added_decay: Any = 0.0,
        outputs: Sequence[str] | None = None,
        inputs: Sequence[str] | None = None,
        averages: int | None = None,
    ):
        check_axis(freq)
        self.freq = as_double(freq, "freq")
        self.H = as_double(H, "H", complex_=True)
        if self.H.ndim != 4 or self.freq.ndim != 1 or self.H.shape[1] != self.freq.shape[0]:
            raise ValueError(
                f"H has shape {self.H.shape} for {self.freq.shape[0]} frequency lines; it needs (run, f, o, i): "
                "run, frequency line, output, input"
            )
        require_finite(self.H, "H")
        check_beside(self.H.shape, coherence, level, added_decay, averages)
        runs, _, n_out, n_in = self.H.shape
        self.variance = None if variance is None else over_samples(variance, "variance", self.H.shape)
        if self.variance is not None:
            check_variance(variance)
        self.coherence = None if coherence is None else over_samples(coherence, "coherence", self.H.shape)
        self.force = None if force is None else _forces(force, self.H.shape[:2])
        if level is None:
            level = jnp.full(runs, jnp.nan) if self.force is None else self.force.mean(axis=1)
        self.level = as_double(level, "level")
        if self.level.shape != (runs,):
            raise ValueError(
                f"level has shape {self.level.shape} for {runs} runs; it needs one force amplitude for each run"
            )
        self.added_decay = as_double(added_decay, "added_decay")
        self.form = check_form(form)
        self.outputs = check_names(default_names(n_out, "o") if outputs is None else outputs, n_out, "outputs")
        self.inputs = check_names(default_names(n_in, "i") if inputs is None else inputs, n_in, "inputs")
        self.averages = averages

    @classmethod
    def from_frfs(cls, frfs: Sequence[FRF]) -> "Measurement":
        """Put runs on one axis together.

        Raises
        ------
        ValueError
            If the runs differ in lines, channels or form; traced frequencies are taken to be the same.
        """
        first = frfs[0]
        for k, frf in enumerate(frfs[1:], start=1):
            same = (frf.outputs, frf.inputs, frf.form, frf.shape) == (
                first.outputs, first.inputs, first.form, first.shape)  # fmt: skip
            known = not is_traced(frf.freq, first.freq)
            if not same or (known and not np.array_equal(np.asarray(frf.freq), np.asarray(first.freq))):
                raise ValueError(f"run {k} differs from run 0 in its lines, channels or form; they must be the same")
        stack = lambda name: (
            None if any(getattr(f, name) is None for f in frfs) else stacked([getattr(f, name) for f in frfs])
        )
        return cls(
            first.freq, stack("H"), form=first.form, variance=stack("variance"),
            coherence=stack("coherence"), level=stack("level"), added_decay=first.added_decay,
            outputs=first.outputs, inputs=first.inputs, averages=first.averages,
        )  # fmt: skip

    def __str__(self) -> str:
        """Runs, lines, channels, forces and what is known of the noise."""
        return of_frfs(self, f"Measurement of {counted(self.runs, 'run')}")

    @property
    def runs(self) -> int:
        """Number of runs."""
        return self.H.shape[0]

    @property
    def omega(self) -> Float[Array, " f"]:
        """Circular frequency of each line [rad/s]."""
        return circular(self.freq)

    @property
    def ends(self) -> tuple[float, float]:
        """First and last frequency [Hz]."""
        return ends_of(self.freq)

    def run(self, k: int) -> FRF:
        """Run ``k``, counted from 0.

        Raises
        ------
        ValueError
            If there is no such run.
        """
        if not -self.runs <= k < self.runs:
            raise ValueError(f"run {k} asked for, but there are {self.runs} runs, counted from 0")
        take = lambda a: None if a is None else cut(a, k)
        return FRF(
            self.freq, take(self.H), form=self.form, variance=take(self.variance), coherence=take(self.coherence),
            level=take(self.level), added_decay=self.added_decay, outputs=self.outputs, inputs=self.inputs,
            averages=self.averages,
        )  # fmt: skip

    @property
    def frf(self) -> FRF:
        """The only run.

        Raises
        ------
        ValueError
            If there are several: pick one with ``run(k)``.
        """
        if self.runs != 1:
            raise ValueError(f"the measurement has {self.runs} runs; pick one with .run(k)")
        return self.run(0)

    def replace(self, **changes: Any) -> "Measurement":
        """A copy with some attributes changed and everything checked again."""
        fields = dict(
            freq=self.freq, H=self.H, variance=self.variance, coherence=self.coherence, level=self.level,
            force=self.force, added_decay=self.added_decay, form=self.form, outputs=self.outputs, inputs=self.inputs,
            averages=self.averages,
        )  # fmt: skip
        return Measurement(**{**fields, **changes})

    def band(self, lower: float, upper: float) -> "Measurement":
        """The lines with ``lower`` <= f <= ``upper`` [Hz]; ``ValueError`` if there is none."""
        return self.lines(band_slice(self.freq, lower, upper))

    def lines(self, which: Any) -> "Measurement":
        """Some lines only, by their numbers or a slice."""
        take = lambda a: None if a is None else cut(a, (slice(None), which))
        return self.replace(
            freq=cut(self.freq, which), H=take(self.H), variance=take(self.variance), coherence=take(self.coherence),
            force=take(self.force),
        )  # fmt: skip

    def to_form(self, form: str) -> "Measurement":
        """All runs as receptance, mobility or accelerance, as :meth:`FRF.to_form`."""
        return Measurement.from_frfs([self.run(k).to_form(form) for k in range(self.runs)]).replace(force=self.force)


def _forces(force: Any, shape: tuple[int, ...]) -> Float[Array, "run f"]:
    force = as_double(force, "force")
    if force.shape != shape:
        raise ValueError(f"force has shape {force.shape}; it needs one amplitude for each run and line, shape {shape}")
    require_finite(force, "force")
    require_range(force, "force", np.finfo(float).tiny, np.inf, "a force amplitude is above 0 N")
    return force
