r"""Laws of a joint fitted to time records together with the linear modes, the joint's force fed back as an input.

Where the motion across the joint was measured, the force of any law along it is known but for its parameters, and the
structure answers it as it answers any other force,

.. math:: X(\omega) = H_d(\omega)F(\omega) - H_b(\omega)N(\omega;\theta), \qquad
          H(\omega) = \sum_r\frac{\psi_r\psi_r^T}{j\omega-\lambda_r} + \frac{\psi_r^*\psi_r^H}{j\omega-\lambda_r^*} + U,

so that modes, residual terms and :math:`\theta` follow from spectra by least squares, without any equation of motion
being solved (Adams and Allemang 1999, J. Sound Vib. 226:1083). Records must repeat, or begin and end at rest: only
then is the product of spectra the response.

The law sees the measured motion, so that one with a large linear part (a slider that never slips) can explain that
motion by itself, whatever the structure is. How good a law is tells only the response that it predicts under the force
alone, :meth:`FittedLaws.simulate`, best of records that were not fitted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
import scipy.signal
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_array, as_double, require_double
from modalax.data.frf import DERIVATIVES
from modalax.model import ModalModel
from modalax.model.modal import poles_from
from modalax.simulate.joints import Hysteretic, Joint, Memoryless
from modalax.simulate.joints.base import POSITIVE
from modalax.simulate.march import respond

STEPS = 100  # of the search
FINER = 8  # steps of a simulation in each sample of the record


Free = tuple[tuple[tuple[int, ...], ...], ...]  # of each joint, of each of its parameters: which numbers are not 0


@dataclass(frozen=True)
class FittedLaws:
    """Laws of a joint and modes, fitted together.

    Attributes
    ----------
    model
        The linear structure, reciprocal, with the driven DoF as its input.
    joints, place
        The laws, and the DoFs between which they act.
    std
        Standard deviation of each law's parameters by name, from fits that leave one run out each (jackknife; Efron
        and Stein 1981, Ann. Statist. 9:586), so that what no law explains is in it too; NaN where there is one run.
    unexplained
        Norm of what is left over the norm of the response, in the band; the runs count alike.
    """

    model: ModalModel
    joints: tuple[Joint, ...]
    place: tuple[str, ...]
    std: tuple[dict[str, np.ndarray], ...]
    unexplained: float

    def simulate(self, force: Any, fs: float, *, form: str = "receptance") -> Float[np.ndarray, "t o"]:
        """Response from rest to a force record of no component above half the sampling rate, shape ``(t,)`` [N]."""
        u = np.asarray(scipy.signal.resample(np.asarray(force, float), FINER * len(np.asarray(force))))[:, None]
        places = [self.place] * len(self.joints)
        record = respond(
            self.model, self.joints, places, u, FINER * fs, inputs=self.model.inputs, outputs=self.model.outputs,
            form=form,
        )  # fmt: skip
        return np.asarray(record.response)[::FINER]


def fit_laws(
    force: Any, response: Any, fs: float, start: ModalModel, joints: Sequence[Joint], place: Sequence[str], *,
    band: tuple[float, float], form: str = "receptance",
) -> FittedLaws:  # fmt: skip
    """Fit laws of one joint to records, together with the modes.

    Parameters
    ----------
    force
        Records of one force, shape ``(run, t)`` [N].
    response
        Responses in the order of the outputs of ``start``, shape ``(run, t, o)``.
    fs
        Sampling rate [Hz].
    start
        Modes to start from, with one input, which is also an output.
    joints
        Laws with parameters to start from; those that start at 0 stay there. None: the linear structure.
    place
        One output, the other end being the ground, or two.
    band
        Lines to fit [Hz].
    form
        Responses are displacement (``receptance``), velocity (``mobility``) or acceleration (``accelerance``).

    Raises
    ------
    ValueError
        If shapes do not fit, or the place or the driven DoF was not measured.
    """
    require_double("fit_laws")
    records = _Records.of(force, response, fs, band, form)
    runs = len(records.X)
    layout = _Layout.of(start, joints, place, records)
    found = _search(layout, records, np.asarray(layout.start))
    left = [_search(layout, records.without(k), found.x).x for k in range(runs) if runs > 1]
    std = np.full(len(found.x), np.nan)
    if left:
        std = np.sqrt((runs - 1) * np.mean((np.array(left) - np.mean(left, axis=0)) ** 2, axis=0))
    model, laws = layout.unpack(as_array(found.x))
    # what is positive is searched by its logarithm, so that its own spread is relative
    by = np.asarray(layout.factors(as_array(found.x)[layout.linear :]))
    spread = std[layout.linear :] * np.where(layout.positive, by, 1.0)
    told = tuple(
        {n: np.asarray(np.abs(p)) for n, p in j.parameters.items()}
        for j in _scaled(joints, layout.free, as_array(spread))
    )
    return FittedLaws(model, laws, tuple(place), told, float(np.linalg.norm(found.fun)))


def _search(layout: "_Layout", records: "_Records", start: np.ndarray) -> Any:
    return scipy.optimize.least_squares(
        lambda t: np.asarray(_residual(as_array(t), layout, records)), start,
        lambda t: np.asarray(_slope(as_array(t), layout, records)), x_scale="jac", max_nfev=STEPS,
    )  # fmt: skip


class _Records(eqx.Module):
    """Spectra of the records in the band, and the motion of the outputs in time."""

    s: Complex[Array, " f"]
    F: Complex[Array, "r f"]
    X: Complex[Array, "r f o"]
    motion: Float[Array, "r t o"]
    speed: Float[Array, "r t o"]
    norm: Float[Array, " r"]
    inside: tuple[int, int] = eqx.field(static=True)
    order: int = eqx.field(static=True)

    @classmethod
    def of(cls, force: Any, response: Any, fs: float, band: tuple[float, float], form: str) -> "_Records":
        f, x = np.asarray(as_double(force, "force")), np.asarray(as_double(response, "response"))
        if f.ndim != 2 or x.ndim != 3 or f.shape != x.shape[:2]:
            raise ValueError(f"force has shape {f.shape} and response {x.shape}; they need (run, t) and (run, t, o)")
        count, order = f.shape[1], DERIVATIVES[form]
        s = 2j * np.pi * np.fft.rfftfreq(count, 1 / fs)
        lines = np.flatnonzero((s.imag >= 2 * np.pi * band[0]) & (s.imag <= 2 * np.pi * band[1]))
        if not len(lines):
            raise ValueError(f"the band {band[0]:g} to {band[1]:g} Hz holds no line; they are {fs / count:g} Hz apart")
        F, X = np.fft.rfft(f, axis=1), np.fft.rfft(x, axis=1)
        # below the band an integration would make drift of noise
        low = np.abs(s) < np.abs(s[lines[0]])
        factor = np.where(low, 0.0, np.where(low, 1.0, s) ** -float(order)) if order else np.ones(len(s))
        displacement = X * factor[:, None]
        motion, speed = (np.fft.irfft(part, count, axis=1) for part in (displacement, displacement * s[:, None]))
        first, last = int(lines[0]), int(lines[-1]) + 1
        X = X[:, first:last]
        return cls(
            as_array(s[first:last]), as_array(F[:, first:last]), as_array(X), as_array(motion),
            as_array(speed), as_array(np.sqrt(len(X)) * np.linalg.norm(X, axis=(1, 2))), (first, last), order,
        )  # fmt: skip

    def without(self, run: int) -> "_Records":
        """The other runs."""
        of = lambda a: as_array(np.delete(a, run, axis=0))
        fewer = np.sqrt((len(self.X) - 1) / len(self.X))
        return _Records(
            self.s, of(self.F), of(self.X), of(self.motion), of(self.speed), fewer * of(self.norm), self.inside,
            self.order,
        )  # fmt: skip


class _Layout(eqx.Module):
    """The unknowns as one vector: logarithms of frequencies and damping, shapes, residual terms, laws."""

    start: Float[Array, " u"]
    joints: tuple[Joint, ...]
    direction: Float[Array, " o"]
    flexibility: Float[Array, ""]
    outputs: tuple[str, ...] = eqx.field(static=True)
    free: Free = eqx.field(static=True)
    positive: tuple[bool, ...] = eqx.field(static=True)
    drive: int = eqx.field(static=True)
    modes: int = eqx.field(static=True)

    @classmethod
    def of(cls, start: ModalModel, joints: Sequence[Joint], place: Sequence[str], records: _Records) -> "_Layout":
        names = start.outputs
        missing = [n for n in (*place, *start.inputs) if n not in names]
        if missing or len(start.inputs) != 1 or len(place) not in (1, 2):
            raise ValueError(
                f"place {list(place)} and input {list(start.inputs)}: one input and one or two DoFs of the joint are "
                f"needed, all measured; measured are {', '.join(names)}"
            )
        if records.X.shape[2] != len(names):
            raise ValueError(f"{records.X.shape[2]} responses for {len(names)} outputs of the modes")
        drive = names.index(start.inputs[0])
        direction = np.zeros(len(names))
        direction[names.index(place[0])] = 1.0
        if len(place) == 2:
            direction[names.index(place[1])] = -1.0
        # a residue of the driving point is a square
        residue = np.asarray(start.shapes) * np.asarray(start.participation)
        psi = residue / np.sqrt(residue[:, drive] + 0j)[:, None]
        scale = np.abs(psi).max(axis=1)
        flexibility = float(np.abs(residue / np.asarray(start.poles)[:, None]).max())
        count = len(scale)
        free = _free(joints)
        positive = _positive(joints, free)
        laws = np.where(positive, 0.0, 1.0)
        upper = np.zeros(len(names) * (len(names) + 1) // 2)
        vector = np.concatenate([
            np.log(np.asarray(start.frequency_hz)), np.log(np.asarray(start.damping_ratio)),
            psi.real.ravel(), psi.imag.ravel(), upper, laws,
        ])  # fmt: skip
        return cls(
            as_array(vector), tuple(joints), as_array(direction), as_array(flexibility), names, free,
            positive, drive, count,
        )  # fmt: skip

    @property
    def linear(self) -> int:
        """Unknowns of the linear structure."""
        n = len(self.outputs)
        return self.modes * (2 + 2 * n) + n * (n + 1) // 2

    def factors(self, laws: Array) -> Array:
        """Factors on the start values of the laws' parameters."""
        positive = np.array(self.positive, bool)
        return jnp.where(positive, jnp.exp(jnp.where(positive, laws, 0.0)), laws)

    def parts(self, t: Array) -> tuple[Array, Array, Array, tuple[Joint, ...]]:
        """Poles, reciprocal shapes ``(k, o)``, upper residual terms ``(o, o)`` and joints."""
        n, k = len(self.outputs), self.modes
        f, z, re, im, upper, laws = jnp.split(t, np.cumsum([k, k, k * n, k * n, n * (n + 1) // 2]).tolist())
        poles = poles_from(jnp.exp(f), jnp.exp(z))
        U = jnp.zeros((n, n)).at[np.triu_indices(n)].set(upper)
        joints = _scaled(self.joints, self.free, self.factors(laws))
        return poles, (re + 1j * im).reshape(k, n), self.flexibility * (U + U.T) / 2, joints

    def unpack(self, t: Array) -> tuple[ModalModel, tuple[Joint, ...]]:
        """Modes and joints of a vector."""
        poles, psi, U, joints = self.parts(t)
        d = self.drive
        model = ModalModel(
            poles, psi, psi[:, d : d + 1], upper=U[:, d : d + 1] + 0j, outputs=self.outputs,
            inputs=(self.outputs[d],),
        )  # fmt: skip
        return model, joints

    def residual(self, t: Array, records: _Records) -> Float[Array, " n"]:
        """What is left of the spectra, over the norm of the response; runs, outputs and lines in this order."""
        poles, psi, U, joints = self.parts(t)
        s, b = records.s, self.direction
        a, c = 1 / (s[:, None] - poles), 1 / (s[:, None] - poles.conj())

        def columns(ends: Array) -> Array:
            A = psi * (psi @ ends)[:, None]
            return (a @ A + c @ A.conj() + U @ ends) * (s**records.order)[:, None]

        drive = jnp.zeros(len(self.outputs)).at[self.drive].set(1.0)
        X = columns(drive) * records.F[:, :, None]
        if joints:
            x, v = records.motion @ b, records.speed @ b
            force = sum((along(j, x, v) for j in joints), jnp.zeros_like(x))
            N = jnp.fft.rfft(force, axis=1)[:, records.inside[0] : records.inside[1]]
            X = X - columns(b) * N[:, :, None]
        left = jnp.moveaxis((X - records.X) / records.norm[:, None, None], 2, 1)
        return jnp.concatenate([left.real.ravel(), left.imag.ravel()])


@eqx.filter_jit
def _residual(t: Array, layout: _Layout, records: _Records) -> Float[Array, " n"]:
    return layout.residual(t, records)


@eqx.filter_jit
def _slope(t: Array, layout: _Layout, records: _Records) -> Float[Array, "n u"]:
    return jax.jacfwd(layout.residual)(t, records)


def along(joint: Joint, x: Float[Array, "r t"], v: Float[Array, "r t"]) -> Float[Array, "r t"]:
    """Force of a joint along records of its motion that repeat: the second lap of a law with memory."""
    if isinstance(joint, Memoryless):
        return joint.force(x, v)
    if not isinstance(joint, Hysteretic):
        raise ValueError(f"{joint.slug} has no law in time")

    def one(way: Array) -> Array:
        def step(now: tuple[Any, Array], new: Array) -> tuple[tuple[Any, Array], Array]:
            state, f = joint.step(now[0], now[1], new)
            return (state, new), f

        first, _ = jax.lax.scan(step, (joint.initial_state(), jnp.zeros(())), way)
        return jax.lax.scan(step, first, way)[1]

    return jax.vmap(one)(x)


def _free(joints: Sequence[Joint]) -> Free:
    return tuple(tuple(tuple(np.flatnonzero(np.asarray(p)).tolist()) for p in j.parameters.values()) for j in joints)


def _positive(joints: Sequence[Joint], free: Free) -> tuple[bool, ...]:
    """Of each number, whether its law needs it to be positive."""
    return tuple(
        j.bounds[name] == POSITIVE
        for j, numbers in zip(joints, free, strict=True)
        for name, which in zip(j.parameters, numbers, strict=True)
        for _ in which
    )


def _scaled(joints: Sequence[Joint], free: Free, by: Array) -> tuple[Joint, ...]:
    """The joints with each number that is not 0 times its own factor."""
    out, at = [], 0
    for joint, numbers in zip(joints, free, strict=True):
        new = {}
        for (name, value), which in zip(joint.parameters.items(), numbers, strict=True):
            factors = by[at : at + len(which)]
            new[name] = (
                jnp.ravel(value)
                .at[np.array(which, int)]
                .multiply(factors, unique_indices=True)
                .reshape(jnp.shape(value))
            )
            at += len(which)
        out.append(_with(joint, new))
    return tuple(out)


def _with(joint: Joint, values: dict[str, Array]) -> Joint:
    """The joint with other parameters."""
    names = list(values)
    return eqx.tree_at(lambda j: [getattr(j, n) for n in names], joint, [values[n] for n in names])
