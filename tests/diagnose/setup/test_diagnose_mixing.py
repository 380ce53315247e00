"""Complex modes of a structure whose dampers couple them, where the undamped modes are off, against the matrices."""

from dataclasses import replace

import jax
import numpy as np
import pytest
import scipy.linalg

from modalax import Measurement
from modalax.diagnose import diagnose
from modalax.diagnose.causes.damping import LossFactor, ModalDamping, StructuralDamping
from modalax.diagnose.causes.local import AddedMass, JointStiffness, LocalDamper
from modalax.diagnose.comparison import empty, make_comparison
from modalax.diagnose.pipeline import look
from modalax.diagnose.prediction.frf import predict
from modalax.diagnose.screening.every_cause import screen_all
from modalax.diagnose.screening.products import reduce
from modalax.diagnose.screening.score_state import score_state_of
from modalax.diagnose.screening.sensitivities import Residual
from modalax.diagnose.setup.modal_form import modal_form_of
from modalax.diagnose.setup.problem import make_problem
from modalax.model import Structure
from modalax.model.examples import five_dof

FREQ = np.linspace(18.0, 70.0, 120)
NAMES = ("1", "2", "3", "4", "5")
PREDICT = jax.jit(predict, static_argnums=0)


def coupled(damper: float, std: float = 0.01) -> Structure:
    """The five-DoF system with dampers at two places only."""
    S = five_dof()
    C = np.asarray(S.C).copy()
    C[0, 0] += damper
    C[np.ix_([2, 4], [2, 4])] += damper * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return Structure(S.M, C, S.K, NAMES, frequency_std=std, damping_std=10 * std)


def changed(structure: Structure, theta: np.ndarray, freq: np.ndarray = FREQ) -> np.ndarray:
    """Receptances from the matrices with frequencies and damping ratios of the undamped modes changed."""
    M, C, K = (np.asarray(getattr(structure, name)) for name in "MCK")
    square, phi = scipy.linalg.eigh(K, M)
    own = np.einsum("dr,de,er->r", phi, C, phi)
    back = M @ phi
    K = K + (back * square * np.expm1(2 * theta[0])) @ back.T
    C = C + (back * own * np.expm1(theta[0] + theta[1])) @ back.T
    s = 2j * np.pi * freq[:, None, None]
    return np.linalg.inv(s**2 * M + s * C + K)


def adapted(
    structure: Structure, theta: np.ndarray, centre: np.ndarray | None = None, mixing: bool = True
) -> np.ndarray:
    shape, modal_form = (1, len(FREQ), 5, 5), modal_form_of(structure, FREQ[0], centre)
    modal_form = modal_form if mixing else replace(modal_form, mixing=None)
    problem = make_problem(FREQ, np.zeros(shape, complex), np.ones(shape), np.ones(1), NAMES, NAMES, modal_form)
    full = np.zeros((2, problem.modal_form.stiffness.shape[0]))
    full[:, :5] = theta
    H = PREDICT((), np.zeros((0, 3), int), (), (), full, problem)
    return np.asarray(H)[0, : len(FREQ), :5, :5]


def test_real_modes_need_no_mixing():
    S = five_dof()
    M, K = np.asarray(S.M), np.asarray(S.K)
    assert modal_form_of(Structure(M, 1e-4 * K + 0.2 * M, K, NAMES, frequency_std=0.01), 1.0).mixing is None
    assert modal_form_of(coupled(30.0, std=0.0), 1.0).mixing is not None


@pytest.mark.parametrize("kind", [0, 1])
def test_complex_modes_follow_to_first_order(kind):
    """The error left falls as the square of the change, and is far below what is missed without mixing."""
    S, rng = coupled(60.0), np.random.default_rng(3)
    way = np.zeros((2, 5))
    way[kind] = rng.normal(size=5)
    error, missed = [], []
    for size in (1e-3, 1e-2):
        exact = changed(S, size * way)
        top = np.abs(exact).max()
        error.append(np.abs(adapted(S, size * way) - exact).max() / top)
        missed.append(np.abs(adapted(S, size * way, mixing=False) - exact).max() / top)
    assert 30 < error[1] / error[0] < 300
    assert error[0] < 0.05 * missed[0]


@pytest.mark.parametrize("kind", [0, 1])
def test_complex_modes_are_exact_where_they_are_centred(kind):
    S, theta = coupled(60.0), np.zeros((2, 5))
    theta[kind] = np.random.default_rng(4).normal(size=5) * (0.02, 0.3)[kind]
    exact = changed(S, theta)
    top = np.abs(exact).max()
    assert np.abs(adapted(S, theta, centre=theta) - exact).max() < 1e-10 * top
    assert np.abs(adapted(S, 1.01 * theta, centre=theta) - changed(S, 1.01 * theta)).max() < 1e-4 * top
    assert np.abs(adapted(S, theta) - exact).max() > 1e-3 * top


def test_a_centre_means_nothing_where_no_modes_are_coupled():
    S = five_dof()
    alone = Structure(S.M, 1e-4 * np.asarray(S.K), S.K, NAMES, frequency_std=0.01)
    centred, plain = modal_form_of(alone, 1.0, np.full((2, 5), 0.1)), modal_form_of(alone, 1.0)
    np.testing.assert_array_equal(np.asarray(centred.poles), np.asarray(plain.poles))


def test_second_order_of_coupled_modes_is_no_finding():
    """Two close modes coupled by their dampers, their damping off by more than what parts them, as claimed."""
    M, freq = np.eye(3), np.linspace(10.0, 60.0, 150)
    K = (2 * np.pi) ** 2 * (np.diag([1000.0, 1020.0, 1900.0]) + 8.0 * (np.eye(3, k=1) + np.eye(3, k=-1)))
    C = np.diag([4.0, 4.0, 6.0]) + 3.0 * (np.eye(3, k=1) + np.eye(3, k=-1))
    S = Structure(M, C, K, NAMES[:3], frequency_std=0.005, damping_std=0.3)
    rng = np.random.default_rng(1)
    theta = np.array([0.005 * rng.normal(size=3), [0.5, -0.4, 0.1]])
    exact = changed(S, theta, freq)[None].repeat(2, axis=0)
    sigma = 0.01 * np.sqrt((np.abs(exact) ** 2).mean(axis=1, keepdims=True)) * np.ones(exact.shape)
    noise = (rng.normal(size=exact.shape) + 1j * rng.normal(size=exact.shape)) * sigma / np.sqrt(2)
    data = Measurement(freq, exact + noise, variance=sigma**2, outputs=NAMES[:3], inputs=NAMES[:3], level=[1.0, 2.0])
    comparison = make_comparison(data, S)
    causes = [ModalDamping()]
    assert not look(comparison, causes).detection.anything
    null = comparison.fit([empty(comparison)], 14)[0]
    bare = screen_all(score_state_of(comparison, null), causes).trials
    assert max(abs(t.z) for t in bare) > 6.0


def test_nothing_changes_at_zero_and_elements_see_the_same_receptances():
    S = coupled(60.0)
    theta = np.random.default_rng(5).normal(size=(2, 5)) * np.array([[3e-3], [0.05]])
    assert np.abs(adapted(S, 0 * theta) - changed(S, 0 * theta)).max() < 1e-11 * np.abs(changed(S, 0 * theta)).max()
    shape = (1, len(FREQ), 5, 5)
    problem = make_problem(
        FREQ, np.zeros(shape, complex), np.ones(shape), np.ones(1), NAMES, NAMES, modal_form_of(S, FREQ[0])
    )
    full = np.zeros((2, problem.modal_form.stiffness.shape[0]))
    full[:, :5] = theta
    padded = problem.weight.shape
    none = Residual(np.zeros((*padded[2:], 2 * padded[1])), np.zeros((0, *padded[2:], 2 * padded[1])), np.zeros((0, 0)))
    columns = np.swapaxes(reduce(problem, full, none).column(np.arange(5), np.full(5, -1)), 1, 2)
    expected = adapted(S, theta)
    assert np.abs(columns[: len(FREQ), :5] - expected).max() < 1e-12 * np.abs(expected).max()


def hysteretic(structure: Structure, share: float, loss: float | None = None) -> np.ndarray:
    """Receptances from the matrices: a share of the viscous damping out, hysteretic damping of undamped modes in."""
    M, C, K = (np.asarray(getattr(structure, name)) for name in "MCK")
    square, phi = scipy.linalg.eigh(K, M)
    own = np.einsum("dr,de,er->r", phi, C, phi) * np.sqrt(square) if loss is None else loss * square
    back = M @ phi
    s = 2j * np.pi * FREQ[:, None, None]
    return np.linalg.inv(s**2 * M + s * (1 - share) * C + K + 1j * share * (back * own) @ back.T)


@pytest.mark.parametrize("share", [0.1, 0.3, 1.0])
def test_hysteretic_damping_takes_the_coupling_of_the_modes_with_it(share):
    """Against the matrices; the complex shapes left as they are would miss most of the effect."""
    S = coupled(5.0)
    shape = (1, len(FREQ), 5, 5)
    problem = make_problem(
        FREQ, np.zeros(shape, complex), np.ones(shape), np.ones(1), NAMES, NAMES, modal_form_of(S, FREQ[0])
    )
    theta = np.zeros((2, problem.modal_form.stiffness.shape[0]))

    def ours(cause, p):
        H = PREDICT((cause,), np.zeros((1, 3), int), (None,), (np.array([p]),), theta, problem)
        return np.asarray(H)[0, : len(FREQ), :5, :5]

    without = hysteretic(S, 0.0)
    exact = hysteretic(S, share)
    error = np.linalg.norm(ours(StructuralDamping(), share) - exact) / np.linalg.norm(exact - without)
    assert error < (1e-9 if share == 1.0 else 0.07)  # of the effect; what is left is of second order
    if share == 1.0:
        np.testing.assert_allclose(ours(LossFactor(), 0.03), hysteretic(S, 1.0, 0.03), rtol=1e-8)


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_close_modes_that_dampers_couple_are_exact_at_the_share_that_is_fitted(share):
    """Two nearly equal oscillators, one damper: apart by less than they are wide, they turn into each other."""
    K = 1e4 * np.array([[1.0, -0.02], [-0.02, 1.01]])
    S = Structure(np.eye(2), np.array([[4.0, 0.0], [0.0, 0.4]]), K, ("1", "2"))
    freq = np.linspace(13.0, 19.0, 120)
    shape, s = (1, len(freq), 2, 2), 2j * np.pi * freq[:, None, None]
    square, phi = scipy.linalg.eigh(K)
    own = (phi * (np.einsum("dr,de,er->r", phi, S.C, phi) * np.sqrt(square))) @ phi.T
    exact, without = (
        np.linalg.inv(s**2 * np.eye(2) + s * (1 - q) * np.asarray(S.C) + K + 1j * q * own) for q in (share, 0)
    )

    def error(coupling):
        modal_form = modal_form_of(S, freq[0], None, coupling)
        problem = make_problem(
            freq, np.zeros(shape, complex), np.ones(shape), np.ones(1), ("1", "2"), ("1", "2"), modal_form
        )
        theta = np.zeros((2, problem.modal_form.stiffness.shape[0]))
        H = PREDICT((StructuralDamping(),), np.zeros((1, 3), int), (None,), (np.array([share]),), theta, problem)
        return np.linalg.norm(np.asarray(H)[0, : len(freq), :2, :2] - exact) / np.linalg.norm(exact - without)

    assert error(1 - share) < 0.03
    assert error(None) < 0.25


@pytest.mark.parametrize("relative", [0.6, -0.5])
def test_modal_damping_of_coupled_modes_is_followed_as_a_claimed_error_is(relative):
    """Elsewhere its score would live on how a real mode differs from the complex one, and drown in noise."""
    structure, shape = coupled(2.0), (1, len(FREQ), 5, 5)
    log = np.zeros((2, 5))
    log[1, 2] = np.log1p(relative)
    problem = make_problem(
        FREQ, np.zeros(shape, complex), np.ones(shape), np.ones(1), NAMES, NAMES,
        modal_form_of(structure, FREQ[0], log),
    )  # fmt: skip
    where, theta = np.array([[2, -1, 0]]), np.zeros((2, problem.modal_form.stiffness.shape[0]))
    H = np.asarray(PREDICT((ModalDamping(),), where, (None,), (np.array([relative]),), theta, problem))
    exact = changed(structure, log)
    assert np.abs(H[0, : len(FREQ), :5, :5] - exact).max() < 1e-9 * np.abs(exact).max()


@pytest.mark.parametrize(
    ("damper", "std", "ratio"),
    [
        pytest.param(4.0, 0.003, 0.7, marks=pytest.mark.slow),
        (4.0, 0.0, 3.0),
        (20.0, 0.0, 0.4),
    ],
)
def test_large_modal_damping_is_named_where_dampers_couple_the_modes(damper, std, ratio):
    """Followed to first order only, it left more than it explained: nothing was found, or other causes."""
    structure, rng = coupled(damper, std), np.random.default_rng(2)
    log = np.zeros((2, 5))
    log[1, 1] = np.log(ratio)
    log += std * rng.normal(size=(2, 5)) * np.array([[0.7], [7.0]])
    H = np.stack([changed(structure, log)[:, :, [0, 3]]] * 2)
    sigma = 0.01 * np.abs(H) + 1e-4 * np.abs(H).max()
    H = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    data = Measurement(FREQ, H, variance=sigma**2, outputs=NAMES, inputs=("1", "4"))
    causes = [ModalDamping(), JointStiffness(), AddedMass(), LocalDamper()]
    answer = diagnose(data, structure, causes=causes).to_dict()
    assert answer["verdict"] == "named"
    assert [(c["name"], c["where"]) for c in answer["causes"]] == [("modal_damping", [2])]


def test_modes_without_any_damping_stay_so_beside_coupled_ones():
    """Of a model whose damping is that of its lowest modes; a user saw a warning of a division by zero."""
    M, K = np.eye(4), np.diag([1.0, 2.0, 3.0, 4.0]) * 1e4
    C = np.zeros((4, 4))
    C[:2, :2] = [[1.0, 0.6], [0.6, 2.0]]
    form = modal_form_of(Structure(M, C, K, NAMES[:4]), 20.0, np.zeros((2, 4)))
    assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree_util.tree_leaves(form))
