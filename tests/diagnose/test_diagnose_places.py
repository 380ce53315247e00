"""Which of very many places are worth a look, and lines at the mains frequency, against what is exact."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from modalax import Measurement, Structure
from modalax.diagnose.causes.channels import ChannelGain, ChannelSwap, SensorMass
from modalax.diagnose.causes.couplings import Gyroscopic
from modalax.diagnose.causes.hum_pickup import pickup
from modalax.diagnose.causes.local import JointStiffness, LocalDamper
from modalax.diagnose.causes.mains_hum import MainsHum, _tail, hums
from modalax.diagnose.causes.missing_modes import MissingMode, OutOfBand
from modalax.diagnose.causes.scene import Place, Scene
from modalax.diagnose.comparison import make_comparison
from modalax.diagnose.decision.detection import WHEREABOUTS, _pattern_p, detect
from modalax.diagnose.decision.omnibus import Omnibus
from modalax.diagnose.extend import _key
from modalax.diagnose.fitting.gauss_newton import covariance_of, damped
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening import sensitivities as changes
from modalax.diagnose.screening import shortlist as many
from modalax.diagnose.screening.local_elements import score
from modalax.diagnose.screening.patterns import low_rank, screen_pattern, settled_rank
from modalax.diagnose.screening.products import at_places, ends, factors_of, reduce
from modalax.diagnose.screening.score_state import score_state_of
from modalax.diagnose.screening.screen import Trial, screen_cause
from modalax.diagnose.screening.sensitivities import Residual


def grid(count, claimed):
    """Masses in a row with a few cross springs; 1 % of claimed error if asked for."""
    rng = np.random.default_rng(count)
    K = 2e5 * (2 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1))
    for a, b in rng.integers(count, size=(count // 2, 2)):
        if a != b:
            K[[a, b, a, b], [a, b, b, a]] += np.array([1, 1, -1, -1]) * 8e4
    M = np.diag(rng.uniform(0.8, 1.2, count))
    names = [str(k + 1) for k in range(count)]
    return Structure(M, 1e-4 * K + 0.5 * M, K, names, frequency_std=0.01 * claimed, damping_std=0.1 * claimed)


def comparison_of(structure, changed, lines=80, seed=0):
    rng, freq = np.random.default_rng(seed), np.linspace(10.0, 120.0, lines)
    names = structure.dofs
    H = np.stack([np.asarray(changed.frf(freq, outputs=names, inputs=names[:2]).H)] * 2)
    sigma = 0.03 * np.sqrt((np.abs(H) ** 2).mean(axis=1, keepdims=True)) * np.ones(H.shape)
    e = (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) * sigma / np.sqrt(2)
    data = Measurement(freq, H + e, variance=sigma**2, outputs=names, inputs=names[:2], level=[1.0, 2.0])
    comparison = make_comparison(data, structure)
    count = comparison.problem.modal_form.stiffness.shape[0]
    null = comparison.fit([Hypothesis(theta=np.zeros((2, count)))], 10)[0]
    return comparison, score_state_of(comparison, null)


def sprung(structure, a, b, k):
    K = np.array(structure.K)
    K[[a, b, a, b], [a, b, b, a]] += np.array([k, k, -k, -k])
    return Structure(structure.M, structure.C, K, structure.dofs)


@pytest.mark.parametrize("claimed", [False, True])
def test_gain_of_free_springs_and_dampers_is_that_of_the_elements(claimed):
    """Two runs, so four unknowns at each place: their normal equations by hand from the elements' own products."""
    structure = grid(8, claimed)
    comparison, state = comparison_of(structure, sprung(grid(8, False), 2, 5, 2e3))
    every, reduced = comparison.scene.pairs(), state.reduced[True]
    a, b = ends(every)
    found = many.gains_at(reduced, many.sketch(reduced, state.sides[True].nuisance), a, b)
    at = at_places(reduced, every)
    w, runs = reduced.omega, reduced.S.shape[0]
    for k in range(len(every)):
        changes = []
        for Z, run in itertools.product((np.ones_like(w), 1j * w), range(runs)):
            y = np.zeros(at.S.shape[1:], complex)
            y[run] = -Z[:, None] * at.motion[k]
            changes.append(y)
        p = np.array([np.sum(np.real(y.conj() * at.S[k])) for y in changes])
        gram = np.array([[np.sum(np.real(y.conj() * z) * at.N[k]) for z in changes] for y in changes])
        across = np.array(
            [[np.sum(np.real(y.conj() * t)) for t in reduced.nuisances(at.a[k], at.b[k])] for y in changes]
        ).reshape(len(p), -1)
        if across.size:
            gram = gram - across @ reduced.inner @ across.T
        # the nuisances leave some directions a hundred-thousandth of their length, and the ridge is 1e-9 of that length
        assert found[k] == pytest.approx(p @ np.linalg.solve(gram, p), rel=1e-3)


def test_a_spring_alone_explains_no_more_than_free_springs_and_dampers():
    structure = grid(8, True)
    comparison, state = comparison_of(structure, sprung(grid(8, False), 2, 5, 2e3))
    every, reduced = comparison.scene.pairs(), state.reduced[True]
    free = many.gains_at(reduced, many.sketch(reduced, state.sides[True].nuisance), *ends(every))
    at = at_places(reduced, every)
    for cause in (JointStiffness(), LocalDamper()):
        square, product, _ = score(cause, reduced, at, [cause.grid(comparison.scene, p)[:1] for p in every], False)
        alone = np.array([float(p[0] ** 2 / s[0]) for s, p in zip(square, product, strict=True)])
        # the change by the least strength that is tried differs from the derivative by a part in a thousand
        assert (alone <= 1.01 * free + 0.01).all()


def test_few_lines_and_random_sums_find_the_place_among_many(monkeypatch):
    structure = grid(46, False)
    comparison, state = comparison_of(structure, sprung(structure, 3, 11, 2e3), lines=160)
    every = comparison.scene.pairs()
    assert len(every) == 46 * 47 // 2
    monkeypatch.setattr(many, "MANY", 100)
    monkeypatch.setattr(many, "KEPT", 20)
    monkeypatch.setattr(many, "LINES", 40)
    monkeypatch.setattr(many, "SUMS", 12)
    few = many.sketch(state.reduced[True], state.sides[True].nuisance)
    kept = [every[k].index[:2] for k in many.shortlist(state.reduced[True], few, every)]
    assert len(kept) == 20 and (3, 11) in kept


def test_gains_of_many_modes_beyond_the_band_are_few_alike():
    """150 modes of which 12 are in the band: two short factors hold all their gains; of 150 in it they could not."""
    s = 2j * np.pi * np.linspace(10.0, 40.0, 400)[:, None]
    for low, high, kept in ((4.0, 300.0, True), (10.0, 40.0, False)):
        omega = 2 * np.pi * np.linspace(low, high, 150)
        poles = omega * (-0.002 + 1j)
        gains = np.concatenate([1 / (s - poles), 1 / (s - poles.conj())], axis=1)
        found = factors_of(gains)
        assert (found is not None) == kept
        if found is not None:
            assert len(found[1]) <= 100
            assert np.abs(gains - found[0] @ found[1]).max() < 1e-13 * np.abs(gains).max()
    structure = grid(20, False)
    comparison, state = comparison_of(structure, structure)
    reduced = replace(state.reduced[True], factors=tuple(np.linalg.qr(state.reduced[True].gains)))
    a, b = ends(comparison.scene.pairs()[10:40])
    found = reduced.column(a, b)
    direct = replace(reduced, factors=None).column(a, b)
    H = np.asarray(structure.frf(comparison.scene.freq, inputs=structure.dofs).H)
    exact = np.swapaxes(H[:, :, a] - np.where(b >= 0, 1.0, 0.0) * H[:, :, np.maximum(b, 0)], 1, 2)
    top = np.abs(direct).max()
    assert np.abs(found - direct).max() < 1e-11 * top
    assert np.abs(found[: len(H), :, : H.shape[1]] - exact).max() < 1e-8 * top


def test_products_of_pooled_runs_are_the_sums_of_those_of_the_runs():
    structure = grid(12, True)
    runs = [structure.frf(np.linspace(2.0, 40.0, 90), inputs=("1", "5")) for _ in range(3)]
    rng = np.random.default_rng(1)
    data = np.stack([np.asarray(r.H) * (1 + 0.05 * rng.normal(size=r.shape)) for r in runs])
    sigma2 = np.abs(data).max() ** 2 * rng.uniform(1e-4, 2e-4, data.shape)
    m = Measurement(
        runs[0].freq, data, variance=sigma2, level=np.array([1.0, 2.0, 4.0]), outputs=runs[0].outputs,
        inputs=runs[0].inputs, form="receptance",
    )  # fmt: skip
    comparison = make_comparison(m, structure)
    null = comparison.fit([Hypothesis(theta=np.zeros((2, comparison.problem.modal_form.stiffness.shape[0])))], 4)[0]
    state = score_state_of(comparison, null)
    assert comparison.pooled is not comparison.problem
    direct = reduce(comparison.pooled, null.theta * comparison.nuisance.spread, state.sides[False])
    for name in ("S", "T", "weight2", "level"):
        a, b = np.asarray(getattr(state.reduced[False], name)), np.asarray(getattr(direct, name))
        assert a.size and a.shape == b.shape and np.abs(a - b).max() <= 1e-11 * max(np.abs(b).max(), 1e-300)


def test_an_exchange_of_outputs_is_among_those_kept(monkeypatch):
    structure = grid(12, False)
    comparison, _ = comparison_of(structure, structure)
    expected = np.asarray(comparison.problem.data)
    data = expected.copy()
    data[:, :, [4, 9]] = data[:, :, [9, 4]]
    weight = np.asarray(comparison.problem.weight)
    every = [Place((), (a, b, 0)) for a, b in itertools.combinations(range(12), 2)]
    monkeypatch.setattr(many, "MANY", 10)
    monkeypatch.setattr(many, "KEPT", 1)
    kept = many.likely_swaps(data, weight, weight * (data - expected), every)
    assert [every[k].index[:2] for k in kept] == [(4, 9)]


def test_noise_alone_is_rarely_called_hum():
    freq, live = np.arange(30.0, 210.0, 0.5), np.ones((4, 6, 360), bool)
    rng, values = np.random.default_rng(0), []
    for _ in range(200):
        noise = rng.normal(size=live.shape) + 1j * rng.normal(size=live.shape)
        values.append(MainsHum().explain(freq, 50.0, noise, live).p_value)
    assert np.mean(np.array(values) < 0.05) < 0.1  # 0.05 nominal
    assert np.mean(np.array(values) < 0.01) < 0.04  # 0.01 nominal


@pytest.mark.parametrize(
    "freq", [np.arange(30.0, 49.93, 0.05), np.r_[30.0:45.0:0.3, 55.0:59.0:0.3]], ids=["ends just below", "has a gap"]
)
def test_no_hum_is_looked_for_where_no_line_is(freq):
    scene = Scene(freq, ("1",), ("1",), ("1",), np.zeros(0), np.zeros(0), np.ones(1), None)
    assert MainsHum().places(scene) == []
    found = MainsHum().explain(freq, 50.0, np.full((3, 4, len(freq)), 9.0 + 0j), np.ones((3, 4, len(freq)), bool))
    assert found.p_value == 1.0 and not found.lines.any()


def test_only_places_between_many_dofs_and_swaps_are_shortlisted(monkeypatch):
    """A sensor's number is no DoF's: every sensor is looked at, however many."""
    structure = grid(12, False)
    comparison, state = comparison_of(structure, sprung(structure, 2, 5, 2e3))
    monkeypatch.setattr("modalax.diagnose.screening.score_state.MANY", 10)
    monkeypatch.setattr("modalax.diagnose.screening.shortlist.MANY", 10)
    monkeypatch.setattr("modalax.diagnose.screening.shortlist.KEPT", 5)
    kept = []
    for cause in (ChannelGain(), JointStiffness(), Gyroscopic(), ChannelSwap()):
        places = cause.places(comparison.scene)
        kept.append((len(places), len(state.nearest(comparison, cause, places))))
    assert kept == [(12, 12), (78, 5), (66, 5), (66, 5)]


def test_hum_that_stands_out_is_found_at_its_lines():
    freq, live = np.arange(30.0, 210.0, 0.5), np.ones((4, 6, 360), bool)
    rng = np.random.default_rng(0)
    noise = rng.normal(size=live.shape) + 1j * rng.normal(size=live.shape)
    noise[..., np.isin(freq, (50.0, 100.0, 150.0))] *= 2.0
    found = MainsHum().explain(freq, 50.0, noise, live)
    assert found.p_value < 1e-6
    assert set(freq[found.lines]) >= {50.0, 100.0, 150.0}


def one_source(freq, size, rng, width):
    """Noise of 6 runs and inputs at 9 outputs, and a source at 60 Hz that the outputs share, ``width`` in spacings."""
    noise = rng.normal(size=(6, 9, len(freq))) + 1j * rng.normal(size=(6, 9, len(freq)))
    lines = np.exp(-0.5 * ((freq - 60.0) / (width * np.diff(freq)[0])) ** 2)
    source = (rng.normal(size=6) * np.exp(2j * np.pi * rng.uniform(size=6)))[:, None] * rng.normal(size=9)
    signal = source[..., None] * lines
    return noise + size * signal / np.linalg.norm(signal)


def test_one_source_is_found_where_each_channel_alone_hides_it():
    """At 9 standard deviations over 54 channels the sum of squares is hardly out of its scatter; the rank tells."""
    freq, rng = np.arange(20.0, 110.0, 0.3), np.random.default_rng(3)
    live = np.ones((6, 9, len(freq)), bool)
    found = [MainsHum().explain(freq, 60.0, one_source(freq, 9.0, rng, 0.7), live) for _ in range(20)]
    assert sum(h.p_value < 1e-3 and -h.chi2 > 10 for h in found) >= 18
    assert all(np.abs(freq[h.lines] - 60.0).max() < 1.0 for h in found if h.lines.any())
    wide = [MainsHum().explain(freq, 60.0, one_source(freq, 40.0, rng, 12.0), live) for _ in range(5)]
    assert all(not h.lines.any() for h in wide)  # a resonance, seen by all outputs too


@pytest.mark.parametrize(("step", "known"), [(0.5, np.inf), (0.05, 12.0)], ids=["one offset", "three, from repeats"])
def test_forms_and_offsets_of_a_tone_are_counted_for_what_they_are(step, known):
    """They are much alike: corrected as if each were a test of its own, a chance would be ten times too large."""
    freq, rng, values = np.arange(30.0, 110.0, step), np.random.default_rng(6), []
    live = np.ones((4, 6, len(freq)), bool)
    for _ in range(600):
        noise = rng.normal(size=live.shape) + 1j * rng.normal(size=live.shape)
        if np.isfinite(known):
            noise /= np.sqrt(rng.gamma(known / 2, 2 / known, live.shape))
        values.append(pickup(freq, 50.0, noise, live, 0.0, known, _tail).p_value)
    assert 0.02 < np.mean(np.array(values) < 0.05) < 0.075


def test_a_mode_narrower_than_the_lines_at_the_mains_frequency_is_hum():
    freq = np.linspace(20.0, 110.0, 301)
    none = np.zeros(0)
    scene = Scene(freq, ("1",), ("1",), ("1",), none, none, np.ones(1), None)
    modes = ((50.1, 1e-3), (100.2, 5e-4), (60.0, 5e-4), (47.0, 1e-3), (50.1, 0.01))
    assert [hums(f, zeta, freq) for f, zeta in modes] == [True, True, True, False, False]
    assert [MissingMode().fits(np.array([1.0, *m]), scene) for m in modes] == [False, False, False, True, True]


def test_hum_is_judged_by_how_uneven_the_noise_is_elsewhere():
    rng = np.random.default_rng(4)
    freq = np.linspace(20.0, 110.0, 301)
    noise = rng.normal(size=(4, 10, 301)) + 1j * rng.normal(size=(4, 10, 301))
    even = MainsHum().explain(freq, 50.0, noise, np.ones(noise.shape, bool))
    uneven = noise * np.sqrt(rng.gamma(4.0, 0.25, 301))
    assert even.p_value > 0.01
    assert MainsHum().explain(freq, 50.0, uneven, np.ones(noise.shape, bool)).p_value > 0.001
    k = int(np.abs(freq - 50.0).argmin())
    plain, doubted = noise.copy(), uneven.copy()
    for x in (plain, doubted):
        x[..., k] *= 1.7
    assert MainsHum().explain(freq, 50.0, plain, np.ones(noise.shape, bool)).p_value < 1e-4
    assert MainsHum().explain(freq, 50.0, doubted, np.ones(noise.shape, bool)).p_value > 1e-4


def test_effects_that_overflow_are_left_out_of_the_count_of_tests():
    """Wrong units drive the modes of a simulation with claimed errors so far that some effect is infinite there."""
    D = np.random.default_rng(3).normal(size=(3, 40))
    side = Residual(np.zeros((2, 1, 20)), np.zeros((0, 2, 1, 20)), np.zeros((0, 0)))
    quiet = Omnibus(1.0, 0.0, "", (0.0, 0.0))

    def found(directions):
        t = Trial(JointStiffness(), Place(("1",), (0, -1, 0)), 16.0, 4.0, np.ones(1), direction=directions, trials=3)
        return detect([t], {True: side, False: side}, quiet)

    spoilt = np.concatenate([D, np.full((1, 40), np.nan)])
    assert found(spoilt).p_value == found(D).p_value
    assert 0 < found(np.full((1, 40), np.inf)).p_value <= found(D).p_value < 0.01


def test_several_far_modes_of_unlike_shapes_are_residual_terms_in_every_channel():
    structure = grid(8, False)
    comparison, state = comparison_of(structure, structure, lines=60)
    runs, lines, n_out, n_in = comparison.problem.weight.shape
    size = np.random.default_rng(2).normal(size=(n_out, n_in))  # of no low rank: as many shapes as inputs
    z = np.zeros((runs, lines, n_out, n_in), complex)
    z += size * (np.asarray(comparison.problem.weight) > 0)
    value = np.moveaxis(np.stack([z.real, z.imag], axis=-1), (2, 3), (0, 1)).reshape(n_out, n_in, -1)
    there = replace(state.sides[True], value=value)
    one, several = (
        screen_pattern(OutOfBand("upper", k), comparison.scene, there, comparison.problem) for k in (False, True)
    )
    everything = float((value**2).sum())
    assert several.gain > 0.99 * everything and one.gain < 0.9 * everything
    sizes = np.zeros((1, 5, 2))
    assert OutOfBand("upper").free_sizes(sizes) == 6 and OutOfBand("both", several=True).free_sizes(sizes) == 20
    keys = [_key(OutOfBand(side, k)) for side in ("upper", "lower", "both") for k in (False, True)]
    assert len(set(keys)) == 6  # they are saved and loaded apart


@pytest.mark.parametrize("cause", [SensorMass(), ChannelSwap()], ids=lambda c: c.slug)
def test_causes_of_single_sensors_explain_what_they_would_over_all_outputs(cause, monkeypatch):
    structure = grid(8, True)
    loaded = Structure(structure.M + np.diag([0, 0, 0.02, 0, 0, 0, 0, 0]), structure.C, structure.K, structure.dofs)
    comparison, state = comparison_of(structure, loaded, lines=40)
    problem, nuisance, residual = comparison.side(False)[0], comparison.side(False)[1], state.sides[False]
    places = cause.places(comparison.scene)
    assert changes.rows_of(cause, np.array([p.index for p in places]), problem) is not None

    def screened():
        theta = np.zeros((2, problem.modal_form.stiffness.shape[0]))
        return screen_cause(cause, comparison.scene, places, theta, residual, problem, nuisance, True)

    own = screened()
    monkeypatch.setattr(changes, "rows_of", lambda *_: None)
    monkeypatch.setattr("modalax.diagnose.screening.screen.rows_of", lambda *_: None)
    for one, whole in zip(own, screened(), strict=True):
        np.testing.assert_allclose(one.gain, whole.gain, rtol=1e-9, atol=1e-9)
        assert (one.direction is None) == (whole.direction is None)
        if one.direction is not None:
            np.testing.assert_allclose(one.direction, whole.direction, atol=1e-12 * np.abs(whole.direction).max())
    assert len({round(t.gain, 6) for t in own}) == len(places)  # a gain of its own at each place


def test_what_the_data_does_not_show_has_no_small_error():
    """Two unknowns that act alike: their sum is known, each alone is not."""
    J = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]) * np.array([1e6, 1.0])
    std = np.sqrt(np.diag(covariance_of(J.T @ J)))
    assert (std * np.array([1e6, 1.0]) > 1e4).all()
    A = np.array([[2.0, 0.3], [0.3, 0.05]])
    np.testing.assert_allclose(covariance_of(A), np.linalg.inv(A))
    assert covariance_of(np.diag([4.0, 0.0]))[0, 0] == 0.25 and covariance_of(np.diag([4.0, 0.0]))[1, 1] > 1e9


def test_an_unknown_pushed_against_its_bound_does_not_bend_the_steps_of_the_others():
    """A narrow slanting valley whose bottom lies beyond a bound; at the bound the least is known in closed form."""
    Q, centre = np.array([[1.0, 0.999], [0.999, 1.0]]), np.array([3.0, -3.0])

    def normal(x, moving):
        off = x - centre
        return np.einsum("bi,ij,bj->b", off, Q, off), np.broadcast_to(Q, (len(x), 2, 2)), off @ Q

    low, high = np.array([-np.inf, 0.0]), np.full(2, np.inf)
    x, chi2, _, moving = damped(normal, np.array([[5.0, 0.0], [-4.0, 2.0]]), low, high, 30)
    np.testing.assert_allclose(x, [[3 - 0.999 * 3, 0.0]] * 2, atol=1e-5)
    np.testing.assert_allclose(chi2, 9 * (1 - 0.999**2), rtol=1e-6)
    assert not moving.any()


def test_a_shape_of_rank_one_is_the_best_however_unlike_the_channels_noise_is():
    """Two terms, weights over two decades that no product of an output's and an input's describes; against scipy."""
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(5, 3, 40, 2)) * 10.0 ** rng.uniform(-1.0, 1.0, (5, 3, 1, 1))
    sizes = np.einsum("ot,it->oit", rng.normal(size=(5, 2)), rng.normal(size=(3, 2)))
    data = np.einsum("oint,oit->oin", columns, sizes) + rng.normal(size=(5, 3, 40))
    gram, right = np.einsum("oint,oinu->oitu", columns, columns), np.einsum("oint,oin->oit", columns, data)

    def explained(a):
        return 2 * np.sum(a * right) - np.einsum("oit,oitu,oiu->", a, gram, a)

    def least(x):
        u, v = x[:10].reshape(5, 2), x[10:].reshape(3, 2)
        return (np.einsum("oint,ot,it->oin", columns, u, v) - data).ravel()

    free = np.linalg.solve(gram, right[..., None])[..., 0]
    start = low_rank(free, gram)
    found = settled_rank(start, gram, right)
    true = np.concatenate([sizes[:, 0].ravel(), (sizes[0] / sizes[0, 0]).ravel()])
    best = np.sum(data**2) - 2 * scipy.optimize.least_squares(least, true, xtol=1e-14, ftol=1e-14).cost
    assert explained(start) < best - 10  # what the unlike weights cost
    assert explained(found) == pytest.approx(best, abs=0.05)
    assert np.linalg.matrix_rank(found[..., 0], tol=1e-9 * np.abs(found).max()) == 1


def test_the_chance_of_a_missing_mode_in_noise_holds_however_unlike_the_channels_noise_is():
    """The bound is that of channels alike; 1500 draws each with up to 12 x 3 channels were 0.8 to 1.6 % below 2 %."""
    rng, below = np.random.default_rng(4), 0
    for _ in range(500):
        gram = np.exp(1.5 * rng.normal(size=(7, 2)))[..., None, None]
        right = (np.sqrt(gram[..., 0, 0]) * rng.normal(size=(7, 2)))[..., None]
        sizes = settled_rank(low_rank(right / gram[..., 0], gram), gram, right)
        gain = 2 * np.sum(sizes * right) - np.sum(sizes**2 * gram[..., 0])
        t = Trial(MissingMode(), Place(()), float(gain), np.nan, np.ones(3), extra=np.moveaxis(sizes, -1, 0))
        below += _pattern_p(t, 1.0, 0.0) < 0.02 * WHEREABOUTS
    assert 2 <= below <= 20
