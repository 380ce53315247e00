"""Places ranked by the sizes that measured frequencies ask for, against eigenvalues of the changed chain."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg

from modalax.diagnose.modal_domain.causes.change import Change
from modalax.diagnose.modal_domain.causes.channel_faults import Gain
from modalax.diagnose.modal_domain.search.matched import CLOSE, FAR, NEARER, missed_dampings, missed_frequencies
from modalax.diagnose.modal_domain.search.screen import SIZES, cost_of_size

COUNT = 7
M = np.diag(np.linspace(1.0, 1.6, COUNT))
PAIRS = [(k, k + 1) for k in range(COUNT - 1)] + [(0, 3), (2, 5)]
TRIED = np.array([-s for s in SIZES] + [0.0, *SIZES])


def across(pair) -> np.ndarray:
    b = np.zeros(COUNT)
    b[pair[0]], b[pair[1]] = 1.0, -1.0
    return b


def point(k) -> np.ndarray:
    return np.eye(COUNT)[k]


K = 200.0 * np.eye(COUNT) + sum((900.0 + 70.0 * k) * np.outer(across(p), across(p)) for k, p in enumerate(PAIRS))
VALUES, SHAPES = scipy.linalg.eigh(K, M)
CANDIDATES = [Change("joint_stiffness", p, scale=500.0, direction=SHAPES.T @ across(p)) for p in PAIRS]
CANDIDATES += [Change("added_mass", (k,), scale=0.5, direction=SHAPES.T @ point(k)) for k in range(COUNT)]
CANDIDATES += [Gain("channel_gain", ("1",), channel=(0, 0))]


def missed_by_all(values, sizes=TRIED, damping=0.01):
    """Misses and sizes of all candidates for measured poles of some squared frequencies."""
    poles = np.sqrt(values) * (-damping + 1j * np.sqrt(1 - damping**2))
    eye = np.eye(COUNT)
    modes = SimpleNamespace(low=(eye[:5], VALUES[:5], eye), high=(eye[5:], VALUES[5:]))
    return missed_frequencies(SimpleNamespace(poles=poles), modes, CANDIDATES, sizes)


@pytest.mark.parametrize(("which", "size"), [(2, 1.3), (6, -1.5), (10, 2.6), (14, -0.9)])
def test_the_place_of_a_change_that_moves_modes_past_each_other_comes_first(which, size):
    """Sizes that are not among those tried: the measured frequencies tell them."""
    c = CANDIDATES[which]
    v = across(c.where) if c.kind == "K" else point(*c.where)
    parts = {"K": K, "M": M}
    parts[c.kind] = parts[c.kind] + size * c.scale * np.outer(v, v)
    values = scipy.linalg.eigh(parts["K"], parts["M"])[0]
    assert np.abs(values[:5] / VALUES[:5] - 1).max() > 2 * CLOSE
    missed, sizes = missed_by_all(values[:5])
    assert sizes[which] == pytest.approx(size)
    assert missed[which] == pytest.approx(0, abs=1e-12)
    assert np.argmin(missed) == which
    assert np.sort(missed)[1] > 0.01
    assert missed[-1] == np.inf  # of no change of a matrix nothing is told


@pytest.mark.parametrize("size", [0.7, -0.4])
def test_misses_are_those_of_the_nearest_modes_of_the_changed_structure(size):
    """Also of a mode that the place hardly moves, which may be as far off as any; in steps of the distances sought."""
    values = VALUES[:5] * (1 + CLOSE * np.array([0.3, -0.7, 1.6, -1.1, 0.2]))
    told, _ = missed_by_all(values, np.array([size]))
    alone = np.zeros(len(CANDIDATES))
    for k, c in enumerate(CANDIDATES[:-1]):
        asked = [size]
        for value in values:  # the sizes that frequencies ask for, by the determinant
            v = SHAPES.T @ (across(c.where) if c.kind == "K" else point(*c.where))
            flexible = c.scale * (v**2 / (VALUES - value)).sum()
            asked.append(-1 / flexible if c.kind == "K" else 1 / value / flexible)
        b = across(c.where) if c.kind == "K" else point(*c.where)
        missed = []
        for u in asked:
            parts = {"K": K, "M": M}
            parts[c.kind] = parts[c.kind] + u * c.scale * np.outer(b, b)
            if np.linalg.eigvalsh(parts["M"]).min() <= 0:
                continue
            changed = scipy.linalg.eigh(parts["K"], parts["M"])[0]
            off = np.abs(changed / values[:, None] - 1).min(axis=1) / CLOSE
            step = np.append(0.0, NEARER)[np.searchsorted(NEARER, off * (1 - 1e-6))]
            missed.append((step**2).sum())
        alone[k] = min(missed)
    assert told[:-1] == pytest.approx(alone[:-1], abs=1e-9)


def test_where_nothing_has_changed_every_place_is_as_good_and_a_miss_is_bounded():
    same, _ = missed_by_all(VALUES[:5] * (1 + 1e-7))
    assert same[:-1] == pytest.approx(0, abs=1e-6)
    elsewhere, _ = missed_by_all(VALUES[-1] * np.array([7.0, 11.0]), np.zeros(1))
    assert (elsewhere[:-1] <= 2 * FAR**2).all()


def test_a_size_beyond_the_usual_one_costs_what_its_own_width_does():
    assert cost_of_size(np.array([0.5, 1.0, 10.0])) == pytest.approx([0.25, 1.0, 1 + 2 * np.log(10.0)])
    assert cost_of_size(-10.0) == cost_of_size(10.0)


def test_a_free_structure_may_be_softer_and_none_has_less_than_no_stiffness():
    """Rigid bodies have no frequency, or one of rounding; points that are joined move alike at any size above some."""
    free = K - 200.0 * np.eye(COUNT)
    values, shapes = scipy.linalg.eigh(free, M)
    modes = SimpleNamespace(
        low=(np.eye(COUNT)[:5], np.maximum(values, 0.0)[:5], None), high=(np.eye(COUNT)[5:], values[5:])
    )
    pair = Change("joint_stiffness", PAIRS[2], scale=500.0, direction=shapes.T @ across(PAIRS[2]))
    for size in (-1.5, 1e5):
        changed = free + size * 500.0 * np.outer(across(PAIRS[2]), across(PAIRS[2]))
        poles = np.sqrt(scipy.linalg.eigh(changed, M)[0][1:5] * (1 + 1e-4 * np.array([1, -1, 1, -1]))) * 1j
        (missed,), (found,) = missed_frequencies(SimpleNamespace(poles=poles), modes, [pair], TRIED)
        assert missed < 0.01
        assert found == pytest.approx(size, rel=0.05) if size < 0 else found > 50.0


def test_the_place_of_a_damper_is_the_first_by_the_dampings():
    """Of exact poles of the structure with it, one of them damped ten times as much."""
    where, damper = 4, 15.0  # N s/m
    state = lambda c: np.block(
        [[np.zeros((COUNT, COUNT)), np.eye(COUNT)], [-np.linalg.solve(M, K), -np.linalg.solve(M, c)]]
    )
    own = M @ SHAPES @ np.diag(2 * 0.01 * np.sqrt(VALUES)) @ SHAPES.T @ M
    poles = np.linalg.eigvals(state(own + damper * np.outer(point(where), point(where))))
    poles = poles[poles.imag > 0][np.argsort(np.abs(poles[poles.imag > 0]))][:5]
    before = np.sqrt(VALUES[:5]) * (-0.01 + 1j * np.sqrt(1 - 0.01**2))
    assert (poles.real / before.real).max() > 5
    candidates = [Change("local_damper", (k,), scale=0.5, direction=SHAPES.T @ point(k)) for k in range(COUNT)]
    candidates += [Change("local_damper", p, scale=0.5, direction=SHAPES.T @ across(p)) for p in PAIRS]
    vectors = np.eye(COUNT)[:5] / np.sqrt(2j * before.imag)[:, None]
    modes = SimpleNamespace(poles=before, vectors=vectors)
    features = SimpleNamespace(poles=poles)
    missed = missed_dampings(features, modes, np.arange(5), [*candidates, CANDIDATES[0]])
    assert np.argmin(missed) == where
    assert missed[where] < 1 < np.sort(missed)[1]
    assert missed[-1] == np.inf  # of what is no damper nothing is told
