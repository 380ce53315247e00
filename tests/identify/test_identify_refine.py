import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax.identify import cramer_rao, lscf, refine, residues
from modalax.model import ModalModel
from modalax.model.modal import poles_from

FREQ = np.arange(200, 701) * 0.1


def test_the_cramer_rao_bound_is_the_inverse_of_fishers_information():
    """Against the derivatives of pole-residue sums, two close modes at three outputs, uneven noise."""
    model = ModalModel.from_real_modes(
        [30.0, 31.0], [0.01, 0.02], np.array([[1.0, 0.5, -0.7], [0.3, 1.0, 0.8]]), [2.0, 1.0], ["1", "2", "3"]
    )
    freq = np.linspace(25.0, 36.0, 80)
    clean = model.frf(freq, inputs=["1"])
    variance = np.random.default_rng(0).uniform(0.5, 2.0, clean.H.shape) * np.abs(clean.H).max() ** 2 * 1e-4
    bound = cramer_rao(model, clean.replace(variance=variance), residuals="none")
    s = 2j * np.pi * freq[:, None, None]
    f, zeta = np.asarray(model.frequency_hz), np.asarray(model.damping_ratio)
    R = (np.asarray(model.shapes) * np.asarray(model.participation)[:, :1]).T
    root = np.sqrt(1 - zeta**2)
    pole = 2 * np.pi * f * (-zeta + 1j * root)

    def slope(of_residue, of_pole):
        """Of an FRF ``(line, output, mode)`` by what changes residue and pole so; both conjugate terms count."""
        upper = of_residue / (s - pole) + R * of_pole / (s - pole) ** 2
        return upper + np.conj(of_residue) / (s - pole.conj()) + (R * of_pole).conj() / (s - pole.conj()) ** 2

    each = np.eye(3)[:, None, :]  # a residue changes the FRF of its own output
    residue = [(slope(part, 0.0)[..., None] * each).reshape(80, 3, 6) for part in (1.0, 1j)]
    by_pole = [slope(0.0, pole / f), slope(0.0, -2 * np.pi * f * (1 + 1j * zeta / root))]
    J = np.concatenate([*by_pole, *residue], axis=2) * np.sqrt(2 / variance)
    J = np.concatenate([J.real, J.imag]).reshape(-1, 16)
    std = np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    np.testing.assert_allclose(bound.frequency_std_hz, std[:2], rtol=1e-5)
    np.testing.assert_allclose(bound.damping_std, std[2:4], rtol=1e-5)
    with pytest.raises(ValueError, match="needs a noise variance"):
        cramer_rao(model, clean)


def start_of(frf, model, **options):
    """Residues at poles that are off by up to half a bandwidth, and dampings by up to 90 %."""
    shift = jnp.array([3e-3, -2e-3, 4e-3, -3e-3, 1e-3])
    poles = model.poles * (1 + shift) + model.poles.real * jnp.array([0.5, -0.4, -0.5, 0.2, 0.3])
    return residues(frf, poles, **options)


@jax.jit
def refined(noisy, start):
    """Refinements of noisy copies, compiled once for all levels."""
    return jax.vmap(lambda frf: refine(frf, start))(noisy)


def draws(seed, level, frf, start, count=200):
    keys = jax.random.split(jax.random.key(seed), count)
    return refined(jax.vmap(lambda key: frf.add_noise(key, level))(keys), start)


class TestResidues:
    @pytest.mark.parametrize(
        ("form", "residuals"),
        [
            # each form and each kind of residual terms by default, as neither asks for the other
            pytest.param(form, residuals, marks=() if k == j else pytest.mark.slow)
            for k, form in enumerate(("receptance", "mobility", "accelerance"))
            for j, residuals in enumerate(("none", "real", "complex"))
        ],
    )
    def test_exact_poles_give_exact_modal_mass(self, form, residuals, paper):
        frf = paper.frf(FREQ, inputs=["1"], form=form)
        model = residues(frf, paper.poles, residuals=residuals)
        assert np.allclose(model.modal_mass("1"), paper.modal_mass("1"), rtol=1e-10)
        assert np.allclose(model.frf(FREQ, form=form).H, frf.H, atol=1e-11 * float(jnp.abs(frf.H).max()))

    @pytest.mark.parametrize("form", ["receptance", "mobility", "accelerance"])
    def test_residual_terms_suit_the_form(self, form, paper):
        """A stiffness line above and a mass line below are found exactly in every form."""
        upper = np.linspace(1, 5, 5)[:, None] * 1e-6
        lower = np.linspace(-1, 2, 5)[:, None] * 0.1
        truth = ModalModel(
            paper.poles,
            paper.shapes,
            paper.participation[:, :1],
            outputs=paper.outputs,
            inputs=["1"],
            upper=upper,
            lower=lower,
        )
        model = residues(truth.frf(FREQ, form=form), paper.poles)
        assert np.allclose(model.upper, upper, rtol=1e-8, atol=1e-14)
        assert np.allclose(model.lower, lower, rtol=1e-8, atol=1e-9)

    def test_real_normal_modes(self, paper):
        frf = paper.frf(FREQ, inputs=["1"]).add_noise(jax.random.key(0), 0.01)
        model = residues(frf, paper.poles, real_modes=True)
        assert float(jnp.abs(model.shapes.imag).max()) < 1e-12
        assert np.allclose(model.modal_mass("1").imag, 0, atol=1e-12)

    def test_line_at_zero_frequency_does_not_break_the_lower_term(self, paper):
        freq = np.arange(0, 701) * 0.1
        model = residues(paper.frf(freq, inputs=["1"]), paper.poles)
        assert np.allclose(model.modal_mass("1"), paper.modal_mass("1"), rtol=1e-9)

    def test_refusals(self, paper_frf, paper):
        with pytest.raises(ValueError, match="5 modes have 14 unknowns an output, but 3 lines x 1 inputs give 6"):
            residues(paper_frf.lines(slice(0, 3)), paper.poles)
        with pytest.raises(ValueError, match="residuals is 'both'"):
            residues(paper_frf, paper.poles, residuals="both")
        with pytest.raises(ValueError, match="weights 'variance' needs"):
            residues(paper_frf, paper.poles, weights="variance")


class TestRefine:
    @pytest.mark.parametrize(("inputs", "form"), [
        pytest.param(["1"], "receptance", marks=pytest.mark.slow), (["1", "3"], "accelerance"),
    ])  # fmt: skip
    def test_accurate_without_noise(self, inputs, form, paper, errors):
        """Asked: 1e-10; measured 1e-15 in frequency and 5e-15 in damping: rounding of the poles themselves."""
        frf = paper.frf(FREQ, inputs=inputs, form=form)
        result = refine(frf, start_of(frf, paper))
        assert bool(result.success), result.reason
        frequency, damping = errors(result.model.poles, paper)
        assert frequency < 1e-13
        assert damping < 1e-12

    @pytest.mark.slow
    def test_honest_at_ten_percent(self, paper_frf, paper):
        """Standardised errors over 200 draws in one vmap: mean 0, spread 1, 95 % intervals that hold the truth."""
        found = draws(5, 0.10, paper_frf, start_of(paper_frf, paper))
        assert bool(found.success.all())
        size = jnp.abs(found.model.poles)
        zeta = (-found.model.poles.real / size - 0.02) / found.damping_std
        frequency = (size / (2 * jnp.pi) - paper.frequency_hz) / found.frequency_std_hz
        for z in (np.asarray(zeta), np.asarray(frequency)):
            assert np.all(abs(z.mean(axis=0)) < 4 / np.sqrt(200))
            assert np.all(abs(z.std(axis=0) - 1) < 4 / np.sqrt(400))
            covered = np.mean(abs(z) < 1.96)
            assert 0.93 < covered < 0.97  # 1,000 values: 0.95 +- 0.007

    def test_converges_from_unstable_start_at_25_percent(self, paper_frf, paper):
        """LSCF gives mode 3 a negative damping there; the search must come back from it."""
        frf = paper_frf.add_noise(jax.random.key(3), 0.25)
        poles = paper.poles.at[2].set(-paper.poles[2].real * 0.5 + 1.004j * paper.poles[2].imag)
        start = residues(frf, paper.poles).replace(poles=poles)
        result = refine(frf, start)
        assert bool(result.success), result.reason
        assert np.all(abs(result.model.damping_ratio - 0.02) < 4 * result.damping_std)

    def test_error_bars_of_shapes_and_modal_mass(self, paper_frf, paper):
        """Delta-method deviations against the spread over draws."""
        exact, start = paper.normalised("max"), start_of(paper_frf, paper)
        rng, noisy = np.random.default_rng(1), paper_frf.add_noise(jax.random.key(1), 0.02)
        sigma = np.sqrt(np.asarray(noisy.variance) / 2)
        noise = sigma * (rng.normal(size=(100, *sigma.shape)) + 1j * rng.normal(size=(100, *sigma.shape)))
        # one by one, as compiled already
        each = [refine(noisy.replace(H=one), start) for one in np.asarray(paper_frf.H) + noise]
        found = jax.tree.map(lambda *one: np.stack(one), *each)
        shapes, std, mass_std = found.model.shapes, found.shape_std, found.modal_mass_std
        mass = jax.vmap(lambda m: m.modal_mass().real)(found.model)
        # Measured over 1,000 draws (experiments/identify): 0.96 to 1.01, mode 3, hardly seen at the drive point, too.
        # Mode 2 is left out: its two largest components differ by 1e-4, so which of them is the one that the shape is
        # scaled to changes from draw to draw.
        well = np.array([0, 2, 3, 4])
        z = np.asarray((shapes - exact.shapes).real / jnp.where(std.real > 0, std.real, 1))[:, well]
        some = np.asarray(std.real.min(axis=0))[well] > 0
        assert np.all(abs(z.std(axis=0)[some] - 1) < 0.25)
        z = np.asarray((mass - exact.modal_mass().real) / mass_std)[:, well]
        assert np.all(abs(z.std(axis=0) - 1) < 0.25)

    def test_roving_input_gives_the_same(self, paper):
        """Outputs and inputs exchanged: the same modes, the same errors."""
        frf = paper.frf(FREQ, inputs=["1", "3"], form="accelerance").add_noise(jax.random.key(0), 0.02)
        frf = frf.replace(variance=None)  # compiled already for exact data
        one = refine(frf, start_of(frf, paper))
        turned = frf.transpose()
        two = refine(turned, start_of(turned, paper))
        assert np.allclose(one.model.poles, two.model.poles, rtol=1e-9)
        assert np.allclose(one.damping_std, two.damping_std, rtol=1e-6)
        assert np.allclose(one.model.residues, jnp.swapaxes(two.model.residues, 1, 2), rtol=1e-7, atol=1e-12)
        assert np.isfinite(two.shape_std).all()

    def test_empty_slots_change_nothing(self, paper_frf, paper):
        frf = paper_frf.add_noise(jax.random.key(0), 0.05)
        one, two = (refine(frf, start_of(frf, paper), slots=s) for s in (None, 8))
        assert np.allclose(one.model.poles, two.model.poles, rtol=1e-10)
        assert np.allclose(one.damping_std, two.damping_std, rtol=1e-7)
        assert np.allclose(one.chi2, two.chi2, rtol=1e-9)
        assert float(one.dof) == float(two.dof)

    def test_weights_shared_by_outputs_and_not_give_the_same(self, paper):
        frf = paper.frf(FREQ, inputs=["1"]).add_noise(jax.random.key(0), 0.05)
        shared = refine(frf, start_of(frf, paper))
        nearly = frf.variance * (1 + 1e-7 * np.random.default_rng(0).uniform(size=frf.variance.shape))
        general = refine(frf.replace(variance=nearly), start_of(frf, paper))
        assert np.allclose(shared.model.poles, general.model.poles, rtol=1e-7)
        assert np.allclose(shared.damping_std, general.damping_std, rtol=1e-5)

    def test_scale_of_unknown_noise(self, paper_frf, paper):
        frf = paper_frf.add_noise(jax.random.key(0), 0.05)
        sigma = jnp.sqrt(frf.variance.mean())
        plain = frf.replace(variance=jnp.broadcast_to(sigma**2, frf.H.shape))
        noise = jax.random.normal(jax.random.key(1), (2, *frf.H.shape)) * sigma / jnp.sqrt(2)
        plain = plain.replace(H=paper_frf.H + noise[0] + 1j * noise[1])
        known = refine(plain, start_of(frf, paper))
        unknown = refine(plain.replace(variance=None), start_of(frf, paper))
        assert abs(float(unknown.noise_scale / sigma) - 1) < 0.05
        assert np.allclose(unknown.damping_std, known.damping_std, rtol=0.05)

    def test_whiteness_and_kinds_of_covariance(self, paper_frf, paper):
        frf = paper_frf.add_noise(jax.random.key(0), 0.05)
        good = refine(frf, start_of(frf, paper))
        assert float(good.whiteness) > 1e-3
        assert abs(float(good.noise_scale) - 1) < 0.05
        sandwich = refine(frf, start_of(frf, paper), covariance="sandwich")
        assert np.allclose(sandwich.damping_std, good.damping_std, rtol=0.3)
        robust = refine(frf, start_of(frf, paper), covariance="robust")
        ratio = np.asarray(robust.damping_std / good.damping_std)  # the plain ones, as the noise is white
        assert np.all(ratio > 1 - 1e-9)
        assert np.all(ratio < 1.3)
        missing = refine(frf, residues(frf, paper.poles[1:]), slots=5)  # no compilation of its own
        assert float(missing.whiteness) < 1e-12
        assert float(missing.noise_scale) > 2

    def test_same_maximum_from_lscf_as_from_the_truth_in_loud_noise(self, paper_frf, paper):
        """25 % noise: LSCF gives the third mode a damping that is low by four fifths and more, or none."""
        for seed in range(6):
            frf = paper_frf.add_noise(jax.random.key(100 + seed), 0.25)
            table = lscf(frf, 32)
            ok = np.asarray(table.valid[0] & (table.poles[0].imag > 0))
            poles = np.asarray(table.poles[0])[ok]
            near = np.abs(poles - np.asarray(paper.poles)[:, None]).argmin(axis=1)
            assert len(set(near)) == 5
            found = refine(frf, residues(frf, poles[near]))
            best = refine(frf, residues(frf, paper.poles))
            assert found.success, found.reason
            assert np.allclose(found.chi2, best.chi2, rtol=1e-9)
            assert np.allclose(found.model.poles, best.model.poles, rtol=1e-5)

    def test_one_program_does_with_any_steps_covariance_and_statistics(self, paper_frf, paper, monkeypatch):
        frf = paper_frf.add_noise(jax.random.key(0), 0.05)
        start = start_of(frf, paper)
        refine(frf, start)
        monkeypatch.delattr(sys.modules["modalax.identify.refine"], "objective")  # a second program could not be traced
        short = refine(frf, start, max_steps=2)
        assert not bool(short.success)
        assert "ran out of steps" in short.reason
        grown = refine(frf, start, covariance="sandwich", scale_errors="always")
        assert bool(grown.success) and not np.array_equal(grown.damping_std, refine(frf, start).damping_std)
        assert bool(refine(frf.replace(variance=None, averages=3), start).success)

    @pytest.mark.parametrize(
        ("mode", "start", "weights", "reason"),
        [
            ((10.0, 0.01), (10.05, 0.02), "auto", "a maximum here"),
            ((10.0, 0.01), (12.0, 0.005), "auto", "left the neighbourhood of its start"),
            ((16.0, 0.01), (14.0, 0.02), "auto", "left the neighbourhood of its start"),  # beyond the band
            ((10.013, 1e-9), (10.02, 0.002), "auto", "lost its damping"),
            ((10.0, 0.01), (10.05, 0.02), jnp.full((201, 1, 1), 1e-300), "likelihood of the start is not finite"),
        ],
        ids=["none", "moved", "moved out of the band", "no damping", "weights beyond numbers"],
    )
    def test_every_reason_of_a_failure(self, mode, start, weights, reason):
        """One mode from 5 to 15 Hz, 1 % noise. Out of steps stands above, contradicting rows in a file of their own."""
        one = ModalModel.from_real_modes([mode[0]], [mode[1]], [[1.0]], [2.0], ["p"])
        frf = one.frf(np.linspace(5, 15, 201)).add_noise(jax.random.key(0), 0.01)
        poles = poles_from([start[0]], [start[1]])
        result = refine(frf, residues(frf, poles, residuals="none"), residuals="none", weights=weights)
        assert reason in result.reason
        assert bool(result.success) == (reason == "a maximum here")

    def test_refusals(self, paper_frf, paper):
        start = residues(paper_frf, paper.poles)
        with pytest.raises(ValueError, match="covariance is 'x'"):
            refine(paper_frf, start, covariance="x")
        with pytest.raises(ValueError, match="scale_errors is 'x'"):
            refine(paper_frf, start, scale_errors="x")
