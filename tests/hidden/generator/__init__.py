"""Hidden-effect cases for modal tests, made without the package that is to find them.

``draw_case(seed, cause, d, family)`` gives the arrays of a measurement and of a simulation that lacks something, and
the truth. NumPy and SciPy only.
"""

from .case import CATALOGUE, OUTSIDE_CATALOGUE, SIZES, Case, draw_case
from .systems import FAMILIES

__all__ = ["CATALOGUE", "FAMILIES", "OUTSIDE_CATALOGUE", "SIZES", "Case", "draw_case"]
