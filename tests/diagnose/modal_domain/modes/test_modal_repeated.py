"""Structures with pairs of modes of one frequency: a ring of equal masses and springs, each also held to the ground."""

import numpy as np
import pytest
from kinds import FEW_OR_ALL

from modalax.data import FRF, Measurement
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.inaccuracy import inaccuracy_of
from modalax.diagnose.modal_domain.fitting.state import Setting, compared, slopes_at, state_at
from modalax.diagnose.modal_domain.modes.features import whitener_of
from modalax.diagnose.modal_domain.modes.free_residues import refine
from modalax.diagnose.modal_domain.modes.measured import channels_of, features_at, identify
from modalax.diagnose.modal_domain.modes.repeated import close_pairs, of_rank
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of, modes_of
from modalax.model import Structure

COUNT = 8
DOFS = tuple(f"{k}:+Z" for k in range(1, COUNT + 1))
OUTPUTS, INPUTS = DOFS[:2] + DOFS[3:6], (DOFS[0], DOFS[3])
FREQ = np.arange(15.0, 62.0, 0.1)


def ring(between=1.0, ground=1.0, damping=0.01):
    """Masses of 2 kg, springs of 40 and 25 kN/m times factors."""
    K = np.diag(2.5e4 * ground * np.ones(COUNT))
    for k, stiffness in enumerate(4e4 * between * np.ones(COUNT)):
        at = [k, (k + 1) % COUNT]
        K[np.ix_(at, at)] += stiffness * np.array([[1, -1], [-1, 1]])
    values, V = np.linalg.eigh(K / 2)
    return Structure(2 * np.eye(COUNT), 2 * V @ np.diag(2 * damping * np.sqrt(values)) @ V.T, K, DOFS)


def uneven(size, seed):
    rng = np.random.default_rng(seed)
    return ring(*(1 + size * rng.standard_normal((2, COUNT))))


def measured(structure, seed=0, gain=1.0):
    H = np.asarray(structure.frf(FREQ, outputs=OUTPUTS, inputs=INPUTS).H)
    sigma = np.broadcast_to(0.01 * np.sqrt((np.abs(H) ** 2).mean(axis=0)), H.shape)
    rng = np.random.default_rng(seed)
    H = H * np.where(np.arange(len(OUTPUTS)) == 2, gain, 1.0)[:, None]
    H = H + sigma / np.sqrt(2) * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    return Measurement.from_frfs([FRF(FREQ, H, variance=sigma**2, outputs=OUTPUTS, inputs=INPUTS)])


def setting_of(measurement, simulation):
    highest = 2 * np.pi * FREQ[-1]
    c = coordinates_of(simulation, measurement.outputs, measurement.inputs, highest)
    found = identify(measurement, c)
    return found, Setting(c, inaccuracy_of(simulation, c, highest), found.features, whitener_of(found.features))


def test_two_modes_of_one_frequency_are_compared_as_a_pair_or_as_what_the_inputs_show_of_them():
    found, setting = setting_of(measured(ring()), uneven(0.01, 1))
    exact = np.sort(np.abs(modes_of(coordinates_of(ring(), OUTPUTS, INPUTS, 2 * np.pi * FREQ[-1])).poles[:COUNT]))
    # shapes cos and sin of 1, 2 and 3 waves: two inputs three places apart see both of 1 and 3 waves, and of 2 as well
    np.testing.assert_allclose(np.sort(np.abs(found.features.poles)), exact, rtol=1e-4)
    assert found.features.grouped.tolist() == [False, *6 * [True], False]
    state = state_at(setting, np.zeros(len(setting.inaccuracy.group_of)))
    assert np.unique(state.pairs).tolist() == list(range(COUNT)) and not len(state.together.rows)
    # forces two places apart cannot tell the two modes of two waves apart, nor can one force those of any pair
    one = replace_inputs(measured(ring()), 1)
    found, setting = setting_of(one, uneven(0.01, 1))
    assert len(found.features.poles) == 5 and not found.features.groups
    assert len(state_at(setting, np.zeros(len(setting.inaccuracy.group_of))).together.rows) == 3


def replace_inputs(m, count):
    """The measurement with its first inputs only."""
    return m.replace(H=m.H[..., :count], variance=m.variance[..., :count], inputs=m.inputs[:count])


def test_repeated_modes_together_make_the_receptance_of_the_matrices():
    modes = modes_of(c := coordinates_of(ring(), OUTPUTS, INPUTS, 2 * np.pi * FREQ[-1]))
    s, A = 2j * np.pi * FREQ[:, None, None, None], modes.residues(c)
    H = (A / (s - modes.poles[:, None, None]) + A.conj() / (s - modes.poles.conj()[:, None, None])).sum(axis=1)
    aim = np.asarray(ring().frf(FREQ, outputs=OUTPUTS, inputs=INPUTS).H)
    np.testing.assert_allclose(H, aim, atol=1e-10 * np.abs(aim).max())


@pytest.mark.parametrize("inputs", [1, 2])
@pytest.mark.parametrize(
    ("truth", "simulation", "tolerance"),
    [(ring(), uneven(0.01, 1), 1e-6), (uneven(0.002, 4), uneven(0.01, 1), 1e-6), (ring(), ring(), 1e-4)],
)
def test_features_of_such_modes_move_as_their_derivatives_say(truth, simulation, tolerance, inputs):
    exact = simulation.K[0, 0] == simulation.K[1, 1]  # of modes of one pole steps must tell them apart
    setting = setting_of(replace_inputs(measured(truth), inputs), simulation)[1]
    rng = np.random.default_rng(5)
    x, d = rng.standard_normal((2, len(setting.inaccuracy.group_of)))
    x, step = (0 * x, 1e-3) if exact else (1e-3 * x, 1e-6)
    ends = [state_at(setting, x + way * step * d).difference for way in (1, -1)]
    moved = slopes_at(setting, state_at(setting, x)) @ d
    np.testing.assert_allclose((ends[1] - ends[0]) / (2 * step), moved, atol=tolerance * np.abs(moved).max())


@pytest.mark.parametrize("truth", [ring(), uneven(0.004, 4)])
def test_features_of_such_modes_scatter_as_their_covariance_says(truth):
    c = coordinates_of(truth, OUTPUTS, INPUTS, 2 * np.pi * FREQ[-1])
    found = identify(measured(truth), c)
    assert found.features.grouped.sum() == 6
    modes, pulls = modes_of(c), []
    for seed in range(30):
        m = measured(truth, 10 + seed)
        channels = channels_of(
            2j * np.pi * FREQ, np.asarray(m.H), np.sqrt(np.asarray(m.variance)), 0, c.frequencies[:0]
        )
        f = features_at(refine(found.modes.poles, channels), channels, (len(OUTPUTS), len(INPUTS)), 1.0)[0]
        exact = f.predicted(*compared(f, modes.poles[:COUNT], modes.residues(c)[:COUNT], np.arange(COUNT))[1:])
        pulls.append(((f.values - exact) / np.sqrt(np.diag(f.covariance)).reshape(f.values.shape))[f.grouped])
    scatter = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert 0.9 < np.sqrt(np.mean(scatter**2)) < 1.1 and scatter.min() > 0.4 and scatter.max() < 1.6, scatter


def test_the_gain_of_one_output_moves_their_features_as_its_root_has_it():
    f, gain = setting_of(measured(ring()), ring())[0].features, np.zeros((len(OUTPUTS), 1))
    gain[1] = 1e-6
    ends = [f.predicted(f.poles, f.seen * (1 + way * gain)) for way in (1, -1)]
    moved = f.slopes(f.poles, f.seen, np.zeros((len(f.poles), 1)), (f.seen * (gain > 0))[:, None])[:, :, 0]
    np.testing.assert_allclose((ends[0] - ends[1]) / 2e-6, moved, atol=1e-6)
    # one of five outputs moves no frequency or damping, and of each pair a part of the size
    assert np.abs(moved[:, :2]).max() < 1e-9 and 0 < moved[f.grouped, 2].max() < 1


def test_the_closest_poles_are_taken_together_two_by_two():
    light = [-0.01 + 200j, -0.01 + 203j, -0.01 + 206.5j]
    poles = np.array([-1 + 100j, -1 + 101.5j, -1 + 103.7j, *light, -6 + 300j, -6 + 307j])
    assert set(close_pairs(poles)) == {(0, 1), (3, 4)}
    assert close_pairs(poles[[5, 4]]) == [(0, 1)] and not close_pairs(poles[[3, 5]])


def test_a_ring_of_which_all_springs_are_off_by_a_per_cent_has_no_cause():
    d = diagnose_modes(measured(ring()), uneven(0.01, 1))
    assert d.verdict == "clean"
    assert d.inaccuracy["stiffness"]["interval"][0] < 0.01 < d.inaccuracy["stiffness"]["interval"][1]


@FEW_OR_ALL
@pytest.mark.parametrize("spread", [0.0, pytest.param(0.002, marks=pytest.mark.slow)])
def test_a_gain_is_told_on_a_ring_whose_modes_are_or_nearly_are_repeated(spread, wanted):
    d = diagnose_modes(measured(uneven(spread, 4), gain=1.08), uneven(0.01, 1), wanted=wanted)
    assert d.verdict == "named" and [(c["name"], c["where"]) for c in d.causes] == [("channel_gain", ["4:+Z"])]
    gain = d.causes[0]["parameters"]["gain"]
    assert abs(gain["value"] - 0.08) < 3 * gain["std"] < 0.01


@pytest.mark.parametrize("rank", [1, 2])
def test_a_sum_of_shapes_leaves_no_more_than_noise_whatever_the_channels_deviations_are(rank):
    """Chi-square of ``oi - r(o + i - r)`` complex numbers; singular vectors leave some thirty times as much."""
    rng = np.random.default_rng(rank)
    draw = lambda *shape: rng.standard_normal((200, *shape)) + 1j * rng.standard_normal((200, *shape))
    deviation = 10.0 ** rng.uniform(-2, 0, (200, 7, 3))
    residues = 100 * draw(7, rank) @ draw(rank, 3)
    noise = deviation * draw(7, 3) / np.sqrt(2)
    off = (residues + noise - of_rank(residues + noise, deviation**2, rank)) / deviation
    left = (np.abs(off) ** 2).sum(axis=(1, 2))
    freedom = 21 - rank * (10 - rank)
    assert abs(np.median(left) / freedom - 1) < 0.15 and np.mean(left < 3 * freedom) > 0.95


def test_a_channel_without_weight_and_one_without_response_decide_nothing():
    A = np.outer([1.0, 2.0, 3.0], [1.0, -2.0])
    dead = np.zeros((4, 3))
    dead[:3, :2], dead[3, 2] = A, 1e-9  # a motion of its own that hardly anything tells of
    deviation = np.full((4, 3), 1e-3)
    deviation[3], deviation[:, 2] = 1e-15, 1e-15
    deviation[3, 2] = 1e-6
    deviation[0, 0] = 0.0
    found = of_rank(dead[None] + 0j, deviation[None] ** 2, 1)[0]
    np.testing.assert_allclose(found[:3, :2], A, atol=1e-6)


def test_a_mode_that_one_input_hardly_moves_is_one_mode():
    """Noise is a share of each FRF: where another mode is large, it is large on the peak of the small one too."""
    poles = 2 * np.pi * np.array([10.0, 14.0, 30.0]) * (-0.01 + 1j)
    across = np.array([[1.0, 0.8, 0.5, 0.3, 0.9, 0.6], [0, 0, 0.1, 1.0, 0.7, 0.9], [0.9, -0.7, 0.4, 0.5, 0.2, -0.8]])
    along = np.array([[1e-3, 30.0], [0.06, 0.3], [1e-3, 30.0]])
    freq = np.linspace(6.0, 40.0, 700)
    s = 2j * np.pi * freq[:, None]
    gain = 1 / (s - poles) / (2j * poles.imag) + 1 / (s - poles.conj()) / (-2j * poles.imag)
    H = np.einsum("fm,mo,mi->foi", gain, across, along) * s[:, :, None] ** 2
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones(H.shape)
    rng = np.random.default_rng(3)
    noise = (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    m = Measurement(freq, (H + sigma * noise)[None], form="accelerance", variance=sigma[None] ** 2)
    found = identify(m, None)
    assert not found.features.origin.twice.any()
    np.testing.assert_allclose(np.abs(found.features.poles), np.abs(poles), rtol=2e-4)
