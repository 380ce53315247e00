"""Receptance of matrices and of modal models, its derivatives, local modification against assembly, reduction."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse

from modalax.model import ModalModel, Structure, assembly
from modalax.model.examples import five_dof
from modalax.model.receptance import Damper, Mass, Spring, TunedMass, change, directions, frf, receptance

OMEGA = 2 * np.pi * np.linspace(1.0, 80.0, 24)
EXACT = 1e-11  # rounding of one solve: measured 2e-13 relative to the largest value of a column


def chain(n: int, *, free: bool = False, seed: int = 1) -> Structure:
    """Masses in a row, springs between them, the first to the ground unless free."""
    rng = np.random.default_rng(seed)
    k = 1e6 * (1 + rng.random(n + 1))
    k[-1] = 0.0
    if free:
        k[0] = 0.0
    K = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    M = np.diag(1 + rng.random(n))
    return Structure(M, 1e-5 * K + 0.0 * M, K, [str(i) for i in range(n)])


def plain(s: Structure, omega: np.ndarray) -> np.ndarray:
    M, C, K, D = (np.asarray(A) for A in (s.M, s.C, s.K, s.D))
    return np.stack([np.linalg.inv(K + 1j * np.sign(w) * D + 1j * w * C - w**2 * M) for w in omega])


def worst(a, b) -> float:
    return float(np.max(np.abs(np.asarray(a) - np.asarray(b))) / np.max(np.abs(np.asarray(b))))


@pytest.mark.parametrize("n", [5, 40])
def test_receptance_is_the_inverse_of_the_dynamic_stiffness(n):
    s = chain(n)
    H = s.receptance(OMEGA, s.dofs, s.dofs)
    assert worst(H, plain(s, OMEGA)) < EXACT


def test_receptance_with_dampers_that_couple_the_modes():
    s = assembly.add_damper(chain(40), ["3", "20"], 200.0)
    assert worst(s.receptance(OMEGA, s.dofs, s.dofs), plain(s, OMEGA)) < EXACT


def test_receptance_of_a_free_structure_with_massless_dofs():
    free = chain(40, free=True)
    assert worst(free.receptance(OMEGA, free.dofs, free.dofs), plain(free, OMEGA)) < 1e-9
    light = free.replace(M=free.M.at[7, 7].set(0.0))
    assert worst(light.receptance(OMEGA, light.dofs, light.dofs), plain(light, OMEGA)) < 1e-9


def test_structural_damping_is_the_imaginary_stiffness():
    for s in (five_dof(), chain(40)):
        damped = assembly.structural_damping(s, 0.03)
        assert worst(damped.receptance(OMEGA, s.dofs, s.dofs), plain(damped, OMEGA)) < EXACT
        with pytest.raises(ValueError, match="hysteretic"):
            damped.modal()


@pytest.mark.parametrize("n", [5, 24])
def test_derivatives_by_every_matrix_frequency_and_direction(n):
    s = assembly.structural_damping(chain(n), 0.02).replace(C=chain(n).C)
    rows, columns = directions(s, [["0", "2"]]), directions(s, [["3"], ["1"]]).T
    rng = np.random.default_rng(2)
    arguments = (s.M, s.C, s.K, s.D, jnp.asarray(OMEGA[:3]), rows, columns)
    change_of = tuple(1e-3 * np.abs(a).mean() * rng.standard_normal(a.shape) for a in arguments)
    from modalax.model.solve import receptance_along

    along = jax.jit(lambda h: receptance_along(*(a + h * d for a, d in zip(arguments, change_of, strict=True))))
    tangent = jax.jit(lambda: jax.jvp(receptance_along, arguments, change_of)[1])()
    h = 1e-5
    there, back = np.asarray(along(h)), np.asarray(along(-h))
    assert worst(tangent, (there - back) / (2 * h)) < 1e-6  # central differences: measured 3e-8


def test_equal_natural_frequencies_do_not_harm_the_derivative():
    two = Structure(np.eye(20), 0.01 * np.eye(20), 1e4 * np.eye(20))

    @jax.jit
    def size(k):
        return jnp.abs(two.replace(K=two.K.at[0, 1].set(k).at[1, 0].set(k)).receptance(OMEGA[:4], ["1"], ["1"])).sum()

    slope = jax.jit(jax.grad(size))(10.0)
    assert float(slope) == pytest.approx((float(size(10.01)) - float(size(9.99))) / 0.02, rel=1e-5)


def test_receptance_jits_and_vmaps():
    s = five_dof()

    def one(scale):
        return s.replace(K=s.K * scale).receptance(OMEGA, ["1"], ["1"])

    many = jax.jit(jax.vmap(one))(jnp.array([0.9, 1.0]))
    assert worst(many[1], s.receptance(OMEGA, ["1"], ["1"])) < EXACT


def test_modal_model_and_matrices_have_one_receptance():
    s = assembly.add_damper(five_dof(), ["2", "4"], 3.0)
    b = directions(s, [["3", "5"], ["1"]])
    assert worst(receptance(s.modal(), OMEGA, b, b.T), receptance(s, OMEGA, b, b.T)) < 1e-10


def test_modal_model_driven_at_one_dof_knows_the_others_by_reciprocity():
    s = five_dof()
    full = s.modal()
    model = ModalModel(full.poles, full.shapes, full.participation[:, :1], outputs=s.dofs, inputs=s.dofs[:1])
    b = directions(model, [["3", "5"]])
    assert worst(receptance(model, OMEGA, b, b.T), receptance(s, OMEGA, b, b.T)) < 1e-10


def test_free_body_modes_are_the_lower_residual_term():
    s = chain(6, free=True)
    model = s.modal()
    assert model.poles.shape == (5,)
    b = directions(s, [["0", "3"], ["5"]])
    assert worst(receptance(model, OMEGA, b, b.T), receptance(s, OMEGA, b, b.T)) < 1e-9


ELEMENTS = [
    (["3", "5"], Spring(2e3), lambda s: assembly.add_spring(s, ["3", "5"], 2e3)),
    (["2"], Damper(7.0), lambda s: assembly.add_damper(s, ["2"], 7.0)),
    (["4"], Mass(0.2), lambda s: assembly.add_mass(s, "4", 0.2)),
    (["1"], TunedMass(0.1, 4e3, 1.0), lambda s: assembly.add_tuned_mass(s, "1", 0.1, 4e3, 1.0)),
]


@pytest.mark.parametrize(("place", "element", "assembled"), ELEMENTS, ids=[type(e[1]).__name__ for e in ELEMENTS])
@pytest.mark.parametrize("modal", [False, True])
def test_local_change_is_the_assembled_structure(place, element, assembled, modal):
    s = five_dof()
    changed = change(s.modal() if modal else s, place, element)
    expected = assembled(s).frf(OMEGA / (2 * np.pi), outputs=s.dofs, inputs=s.dofs)
    assert worst(changed.frf(OMEGA / (2 * np.pi)).H, expected.H) < 1e-9


def test_local_changes_stack():
    s = five_dof()
    both = change(change(s, ["3", "5"], Spring(2e3)), ["2"], Damper(7.0))
    expected = assembly.add_damper(assembly.add_spring(s, ["3", "5"], 2e3), ["2"], 7.0)
    assert worst(frf(both, OMEGA / (2 * np.pi)).H, expected.frf(OMEGA / (2 * np.pi)).H) < 1e-9


def test_derivative_at_no_change_is_the_screening_direction():
    s, b = five_dof(), directions(five_dof(), [["3", "5"]])
    e = directions(s, [["1"]])

    def column(k):
        H = receptance(change(s, ["3", "5"], Spring(k)), OMEGA, e, e.T)
        return jnp.stack([H.real, H.imag])

    slope = jax.jit(jax.jacfwd(column))(0.0)
    expected = -receptance(s, OMEGA, e, b.T) * receptance(s, OMEGA, b, e.T)
    assert worst(slope[0] + 1j * slope[1], expected) < 1e-10


def test_tuned_mass_by_its_own_frequency():
    element = TunedMass.at(0.1, 30.0, 0.05)
    assert float(jnp.sqrt(element.k / element.m) / (2 * jnp.pi)) == pytest.approx(30.0)


def sparse_chain(free: bool):
    s = chain(200, free=free)
    return s, scipy.sparse.csr_matrix(np.asarray(s.M)), scipy.sparse.csr_matrix(np.asarray(s.K))


@pytest.mark.parametrize("free", [False, True])
def test_sparse_matrices_reduced_to_modes_with_static_correction(free):
    s, M, K = sparse_chain(free)
    low = 2 * np.pi * np.linspace(0.5, 12.0, 40)  # the first 12 modes lie below 24 Hz (30 modes: 60 Hz)
    names = ["0", "150", "199"]
    full = assembly.modal_damping(s, 0.02).receptance(low, names, names)
    model = assembly.reduce_to_modes(M, K, s.dofs, modes=30, keep=names, damping_ratio=0.02, shift_hz=0.3)
    error = worst(model.frf(low / (2 * np.pi)).H, full)
    bare = worst(model.replace(upper=jnp.zeros((3, 3))).frf(low / (2 * np.pi)).H, full)
    assert error < 1e-4 and bare > 10 * error


def test_sparse_reduction_with_a_damper_that_couples_modes():
    s, M, K = sparse_chain(False)
    damped = assembly.add_damper(s.replace(C=1e-5 * s.K), ["10", "150"], 300.0)
    keep, low = ["0", "199", "10", "150"], 2 * np.pi * np.linspace(0.5, 12.0, 30)
    full = damped.receptance(low, keep, keep)
    projected = assembly.reduce_to_modes(M, K, s.dofs, modes=40, keep=keep, C=np.asarray(damped.C), shift_hz=0.3)
    # the damper sits on the flexibility of the modes left out, which a projection cannot see: measured 5e-3
    assert worst(receptance(projected, low, np.eye(4), np.eye(4)), full) < 2e-2
    bare = assembly.reduce_to_modes(M, K, s.dofs, modes=40, keep=keep, C=1e-5 * np.asarray(s.K), shift_hz=0.3)
    attached = change(bare, ["10", "150"], Damper(300.0))
    assert worst(receptance(attached, low, np.eye(4), np.eye(4)), full) < 1e-4


def test_modal_damping_gives_those_ratios():
    s = assembly.modal_damping(chain(7), np.linspace(0.01, 0.04, 7))
    np.testing.assert_allclose(s.modal().damping_ratio, np.linspace(0.01, 0.04, 7), rtol=1e-9)
    alpha_beta = assembly.proportional_damping(s, 0.3, 1e-5)
    w = 2 * np.pi * alpha_beta.modal().frequency_hz
    np.testing.assert_allclose(alpha_beta.modal().damping_ratio, 0.15 / w + 0.5e-5 * w, rtol=1e-9)


def test_messages_say_what_was_seen():
    s = five_dof()
    with pytest.raises(ValueError, match="no DoF named '9'"):
        directions(s, [["9"]])
    with pytest.raises(ValueError, match="must be"):
        directions(s, [["1", "1"]])
    with pytest.raises(ValueError, match="one of them"):
        assembly.reduce_to_modes(np.eye(4), np.eye(4), list("abcd"), modes=2, keep=["a"])
    with pytest.raises(ValueError, match="4 modes asked of 4 DoFs"):
        assembly.reduce_to_modes(np.eye(4), np.eye(4), list("abcd"), modes=4, keep=["a"], damping_ratio=0.0)
