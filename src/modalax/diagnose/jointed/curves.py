r"""Sets of laws compared with the stiffness and loss that a joint without a law has at the measured amplitudes.

Strengths enter linearly, and so do a spring and a loss, which belong to modes that are not known; thresholds and
exponents are tried on grids. A change dN of the impedance changes the motion across the joint by the share
:math:`b^T H b\,dN`, H the structure with the joint, and that over the error of a sample is its weight.
"""

import itertools
import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from modalax._numerics.checks import as_array
from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.causes.scene import across
from modalax.diagnose.decision.beliefs import believed
from modalax.diagnose.joint_laws import Explained, Task
from modalax.diagnose.setup.modal_form import modal_form_of
from modalax.diagnose.thresholds import THRESHOLDS

SHAPES = 10  # thresholds that are tried, over the range of amplitudes
LOWEST = 0.05  # of the amplitudes, the quantile at which thresholds begin
SAME = 1e-9  # norm of what is left of a law beside a spring and a loss, over its own, from which on it is more


def likeliest_sets(
    free: Explained, task: Task, laws: Sequence[JointCause], length: float
) -> list[tuple[tuple[JointCause, ...], list[np.ndarray]]]:  # fmt: skip
    """Single laws and pairs by falling evidence, with sizes; one form of each, as far as it is no linear element.

    Parameters
    ----------
    free
        The joint without a law, fitted.
    task
        What it was fitted to.
    laws
        What to look for.
    length
        Correlation length of errors in lines.
    """
    motion, target, weight, omega = _curve(free, task)
    count, floor = free.samples / length, float(free.samples)  # the floor is what the data leave beside any law
    unit = np.stack([weight + 0j, 1j * weight], axis=-1)
    shapes = {law: _shapes(task, law, motion) for law in laws}
    basis, _ = np.linalg.qr(_real(unit))
    apart = lambda c: c - basis @ (basis.T @ c)
    told = apart(_real(weight * target))
    columns: dict[JointCause, list[tuple[np.ndarray, np.ndarray]]] = {law: [] for law in laws}
    for law in laws:
        for shape in shapes[law]:
            whole = _real(weight * _unit(law, motion, omega, shape))
            left = apart(whole)
            if np.linalg.norm(left) > SAME * np.linalg.norm(whole):
                columns[law].append((shape, left))
    found: dict[frozenset[str], tuple[float, tuple[JointCause, ...], list[np.ndarray]]] = {}
    sets = [*((law,) for law in laws), *((a, b) for a, b in itertools.combinations(laws, 2) if a.slug != b.slug)]
    for one in sets:
        tried = [_strengths(told, some, one) for some in itertools.product(*(columns[law] for law in one))]
        missed, sizes = min(tried, key=lambda t: t[0], default=(math.inf, []))
        if not np.isfinite(missed):
            continue
        unknowns = sum(len(law.parameters) for law in one)
        prior = sum(math.log(law.prior) + believed(law.slug) for law in one)
        prior -= THRESHOLDS.several_causes * (len(one) - 1)
        size = -0.5 * count * math.log(missed + floor) - 0.5 * unknowns * math.log(count) + prior
        names = frozenset(law.slug for law in one)
        if names not in found or size > found[names][0]:
            found[names] = size, one, sizes
    return [(one, sizes) for _, one, sizes in sorted(found.values(), key=lambda f: -f[0])]


def _curve(free: Explained, task: Task) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Amplitudes, impedance, its weight and circular frequency at every fitted line, shape ``(n,)`` each."""
    e, weight = free.extended, np.asarray(task.problem.weight)
    form, on = modal_form_of(e.base, e.lowest_hz), (weight > 0).any(axis=2)
    A = task.motion[on]
    omega = np.broadcast_to(np.asarray(task.problem.omega)[None, :, None], on.shape)[on]
    law = e.causes[0]
    assert isinstance(law, JointCause)
    N = np.asarray(law.impedance(as_array(A), as_array(omega), e.params[0]))
    k, c, psi, part = (np.asarray(x) for x in form.adapted(e.theta))
    place = e.places[0]
    R, poles, s = across(psi, place) * across(part, place), np.asarray(form.poles), 1j * omega[:, None]
    H = ((R * (s - poles.conj()) + R.conj() * (s - poles)) / (s**2 + c * s + k)).sum(axis=1)
    size = np.linalg.norm(weight * np.abs(np.asarray(task.problem.data)), axis=2)[on]
    return A, N, size * np.sqrt(free.samples / free.chi2) * np.abs(H / (1 + N * H)), omega


def _shapes(task: Task, law: JointCause, motion: np.ndarray) -> list[np.ndarray]:
    """Thresholds over the range of amplitudes, or the exponents and thresholds that the law is screened at."""
    if len(law.parameters) == 1:
        return [np.zeros(0)]
    if law.has_threshold:
        within = np.geomspace(np.quantile(motion, LOWEST), motion.max(), SHAPES)
        return [np.array([x]) for x in within]
    return list(np.unique(law.grid(task.scene, task.place)[:, 1:], axis=0))


def _unit(law: JointCause, motion: np.ndarray, omega: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Impedance of a law of strength one."""
    p = jnp.array([1.0, *shape])
    return np.asarray(law.impedance(as_array(motion), as_array(omega), p))


def _real(a: np.ndarray) -> np.ndarray:
    return np.concatenate([a.real, a.imag])


def _strengths(
    target: np.ndarray, columns: Sequence[tuple[np.ndarray, np.ndarray]], laws: Sequence[JointCause]
) -> tuple[float, list[np.ndarray]]:
    """Squares left by the best strengths, and all parameters; infinite where its law cannot have a strength."""
    A = np.stack([c for _, c in columns], axis=1)
    scale = np.linalg.norm(A, axis=0)
    fitted = np.linalg.lstsq(A / scale, target, rcond=None)[0]
    strength = fitted / scale
    if any(s < law.parameters[0].lower for s, law in zip(strength, laws, strict=True)):
        return math.inf, []
    sizes = [np.array([s, *shape]) for s, (shape, _) in zip(strength, columns, strict=True)]
    return float(np.sum((target - A / scale @ fitted) ** 2)), sizes
