"""Two points of a roving hammer exchanged: hits written down at each other's points."""

import numpy as np

from modalax import Measurement
from modalax.diagnose import diagnose
from modalax.diagnose.causes import catalogue
from modalax.diagnose.causes.forces import ForceSwap
from modalax.diagnose.comparison import make_comparison
from modalax.diagnose.search.look import look
from modalax.files import load
from modalax.model.examples import five_dof

FREQ = np.linspace(20.0, 70.0, 128)
HITS = ("1", "2", "3", "4", "5")


def roving(exchanged=(1, 4), noise=0.02):
    """Accelerances of one sensor, hit at every mass, two hits written down at each other's."""
    columns = np.arange(5)
    columns[list(exchanged)] = columns[list(exchanged[::-1])]
    H = np.asarray(five_dof().frf(FREQ, inputs=HITS, outputs=("3",), form="accelerance").H)[None][..., columns]
    rng = np.random.default_rng(3)
    sigma = noise * np.sqrt((np.abs(H) ** 2).mean(axis=1, keepdims=True)) * np.ones(H.shape)
    H = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    return Measurement(FREQ, H, variance=sigma**2, form="accelerance", outputs=("3",), inputs=HITS)


def test_exchanged_hits_are_named_and_the_extension_exchanges_them(tmp_path):
    data = roving()
    few = [c for c in catalogue() if c.slug in ("channel_swap", "force_gain", "joint_stiffness", "added_mass")]
    found = diagnose(data, five_dof(), causes=few)
    assert found.verdict == "named"
    assert [(c["name"], c["where"]) for c in found.causes] == [("channel_swap", ["2", "5"])]
    assert found.gain.chi2_after < 1.2 < found.gain.chi2_before
    found.extended.save(tmp_path / "extended.npz")
    again = load(tmp_path / "extended.npz").predict(1.0, FREQ)
    sound = np.asarray(five_dof().frf(FREQ, inputs=HITS, outputs=("3",), form="receptance").H)
    assert np.allclose(np.asarray(again.H)[:, 0], sound[:, 0, [0, 4, 2, 3, 1]], rtol=1e-6)


def test_of_many_hits_those_that_come_nearest_are_looked_at(monkeypatch):
    for module in ("score_state", "shortlist"):
        monkeypatch.setattr(f"modalax.diagnose.screening.{module}.MANY", 4)
    monkeypatch.setattr("modalax.diagnose.screening.shortlist.KEPT", 1)
    comparison = make_comparison(roving(noise=1e-3), five_dof(), "fixed")
    state = look(comparison, ()).state
    places = ForceSwap().places(comparison.scene)
    assert len(places) == 10
    assert [p.where for p in state.nearest(ForceSwap(), places)] == [("2", "5")]
