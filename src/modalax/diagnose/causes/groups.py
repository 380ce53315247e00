"""Parameters of a finite-element model that are wrong for a whole group of elements."""

from typing import Any

from modalax.diagnose.causes.base import Cause
from modalax.diagnose.causes.parameter import Parameter


class GroupCause(Cause):
    """A parameter of a group of elements that the simulation names; only its matrices show it, not its receptances.

    It is looked for in the modal domain (:mod:`modalax.diagnose.modal_domain.causes.groups`), never line by line.
    """

    in_structure = True


class ElementGroup(GroupCause):
    """Young's modulus, or the rate of springs."""

    slug = "element_group"
    summary = "the right stiffness of a group of elements"
    advice = "measure the group's material or section by itself"
    parameters = (Parameter("stiffness_factor", "-", 0.0),)


class ElementGroupMass(GroupCause):
    """Density."""

    slug = "element_group_mass"
    summary = "the right mass of a group of elements"
    advice = "weigh the group"
    parameters = (Parameter("mass_factor", "-", 0.0),)


GROUPS: tuple[Any, ...] = (ElementGroup(), ElementGroupMass())
