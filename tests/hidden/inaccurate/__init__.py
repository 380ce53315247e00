"""Virtual tests of structures whose simulation is off everywhere, made without the package that is to explain them.

``draw_case(seed, ...)`` gives the arrays of a measurement and of a nominal simulation, and the truth: every element's
stiffness and mass off a little, dampings off, and one gross error or none. NumPy and SciPy only.
"""

from .case import CAUSES, Case, draw_case
from .structures import KINDS

__all__ = ["CAUSES", "KINDS", "Case", "draw_case"]
