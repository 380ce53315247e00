"""Masses in a row and what is measured on them, for the tests of the screening."""

import numpy as np

from modalax import Measurement, Structure
from modalax.diagnose.comparison import make_comparison
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.score_state import score_state_of


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


def comparison_of(structure, changed, lines=80, seed=0, level=(1.0, 2.0)):
    rng, freq = np.random.default_rng(seed), np.linspace(10.0, 120.0, lines)
    names = structure.dofs
    H = np.stack([np.asarray(changed.frf(freq, outputs=names, inputs=names[:2]).H)] * 2)
    sigma = 0.03 * np.sqrt((np.abs(H) ** 2).mean(axis=1, keepdims=True)) * np.ones(H.shape)
    e = (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) * sigma / np.sqrt(2)
    data = Measurement(freq, H + e, variance=sigma**2, outputs=names, inputs=names[:2], level=level)
    comparison = make_comparison(data, structure)
    count = comparison.problem.modal_form.stiffness.shape[0]
    null = comparison.fit([Hypothesis(theta=np.zeros((2, count)))], 10)[0]
    return comparison, score_state_of(comparison, null)


def sprung(structure, a, b, k):
    K = np.array(structure.K)
    K[[a, b, a, b], [a, b, b, a]] += np.array([k, k, -k, -k])
    return Structure(structure.M, structure.C, K, structure.dofs)
