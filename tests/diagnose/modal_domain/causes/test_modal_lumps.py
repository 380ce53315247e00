"""Places that no element tells: a mass at a node, which moves in all its directions, and a spring where none is."""

import itertools

import numpy as np
import scipy.linalg
from kinds import FEW_OR_ALL

from modalax.data import Measurement
from modalax.diagnose.modal_domain.causes.places import candidates_of
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.inaccuracy import inaccuracy_of
from modalax.diagnose.modal_domain.fitting.state import Setting, matrices_of
from modalax.diagnose.modal_domain.modes.features import Features
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of
from modalax.model import Structure

POINTS = np.array([(x, 0.9 * y) for y in range(4) for x in (0.0, 1.0)])  # a free ladder
DOFS = tuple(f"{k}:+{d}" for k in range(1, 9) for d in "XY")
RODS = [(a, b) for a, b in itertools.combinations(range(8), 2) if np.linalg.norm(POINTS[a] - POINTS[b]) < 1.5 and b > 1]
OUTPUTS, INPUTS, TOP = DOFS[3:13], ("7:+X", "6:+Y"), 175.0
LOSS = 0.02 / (2 * np.pi * 100)  # damping over stiffness [s]: 1 % at 100 Hz


def truss(factor):
    """Stiffness of a plane truss, each rod's times a factor, and its mass."""
    K = np.zeros((16, 16))
    for (a, b), f in zip(RODS, factor, strict=True):
        along = POINTS[b] - POINTS[a]
        d = np.concatenate([-along, along]) / np.linalg.norm(along)
        at = [2 * a, 2 * a + 1, 2 * b, 2 * b + 1]
        K[np.ix_(at, at)] += 4e5 * f / np.linalg.norm(along) * np.outer(d, d)
    return K, np.eye(16)


def simulation():
    K, M = truss(np.ones(len(RODS)))
    return Structure(M, LOSS * K, K, DOFS)


def test_its_effect_is_that_of_the_mass_in_the_matrix():
    S, highest = simulation(), 2 * np.pi * TOP
    c = coordinates_of(S, OUTPUTS, INPUTS, highest)
    lump = next(
        k for k in candidates_of(S, c, OUTPUTS, INPUTS, None, highest)
        if k.slug == "added_mass" and k.pattern is not None and k.where[0].startswith("6:")
    )  # fmt: skip
    none = np.zeros((0, 10, 2))
    empty = Features(np.zeros(0), none, none, none[:, None], np.zeros((0, 5)), np.zeros((0, 0)))
    setting = Setting(c, inaccuracy_of(S, c, highest), empty, np.zeros((0, 0)))
    M, _, K = matrices_of(setting, np.zeros(len(setting.inaccuracy.group_of)), (lump,), np.array([0.4]))
    heavy = np.asarray(S.M).copy()
    for dof in ("6:+X", "6:+Y"):
        heavy[DOFS.index(dof), DOFS.index(dof)] += 0.4 * lump.scale
    found, expected = (scipy.linalg.eigh(*pair, eigvals_only=True) for pair in ((K, M), (np.asarray(S.K), heavy)))
    bent = (expected > 1.0) & (expected < highest**2)  # beyond the rigid bodies, inside the band
    np.testing.assert_allclose(found[: len(bent)][bent], expected[bent], rtol=2e-3)
    assert bent.sum() > 5 and lump.told(np.array([0.4]), np.eye(1))["mass"]["unit"] == "kg"


def test_a_mass_where_nothing_moves_in_the_band_is_no_heavier_than_the_structure():
    """Bodies of 1 kg: at one that is held far stiffer, a mass of tons would change no mode, and none is usual."""
    S, highest = simulation(), 2 * np.pi * TOP
    still = DOFS.index("5:+Y")
    K = np.asarray(S.K) + 1e10 * np.diag(np.arange(16) == still)
    held = S.replace(K=K)
    c = coordinates_of(held, OUTPUTS, INPUTS, highest)
    every = candidates_of(held, c, OUTPUTS, INPUTS, None, highest)
    usual = {k.where[0]: k.scale for k in every if k.slug == "added_mass" and k.pattern is None}
    inside = (c.frequencies < highest) & (c.frequencies > 0.02 * highest)
    assert (c.shapes[still, inside] ** 2).mean() < 1e-4 * np.median((c.shapes[:, inside] ** 2).mean(axis=1))
    assert 0.1 < usual["5:+Y"] < 10.0 and usual["5:+Y"] == max(usual.values())


def diagnosed(K, M, rng, wanted):
    """The diagnosis of the truss as built, by a test with noise of 1 %."""
    C = 1.1 * LOSS * truss(np.ones(len(RODS)))[0]
    freq = np.linspace(8, TOP, 120)
    s = 2j * np.pi * freq[:, None, None]
    H = np.linalg.inv(K + s * C + s**2 * M) * s**2
    H = H[:, [DOFS.index(name) for name in OUTPUTS]][:, :, [DOFS.index(name) for name in INPUTS]]
    sigma = 0.01 * np.sqrt((np.abs(H) ** 2).mean(axis=0)) * np.ones(H.shape)
    noise = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    seen = (H + sigma * noise / np.sqrt(2))[None]
    measurement = Measurement(
        freq=freq, H=seen, outputs=OUTPUTS, inputs=INPUTS, form="accelerance", variance=sigma[None] ** 2,
        level=np.full(1, np.nan),
    )  # fmt: skip
    return diagnose_modes(measurement, simulation(), wanted=wanted)


@FEW_OR_ALL
def test_one_is_named_where_every_rod_is_off(wanted):
    rng = np.random.default_rng(5)
    K, M = truss(1 + 0.02 * rng.standard_normal(len(RODS)))
    for dof in ("6:+X", "6:+Y"):
        M[DOFS.index(dof), DOFS.index(dof)] += 0.35
    found = diagnosed(K, M, rng, wanted)
    (cause,) = found.causes
    assert found.verdict == "named" and cause["name"] == "added_mass" and cause["where"][0] in ("6:+X", "6:+Y")
    assert abs(cause["parameters"]["mass"]["value"] - 0.35) < 4 * cause["parameters"]["mass"]["std"] < 0.1


@FEW_OR_ALL
def test_a_spring_is_named_where_nothing_joins_two_points(wanted):
    rng = np.random.default_rng(6)
    K, M = truss(1 + 0.02 * rng.standard_normal(len(RODS)))
    at = [DOFS.index("4:+X"), DOFS.index("7:+X")]
    K[np.ix_(at, at)] += 1.5e5 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    found = diagnosed(K, M, rng, wanted)
    (cause,) = found.causes
    assert found.verdict == "named" and cause["name"] == "joint_stiffness"
    assert sorted(cause["where"]) == ["4:+X", "7:+X"]
    stiffness = cause["parameters"]["stiffness"]
    assert abs(stiffness["value"] - 1.5e5) < 4 * stiffness["std"] < 0.3e5
