"""Virtual tests from excitation to FRFs: random, multisine, swept sine, stepped sine and hammer.

Records are processed as real ones are (:mod:`modalax.data.records`), so that leakage, noise on the force, filters,
delays and the best linear approximation of a joint come out as they do in a laboratory.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from modalax._numerics.checks import as_double
from modalax.data.checks import check_axis
from modalax.data.frf import FRF
from modalax.data.measurement import Measurement
from modalax.data.multisine import cut_periods, excited_lines, multisine
from modalax.data.records import frf_from_blocks, frf_from_hits, frf_from_records
from modalax.simulate.bench import Bench, Records
from modalax.simulate.excitation import hammer, random, stepped, swept_sine


def random_test(
    bench: Bench,
    key: jax.Array,
    levels: Any,
    *,
    band: tuple[float, float],
    duration: float,
    block: float,
    estimator: Any = "H1",
    **processing: Any,
) -> Measurement:
    """Random excitation at several levels (root mean square [N]), FRFs by averaged blocks.

    Parameters
    ----------
    band
        Band of the force, and of the lines kept [Hz].
    duration, block
        Length of the record and of a block [s]; one block more is run first and left out.
    processing
        Further arguments of :func:`modalax.data.records.frf_from_records`.
    """
    levels = np.atleast_1d(np.asarray(levels, dtype=float))
    chance, noise = jax.random.split(key)
    samples, skip = round((duration + block) * bench.rate), round(block * bench.fs)
    draw = jax.vmap(lambda k: random(k, samples, bench.rate, *band))
    unit = draw(jax.random.split(chance, len(levels) * len(bench.inputs)))
    force = jnp.swapaxes(unit.reshape(len(levels), len(bench.inputs), samples), 1, 2) * levels[:, None, None]
    kept = bench.record(noise, force)
    return Measurement.from_frfs(
        [
            frf_from_records(
                f[skip:], x[skip:], bench.fs, unit=kept.unit, block=block, estimator=estimator, band=band, level=level,
                outputs=bench.outputs, inputs=bench.inputs, **processing,
            )
            for f, x, level in zip(kept.force, kept.response, levels, strict=True)
        ]
    )  # fmt: skip


def multisine_test(
    bench: Bench,
    key: jax.Array,
    levels: Any,
    *,
    band: tuple[float, float],
    period: float,
    periods: int = 8,
    skip: int = 2,
) -> Measurement:
    """One random-phase multisine at several levels (root mean square [N]), FRFs from whole periods: no leakage.

    Parameters
    ----------
    band
        Band excited [Hz], on every line of the period.
    period
        Period [s].
    periods, skip
        Periods averaged, and run before them until the transient is gone.

    Raises
    ------
    ValueError
        If there are several inputs, for which records of several experiments are needed, or the period holds no
        whole number of samples.
    """
    _check_one_input(bench)
    count = _whole_samples(period, bench.fs, "a period")
    levels = np.atleast_1d(np.asarray(levels, dtype=float))
    chance, noise = jax.random.split(key)
    samples = count * bench.oversample
    lines = excited_lines("full", *band, bench.rate, samples)
    one = jnp.tile(multisine(chance, lines, samples)[0], (periods + skip, 1))
    kept = bench.record(noise, one * levels[:, None, None])
    return Measurement.from_frfs(
        [
            _from_blocks(kept, cut_periods(f, count, skip), cut_periods(x, count, skip), band=band, level=level)
            for f, x, level in zip(kept.force, kept.response, levels, strict=True)
        ]
    )


def sweep_test(
    bench: Bench,
    key: jax.Array,
    levels: Any,
    *,
    start: float,
    stop: float,
    rate: float,
    tail: float,
    logarithmic: bool = False,
    repeats: int = 1,
    band: tuple[float, float] | None = None,
) -> Measurement:
    """Swept sine, up or down, at several amplitudes [N]; each sweep with its decay is one block.

    Parameters
    ----------
    start, stop, rate
        First and last frequency [Hz] and speed [Hz/s], or [octave/s] if ``logarithmic``.
    tail
        Time recorded after the sweep, in which the motion dies away [s].
    repeats
        Sweeps averaged; noise differs, so the variance is known from 2 up.
    band
        Lines kept [Hz]; those swept by default.
    """
    levels = np.atleast_1d(np.asarray(levels, dtype=float))
    one = swept_sine(start, stop, rate, bench.rate, logarithmic=logarithmic)
    one = jnp.concatenate([one, jnp.zeros(round(tail * bench.rate))])
    one = one[: len(one) // bench.oversample * bench.oversample]
    force = jnp.repeat(levels, repeats)[:, None, None] * one[None, :, None]
    kept = bench.record(key, force)
    force, response = (a.reshape(len(levels), repeats, *a.shape[1:]) for a in (kept.force, kept.response))
    band = band or (min(start, stop), max(start, stop))
    return Measurement.from_frfs(
        [_from_blocks(kept, f, x, band=band, level=level) for f, x, level in zip(force, response, levels, strict=True)]
    )


def stepped_test(
    bench: Bench,
    key: jax.Array,
    levels: Any,
    freq: Any,
    *,
    block: float,
    settle: float,
    repeats: int = 4,
    downward: bool = False,
    estimator: Any = "H1",
) -> Measurement:
    """Stepped sine at several force amplitudes [N]: each line acts until the motion is steady, then is averaged.

    The sine steps from line to line without a jump and without a pause, so the motion stays on its branch, as on a
    shaker; there is no leakage, for a block holds whole periods.

    Parameters
    ----------
    freq
        Lines, increasing, each a whole multiple of ``1 / block``, shape ``(f,)`` [Hz].
    block, repeats
        Length of a block [s] and blocks averaged at a line; noise differs, so the variance is known from 2 up.
    settle
        Time that the sine of a line acts before the response is recorded [s].
    downward
        Start at the highest line.

    Raises
    ------
    ValueError
        If there are several inputs, or a block holds no whole number of samples or of periods of a line.
    """
    _check_one_input(bench)
    freq = np.asarray(as_double(freq, "freq"))
    check_axis(freq)
    count, wait = _whole_samples(block, bench.fs, "a block"), round(settle * bench.fs)
    off = np.abs(freq * block - np.round(freq * block)) > 1e-6
    if off.any():
        raise ValueError(
            f"a block of {block:g} s holds {freq[off][0] * block:g} periods of {freq[off][0]:g} Hz; it needs a whole "
            "number"
        )
    way = freq[::-1] if downward else freq
    levels = np.atleast_1d(np.asarray(levels, dtype=float))
    one = stepped(way, wait / bench.fs + repeats * block, bench.rate)
    kept = bench.record(key, levels[:, None, None] * one[None, :, None])

    def line(run: int, at: int) -> FRF:
        start = at * (wait + repeats * count) + wait
        f, x = (
            a[run, start : start + repeats * count].reshape(repeats, count, -1) for a in (kept.force, kept.response)
        )
        band = (way[at] - 0.5 / block, way[at] + 0.5 / block)
        return _from_blocks(kept, f, x, band=band, level=levels[run], estimator=estimator)

    order = range(len(way))[::-1] if downward else range(len(way))
    return Measurement.from_frfs([_join_lines([line(run, at) for at in order]) for run in range(len(levels))])


def hammer_test(
    bench: Bench,
    key: jax.Array,
    peaks: Any,
    *,
    contact: float,
    block: float,
    hits: int = 5,
    scatter: float = 0.1,
    band: tuple[float, float] | None = None,
    **processing: Any,
) -> Measurement:
    """Hammer hits at several peak forces [N], ``hits`` at each, FRFs by :func:`modalax.data.records.frf_from_hits`.

    Parameters
    ----------
    contact
        Contact time [s].
    block
        Time from hit to hit [s]; blocks of 95 % of it are cut.
    scatter
        Relative standard deviation of the peaks of one level.
    processing
        Further arguments of :func:`modalax.data.records.frf_from_hits`.
    """
    peaks = np.atleast_1d(np.asarray(peaks, dtype=float))
    chance, noise = jax.random.split(key)
    factors = jnp.exp(scatter * jax.random.normal(chance, (len(peaks), hits), jnp.float64))
    samples = round(hits * block * bench.rate)
    times = (jnp.arange(hits) + 0.04) * block
    one = jax.vmap(lambda p: hammer(samples, bench.rate, peak=p, contact=contact, times=times))
    kept = bench.record(noise, one(jnp.asarray(peaks)[:, None] * factors)[:, :, None])
    given: dict[str, Any] = {"pretrigger": 0.02 * block} | processing
    return Measurement.from_frfs(
        [
            frf_from_hits(
                f, x, bench.fs, unit=kept.unit, block=0.95 * block, band=band, outputs=bench.outputs,
                input=bench.inputs[0], **given,
            ).replace(level=peak)
            for f, x, peak in zip(kept.force, kept.response, peaks, strict=True)
        ]
    )  # fmt: skip


def _check_one_input(bench: Bench) -> None:
    if len(bench.inputs) != 1:
        raise ValueError(f"{len(bench.inputs)} inputs; this test drives one")


def _whole_samples(duration: float, fs: float, what: str) -> int:
    """Samples in ``duration`` [s]."""
    count = duration * fs
    if abs(count - round(count)) > 1e-6:
        raise ValueError(f"{what} of {duration:g} s holds {count:g} samples at {fs:g} Hz; it needs a whole number")
    return round(count)


def _from_blocks(kept: Records, force: Float[Array, "m t i"], response: Float[Array, "m t o"], **rest: Any) -> FRF:
    """FRF of blocks cut from the records."""
    return frf_from_blocks(force, response, kept.fs, unit=kept.unit, outputs=kept.outputs, inputs=kept.inputs, **rest)


def _join_lines(frfs: list[FRF]) -> FRF:
    """FRFs of single lines as one."""
    return jax.tree.map(lambda *parts: jnp.concatenate(parts) if parts[0].ndim else parts[0], *frfs)
