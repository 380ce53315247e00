r"""The number :math:`y = -\frac{Z}{1 + Z\,b^THb}\,b^TH` of an element at a place, sample by sample.

Where the amplitude across a joint is solved for, trials, lines and inputs are laid out in a row and worked on in pieces
of one length, so that what is compiled depends on the cause alone: measurements of any size share it.
"""

import math
from functools import partial

import jax
import numpy as np

from modalax.diagnose.causes.base import ElementCause, LocalCause
from modalax.diagnose.prediction.amplitude import TINY
from modalax.diagnose.prediction.frf import equivalent
from modalax.diagnose.prediction.impedances import impedances, linear_impedances

LENGTH = 2048  # samples of a piece; longer ones take as long a sample, and a program more


@partial(jax.jit, static_argnames="cause", compiler_options={"xla_backend_optimization_level": 1})
def _piece(cause, p, motion, drive, omega, level):
    """Samples of a joint in balance: of one line and input each, ``level`` holds the runs, shape ``(run or 1,)``."""

    def one(p, motion, drive, omega, level):
        Z = equivalent(cause, p, omega[None], drive[None, None], motion[None, None, None], level[:, None])[:, 0, 0]
        return -Z / (1 + Z * drive) * motion

    return jax.vmap(one)(p, motion, drive, omega, level)


def coefficients(
    cause: ElementCause, solve: bool, params: np.ndarray, owner: np.ndarray, motion: np.ndarray, drive: np.ndarray,
    omega: np.ndarray, level: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """The number y of each trial at the place that owns it, shape ``(trial, run or 1, f, i)``.

    Parameters
    ----------
    solve
        Whether the amplitude across a joint is solved for; without, it is that of the structure without the joint.
    params, owner
        Parameters of each trial, shape ``(trial, parameter)``, and the number of its place.
    motion, drive
        Receptances from the inputs to the places, shape ``(place, f, i)``, and across them, ``(place, f)`` [m/N].
    level
        Force amplitudes, shape ``(run, f)`` [N].

    Raises
    ------
    ValueError
        If an impedance does not have the shape of the lines that it is asked at.
    """
    if isinstance(cause, LocalCause):
        Z = linear_impedances(cause, params, omega)[0]
        with np.errstate(all="ignore"):
            return (-Z / (1 + Z * drive[owner]))[:, None, :, None] * motion[owner][:, None]
    if not solve:
        A = level[:, :, None] * np.abs(motion[owner])[:, None] + TINY
        with np.errstate(all="ignore"):
            return -impedances(cause, params, omega, A) * motion[owner][:, None]
    # trial, run, line, input; where the law follows the number of the run, all runs are in one sample
    force = level.T[None, None, :, None] if cause.each_run else level[None, :, :, None, None]
    shape = len(params), force.shape[1], *motion.shape[1:]

    def flat(x: np.ndarray) -> np.ndarray:
        """All samples in a row."""
        return np.broadcast_to(x, (*shape, *x.shape[4:])).reshape(math.prod(shape), *x.shape[4:])

    samples = [
        flat(params[:, None, None, None]), flat(motion[owner][:, None]), flat(drive[owner][:, None, :, None]),
        flat(omega[None, None, :, None]), flat(force),
    ]  # fmt: skip
    size = math.prod(shape)
    out = [
        _piece(cause, *(_filled(x[start : start + LENGTH], LENGTH) for x in samples))
        for start in range(0, size, LENGTH)
    ]
    every = np.concatenate([np.asarray(y) for y in out])[:size]
    y = np.moveaxis(every.reshape(*shape, -1), -1, 2)
    return y.reshape(len(params), -1, *motion.shape[1:])


def _filled(x: np.ndarray, length: int) -> np.ndarray:
    return np.concatenate([x, np.repeat(x[-1:], length - len(x), axis=0)]) if len(x) < length else x
