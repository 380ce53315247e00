"""Products that all places share, against the sums that they stand for."""

from dataclasses import replace

import numpy as np
from chains import comparison_of, grid

from modalax import Measurement
from modalax.diagnose.comparison import make_comparison
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.products import ends, factors_of, reduce
from modalax.diagnose.screening.score_state import score_state_of


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
