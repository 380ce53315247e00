r"""The general inaccuracy of a simulation of which modes alone are known.

What is off of a structure without known elements is a random symmetric change of its modal matrices (Soize 2000),

.. math:: \delta K_{rs} = \epsilon_K\,\omega_r\omega_s\,z_{rs}, \qquad \delta M_{rs} = \epsilon_M\,z_{rs},

with ``z`` standard normal. Elements that are each off by themselves change a mode's own stiffness by more than what
couples two modes: of shapes that are sines in space the mean of :math:`\sin^4` is 1.5 times that of
:math:`\sin^2\sin^2`, which is the ratio of the variances.

Modes above those that are known take part as well: they give a mode's shape at a DoF the variance
:math:`\epsilon_K^2\omega_r^2\sum_s\phi_s^2/\omega_s^2`, which is the flexibility that they have there. It is that of a
coordinate of its own (:mod:`modalax.diagnose.modal_domain.structure.modes_only`), coupled as all others are.
"""

from collections.abc import Sequence

import numpy as np

from modalax.diagnose.modal_domain.structure.coordinates import Coordinates

OWN = 1.5  # variance of a mode's own change over that of a coupling
ABOVE = 2  # modes above the band that are off as those in it are, as they are coupled with it
FURTHER = {"K": 24, "M": 8}  # modes above these that they are coupled with, by mass less than by stiffness
RIGID = 1e-3  # frequency, relative to the highest, below which a mode is that of a rigid body


def between_modes(c: Coordinates, highest: float) -> tuple[np.ndarray, np.ndarray]:
    """Patterns of stiffness and of mass, shapes ``(p, n, n)``, of a simulation whose band ends at ``highest`` [rad/s].

    The stiffness of a rigid-body mode is exact: it is that of no element.
    """
    several = c.size - c.spares - c.local
    near = min(int(np.count_nonzero(c.frequencies < highest)) + ABOVE, several)
    local = range(several, several + c.local)
    elastic = [r for r in range(near) if c.frequencies[r] > RIGID * highest]
    stiffness = _coupled(c.size, elastic, min(near + FURTHER["K"], several), local)
    mass = _coupled(c.size, range(near), min(near + FURTHER["M"], several), ())
    return stiffness * c.frequencies[:, None] * c.frequencies, mass


def _coupled(size: int, near: Sequence[int], end: int, local: Sequence[int]) -> np.ndarray:
    """Changes of modes ``near`` and of what couples them with one another, with those up to ``end`` and ``local``."""
    pairs = [(r, s) for r in near for s in (*range(r, end), *local)]
    unit = np.zeros((len(pairs), size, size))
    for k, (r, s) in enumerate(pairs):
        unit[k, r, s] = unit[k, s, r] = np.sqrt(OWN) if r == s else 1.0
    return unit
