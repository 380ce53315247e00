"""The parts of the diagnosis in the modal domain, each against a second route."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
from frames import DOFS, ELEMENTS, FLIP, beam, cantilever, simulation

from modalax.diagnose.causes.joints import CubicStiffness, ElastoSlip
from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.causes.places import candidates_of
from modalax.diagnose.modal_domain.fitting.explanation import Explanation, Prior
from modalax.diagnose.modal_domain.fitting.inaccuracy import TOLD
from modalax.diagnose.modal_domain.judged import standing_out
from modalax.diagnose.modal_domain.levels.explain import ByLevel, JointFound
from modalax.diagnose.modal_domain.levels.slipping import settled
from modalax.diagnose.modal_domain.modes.features import Features, features_of, paired
from modalax.diagnose.modal_domain.modes.free_residues import Channels, project, refine
from modalax.diagnose.modal_domain.modes.mode_count import beside_one_line, blind_modes, misfit
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of, modes_of
from modalax.diagnose.modal_domain.structure.element_masses import mass_parts
from modalax.diagnose.modal_domain.structure.elements import stiffness_parts
from modalax.diagnose.modal_domain.structure.factored import factored
from modalax.diagnose.modal_domain.structure.nodes import nodes_of
from modalax.diagnose.modal_domain.structure.parts import coupled_rows, local_parts, parts_of
from modalax.diagnose.modal_domain.structure.slopes import direction_slopes, factored_slopes, pattern_slopes, slopes_of
from modalax.model import Structure


@pytest.fixture(scope="module")
def coordinates():
    return coordinates_of(simulation(), DOFS[::2], (DOFS[6], DOFS[14]), 2 * np.pi * 330)


def synthetic(noise=0.0, seed=0, lines=240):
    rng = np.random.default_rng(seed)
    poles = np.array([-2.0 + 200j, -3.0 + 410j, -5.0 + 640j])
    residues = rng.standard_normal((3, 6)) * -0.01j
    s = 1j * np.linspace(120, 800, lines)
    H = (residues[None] / (s[:, None, None] - poles[:, None]) +
         residues.conj()[None] / (s[:, None, None] - poles.conj()[:, None])).sum(axis=1)  # fmt: skip
    sigma = noise * np.sqrt((np.abs(H) ** 2).mean(axis=0)) + 1e-12
    error = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    weight = np.broadcast_to(2 / sigma**2, H.shape)
    return poles, residues, Channels(s, H + sigma * error / np.sqrt(2), weight, 0, np.zeros(0, complex))


def test_the_energy_of_a_mode_beside_its_line_is_that_of_its_samples():
    poles, _, channels = synthetic(0.01)
    found = project(poles, channels)[0]
    for told, A, pole in zip(beside_one_line(found, channels), found.residues, found.poles, strict=True):
        u, v = (1 / (channels.s - x) for x in (pole, pole.conj()))
        energy = (channels.weight * np.abs(np.outer(u, A) + np.outer(v, A.conj())) ** 2).sum(axis=1)
        assert told == pytest.approx(energy.sum() - energy.max(), rel=1e-9)


def test_variable_projection_has_the_gradient_of_its_chi_square():
    poles, _, channels = synthetic(0.01)
    start = poles * (1 + 0.001)
    _, gradient = project(start, channels)
    for k, step in ((0, 1e-4), (1, 1e-4j)):
        up, down = start.copy(), start.copy()
        up[1] += step
        down[1] -= step
        slope = (project(up, channels)[0].chi2 - project(down, channels)[0].chi2) / (2 * 1e-4)
        assert -slope / 2 == pytest.approx(gradient[2 + k], rel=2e-2)


@pytest.mark.parametrize("imag", [1e-4, 1e-3, 1e-2])
def test_a_search_from_a_pole_without_vibration_ends_as_any_other(imag):
    """Information on such a pole is lost in rounding; it had ended in an overflow, and with it the diagnosis."""
    poles, _, channels = synthetic()
    start = np.append(-5.0 + 1j * imag, poles * (1 + 0.002))
    found = refine(start, channels)
    assert np.all(np.isfinite(found.poles)) and found.chi2 <= project(start, channels)[0].chi2


def test_poles_and_residues_come_back():
    poles, residues, channels = synthetic()
    found = refine(poles * (1 + 0.002), channels)
    np.testing.assert_allclose(found.poles, poles, rtol=1e-6)
    np.testing.assert_allclose(found.residues, residues, rtol=1e-4, atol=1e-8)


def test_blind_modes_are_counted_and_as_certain_as_told():
    pulls = []
    for seed in range(6):
        poles, _, channels = synthetic(0.02, seed)
        found = blind_modes(channels)
        assert len(found.poles) == 3
        assert misfit(found, channels) < 1.1
        std = np.sqrt(np.diag(np.linalg.inv(found.information))).reshape(-1, 2)
        error = found.poles - poles
        pulls += [*(error.real / std[:, 0]), *(error.imag / std[:, 1])]
    assert 0.6 < np.std(pulls) < 1.5


def test_features_scatter_as_their_covariance_says():
    values, told = [], None
    for seed in range(40):
        poles, _, channels = synthetic(0.02, 0)
        rng = np.random.default_rng(seed)
        sigma = np.sqrt(2 / channels.weight)
        more = sigma * (rng.standard_normal(sigma.shape) + 1j * rng.standard_normal(sigma.shape)) / np.sqrt(2)
        clean = Channels(channels.s, channels.data + more, channels.weight / 2, 0, channels.outside)
        f = features_of(refine(poles, clean), 3, 2)
        values.append(f.values[:, :3].ravel())
        told = np.sqrt(np.diag(f.covariance)).reshape(f.values.shape)[:, :3].ravel() / np.sqrt(2)
    ratio = np.std(values, axis=0) / told
    assert ((ratio > 0.6) & (ratio < 1.5)).all(), ratio


def test_modes_make_the_receptance_of_the_matrices(coordinates):
    c, S = coordinates, simulation()
    modes = modes_of(c)
    omega = np.array([300.0, 1100.0])
    s = 1j * omega[:, None, None, None]
    y, x = modes.vectors @ c.outputs.T, modes.vectors @ c.inputs.T
    A = y[:, :, None] * x[:, None, :]
    H = (A / (s - modes.poles[:, None, None]) + A.conj() / (s - modes.poles.conj()[:, None, None])).sum(axis=1)
    aim = np.asarray(S.receptance(omega, DOFS[::2], (DOFS[6], DOFS[14])))
    np.testing.assert_allclose(H, aim, atol=1e-9 * np.abs(aim).max())


def free_coordinates():
    """The beam without its clamp, which also moves as a rigid body."""
    k, m = beam()
    K, M = np.zeros((len(DOFS), len(DOFS))), np.zeros((len(DOFS), len(DOFS)))
    for e in range(len(DOFS) // 2 - 1):
        at = np.ix_(range(2 * e, 2 * e + 4), range(2 * e, 2 * e + 4))
        K[at] += k
        M[at] += m
    S = Structure(M, 2e-5 * K, K, DOFS)
    return coordinates_of(S, DOFS[::2], (DOFS[6], DOFS[14]), 2 * np.pi * 330)


@pytest.mark.parametrize("kind", ["K", "M", "C"])
@pytest.mark.parametrize("free", [False, True])
def test_derivatives_of_modes_match_differences(coordinates, kind, free):
    c = free_coordinates() if free else coordinates
    rng = np.random.default_rng(1)
    b = c.shapes.T @ rng.standard_normal(len(DOFS))
    b[: 2 if free and kind == "K" else 0] = 0.0  # a rigid body that is held would be a mode more
    unit = {"K": c.frequencies[2] ** 2, "M": 1.0, "C": c.damping[2, 2]}[kind] / float(b @ b)
    which = np.arange(4)
    t = slopes_of(c, modes_of(c), which)
    patterns = [pattern_slopes(t, kind, unit * np.outer(b, b)[None])]
    patterns.append(tuple(unit * a for a in direction_slopes(t, kind, b[None])))
    patterns.append(factored_slopes(t, kind, factored(unit * np.outer(b, b)[None])))
    step = 1e-3  # smaller ones differ by rounding
    up, down = (modes_of(c, **{f"d{kind}": sign * step * unit * np.outer(b, b)}) for sign in (1, -1))
    shape = lambda m: np.einsum("ko,ki->koi", m.vectors[which] @ c.outputs.T, m.vectors[which] @ c.inputs.T)
    poles = (up.poles - down.poles)[which] / (2 * step)
    residues = (shape(up) - shape(down)) / (2 * step)
    for dpoles, out, inn in patterns:
        made = np.einsum("ko,ki->koi", out[:, 0], t.shape_inputs) + np.einsum("ko,ki->koi", t.shape_outputs, inn[:, 0])
        np.testing.assert_allclose(dpoles[:, 0], poles, atol=1e-4 * np.abs(poles).max())
        np.testing.assert_allclose(made, residues, atol=1e-4 * np.abs(residues).max())


def test_beam_elements_are_read_off_the_stiffness_matrix():
    K, _ = cantilever()
    K = FLIP[:, None] * K * FLIP
    parts = stiffness_parts(K, nodes_of(DOFS))
    np.testing.assert_allclose(sum(p.full(len(K)) for p in parts), K, atol=1e-9 * K.max())
    inner = [p for p in parts if len(p.nodes) == 2]
    assert len(inner) == 7
    turn = np.array([1.0, -1.0, 1.0, -1.0])
    aim = turn[:, None] * beam()[0] * turn
    for p in inner:
        order = np.argsort(p.dofs)
        np.testing.assert_allclose(p.matrix[np.ix_(order, order)], aim, atol=1e-8 * aim.max())


def test_springs_and_supports_are_read_off_without_directions():
    k = np.array([100.0, 300.0, 50.0])
    K = np.array([[k[0] + k[1], -k[1], 0], [-k[1], k[1] + k[2], -k[2]], [0, -k[2], k[2]]])
    parts = stiffness_parts(K, nodes_of(("a", "b", "c")))
    found = {tuple(sorted(p.dofs)): p.matrix[0, 0] for p in parts}
    assert found == pytest.approx({(0, 1): 300.0, (1, 2): 50.0, (0,): 100.0})


def test_local_parts_sum_to_the_matrix_and_resist_no_rigid_motion():
    rng = np.random.default_rng(0)
    F = rng.standard_normal((6, 4))
    free = scipy.linalg.null_space(F.T)
    parts = local_parts(F @ F.T, nodes_of(tuple("abcdef")))
    np.testing.assert_allclose(sum(p.full(6) for p in parts), F @ F.T, atol=1e-10)
    for p in parts:
        assert np.abs(p.full(6) @ free).max() < 1e-6


def test_condensed_matrices_have_local_parts_and_mass_parts_sum():
    rng = np.random.default_rng(2)
    A = rng.standard_normal((12, 12))
    dense = A @ A.T
    names = tuple(f"p{k}" for k in range(12))
    assert len(parts_of(dense, nodes_of(names))) == 12
    _, M = cantilever()
    parts = mass_parts(M, nodes_of(DOFS))
    np.testing.assert_allclose(sum(p.full(len(M)) for p in parts), M, atol=1e-12)
    # half of the mass at the node next to the clamp is that of the clamped element; a lump is by itself as well
    assert [p.dofs.tolist() for p in parts if len(p.nodes) == 1] == [[0, 1]]
    M[6, 6] += 0.3
    own = {p.nodes: p.matrix[0, 0] for p in mass_parts(M, nodes_of(DOFS)) if len(p.nodes) == 1}
    assert own == pytest.approx({(0,): M[0, 0] / 2, (3,): 0.3})


def test_masses_of_beams_are_read_off_the_matrix_beside_a_lump():
    rng = np.random.default_rng(4)
    scale = rng.uniform(0.5, 2.0, ELEMENTS)
    M = FLIP[:, None] * cantilever(mass=scale)[1] * FLIP
    M[6, 6] += 0.3
    parts = {p.nodes: p.matrix for p in mass_parts(M, nodes_of(DOFS))}
    for e in range(1, ELEMENTS):  # the first ends at the clamp
        flip = np.tile(FLIP[:2], 2)
        np.testing.assert_allclose(parts[(e, e - 1)], scale[e] * flip[:, None] * _swapped(beam()[1]) * flip, atol=1e-9)
    assert parts[(3,)][0, 0] == pytest.approx(0.3)


@pytest.mark.parametrize("mass", [False, True])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_elements_are_read_off_whatever_the_order_of_the_names(seed, mass):
    """Also where a node's rotation comes before its displacement; nothing is made of rounding."""
    rng = np.random.default_rng(seed)
    A = cantilever(stiffness=rng.uniform(0.5, 2.0, ELEMENTS), mass=rng.uniform(0.5, 2.0, ELEMENTS))[int(mass)]
    order = rng.permutation(len(A))
    mixed = parts_of(A[np.ix_(order, order)], nodes_of(tuple(np.array(DOFS)[order])), mass=mass)
    plain = parts_of(A, nodes_of(DOFS), mass=mass)
    back = np.argsort(order)
    turned = [p.full(len(A))[np.ix_(back, back)] for p in mixed]
    assert len(turned) == len(plain)
    for p in plain:
        assert min(np.abs(a - p.full(len(A))).max() for a in turned) < 1e-9 * np.abs(A).max()


def _swapped(A):
    """An element's matrix with its ends in the other order."""
    return np.roll(A, (2, 2), (0, 1))


def test_modes_far_off_are_still_paired(coordinates):
    c = coordinates
    modes = modes_of(c)
    A = np.einsum("ko,ki->koi", modes.vectors @ c.outputs.T, modes.vectors @ c.inputs.T)

    some, units = [2, 0, 1], np.ones((3, *A.shape[1:]))
    none = np.zeros((3, 1, *A.shape[1:]), complex)
    seen = Features(modes.poles[some] * 1.1, A[some], units, none, np.zeros((3, 5)), np.eye(15))
    np.testing.assert_array_equal(paired(seen, modes.poles, A), some)


def test_rotations_without_mass_move_as_their_stiffness_demands():
    """A lumped beam against its static condensation, also with a spring at a rotation."""
    K, M = cantilever()
    M = np.diag(np.where(np.arange(len(M)) % 2, 0.0, np.diag(M)))
    highest, spring = 2 * np.pi * 400.0, 40.0
    c = coordinates_of(Structure(M, 1e-5 * K, K, DOFS), DOFS[:2], DOFS[:1], highest)
    stiffer = K.copy()
    stiffer[7, 7] += spring
    change = spring * np.outer(c.shapes[7], c.shapes[7])
    for full, found in ((K, modes_of(c)), (stiffer, modes_of(c, dK=change))):
        z, r = np.arange(0, len(K), 2), np.arange(1, len(K), 2)
        condensed = full[np.ix_(z, z)] - full[np.ix_(z, r)] @ np.linalg.solve(full[np.ix_(r, r)], full[np.ix_(r, z)])
        exact = np.sqrt(scipy.linalg.eigh(condensed, M[np.ix_(z, z)], eigvals_only=True))
        few = exact < highest
        assert few.sum() > 3
        np.testing.assert_allclose(np.abs(found.poles)[: few.sum()], exact[few], rtol=1e-5)


def test_the_element_at_a_clamp_is_a_place_as_a_whole(coordinates):
    """Half of the first element's stiffness lost moves modes as the cause of that place and size says."""
    every = candidates_of(simulation(), coordinates, DOFS[::2], (DOFS[6],), None, 2 * np.pi * 330)
    (cause,) = (
        k for k in every if k.slug == "joint_stiffness" and k.pattern is not None and len(k.where) == 1 and not k.piece
    )
    assert cause.where == ("1:+Z",)
    K, M = cantilever(stiffness=np.array([0.5, *np.ones(7)]))
    exact = np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True))[:5]
    found = np.abs(modes_of(coordinates, dK=-0.5 / cause.scale * cause.matrix).poles)[:5]
    np.testing.assert_allclose(found, exact, rtol=1e-6)


@pytest.mark.parametrize("slug", ["joint_stiffness", "gyroscopic"])
@pytest.mark.parametrize(
    ("size", "std", "behind", "stands"),
    [
        (4.0, 1.0, 0.0, True), (3.0, 1.0, 0.0, False), (40.0, 1.0, 0.0, True),
        (4000.0, 5000.0, 5.0, False), (4000.0, 5000.0, 7.0, True), (0.9, 1.0, 7.0, False),
    ],
)  # fmt: skip
def test_a_cause_that_its_error_lets_be_none_does_not_stand_out(slug, size, std, behind, stands):
    """Of a place among hundreds three standard deviations say nothing; a usual size is one tenth of these, or none.

    A size that has no upper end, as it holds two points together, is surely not zero where all is far less likely then.
    """
    cause = Change(slug, ("a", "b"), scale=100.0, reference=1000.0)
    fitted = SimpleNamespace(causes=(cause,), u=np.array([size]), covariance=np.array([[std**2]]), epsilon=[0.01] * 3)
    stage = SimpleNamespace(
        measured=SimpleNamespace(freq=np.array([1.0, 100.0])),
        setting=SimpleNamespace(inaccuracy=SimpleNamespace(groups=TOLD, between_modes=False)),
        seen=None, explanations=[Explanation(SimpleNamespace(causes=()), -behind, 0.5)],
    )  # fmt: skip
    assert (standing_out(stage, Explanation(fitted, 0.0, 1.0)) == (cause,)) == stands


def test_a_spring_at_the_place_of_a_named_joint_is_that_joints_own():
    cause = Change("joint_stiffness", ("a", "b"), scale=100.0, reference=1000.0)
    fitted = SimpleNamespace(
        causes=(cause,), u=np.array([40.0]), covariance=np.array([[1.0]]), epsilon=[0.01] * 3
    )  # fmt: skip

    def stands(joint):
        stage = SimpleNamespace(
            measured=SimpleNamespace(freq=np.array([1.0, 100.0])),
            setting=SimpleNamespace(inaccuracy=SimpleNamespace(groups=TOLD, between_modes=False)),
            seen=SimpleNamespace(joint=SimpleNamespace(spot=SimpleNamespace(where=joint))),
        )
        return standing_out(stage, Explanation(fitted, 0.0, 1.0)) == (cause,)

    assert stands(("a", "c")) and not stands(("b", "a"))


def plate(rows=3, columns=4, k_mount=5.0, k_store=20.0):
    """A grid of bending cells, each resisting its twist and its curvatures, on two mounts and with a mass on a spring.

    Every cell of four nodes resists no rigid motion, but no two of its nodes make an element by themselves.
    """
    pieces = plate_pieces(rows, columns, k_mount, k_store)
    return sum(pieces), tuple(f"{k + 1}:+Z" for k in range(rows * columns + 1))


def plate_pieces(rows, columns, k_mount=5.0, k_store=20.0):
    """Every cell, mount and spring of the plate by itself."""
    count, pieces = rows * columns, []
    at = lambda r, c: r * columns + c

    def strained(nodes, weights, stiffness):
        b = np.zeros(count + 1)
        b[list(nodes)] = weights
        pieces.append(stiffness * np.outer(b, b))

    for r in range(rows):
        for c in range(columns):
            if r < rows - 1 and c < columns - 1:
                strained((at(r, c), at(r, c + 1), at(r + 1, c), at(r + 1, c + 1)), (1, -1, -1, 1), 300.0)
            if 0 < c < columns - 1:
                strained((at(r, c - 1), at(r, c), at(r, c + 1)), (1, -2, 1), 400.0)
            if 0 < r < rows - 1:
                strained((at(r - 1, c), at(r, c), at(r + 1, c)), (1, -2, 1), 500.0)
    strained((at(1, 1), count), (1, -1), k_store)
    for corner in (at(0, 0), at(rows - 1, columns - 1)):
        strained((corner,), (1,), k_mount)
    return pieces


def test_of_a_plate_springs_and_mounts_are_read_off_and_the_rest_is_shared_out_among_its_nodes():
    K, dofs = plate()
    parts = parts_of(K, nodes_of(dofs))
    np.testing.assert_allclose(sum(p.full(len(K)) for p in parts), K, atol=1e-9 * K.max())
    told = {tuple(sorted(p.dofs)): p.matrix[0, 0] for p in parts if p.nodes}
    assert told == pytest.approx({(5, 12): 20.0, (0,): 5.0, (11,): 5.0})
    for p in parts:
        values = np.linalg.eigvalsh(p.matrix)
        assert values[0] > -1e-9 * values[-1]  # read pair by pair they would give energy away
    still = np.append(np.arange(12) % 4, 1.0)  # a rigid motion that strains the mounts alone
    for p in (p for p in parts if not p.nodes):
        assert still @ p.full(len(K)) @ still < 1e-9 * K.max()


def test_cells_of_a_plate_that_are_off_are_errors_of_nodes_and_of_what_neighbours_share():
    """A third of such a change is none of single nodes; a random one of so many couplings would keep four fifths."""
    K, dofs = plate(5, 6)
    parts = parts_of(K, nodes_of(dofs))
    own = [p.full(len(K)) for p in parts]
    shared = [np.outer(a, b) + np.outer(b, a) for a, b in coupled_rows(parts)]
    size, upper, rng = np.sqrt(np.diag(K)), np.triu_indices(len(K)), np.random.default_rng(0)
    flat = lambda A: (A / size[:, None] / size)[upper]
    assert len(own + shared) < 0.4 * len(upper[0])
    for _ in range(3):
        change = flat(sum(rng.standard_normal() * P for P in plate_pieces(5, 6)[:-3]))
        left = []
        for patterns in (own, own + shared):
            X = np.stack([flat(P) for P in patterns], axis=1)
            left.append(np.linalg.norm(change - X @ np.linalg.lstsq(X, change)[0]) / np.linalg.norm(change))
        assert left[1] < 0.1 < 0.25 < left[0]


def test_elements_that_are_read_off_share_nothing():
    K = simulation().K
    assert coupled_rows(parts_of(np.asarray(K), nodes_of(DOFS))) == []


def test_a_spring_between_two_points_of_a_plate_is_compared_with_what_holds_them():
    """A coefficient of a plate's matrix between two of its points may be small by chance; no spring is off by it."""
    K, dofs = plate()
    structure = Structure(np.eye(len(K)), 1e-4 * K, K, dofs)
    c = coordinates_of(structure, dofs[:6], dofs[:1], 30.0)
    every = candidates_of(structure, c, dofs[:6], dofs[:1], None, 30.0)
    own = {frozenset(k.where): k.reference for k in every if k.slug == "joint_stiffness" and k.pattern is None}
    assert own[frozenset((dofs[5], dofs[12]))] == pytest.approx(20.0)
    assert own[frozenset((dofs[0], dofs[4]))] == pytest.approx(min(K[0, 0], K[4, 4]))


def test_a_soft_mount_is_compared_with_itself_and_not_with_the_beam_that_it_holds():
    K, dofs = plate(k_mount=0.02)
    assert K[0, 0] > 3e4 * 0.02
    structure = Structure(np.eye(len(K)), 1e-4 * K, K, dofs)
    c = coordinates_of(structure, dofs[:6], dofs[:1], 30.0)
    every = candidates_of(structure, c, dofs[:6], dofs[:1], None, 30.0)
    own = {k.where: k for k in every if k.slug == "joint_stiffness" and k.pattern is None}
    assert own[dofs[0],].reference == pytest.approx(0.02, rel=1e-6) and not own[dofs[0],].absent
    assert own[dofs[5],].absent


@pytest.mark.parametrize(
    ("law", "where", "share"),
    [(CubicStiffness, ("c",), 1e-4), (CubicStiffness, ("a", "b"), 1.0), (lambda: ElastoSlip(True), ("c",), 1e-4)],
)
def test_beside_a_joint_a_cause_elsewhere_is_a_second_thing_that_is_wrong(law, where, share):
    """Ten to one for a spring somewhere, before it is known that a joint tells the levels apart."""
    spring = Change("joint_stiffness", where, scale=100.0)
    fits = [SimpleNamespace(causes=causes, u=np.zeros(len(causes)), covariance=np.eye(1)) for causes in ((), (spring,))]
    alone = [Explanation(f, 0.0, p) for f, p in zip(fits, (1 / 11, 10 / 11), strict=True)]
    fit = SimpleNamespace(law=law(), p=np.ones(2), chi2=1.0, covariance=np.eye(2))
    joint = JointFound(SimpleNamespace(where=("b", "a"), held=True), fit, np.zeros(1), 0.0, 0, 0.0, 1.0)
    ranked, found = settled(alone, ByLevel([joint], None, 0.0, 0.0, 9.0, 1.0), Prior([spring]))
    odds = {bool(e.causes): e.probability for e in ranked}
    assert odds[True] / odds[False] == pytest.approx(10 * share)
    assert found.joints[0].probability == pytest.approx(1.0)


@pytest.mark.parametrize("above", [1.04, 1.11])
def test_a_mode_just_beyond_the_band_is_no_error_of_those_inside(above):
    """What reaches into the band from a mode that nothing else stands for is not taken for other modes' residues."""
    w, zeta = 2 * np.pi * np.array([20.0, 31.0, 50.0 * above]), np.array([0.01, 0.012, 0.01])
    poles = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
    shapes = np.array([[1.0, 0.6, -0.8], [0.7, -1.0, 0.5], [0.4, 0.9, 1.0]])
    s = 2j * np.pi * np.linspace(10.0, 50.0, 300)
    H = sum(
        np.outer(1 / (s - p) / (2j * p.imag) - 1 / (s - p.conj()) / (2j * p.imag), shape * shape[0])
        for p, shape in zip(poles, shapes, strict=True)
    )
    sigma = 0.003 * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones(H.shape)
    rng = np.random.default_rng(4)
    noise = (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    channels = Channels(s, H + sigma * noise, 2 / sigma**2, 0, np.zeros(0, complex))
    found = blind_modes(channels)
    assert misfit(found, channels) < 1.1
    f = features_of(found, 3, 1, 1.0)
    for p in poles[:2]:
        k = int(np.argmin(np.abs(f.poles - p)))
        std = np.abs(found.poles[k].real) * 0.02
        assert abs(f.poles[k] - p) < std


@pytest.mark.parametrize("seed", range(4))
def test_parts_of_a_simply_supported_beam_are_no_larger_than_the_beam(seed):
    """Where elements were read off a DoF there is nothing left of it but rounding, of either sign."""
    count, length, EI = 12, 0.1, 2.1e11 * 4e-9 * np.random.default_rng(seed).normal(1.0, 0.01, 12)
    unit = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]) * np.outer(
        [1, length, 1, length], [1, length, 1, length]
    )
    K = np.zeros((2 * count + 2,) * 2)
    for e in range(count):
        K[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += EI[e] / length**3 * unit
    kept = [k for k in range(len(K)) if k not in (0, 2 * count)]
    dofs = [f"{k // 2 + 1}:+{'RY' if k % 2 else 'Z'}" for k in kept]
    K = K[np.ix_(kept, kept)]
    parts = parts_of(K, nodes_of(tuple(dofs)))
    assert max(np.abs(p.matrix).max() for p in parts) < 1.01 * np.abs(K).max()
    assert sum(p.full(len(K)) for p in parts) == pytest.approx(K, abs=1e-8 * K.max())


@pytest.mark.parametrize(
    ("names", "axis", "nodes"),
    [
        (("N9u", "N9v", "N9phi", "N10u", "N10v", "N10phi"), [0, 1, 5, 0, 1, 5], 2),
        (("1_u", "1_w", "1_theta", "2_u"), [0, 2, 4, 0], 2),
        (("1u", "1v", "1w", "2u"), [0, 1, 2, 0], 2),
        (("1u", "2u", "3u"), [-1, -1, -1], 3),  # one letter alone may count anything
        (("1u", "1v", "1w", "1phi"), [-1, -1, -1, -1], 4),  # about which axis is not told
        (("1u", "1v", "base"), [-1, -1, -1], 3),
    ],
)  # fmt: skip
def test_displacements_of_a_plane_are_read_by_their_usual_letters(names, axis, nodes):
    found = nodes_of(names)
    assert found.axis.tolist() == axis and len(found.members) == nodes
