"""Formulas of known numbers by NumPy and of traced ones by JAX: the same, and no program for each shape."""

from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax._numerics import known
from modalax._numerics.known import by_numpy, by_numpy_beside, cholesky, over_first, scan, solved, triangular_solved
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


def test_a_loop_and_a_scan_give_the_same():
    step = lambda state, row: (state + row[0], (state * row[1], None))
    rows = np.arange(1.0, 5.0), np.linspace(0.0, 1.0, 4)
    for xp in (np, jnp):
        last, (made, nothing) = scan(xp, step, xp.asarray(2.0), rows)
        assert float(last) == 12.0 and nothing is None
        np.testing.assert_allclose(made, [0.0, 1.0, 10 / 3, 8.0], rtol=1e-15)
        assert scan(xp, lambda state, _: (state, state), xp.ones(3), length=0)[1].shape == (0, 3)
        np.testing.assert_allclose(over_first(xp, lambda a, b: a @ b, np.eye(2), np.ones((2, 2))), [1.0, 1.0])


def test_known_systems_without_a_solution_give_what_jax_gives():
    """NumPy raises an error there, for all systems of a stack; JAX goes on."""
    regular, singular, b = np.array([[2.0, 1.0], [0.0, 4.0]]), np.ones((2, 2)), np.array([[2.0], [4.0]])
    both = solved(np, np.stack([singular, regular]), np.stack([b, b]))
    assert not np.isfinite(both[0]).any()
    np.testing.assert_allclose(both[1], solved(jnp, regular, b), rtol=1e-15)
    assert np.isnan(cholesky(np, -np.eye(2))).all() and np.isnan(cholesky(jnp, -jnp.eye(2))).any()
    with np.errstate(all="ignore"):
        assert not np.isfinite(triangular_solved(np, np.zeros((2, 2)), b)).any()
    for adjoint in (False, True):
        x = triangular_solved(np, regular * (1 + 2j), b + 0j, adjoint=adjoint)
        A = (regular * (1 + 2j)).conj().T if adjoint else regular * (1 + 2j)
        np.testing.assert_allclose(A @ x, b, rtol=1e-15)
        np.testing.assert_allclose(x, triangular_solved(jnp, regular * (1 + 2j), b + 0j, adjoint=adjoint), rtol=1e-14)


def test_long_work_stays_on_an_accelerator_that_holds_the_numbers(monkeypatch):
    chosen = []
    formula = by_numpy_beside(lambda xp, a: chosen.append(xp) or 2 * a)
    a = jnp.ones(3)
    assert np.array_equal(formula(a), [2.0, 2.0, 2.0]) and chosen == [np]
    monkeypatch.setattr(known, "accelerated", lambda *arrays: True)
    assert np.array_equal(formula(a), [2.0, 2.0, 2.0]) and chosen == [np, jnp]
