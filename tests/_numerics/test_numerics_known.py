"""Formulas of known numbers by NumPy and of traced ones by JAX: the same, and no program for each shape."""

from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax._numerics.known import by_numpy
from modalax.model.examples import five_dof

PROGRAMS = Counter()  # events of JAX's compilation in this process, by name
jax.monitoring.register_event_duration_secs_listener(lambda event, *_, **__: PROGRAMS.update([event]))


def programs() -> int:
    return sum(count for event, count in PROGRAMS.items() if "compile" in event)


@by_numpy
def rooted(xp, a, b, *, power):
    return {"root": xp.sqrt(a) ** power, "ratio": a / b}


def test_known_and_traced_numbers_give_the_same():
    a, b = np.array([1.0, 4.0, 9.0]), np.array([2.0, 0.0, 3.0])
    known = rooted(a, b, power=3)  # a ratio to 0 is infinite, without a warning
    traced = jax.jit(lambda a: rooted(a, b, power=3))(a)
    for name, expected in {"root": [1.0, 8.0, 27.0], "ratio": [0.5, np.inf, 3.0]}.items():
        assert isinstance(known[name], jax.Array)
        np.testing.assert_allclose(known[name], expected, rtol=1e-15)
        np.testing.assert_allclose(traced[name], expected, rtol=1e-15)
    slope = jax.grad(lambda a: jnp.sum(rooted(a, b, power=3)["root"]))(a)
    np.testing.assert_allclose(slope, 1.5 * np.sqrt(a), rtol=1e-14)


@pytest.mark.parametrize("modal", [False, True])
def test_an_frf_of_known_numbers_compiles_nothing(modal):
    structure = five_dof().modal() if modal else five_dof()
    freq = np.linspace(20.0, 60.0, 37)
    before = programs()
    known = structure.frf(freq, form="mobility", inputs=["1"])
    known.to_form("receptance").band(30.0, 50.0).transpose()
    assert programs() == before
    traced = jax.jit(lambda f: structure.frf(f, form="mobility", inputs=["1"]).H)(freq)
    assert programs() > before
    assert np.abs(known.H - traced).max() < 1e-12 * np.abs(traced).max()
