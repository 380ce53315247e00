"""Elements whose mass is wrong as a whole, and what stands out among errors of all elements."""

from types import SimpleNamespace

import numpy as np
import pytest

from modalax.data import Measurement
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting import outlying as module
from modalax.diagnose.modal_domain.fitting.outlying import outlying, outlying_said
from modalax.model import Structure

COUNT, MASS, STIFFNESS = 12, 0.5, 4e6  # elements of a bar that is clamped at one end [kg, N/m]
DOFS = [f"{k}:+X" for k in range(1, COUNT + 1)]


def bar(mass: np.ndarray, stiffness: np.ndarray) -> Structure:
    """Elements with linear shapes between neighbouring nodes, each with its own factors."""
    M, K = np.zeros((COUNT + 1, COUNT + 1)), np.zeros((COUNT + 1, COUNT + 1))
    for e in range(COUNT):
        two = np.ix_((e, e + 1), (e, e + 1))
        M[two] += mass[e] * MASS / 6 * np.array([[2.0, 1.0], [1.0, 2.0]])
        K[two] += stiffness[e] * STIFFNESS * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return Structure(M[1:, 1:], 2e-5 * K[1:, 1:], K[1:, 1:], DOFS)


def test_an_element_that_is_heavier_as_a_whole_is_told_with_its_mass():
    """Neither a lump at one of its nodes nor an inaccuracy of all masses, of which twelve per cent had been told."""
    rng = np.random.default_rng(3)
    mass, stiffness = 1 + 0.005 * rng.standard_normal(COUNT), 1 + 0.02 * rng.standard_normal(COUNT)
    mass[8] += 0.6
    freq = np.linspace(20.0, 560.0, 700)
    H = np.asarray(bar(mass, stiffness).frf(freq, form="accelerance", inputs=["4:+X", "12:+X"]).H)
    sigma = 0.003 * np.sqrt((np.abs(H) ** 2).mean(axis=0))
    H = H + sigma * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    variance = np.broadcast_to(sigma**2, H.shape)[None].copy()
    data = Measurement(freq, H[None], form="accelerance", outputs=DOFS, inputs=["4:+X", "12:+X"], variance=variance)
    found = diagnose_modes(data, bar(np.ones(COUNT), np.ones(COUNT)), wanted={"added_mass"}.__contains__)
    (cause,) = found.to_dict()["causes"]
    told = cause["parameters"]["mass"]
    assert found.verdict == "named" and cause["name"] == "added_mass" and cause["where"][0] in ("8:+X", "9:+X")
    assert abs(told["value"] - 0.6 * MASS) < 4 * told["std"] < 0.05
    assert any("spread over the element at" in reason for reason in found.reasons), found.reasons
    M = np.asarray(found.extended.base.M) - np.asarray(bar(np.ones(COUNT), np.ones(COUNT)).M)
    assert M[7:9, 7:9].sum() == pytest.approx(0.6 * MASS, rel=0.1)


def sizes_of(monkeypatch, sizes, std=1e-3):
    """The elements that stand out of errors of stiffness that are all known to a deviation."""
    count = len(sizes)
    a = SimpleNamespace(
        groups=("stiffness",), group_of=np.zeros(count, int), places={"stiffness": [(f"{k}:+X",) for k in range(count)]}
    )
    setting, f = SimpleNamespace(inaccuracy=a), SimpleNamespace(sizes=np.array(sizes), causes=(), u=(), state=None)
    s = np.full(count, 0.1)
    monkeypatch.setattr(module, "scale_of", lambda *_: s)
    monkeypatch.setattr(module, "slopes_at", lambda *_: np.eye(count) * np.sqrt(1 / std**2 - 1 / s[0] ** 2))
    return outlying(setting, f, "stiffness"), outlying_said(setting, f)


def test_what_is_off_by_far_more_than_the_others_stands_out(monkeypatch):
    sizes = 0.01 * np.random.default_rng(1).standard_normal(20)
    assert sizes_of(monkeypatch, sizes) == ([], [])
    sizes[[3, 11]] = 0.2, -0.3
    found, said = sizes_of(monkeypatch, sizes)
    assert [(o.number, round(o.size, 3)) for o in found] == [(11, -0.3), (3, 0.2)]
    assert all(o.std == pytest.approx(1e-3, rel=1e-6) for o in found)
    assert said == [
        "a few elements are off by far more than the others: stiffness at 11:+X by -30 % (± 0.1 %); "
        "stiffness at 3:+X by +20 % (± 0.1 %)"
    ]
    assert sizes_of(monkeypatch, sizes[:10])[1][0].startswith("one element is off by far more")
    assert sizes_of(monkeypatch, sizes, std=0.09)[0] == []  # which nobody knows
    assert sizes_of(monkeypatch, sizes[[3, 4, 5, 6]])[0] == []  # too few others


def test_errors_that_are_all_alike_hardly_ever_stand_out(monkeypatch):
    rng = np.random.default_rng(2)
    assert sum(bool(sizes_of(monkeypatch, 0.03 * rng.standard_normal(25))[0]) for _ in range(400)) <= 2
