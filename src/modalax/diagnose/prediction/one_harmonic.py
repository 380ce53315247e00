r"""The force of a joint by one harmonic alone.

The motion across a joint is :math:`x = u - G\,N(|x|)\,x` for the motion u without it, so that its amplitude solves

.. math:: |x|\,|1 + G\,N(|x|)| = |u|,

one real equation a line, run and input.
"""

import numpy as np

from modalax.diagnose.causes.base import JointCause
from modalax.diagnose.prediction.impedances import impedances

STEPS = 40  # of a search for the amplitude
STEP = 1e-5  # relative change by which slopes are taken
LEAST = 1e-3  # smallest parameter to which such a change relates
FLATTEST = 0.05  # least slope of the equation, on logarithmic scales, in a step
SOLVED = 1e-9  # misfit of the amplitude, on a logarithmic scale


def described(
    cause: JointCause, p: np.ndarray, G: np.ndarray, free: np.ndarray, omega: np.ndarray, near: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    r"""The force of a joint by one harmonic [N], its slopes, whether a motion was found, and that motion [m].

    Parameters
    ----------
    cause, p
        The joint and its parameters.
    G
        Receptance across the place [m/N], shape ``(run, f, i)``.
    free
        Motion across it without the joint [m], of the same shape.
    omega
        Circular frequencies [rad/s], shape ``(f,)``.
    near
        Amplitudes near which the motion is sought [m], of the shape of ``free``.

    Returns
    -------
    tuple
        Shapes ``(run, f, i)``, ``(parameter + 1, run, f, i)``, ``(run, f, i)`` and ``(run, f, i)``. The last slope is
        by the logarithm of the motion without the joint.
    """
    if cause.rigid:
        return _rubbing(cause, p, G, free, omega)
    with np.errstate(all="ignore"):
        a, sound = _amplitude(cause, p, G, np.abs(free), omega, near)
        steps = STEP * np.maximum(np.abs(p), LEAST)
        steps = np.where(p + steps > [q.upper for q in cause.parameters], -steps, steps)
        further = np.array([1.0, 1.0 + STEP, *np.ones(len(p))])[:, None, None, None] * a
        N, louder, *other = impedances(cause, np.stack([p, p, *(p + np.diag(steps))]), omega, further)
        by_a = (louder - N) / STEP  # by the logarithm of the amplitude
        each = [(Z - N) / step for Z, step in zip(other, steps, strict=True)]
        share = 1 / (1 + G * N)
        bent = 1 + (G * by_a * share).real  # how the motion without the joint grows with that with it
        moved = [by_p - by_a * (G * by_p * share).real / bent for by_p in each]
        slopes = [free * share**2 * by_p for by_p in moved]
        force = free * share * N
        slopes.append(force + free * share**2 * by_a / bent)
    slopes = np.stack(slopes)
    sound &= np.isfinite(force) & np.isfinite(slopes).all(axis=0)
    return force, slopes, sound, free * share


def _amplitude(
    cause: JointCause, p: np.ndarray, G: np.ndarray, size: np.ndarray, omega: np.ndarray, near: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The amplitude near a given one, by Newton's steps between bounds on a logarithmic scale, and where it was found.

    ``size`` is the amplitude without the joint.
    """
    x, goal = np.log(np.where(near > 0, near, np.maximum(size, 1e-300))), np.log(np.maximum(size, 1e-300))
    low, high = np.full(x.shape, -np.inf), np.full(x.shape, np.inf)

    def missed(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Misfit and slope."""
        both = np.stack([x, x + STEP])
        left, further = both + np.log(np.abs(1 + G * impedances(cause, p, omega, np.exp(both)))) - goal
        return left, np.maximum((further - left) / STEP, FLATTEST)

    left, slope = missed(x)
    for _ in range(STEPS):
        if not (np.abs(left) > SOLVED).any():
            break
        low, high = np.where(left < 0, x, low), np.where(left > 0, x, high)
        new = x - np.clip(left / slope, -1.0, 1.0)
        between = np.where(np.isfinite(low) & np.isfinite(high), 0.5 * (low + high), new)
        x = np.where(np.abs(left) > SOLVED, np.where((new > low) & (new < high), new, between), x)
        left, slope = missed(x)
    return np.exp(x), (np.abs(left) <= SOLVED) & (size > 0)


def _rubbing(
    cause: JointCause, p: np.ndarray, G: np.ndarray, free: np.ndarray, omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of dry friction, whose force has one size where it slides, and holds the motion at nothing where it sticks."""
    size = np.abs(free)
    unit = size * impedances(cause, p, omega, np.where(size > 0, size, 1.0))  # of one size at any amplitude

    def at(unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        across = G * unit
        a = -across.real + np.sqrt(np.maximum(size**2 - across.imag**2, 0.0))
        slides = (size > np.abs(across)) & (a > 0)
        with np.errstate(all="ignore"):
            moving = unit * free / (a + across)
            return np.where(slides, moving, free / G), np.where(slides, a * free / (a + across), 0.0)

    force, motion = at(unit)
    slope = (at((1 + STEP) * unit)[0] - force) / STEP  # by the logarithm of the limit
    by_p = slope / np.where(p[0] != 0, p[0], 1.0)
    return force, np.stack([by_p, force - slope]), np.isfinite(force) & np.isfinite(slope), motion
