"""Hysteretic damping whose rates of decay are those of an impact window: lines tell them apart, modes do not."""

from dataclasses import replace

import chains_off
import numpy as np
import pytest
from kinds import few_or_all

from modalax.diagnose.modal_domain.causes.further_causes import FACTOR, ZETA, StructuralDamping
from modalax.diagnose.modal_domain.causes.impact_window import impact_windows
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes
from modalax.diagnose.modal_domain.fitting.fit import fit
from modalax.diagnose.modal_domain.search.starts import as_alike
from modalax.diagnose.modal_domain.stage import identified, posed
from modalax.diagnose.modal_domain.structure.coordinates import coordinates_of

DECAY = 5.0  # 1/s


@few_or_all("structural_damping", "exponential_window", "hysteretic_joint", "maxwell_joint")
@pytest.mark.parametrize("hysteretic", [True, False])
def test_hysteretic_damping_that_decays_as_a_window_does_is_told_from_one(hysteretic, wanted):
    """All modes of a simulation that is hardly damped decay alike, by a complex stiffness or by a window."""
    M, C, K = chains_off.chain_off(5, 0.02)
    model = chains_off.simulation()
    freq = chains_off.FREQ
    s = 2j * np.pi * freq[:, None, None]
    if hysteretic:
        w, P = np.linalg.eigh(np.linalg.solve(np.diag(np.sqrt(np.diag(M))), K) / np.sqrt(np.diag(M)))
        shapes = P / np.sqrt(np.diag(M))[:, None]
        loss = M @ shapes @ np.diag(2j * DECAY * np.sqrt(w)) @ shapes.T @ M
        H = s**2 * np.linalg.inv(s**2 * M + K + loss)
    else:
        s = s + DECAY
        H = s**2 * np.linalg.inv(s**2 * M + 0.1 * s * C + K)
    data = chains_off.as_measured(H, freq, 5)
    answer = diagnose_modes(data, model.replace(C=0.1 * np.asarray(model.C)), wanted=wanted).to_dict()
    name = "structural_damping" if hysteretic else "exponential_window"
    assert (answer["verdict"], [c["name"] for c in answer["causes"]]) == ("named", [name])


def test_hysteretic_damping_takes_the_place_of_a_window_beside_another_cause():
    """The window had been fitted first, and hysteretic damping beside a mass never."""
    chain, model = chains_off.chain_off(5, 0.02), chains_off.simulation()
    c = coordinates_of(model, model.dofs, model.dofs[:1], 2 * np.pi * chains_off.FREQ[-1])
    window = impact_windows(c, np.arange(5), 2)[0]
    damping = StructuralDamping("structural_damping", ())
    data = chains_off.as_measured(chains_off.response(*chain, chains_off.FREQ), chains_off.FREQ, 5)
    task = posed(data, model, identified(data, model, lambda _: None))
    mass = next(k for k in task.candidates if k.slug == "added_mass")
    for one, other in ((window, damping), (damping, window)):
        f = fit(task.setting, (mass, one), None, np.array([0.1, 0.5]))
        told = list(as_alike([f], [mass, window, damping]))
        assert [(causes, u.tolist()) for causes, u, _ in told] == [((mass, other), [f.u[0], 1.0])]
    assert not list(as_alike([fit(task.setting, (mass,), None, np.array([0.1]))], [mass, window, damping]))


@few_or_all("tuned_mass", "exponential_window", "structural_damping")
def test_an_oscillator_that_a_damper_holds_to_its_place_is_a_mass_there(wanted):
    """Beside a window it had been named so, with sixty times the critical damping."""
    M, C, K = chains_off.chain_off(5, 0.02)
    M = M + np.diag([0.0, 0.0, 0.3, 0.0, 0.0])
    s = 2j * np.pi * chains_off.FREQ[:, None, None] + DECAY
    data = chains_off.as_measured(s**2 * np.linalg.inv(s**2 * M + s * C + K), chains_off.FREQ, 5)
    model = chains_off.simulation()
    task = posed(data, model, identified(data, model, lambda _: None))
    tuned = next(k for k in task.candidates if k.slug == "tuned_mass" and k.where == ("3:+Z",))
    mass = next(k for k in task.candidates if k.slug == "added_mass" and k.where == ("3:+Z",))
    window = next(k for k in task.candidates if k.slug == "exponential_window")
    held = np.array([np.sqrt(0.3 / tuned.scale), 0.0, np.log(60 / ZETA) / FACTOR])
    f = replace(fit(task.setting, (mass, window), None, np.ones(2)), causes=(tuned, window), u=np.append(held, 1.0))
    assert tuned.possible(np.append(held[:2], 0.0)) and not tuned.possible(held)
    (causes, u, _), *others = as_alike([f], task.candidates)
    assert causes == (mass, window) and u == pytest.approx([0.3 / mass.scale, 1.0])
    assert [causes for causes, _, _ in others] == [(tuned, StructuralDamping("structural_damping", ()))]
    answer = diagnose_modes(data, model, wanted=wanted).to_dict()
    assert {c["name"] for c in answer["causes"]} == {"added_mass", "exponential_window"}
