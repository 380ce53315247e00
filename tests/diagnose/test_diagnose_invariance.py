"""The answer does not depend on how the data is written down: order of channels and runs, names, units of length."""

import numpy as np
import pytest

from modalax.data import FRF, Measurement
from modalax.diagnose import catalogue, diagnose
from modalax.identify import fit
from modalax.model import Structure
from modalax.show import save_fit_pictures
from modalax.show.report import diagnosis_report, fit_report

FREQ = np.linspace(10.0, 60.0, 101)
M = np.diag([1.0, 1.3, 0.9])
K = 4e4 * np.array([[2, -1, 0], [-1, 2, -1], [0, -1, 1.5]])
NAMES = ("a", "b", "c")


def structure(added: float = 0.0, scale: float = 1.0, order=(0, 1, 2), names=NAMES) -> Structure:
    """Three masses, 1 % damped; ``scale`` is the unit of length in m, ``order`` how the DoFs are listed."""
    pick = np.ix_(order, order)
    mass, names = M + np.diag([0, added, 0]), [names[k] for k in order]
    return Structure(scale * mass[pick], scale * (2e-4 * K + 0.5 * M)[pick], scale * K[pick], names)


def measurement() -> Measurement:
    """Two runs with noise of 1 %, of a structure that has 50 g more at b than its simulation."""
    H = np.asarray(structure(0.05).frf(FREQ, inputs=["a", "c"]).H)
    sigma = 0.01 * np.abs(H).mean(axis=0)
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(2, *H.shape)) + 1j * rng.normal(size=(2, *H.shape))
    variance = np.broadcast_to(sigma**2, noise.shape)
    return Measurement(
        FREQ, H + sigma * noise / np.sqrt(2), variance=variance, level=[1.0, 2.0], outputs=NAMES, inputs=["a", "c"]
    )


def rewritten(how: str) -> tuple[Measurement, Structure, float]:
    """The measurement and simulation written in another way, and what a kilogram is there."""
    m, s = measurement(), structure()
    H, variance = np.asarray(m.H), np.asarray(m.variance)
    if how == "outputs":
        turn = [2, 0, 1]
        return m.replace(H=H[:, :, turn], variance=variance[:, :, turn], outputs=["c", "a", "b"]), s, 1.0
    if how == "inputs":
        return m.replace(H=H[..., ::-1], variance=variance[..., ::-1], inputs=["c", "a"]), s, 1.0
    if how == "runs":
        return m.replace(H=H[::-1], variance=variance[::-1], level=[2.0, 1.0]), s, 1.0
    if how == "DoFs of the simulation":
        return m, structure(order=(1, 2, 0)), 1.0
    if how == "names":
        names = ("wing:7:-Z", "$x^2", "12:+Y")
        renamed = m.replace(outputs=list(names), inputs=[names[0], names[2]])
        return renamed, structure(names=names), 1.0
    return m.replace(H=1e3 * H, variance=1e6 * variance), structure(scale=1e-3), 1e-3


WAYS = ("outputs", "inputs", "runs", "DoFs of the simulation", "names", "millimetres")


@pytest.fixture(scope="module")
def causes():
    return [c for c in catalogue(2) if c.slug in ("added_mass", "joint_stiffness")]


@pytest.fixture(scope="module")
def plain(causes):
    return diagnose(measurement(), structure(), causes=causes).to_dict()


@pytest.mark.parametrize("how", WAYS)
def test_the_diagnosis_is_the_same_however_the_data_is_written(causes, plain, how):
    data, simulation, unit = rewritten(how)
    diagnosis = diagnose(data, simulation, causes=causes)
    answer = diagnosis.to_dict()
    if how == "names":  # signs that mean something to what draws are letters of a name
        assert "$x^2" in diagnosis_report(diagnosis, title="$x^2")
    assert plain["verdict"] == answer["verdict"] == "named"
    [expected], [found] = plain["causes"], answer["causes"]
    where = ["$x^2"] if how == "names" else ["b"]
    assert found["name"] == expected["name"] == "added_mass" and found["where"] == where
    mass, true = found["parameters"]["mass"], expected["parameters"]["mass"]
    # Summing in another order changes the last digits only.
    assert mass["value"] == pytest.approx(unit * true["value"], rel=1e-6)
    assert mass["std"] == pytest.approx(unit * true["std"], rel=1e-5)
    assert answer["gain"]["chi2_after"] == pytest.approx(plain["gain"]["chi2_after"], rel=1e-5)


@pytest.fixture(scope="module")
def modes():
    return fit(measurement().run(0), refine=False, order=12)


@pytest.mark.parametrize("how", [w for w in WAYS if w not in ("runs", "DoFs of the simulation")])
def test_the_modes_are_the_same_however_the_data_is_written(modes, how, tmp_path):
    data, _, unit = rewritten(how)
    found = fit(data.run(0), refine=False, order=12)
    np.testing.assert_allclose(found.model.frequency_hz, modes.model.frequency_hz, rtol=1e-8)
    np.testing.assert_allclose(found.model.damping_ratio, modes.model.damping_ratio, rtol=1e-5)
    turn = [2, 0, 1] if how == "outputs" else [0, 1, 2]
    shapes = np.asarray(modes.model.normalised().shapes)[:, turn]
    np.testing.assert_allclose(found.model.normalised().shapes, shapes, atol=1e-6)
    assert float(found.unexplained) == pytest.approx(float(modes.unexplained), rel=1e-6)
    if how == "names":
        assert "$x^2" in fit_report(found, title="$x^2") and save_fit_pictures(found, tmp_path)


def test_lines_in_another_order_are_refused_and_sorted_are_the_same(modes):
    frf = measurement().run(0)
    order = np.random.default_rng(1).permutation(len(FREQ))
    mixed = {"freq": FREQ[order], "H": np.asarray(frf.H)[order], "variance": np.asarray(frf.variance)[order]}
    with pytest.raises(ValueError, match="freq must increase: line .* sort the lines first"):
        FRF(**mixed)
    back = np.argsort(mixed["freq"])
    found = fit(FRF(**{name: value[back] for name, value in mixed.items()}), refine=False, order=12)
    np.testing.assert_array_equal(found.model.frequency_hz, modes.model.frequency_hz)
