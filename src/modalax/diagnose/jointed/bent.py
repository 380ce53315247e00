r"""Whether the modes of a simulation must move before a joint of any law explains the force levels.

A linear mode that was fitted to one force level is bent by the joint already, so that no joint added to that mode does.
A search that takes the mode as it is then tries everything in vain. A joint without a law is fitted with the modes as
they are and with the modes free, at the measured motion, where no equation has to be solved. With the size of the
error unknown and q linear unknowns more, the free modes are likelier by

.. math:: \ln B = \tfrac{n}{2L}\ln\frac{\chi^2_\mathrm{as\ is}}{\chi^2_\mathrm{free}} - \tfrac{q}{2}\ln\tfrac{n}{L},

n real samples, L correlation length in lines (Schwarz 1978, Ann. Statist. 6:461).
"""

import math
from typing import Any

import numpy as np

from modalax.data import Measurement
from modalax.diagnose.causes.free_law import FreeLaw
from modalax.diagnose.joint_laws import Measured, Task, joint_task, linear_unknowns, solve, starts_of
from modalax.diagnose.jointed.fits import KNOTS, correlation_length, granted, highest, reach_of
from modalax.diagnose.thresholds import THRESHOLDS
from modalax.model import ModalModel

STEPS = 30  # of each fit


def modes_are_bent(measurement: Measurement, modes: ModalModel) -> bool:
    """Whether a joint explains the levels with the modes free, and none does with the modes as they are.

    Parameters
    ----------
    measurement
        Runs at three levels or more, with one input; False unless one output alone is measured, as the joint may sit
        elsewhere.
    modes
        Those of the simulation in the band; False where their author claims a spread, within which they may move.
    """
    claimed = np.any(np.asarray(modes.frequency_std)) or np.any(np.asarray(modes.damping_std))
    if len(measurement.outputs) > 1 or claimed:
        return False
    where, held = measurement.outputs[:1], highest(measurement)
    task = joint_task(measurement, modes, where, granted(measurement), [held])
    law = FreeLaw(KNOTS[0], reach_of(measurement, where, held))
    linear = _fitted(task, (), modes_free=True)
    free, as_is = (_fitted(task, (law,), modes_free=moved) for moved in (True, False))
    real, imag = free.fun.reshape(2, *task.problem.data.shape)
    count = task.problem.samples / correlation_length(np.delete(real + 1j * imag, held, axis=0))
    return must_move(linear.cost, free.cost, as_is.cost, count, linear_unknowns(task.problem))


def must_move(linear: float, free: float, as_is: float, count: float, unknowns: int) -> bool:
    """Whether the modes as they are leave too much where a joint with free modes explains the levels.

    Parameters
    ----------
    linear, free, as_is
        Sums of squares that free modes alone leave, and a joint with the modes free or as they are.
    count
        Samples that count as independent.
    unknowns
        Of the modes, where they are free.
    """
    if free > (1 - THRESHOLDS.explained_by_joint) * linear:
        return False
    likelier = 0.5 * count * math.log(as_is / free) - 0.5 * unknowns * math.log(count)
    return likelier > -math.log(THRESHOLDS.rival)


def _fitted(task: Task, causes: tuple[FreeLaw, ...], *, modes_free: bool) -> Any:
    """The best fit at the measured motion."""
    known = tuple(Measured(c) for c in causes)
    fits = [solve(task, known, x, task.motion, STEPS, modes_free=modes_free) for x in starts_of(task, causes, {})]
    return min(fits, key=lambda f: f.cost)
