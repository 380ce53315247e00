r"""Data and simulation brought together: receptances, weights and the modal arrays, on common channels."""

import math
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from modalax._numerics.checks import as_array
from modalax._numerics.cuts import cut
from modalax.diagnose.setup.complex_modes import Mixing, Uncoupled
from modalax.diagnose.setup.modal_form import ModalForm


class Held(eqx.Module):
    """Causes that an extended simulation already has, with their parameters, when it is diagnosed again."""

    index: Int[Array, "cause 3"]
    extras: tuple[Any, ...]
    params: tuple[Array, ...]
    theta: Float[Array, "two n"]
    causes: tuple[Any, ...] = eqx.field(static=True)


class Problem(eqx.Module):
    r"""Data and modal arrays of a comparison, as JAX arrays of padded shapes.

    Axes are padded to a few sizes, so that functions compiled for one measurement serve the next; padded samples
    have weight zero.

    Attributes
    ----------
    omega
        Circular frequencies [rad/s], shape ``(f,)``.
    data
        Measured receptances, shape ``(run, f, o, i)`` [m/N].
    weight
        :math:`\sqrt2/\sigma` of each sample, 0 where it is left out, so that the real and imaginary parts of
        ``weight * (data - prediction)`` have unit variance.
    level
        Force amplitude of each run at each line [N].
    outputs, inputs
        Positions of the channels among the DoFs of the simulation.
    modal_form
        The simulation.
    lines, channels
        True numbers of lines, and of outputs and inputs, before padding.
    held
        What the simulation has besides its modes, or None.
    order
        Derivatives of the displacement that were measured: windows and sweeps act on these.
    """

    omega: Float[Array, " f"]
    data: Complex[Array, "run f o i"]
    weight: Float[Array, "run f o i"]
    level: Float[Array, "run f"]
    outputs: Int[Array, " o"]
    inputs: Int[Array, " i"]
    modal_form: ModalForm
    lines: int
    channels: tuple[int, int]
    held: Held | None = None
    order: int = eqx.field(static=True, default=0)

    @property
    def samples(self) -> int:
        """Number of real numbers that count."""
        return 2 * int(np.count_nonzero(np.asarray(self.weight)))

    def pooled(self) -> tuple["Problem", float]:
        """All runs averaged into one, for causes that do not depend on the run, and the chi-square left out by that."""
        if self.data.shape[0] == 1 or (self.held is not None and any(c.per_run for c in self.held.causes)):
            return self, 0.0
        square = np.asarray(self.weight) ** 2
        total = square.sum(axis=0, keepdims=True)
        mean = (square * np.asarray(self.data)).sum(axis=0, keepdims=True) / np.where(total > 0, total, 1.0)
        rest = float((square * np.abs(np.asarray(self.data) - mean) ** 2).sum())
        one = eqx.tree_at(
            lambda p: (p.data, p.weight, p.level),
            self,
            (as_array(mean), as_array(np.sqrt(total)), cut(self.level, slice(0, 1))),
        )
        return one, rest

    def weighted(self, weight: Any) -> "Problem":
        """The problem with other weights, for example with a block left out."""
        return eqx.tree_at(lambda p: p.weight, self, as_array(weight))


def bucket(count: int) -> int:
    """The next of 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, ... that holds ``count``."""
    if count <= 4:
        return count
    power = 2 ** math.floor(math.log2(count))
    return power if count == power else (power * 3 // 2 if count <= power * 3 // 2 else power * 2)


def make_problem(
    freq: np.ndarray, data: np.ndarray, sigma: np.ndarray, level: np.ndarray,
    outputs: tuple[str, ...], inputs: tuple[str, ...], modal_form: ModalForm, held: Held | None = None,
    order: int = 0,
) -> Problem:  # fmt: skip
    """Pad and weight receptances.

    Parameters
    ----------
    data, sigma
        Receptances and the standard deviations of their complex errors, shape ``(run, f, o, i)`` [m/N].
    level
        Force amplitudes [N] of the runs, shape ``(run,)``, or of each of their lines, shape ``(run, f)``.
    order
        Derivatives of the displacement that were measured (2 for accelerations).
    """
    runs, lines, n_out, n_in = data.shape
    shape = (runs, bucket(lines), bucket(n_out), bucket(n_in))
    pads = [(0, new - old) for new, old in zip(shape, data.shape, strict=True)]
    weight = np.where(sigma > 0, math.sqrt(2) / np.where(sigma > 0, sigma, 1.0), 0.0)
    where = (
        np.array([modal_form.index(name) for name in outputs]),
        np.array([modal_form.index(name) for name in inputs]),
    )
    return Problem(
        as_array(np.pad(2 * np.pi * freq, pads[1], mode="edge")),
        as_array(np.pad(data, pads)),
        as_array(np.pad(weight, pads)),
        as_array(
            np.pad(
                np.broadcast_to(level if np.ndim(level) == 2 else level[:, None], data.shape[:2]), pads[:2], mode="edge"
            )
        ),
        as_array(np.pad(where[0], pads[2])),
        as_array(np.pad(where[1], pads[3])),
        padded(modal_form),
        lines,
        (n_out, n_in),
        None if held is None else _padded_held(held, pads, bucket(len(modal_form.poles))),
        order,
    )


def _padded_held(held: Held, pads: list[tuple[int, int]], modes: int) -> Held:
    extras = tuple(None if e is None else as_array(np.pad(e, ((0, 0), pads[2], pads[3]))) for e in held.extras)
    theta = as_array(np.pad(held.theta, ((0, 0), (0, modes - held.theta.shape[1]))))
    return Held(held.index, extras, held.params, theta, held.causes)


def padded(modal_form: ModalForm) -> ModalForm:
    """The modal form with modes and DoFs that do nothing, up to a common size."""
    n, dofs = modal_form.shapes.shape
    more, wide = bucket(n) - n, bucket(dofs) - dofs
    unit = float(np.median(np.asarray(modal_form.stiffness)))
    rate = math.sqrt(unit)
    fill = lambda a, value: as_array(np.pad(a, (0, more), constant_values=value))
    grow = lambda a: as_array(np.pad(a, ((0, more), (0, wide))))
    square = lambda a: as_array(np.pad(a, ((0, wide), (0, wide))))
    return ModalForm(
        fill(modal_form.poles, -0.6 * rate + 0.8j * rate), grow(modal_form.shapes), grow(modal_form.participation),
        fill(modal_form.stiffness, unit), fill(modal_form.damping, 1.2 * rate), fill(modal_form.hysteresis, 0.0),
        square(modal_form.upper), square(modal_form.lower),
        fill(modal_form.frequency_std, 0.0), fill(modal_form.damping_std, 0.0),
        (), modal_form.scaled, _padded_mixing(modal_form.mixing, more, wide),
        _padded_uncoupled(modal_form.uncoupled, more, wide),
    )  # fmt: skip


def _padded_mixing(mixing: Mixing | None, more: int, wide: int) -> Mixing | None:
    if mixing is None:
        return None
    widths = ((0, 0), (0, more), (0, more), (0, wide))  # the first three for stiffness and damping, two for the centre
    return jax.tree.map(lambda a: as_array(np.pad(a, widths[: a.ndim])), mixing)


def _padded_uncoupled(uncoupled: Uncoupled | None, more: int, wide: int) -> Uncoupled | None:
    if uncoupled is None:
        return None
    modes = ((0, 0), (0, more))
    k, c = (as_array(np.pad(a, modes, constant_values=1.0)) for a in (uncoupled.k, uncoupled.c))
    shapes, participation = (
        as_array(np.pad(a, (*modes, (0, wide)))) for a in (uncoupled.shapes, uncoupled.participation)
    )
    return Uncoupled(k, c, shapes, participation, uncoupled.middle)
