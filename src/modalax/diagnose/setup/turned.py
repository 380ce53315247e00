"""Measured DoFs by the names that the simulation has for them, where they differ in how a direction is written."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TypeVar

import jax.numpy as jnp
import numpy as np

from modalax.data import FRF, Measurement
from modalax.data.dofs import same_place
from modalax.model.mode_table import ModeTable

Measured = TypeVar("Measured", Measurement, FRF)


def turned(measured: Measured, names: Sequence[str]) -> tuple[Measured, tuple[str, ...]]:
    """A measurement in the names and directions of a simulation, and what was turned or renamed, in sentences.

    A DoF that the simulation counts the other way (``8:-Z`` measured, ``8:+Z`` simulated) has its FRFs times -1. One
    that the simulation does not have either way keeps its name.

    Parameters
    ----------
    measured
        Runs of FRFs, or one.
    names
        Of the simulation's DoFs.
    """
    outputs, out = _by_names(measured.outputs, names)
    inputs, into = _by_names(measured.inputs, names)
    if (outputs, inputs) == (measured.outputs, measured.inputs):
        return measured, ()
    said = {*_said(measured.outputs, outputs, out), *_said(measured.inputs, inputs, into)}
    H = measured.H * jnp.asarray(out[:, None] * into)
    return measured.replace(H=H, outputs=outputs, inputs=inputs), tuple(sorted(said))


def turned_modes(table: ModeTable, names: Sequence[str]) -> tuple[ModeTable, tuple[str, ...]]:
    """The same of modes alone."""
    dofs, signs = _by_names(table.dofs, names)
    return replace(table, dofs=dofs, shapes=table.shapes * signs), tuple(_said(table.dofs, dofs, signs))


def _said(old: Sequence[str], new: Sequence[str], signs: np.ndarray) -> Iterable[str]:
    for a, b, sign in zip(old, new, signs, strict=True):
        if a != b:
            yield f"measured {a} is {b} of the simulation, {'turned' if sign < 0 else 'in the same direction'}"


def _by_names(measured: tuple[str, ...], names: Sequence[str]) -> tuple[tuple[str, ...], np.ndarray]:
    """The simulation's name of each DoF, and 1, or -1 where it counts the other way."""
    there, found, signs = set(names), list(measured), np.ones(len(measured))
    for k, name in enumerate(measured):
        if name in there:
            continue
        alike = [(other, sign) for other in names if (sign := same_place(name, other))]
        if len(alike) == 1 and alike[0][0] not in found:
            found[k], signs[k] = alike[0]
    return tuple(found), signs
