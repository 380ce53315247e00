r"""Changes of mass or stiffness between any two modes, the non-parametric model of inaccuracy by Soize (2000).

With shapes of unit modal mass it is :math:`\delta\,\omega_r\omega_s z_{rs}` in stiffness and :math:`\delta z_{rs}` in
mass, ``z`` symmetric and standard normal, on the diagonal of variance 3/2.
"""

import numpy as np

ON_DIAGONAL = np.sqrt(1.5)  # change of a mode itself, relative to a coupling of two modes

Couple = tuple[int, int]


def couples_of(count: int, inside: int, above: int) -> list[Couple]:
    """Pairs of modes, of ``count``, one among the lowest ``inside``, the other at most ``above`` beyond these."""
    return [(r, s) for r in range(inside) for s in range(r, min(count, inside + above))]


def coupling_patterns(couples: list[Couple], scale: np.ndarray) -> np.ndarray:
    """Changes by the whole between pairs of modes, shape ``(p, n, n)``; ``scale`` is what each mode counts with."""
    n = len(scale)
    patterns = np.zeros((len(couples), n, n))
    for k, (r, s) in enumerate(couples):
        patterns[k, r, s] = patterns[k, s, r] = scale[r] * scale[s] * (ON_DIAGONAL if r == s else 1.0)
    return patterns


def counted_with(frequencies: np.ndarray, inside: int) -> np.ndarray:
    """Circular frequency that each mode counts with in a coupling of stiffness: that of a rigid body is not nothing."""
    return np.maximum(frequencies, 0.05 * frequencies[inside - 1])
