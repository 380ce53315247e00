"""Variable projection on the host, against plain least squares of all columns and against the refinement in JAX."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from modalax.data import FRF
from modalax.identify import projection as module
from modalax.identify import reduced, refine, residues
from modalax.identify.ascent import climb
from modalax.identify.estimate import estimate
from modalax.identify.information import covariance, joint_covariance, solution
from modalax.identify.kernels import kernels, pack, residual_terms, unpack
from modalax.identify.projection import Projection, stacked

POLES = 2 * np.pi * np.array([-0.3 + 30.0j, -0.35 + 31.0j, -0.5 + 40.0j])
S = 2j * np.pi * np.linspace(25.0, 45.0, 120)
RNG = np.random.default_rng(2)
SHAPES = RNG.normal(size=(3, 4)) + 0.3j * RNG.normal(size=(3, 4))
PART = RNG.normal(size=(3, 2)) + 0.2j * RNG.normal(size=(3, 2))
PIVOT = np.argmax(np.abs(PART), axis=1)
EXACT = sum(
    k[:, None, None] * z
    for p, o, i in zip(POLES, SHAPES, PART, strict=True)
    for k, z in ((1 / (S - p), np.outer(o, i)), (1 / (S - p.conj()), np.outer(o, i).conj()))
) + (2e-3 - 30.0 / S**2)[:, None, None]  # fmt: skip
NOISE = 0.02 * np.abs(EXACT).mean() * (RNG.normal(size=EXACT.shape) + 1j * RNG.normal(size=EXACT.shape))
WEIGHTS = {
    "shared": 1 / (1 + np.linspace(0, 1, 120))[:, None, None] * np.array([1.0, 2.0, 0.5, 3.0])[:, None] * np.ones(2),
    "shared but by reference": np.linspace(1, 2, 120)[:, None, None] ** np.array([1.0, -1.0]) * np.ones((4, 2)),
    "own": RNG.uniform(0.3, 2.0, EXACT.shape),
}
START = pack(POLES * (1 + 0.004j), PART, PIVOT)
FREE = np.zeros(3)


def brute(theta, weight, real_modes=False, H=EXACT + NOISE):
    """Half the squared residual of each output's least squares on all its samples, column by column."""
    modes = unpack(theta, PIVOT, real_modes)
    terms = residual_terms(S, 1, "complex")
    cost = 0.0
    for o in range(H.shape[1]):
        columns = []
        for r, pole in enumerate(modes.poles):
            for u in modes.unit[r]:
                z = u * modes.participation[r]
                columns.append(S[:, None] * (z / (S[:, None] - pole) + z.conj() / (S[:, None] - pole.conj())))
        for i in range(2):
            columns += [t[:, None] * np.eye(2)[i] for t in terms.T]
        A = np.array([stacked((c * weight[:, o]).ravel()) for c in columns]).T
        y = stacked((weight[:, o] * H[:, o]).ravel())
        scale = np.linalg.norm(A, axis=0)
        cost += 0.5 * np.sum((y - A @ (np.linalg.lstsq(A / scale, y, rcond=None)[0] / scale)) ** 2)
    return cost


@pytest.mark.parametrize("real_modes", [False, True])
@pytest.mark.parametrize("kind", WEIGHTS)
def test_cost_and_gradient(kind, real_modes):
    projection = Projection(
        S, EXACT + NOISE, WEIGHTS[kind], power=1, terms=residual_terms(S, 1, "complex"), real_modes=real_modes
    )
    assert projection.shared == (kind != "own")
    sums = projection.sums(START, PIVOT, FREE)
    assert sums.cost == pytest.approx(brute(START, WEIGHTS[kind], real_modes), rel=1e-10)
    step = 1e-5
    for k in range(START.size):
        move = np.zeros(START.size)
        move[k] = step
        up, down = (brute(START + sign * move.reshape(START.shape), WEIGHTS[kind], real_modes) for sign in (1, -1))
        assert sums.gradient[k] == pytest.approx(
            (up - down) / (2 * step), rel=1e-5, abs=1e-5 * abs(sums.gradient).max()
        )


def test_sums_do_not_depend_on_the_blocks(monkeypatch):
    projection = Projection(S, EXACT + NOISE, WEIGHTS["own"], terms=residual_terms(S, 0, "real"))
    whole = projection.sums(START, PIVOT, FREE)
    monkeypatch.setattr(module, "BLOCK", 2000)  # lines in parts, and one output at a time
    parts = projection.sums(START, PIVOT, FREE)
    for one, two in zip(whole, parts, strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-9 * np.abs(one).max())


@pytest.mark.parametrize("kind", WEIGHTS)
def test_exact_data_give_exact_poles(kind):
    projection = Projection(S, EXACT, WEIGHTS[kind], terms=residual_terms(S, 0, "complex"))
    at = climb(projection, START, PIVOT, FREE, tol=0.0)
    modes = unpack(at.theta, PIVOT, False)
    assert at.finished
    np.testing.assert_allclose(modes.poles, POLES, rtol=1e-12)
    x, left, _, _ = solution(projection, at)
    found = np.einsum("onc,nc,ni->noi", x, modes.unit, modes.participation)
    np.testing.assert_allclose(found, SHAPES[:, :, None] * PART[:, None, :], rtol=1e-9, atol=1e-12)
    assert np.abs(left).max() < 1e-11 * np.abs(EXACT).max()


def test_modes_known_beforehand_are_terms():
    """The third mode as a fixed pole: the other two come out as exact as with it free."""
    known = kernels(S, 0, POLES[2:], squares=False)
    rest = residual_terms(S, 0, "complex")
    projection = Projection(S, EXACT, WEIGHTS["own"], terms=np.concatenate([rest, known], axis=1))
    at = climb(projection, START[:2], PIVOT[:2], FREE[:2], tol=0.0)
    np.testing.assert_allclose(unpack(at.theta, PIVOT[:2], False).poles, POLES[:2], rtol=1e-12)
    x, _, _, terms = solution(projection, at)
    np.testing.assert_allclose(terms[..., 4] + 1j * terms[..., 5], np.outer(SHAPES[2], PART[2]), rtol=1e-8)


def test_all_from_arrays():
    """Poles, residues and their joint covariance of FRFs, nothing known of the participation."""
    sigma = np.sqrt(2) / WEIGHTS["own"] * np.abs(NOISE).mean()
    found = estimate(S, EXACT + NOISE, sigma, POLES * (1 + 0.004j), terms=residual_terms(S, 0, "complex"))
    assert found.finished
    true = np.concatenate([np.log(np.abs(POLES)), np.log(-POLES.real / np.abs(POLES))])
    mine = np.concatenate([np.log(np.abs(found.poles)), np.log(-found.poles.real / np.abs(found.poles))])
    assert np.abs((mine - true) / np.sqrt(np.diag(found.covariance)[:6])).max() < 4
    residues_ = SHAPES[:, :, None] * PART[:, None, :]
    apart = np.concatenate([(found.residues - residues_).real.ravel(), (found.residues - residues_).imag.ravel()])
    assert np.abs(apart / np.sqrt(np.diag(found.covariance)[6:])).max() < 4.5
    assert found.terms.shape == (4, 2, 4)
    with pytest.raises(ValueError, match="120 lines"):
        estimate(S, EXACT[:60], sigma[:60], POLES)
    with pytest.raises(ValueError, match="above zero"):
        estimate(S, EXACT, 0 * sigma, POLES)
    with pytest.raises(ValueError, match="too few for"):
        estimate(S[:2], EXACT[:2], sigma[:2], POLES)


def test_dependent_columns_make_no_step():
    twice = START[[0, 0, 2]]
    with np.errstate(all="raise"):
        at = climb(Projection(S, EXACT, WEIGHTS["own"]), twice, PIVOT[[0, 0, 2]], FREE, max_steps=3)
    assert not at.finished


def everything(x, n_out):
    """Samples of all real unknowns at once: poles, participation, residues of the pivot, residual terms."""
    theta, parts, rest = x[:12].reshape(3, 4), x[12:36].reshape(2, 3, 4), x[36:].reshape(n_out, 2, 4)
    modes = unpack(theta, PIVOT, False)
    z = (parts[0] + 1j * parts[1])[:, :, None] * modes.participation[:, None, :]
    H = sum(
        r / (S - p)[:, None, None] + r.conj() / (S - p.conj())[:, None, None]
        for p, r in zip(modes.poles, z, strict=True)
    )
    return H + np.einsum("ft,oit->foi", residual_terms(S, 0, "complex"), rest), z


@pytest.mark.parametrize("kind", ["shared but by reference", "own"])
def test_largest_likelihood_and_joint_covariance(kind):
    """Against scipy's least squares over all unknowns together and the inverse of the whole information."""
    weight = WEIGHTS[kind] / np.abs(NOISE).mean()
    projection = Projection(S, EXACT + NOISE, weight, terms=residual_terms(S, 0, "complex"))
    at = climb(projection, START, PIVOT, FREE, tol=1e-9)
    x, left, _, terms = solution(projection, at)
    first = np.concatenate([at.theta.ravel(), *(x[..., c].T.ravel() for c in (0, 1)), terms.ravel()])

    def off(unknowns):
        return stacked((weight * (EXACT + NOISE - everything(unknowns, 4)[0])).ravel())

    assert np.sum(np.abs(left) ** 2) == pytest.approx(np.sum(off(first) ** 2), rel=1e-9)
    best = scipy.optimize.least_squares(off, first, x_scale="jac", xtol=1e-12, ftol=1e-14, gtol=1e-12)
    modes, other = unpack(at.theta, PIVOT, False), unpack(best.x[:12].reshape(3, 4), PIVOT, False)
    np.testing.assert_allclose(modes.poles, other.poles, rtol=1e-7)

    def wanted(unknowns):
        z = everything(unknowns, 4)[1]
        return np.concatenate([*unknowns[:12].reshape(3, 4)[:, :2].T, z.real.ravel(), z.imag.ravel()])

    step = 1e-6
    J = np.array([(wanted(first + d) - wanted(first - d)) / (2 * step) for d in step * np.eye(len(first))]).T
    scale = 1 / np.linalg.norm(best.jac, axis=0)
    inverse = scale[:, None] * np.linalg.inv((best.jac * scale).T @ (best.jac * scale)) * scale
    found = joint_covariance(projection, at, covariance(projection, at))
    whole = J @ inverse @ J.T
    size = np.sqrt(np.diag(whole))
    np.testing.assert_allclose(found / np.outer(size, size), whole / np.outer(size, size), atol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["own", "shared"])
def test_as_the_refinement_in_jax(kind):
    frf = FRF(S.imag / (2 * np.pi), EXACT + NOISE)
    sigma = np.sqrt(2) / WEIGHTS[kind]
    refined = refine(frf, residues(frf, POLES, jnp.asarray(PART)), weights=jnp.asarray(sigma), scale_errors="never")
    projection = Projection(S, EXACT + NOISE, WEIGHTS[kind], terms=residual_terms(S, 0, "complex"))
    at = climb(projection, START, PIVOT, FREE, tol=1e-10)
    np.testing.assert_allclose(unpack(at.theta, PIVOT, False).poles, refined.model.poles, rtol=1e-9)
    chi2 = 2 * at.sums.cost
    scale = np.asarray(refined.chi2) / chi2  # of unknown noise, which the refinement makes small
    own = covariance(projection, at).reshape(3, 4, 3, 4)[:, :2, :, :2].reshape(6, 6)
    np.testing.assert_allclose(own, refined.covariance * scale, rtol=1e-6, atol=1e-6 * np.abs(own).max())
    _, _, evidence, _ = solution(projection, at)
    np.testing.assert_allclose(evidence * scale, refined.evidence, rtol=1e-6)


def test_many_samples_take_the_squares_outside_the_basis_by_their_difference(monkeypatch):
    plain = Projection(S, EXACT + NOISE, WEIGHTS["shared"], power=1, terms=residual_terms(S, 1, "complex"))
    one = plain.sums(START, PIVOT, FREE)
    monkeypatch.setattr(module, "MANY", 1)
    other = plain.sums(START, PIVOT, FREE)
    assert other.cost == pytest.approx(one.cost, rel=1e-9)
    assert other.cost != one.cost


@pytest.mark.parametrize("kind", WEIGHTS)
def test_scores_of_the_outputs_make_the_gradient(kind):
    """Also those of the single rows, of which an error bar is made where rows differ."""
    projection = Projection(S, EXACT + NOISE, WEIGHTS[kind], power=1, terms=residual_terms(S, 1, "complex"))
    at = climb(projection, START, PIVOT, FREE, max_steps=1)
    blocks = list(projection.blocks(at.theta, at.pivot, at.held))
    scores = np.concatenate([block.scores() for block in blocks])
    assert np.allclose(-scores.sum(axis=0), at.sums.gradient)
    rows = [row for block in blocks for row in block.rows()]
    assert np.allclose([np.einsum("ikp,ik->p", r.projected(), r.residual) for r in rows], scores)


@pytest.mark.parametrize("kind", WEIGHTS)
@pytest.mark.parametrize("part", [reduced.OWN, 2.0])
def test_the_matrix_is_that_of_the_single_rows(kind, part, monkeypatch):
    """Whether it is a difference of products, or of derivatives that were projected first (no part is above 1)."""
    monkeypatch.setattr(reduced, "OWN", part)
    projection = Projection(S, EXACT + NOISE, WEIGHTS[kind], power=1, terms=residual_terms(S, 1, "complex"))
    blocks = list(projection.blocks(START, PIVOT, FREE))
    derivatives = [row.projected().reshape(-1, START.size) for block in blocks for row in block.rows()]
    expected = sum(d.T @ d for d in derivatives)
    size = np.sqrt(np.diag(expected))
    found = sum(block.sums().matrix for block in blocks)
    np.testing.assert_allclose(found / np.outer(size, size), expected / np.outer(size, size), atol=1e-11)
