"""Many lines and many causes: FRFs by poles and residues, what few lines may tell, causes compared together."""

from dataclasses import replace

import numpy as np
import pytest
from chains_off import DOFS, FREQ, as_measured, chain_off, response, simulation

from modalax.diagnose.deadline import NEVER
from modalax.diagnose.modal_domain.fitting.attempts import attempt
from modalax.diagnose.modal_domain.fitting.explanation import Explanation
from modalax.diagnose.modal_domain.fitting.state import state_at
from modalax.diagnose.modal_domain.held_out import _peaks_elsewhere
from modalax.diagnose.modal_domain.odd_channels.odd_channel import is_of_the_structure
from modalax.diagnose.modal_domain.on_lines import lines as module
from modalax.diagnose.modal_domain.on_lines import polish
from modalax.diagnose.modal_domain.on_lines.lines import lines_of
from modalax.diagnose.modal_domain.on_lines.polish import chi2_of, leading_on_lines, on_lines
from modalax.diagnose.modal_domain.search import starts
from modalax.diagnose.modal_domain.search.screen import finite
from modalax.diagnose.modal_domain.stage import identified, posed, told_wrongly
from modalax.diagnose.modal_domain.structure.many_lines import MANY, by_poles, receptance

S = 2j * np.pi * np.linspace(3.0, 120.0, MANY + 50)


def at_each_line(M, C, K, out, inn):
    return np.stack([out @ np.linalg.inv(s**2 * M + s * C + K) @ inn.T for s in S])


@pytest.mark.parametrize("kind", ["real", "lossy", "heavy"])
def test_poles_and_residues_give_what_each_line_does(kind):
    M, C, K = chain_off(3, 0.02)
    C, K = 300 * C if kind == "heavy" else C, K * (1 + 0.03j) if kind == "lossy" else K
    out, inn = np.eye(5)[[0, 1, 3]], np.eye(5)[[0, 4]]
    found = by_poles(M, C, K, out, inn, S)
    exact = at_each_line(M, C, K, out, inn)
    np.testing.assert_allclose(found, exact, atol=1e-10 * np.abs(exact).max())
    np.testing.assert_array_equal(receptance(M, C, K, out, inn, S), found)


def test_a_rigid_body_without_damping_is_no_sum_of_poles():
    """Its two poles at rest are one, so that each line is solved."""
    M, C, K = chain_off(3, 0.02)
    K = K - np.diag(K.sum(axis=1))  # held nowhere
    C = np.zeros_like(C)
    out, inn = np.eye(5)[[0, 1]], np.eye(5)[[4]]
    exact = at_each_line(M, C, K, out, inn)
    np.testing.assert_allclose(receptance(M, C, K, out, inn, S), exact, rtol=1e-7)
    assert by_poles(np.eye(1), np.zeros((1, 1)), np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), S) is None


@pytest.fixture(scope="module")
def fitted():
    """A chain, a mass that is fitted to its modes, and the FRFs."""
    M, C, K = chain_off(4, 0.01)
    data = as_measured(response(M + np.diag([0, 0.2, 0, 0, 0]), C, K, FREQ), FREQ, 4)
    modes = identified(data, simulation(), lambda _: None)
    task, found = posed(data, simulation(), modes), {}
    mass = next(c for c in task.candidates if (c.slug, c.where) == ("added_mass", (DOFS[1],)))
    attempt(task.setting, found, (mass,), mass.of_size(0.5), None)
    return modes, task, found[(mass,)]


def test_every_so_many_lines_bend_no_fit_that_explains_all(fitted, monkeypatch):
    modes, task, f = fitted
    every = lines_of(modes.channels, task.setting)
    assert every.whole is None and chi2_of(task.setting, f, every) < 1.05 * every.samples
    monkeypatch.setattr(module, "WORK", 3e5)
    few = lines_of(modes.channels, task.setting)
    assert few.whole is not None and len(few.s) < 0.5 * len(every.s) == 0.5 * len(few.whole.s)
    assert on_lines(task.setting, f, few, NEVER) is f
    # a fit that leaves more than the modes do is taken on, where all lines are left better by it
    worse = replace(f, sizes=f.sizes + 0.003)
    left = [chi2_of(task.setting, x, every) for x in (worse, on_lines(task.setting, worse, few, NEVER), f)]
    assert left[1] - left[2] < 0.5 * (left[0] - left[2])
    monkeypatch.setattr(polish, "AS_MODES", 0.0)
    assert chi2_of(task.setting, on_lines(task.setting, f, few, NEVER), every) <= left[2]


@pytest.mark.parametrize("right", [True, False])
def test_what_is_left_of_modes_is_no_more_than_lines_leave_beyond_them(fitted, right, monkeypatch):
    """Modes that lie close together may be told wrongly: a right element had been `unknown`, beside an odd force."""
    modes, task, f = fitted
    wrong = f if right else replace(f, u=0.5 * f.u, sizes=0.5 * f.sizes)
    monkeypatch.setattr(polish, "on_lines", lambda setting, f, lines, late: f)
    (_, (taken,)) = leading_on_lines(task.setting, [Explanation(wrong, 0.0, 1.0, misfit=11.0)], modes, NEVER)
    left = chi2_of(task.setting, taken.fit, lines_of(modes.channels, task.setting))
    unknowns = modes.modes.linear[..., 0].size + 2 * len(modes.modes.poles)
    beyond = left - modes.modes.chi2 * modes.channels.samples / (modes.channels.samples - unknowns)
    assert taken.misfit == pytest.approx(np.clip(beyond / f.state.difference.size, 0.0, 11.0))
    assert (taken.misfit < 1.5) == right
    assert told_wrongly(11.0, taken.misfit) == right and not told_wrongly(0.7, taken.misfit)


def test_noise_that_is_overstated_hides_nothing_that_lines_leave(fitted, monkeypatch):
    """At a quarter of the noise stated all of it lies below one a sample; modes leave as little."""
    modes, task, f = fitted
    c = modes.channels
    stated = replace(
        modes,
        channels=replace(c, weight=c.weight / 4),
        modes=replace(modes.modes, chi2=modes.modes.chi2 / 4),
        misfit=1.0,
    )
    monkeypatch.setattr(polish, "on_lines", lambda setting, f, lines, late: f)
    told, left = [Explanation(replace(f, u=0.98 * f.u), 0.0, 1.0, misfit=np.inf)], []
    for measured in (modes, stated):
        left.append(leading_on_lines(task.setting, told, measured, NEVER)[1][0].misfit)
    assert left[1] > 2.0 and left[1] == pytest.approx(left[0] / 4)


def test_causes_compared_together_are_compared_as_each_by_itself(fitted):
    _, task, _ = fitted
    some = [c for c in task.candidates if c.slug in ("added_mass", "channel_gain", "channel_swap", "missing_mode")]
    distance, size = finite(task.setting, some)
    alone = [finite(task.setting, [c]) for c in some]
    np.testing.assert_allclose(distance, [d[0] for d, _ in alone], rtol=1e-6)
    np.testing.assert_array_equal(size, [u[0] for _, u in alone])


@pytest.mark.parametrize("at_inputs", [False, True])
def test_of_many_exchanges_those_that_bring_shapes_nearest_are_tried(at_inputs, monkeypatch):
    H = response(*chain_off(6, 0.02), FREQ)
    order = [3, 1, 2, 0, 4]  # 1 and 4 are exchanged
    H = H[:, :, order] if at_inputs else H[:, order]
    few, every = (0, 2), (0, 1, 2, 3, 4)
    data = as_measured(H, FREQ, 6, outputs=few if at_inputs else every, inputs=every if at_inputs else (0, 3))
    task = posed(data, simulation(), identified(data, simulation(), lambda _: None))
    swaps = [k for k, c in enumerate(task.candidates) if c.slug == "channel_swap" and c.at_inputs == at_inputs]
    assert len(swaps) == 10 and starts._unlikely_swaps(task.setting, task.candidates) == set()
    monkeypatch.setattr(starts, "SWAPS", 1)
    left = set(swaps) - starts._unlikely_swaps(task.setting, task.candidates)
    assert [set(task.candidates[k].where) for k in left] == [{DOFS[0], DOFS[3]}]


def test_what_moves_frequencies_far_and_explains_all_is_no_channel(fitted):
    """Then no odd channel is looked for, which takes long with many sensors."""
    _, task, f = fitted
    found = {}
    attempt(task.setting, found, (), np.zeros(0), None)
    gain = next(c for c in task.candidates if c.slug == "channel_gain")
    near, far = (
        replace(found[()], state=replace(found[()].state, modes=nominal(task, factor))) for factor in (1.0, 1.1)
    )

    def told(*some, left=1.0):
        return is_of_the_structure([Explanation(x, 0.0, 0.5, left) for x in some], task.setting.features)

    assert told(f, far)
    assert not (told(f, near) or told(far, f) or told(f) or told(f, far, left=1.5))
    assert not told(replace(f, causes=(gain,)), far)


def nominal(task, factor):
    """The modes that were measured, all frequencies by a factor, in the place of the predicted ones."""
    still = state_at(task.setting, np.zeros(len(task.setting.inaccuracy.group_of)))
    poles = still.modes.poles.copy()
    poles[still.pairs] = factor * task.setting.features.poles
    return replace(still.modes, poles=poles)


def test_peaks_are_elsewhere_where_most_are_missed_by_their_widths(fitted):
    _, task, f = fitted
    features = task.setting.features
    for factor, causes, elsewhere in ((1.0, (), False), (1.2, (), True), (1.2, f.causes, False)):
        x = replace(f, causes=causes, state=replace(f.state, modes=nominal(task, factor)))
        assert _peaks_elsewhere(x, features) == elsewhere
