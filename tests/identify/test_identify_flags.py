"""What a fit says of its modes and of the measurement, each from a simulation of its kind."""

import numpy as np
import pytest

from modalax.data import FRF
from modalax.identify import fit
from modalax.identify.disagreement import Spread
from modalax.identify.flags import Modes, flags_of, notes_of
from modalax.identify.quality import ModeQuality
from modalax.identify.record_kind import Record
from modalax.identify.record_window import record_kernel
from modalax.model import ModalModel
from modalax.model.modal import poles_from

FREQ = np.linspace(0.5, 100, 200)


def structure(seed=0, frequency=(20.0, 52.0, 90.0), zeta=0.02, points=6):
    n = len(frequency)
    shapes = np.random.default_rng(seed).normal(size=(n, points))
    return ModalModel.from_real_modes(frequency, [zeta] * n, shapes, np.ones(n), [str(k + 1) for k in range(points)])


def noisy(model, level, inputs=("1",), seed=0, freq=FREQ, form="accelerance"):
    rng = np.random.default_rng(seed)
    H = np.array(model.frf(freq, inputs=list(inputs), form=form).H)
    size = level * np.sqrt(np.mean(np.abs(H) ** 2) / 2)
    H += size * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    return FRF(freq, H, form=form, outputs=model.outputs, inputs=inputs)


def test_unexplained_is_parted_into_noise_and_misfit():
    """Noise as large as the response: it is half of all there is, whatever weak modes are lost in it."""
    found = fit(noisy(structure(), 1.0), refine=False)
    answer = found.to_dict()
    assert 0.4 < answer["unexplained"] < 0.75
    assert answer["unexplained_noise"] == pytest.approx(0.5, abs=0.06)
    assert answer["unexplained_noise"] + answer["unexplained_misfit"] == pytest.approx(answer["unexplained"])
    assert any("is noise" in note for note in answer["notes"])


def test_misfit_is_not_called_noise():
    """A smooth hump that no mode of the fit makes, delayed as what follows a force is."""
    clean = noisy(structure(), 1e-3)
    hump = 2.0 * np.abs(np.asarray(clean.H)).max() * np.exp(-(((FREQ - 70) / 6) ** 2)) * np.exp(-0.3j * FREQ)
    found = fit(clean.replace(H=clean.H + hump[:, None, None]), refine=False, order=12)
    assert float(found.noise) < 0.3 * float(found.unexplained)


def test_a_line_at_0_hz_does_not_spoil_the_fit():
    model = structure().replace(lower=np.full((6, 6), 0.1))
    freq = np.arange(0, 200) * 0.5
    H = np.array(model.frf(freq, form="mobility", inputs=["1"]).H)
    H[0] = 1e3 * np.abs(H).max()
    found = fit(FRF(freq, H, form="mobility"), refine=False)
    assert float(found.unexplained) < 1e-6
    assert "0 Hz" in found.notes[0]


def test_noise_alone_has_no_mode():
    rng = np.random.default_rng(3)
    H = rng.normal(size=(200, 3, 1)) + 1j * rng.normal(size=(200, 3, 1))
    with pytest.raises(ValueError, match=r"no mode (stands out of the noise|lasts)"):
        fit(FRF(FREQ, H), refine=False)


def test_modes_carry_flags_and_grades():
    """Modes at the end of the band, seen by one sensor only, and complex."""
    model = structure(frequency=(20.0, 52.0, 99.7))
    shapes = np.array(model.shapes)
    shapes[0, 1:] *= 1e-3
    shapes[1] = np.exp(2j * np.pi * np.arange(6) / 6)
    found = fit(noisy(model.replace(shapes=shapes), 1e-3), refine=False)
    modes = found.to_dict()["modes"]
    for f, word in ((20.0, "one sensor only"), (52.0, "complex (MPC 0.0"), (99.7, "edge of the band")):
        mode = min(modes, key=lambda m: abs(m["frequency_hz"] - f))
        assert abs(mode["frequency_hz"] - f) < 0.5
        assert any(word in flag for flag in mode["flags"]), mode
        assert sum("sensor only" in flag or "complex" in flag or "edge" in flag for flag in mode["flags"]) == 1
    assert modes[-1]["grade"] > 0.95
    assert np.argmin([m["grade"] for m in modes]) == 0  # the one that is nearly lost


def test_a_quiet_sensor_is_not_the_only_one_that_shows_a_mode():
    """Its noise is a hundredth of that of the others, which show the modes a thousand times over theirs."""
    model = structure()
    noise = 1e-4 * np.abs(np.asarray(noisy(model, 0.0).H)).max() * np.array([0.01, 1, 1, 1, 1, 1])[:, None]
    rng = np.random.default_rng(1)
    H = np.asarray(noisy(model, 0.0).H)
    H = H + noise * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
    frf = FRF(FREQ, H, form="accelerance", variance=np.broadcast_to(noise**2, H.shape))
    assert not any("one sensor" in flag for flags in fit(frf, order=12).flags for flag in flags)


def test_two_inputs_tell_two_modes_of_one_frequency():
    """As a disk of equal blades has them: each mode is sure and its frequency known, though which shapes is not."""
    model = structure(frequency=(20.0, 52.0, 52.0, 90.0), zeta=0.02)
    found = fit(noisy(model, 1e-3, ("1", "2")))
    f = np.asarray(found.model.frequency_hz)
    twins = np.flatnonzero(np.abs(f - 52) < 1)
    assert len(twins) == 2
    assert found.refined is not None
    std = np.asarray(found.refined.frequency_std_hz)[twins]
    assert np.all(np.abs(f[twins] - 52) < 4 * std)  # they scatter by the noise alone, 0.003 Hz here
    assert np.all(std < 0.02)
    assert not any("below the noise" in flag for r in twins for flag in found.flags[r])
    assert np.asarray(found.grade)[twins].min() > 0.5


def test_lines_of_a_stepped_sine_count_where_they_are():
    """Lines 0.05 Hz apart about the resonances and 0.5 Hz elsewhere: no peak of 0.16 Hz falls between them."""
    freq = np.unique(
        np.concatenate([np.arange(10.0, 110, 0.5), *(f + np.arange(-20, 21) * 0.05 for f in (20, 52, 90))])
    )
    frf = noisy(structure(), 1e-3, freq=np.round(freq, 6))
    none, still = np.zeros(3), Spread(np.zeros(1), np.zeros(1), (0.0, 0.0), (0.0, 0.0), 1.0)
    quality = [ModeQuality(99.0, 9.0, 1.0, 9.0, 6.0, still, None, None)] * 3
    narrow = structure(zeta=0.004)
    assert flags_of(Modes(frf, narrow, none, none, True, none, np.ones(3), quality, None)) == ((), (), ())


def test_columns_that_disagree_are_named_with_the_size():
    """The third hit finds all frequencies 0.5 % lower."""
    model = structure()
    lower = model.replace(poles=0.995 * model.poles)
    parts = [noisy(m, 1e-3, (name,)) for m, name in ((model, "1"), (model, "2"), (lower, "3"))]
    frf = FRF(FREQ, np.concatenate([p.H for p in parts], 2), form="accelerance", inputs=["1", "2", "3"])
    found = fit(frf, refine=False)
    assert int(np.sum(np.asarray(found.inside))) == 3
    (note,) = [n for n in found.notes if "inputs disagree" in n]
    assert "3 has them" in note
    assert any("lowest 3" in flag for flags in found.flags for flag in flags)


def test_a_mode_beyond_the_band_does_not_count_among_those_that_disagree():
    """Its frequency is a guess: the note tells of the modes that the table shows."""
    model = structure(frequency=(52.0, 90.0, 150.0))
    frf = noisy(model, 1e-3, ("1", "2"), freq=np.linspace(10.0, 120.0, 221))
    spread = [Spread(np.array([d, -d]), np.array([0.01, 0.01]), (d, 0.0), (d, 0.0), 1e-9) for d in (0.3, 0.4, 20.0)]
    quality = [ModeQuality(99.0, 9.0, 1.0, 9.0, 6.0, one, one, None) for one in spread]
    none = np.zeros(3)
    modes = Modes(frf, model, none, none, True, none, none, quality, None)
    (note,) = [n for n in notes_of(modes, np.ones(3), 0.0, 0.0) if "disagree" in n]
    assert "2 modes, most by 0.58 % at 52 Hz" in note


@pytest.mark.parametrize(("kind", "told"), [(None, False), ("hann", True)])
def test_modes_within_the_window_of_a_record_are_unresolved(kind, told):
    """Two lines apart, each peak of a Hann-tapered record one and a half lines wide."""
    model = structure(frequency=(52.0, 53.0, 90.0))
    frf = noisy(model, 1e-3, freq=np.linspace(10.0, 120.0, 221))
    none, still = np.zeros(3), Spread(np.zeros(1), np.zeros(1), (0.0, 0.0), (0.0, 0.0), 1.0)
    record = None if kind is None else Record(kind, 2.0, np.array([52.0, 53.0, 90.0]), np.full(3, 0.01))
    quality = [ModeQuality(99.0, 9.0, 1.0, 9.0, 6.0, still, None, None)] * 3
    flags = flags_of(Modes(frf, model, none, none, True, none, np.ones(3), quality, record))
    assert [any("window of the record" in word for word in words) for words in flags] == [told, told, False]


def test_an_exponential_window_is_seen_in_equal_decays():
    model = structure(frequency=(20.0, 52.0, 90.0), zeta=1e-4)
    poles = np.array(model.poles) - 5.0
    found = fit(noisy(model.replace(poles=poles), 1e-3), refine=False)
    assert any("exponential window" in note for note in found.notes)


def test_scatter_over_the_orders_tells_of_bad_damping():
    """Without a refinement, noise makes damping scatter: the scatter is of the size of the errors."""
    model = structure()
    quiet, loud = (fit(noisy(model, level), refine=False) for level in (1e-3, 0.3))
    tight, wide = (np.nanmax(np.asarray(f.damping_scatter / f.model.damping_ratio)) for f in (quiet, loud))
    assert tight < 0.02 < wide


@pytest.mark.slow
def test_orders_rise_until_they_show_no_further_mode():
    """Twenty-one modes of unlike strength at one sensor: a diagram of forty poles shows less than half of them."""
    frequency = np.sort(np.append(20 + np.cumsum(np.random.default_rng(5).uniform(5, 9, 20)), 52.0))
    model = structure(frequency=tuple(frequency), zeta=0.002, points=1)
    participation = np.array(model.participation)
    participation[::3] *= 30
    frf = noisy(model.replace(participation=participation), 3e-3, freq=np.arange(1, 1001) * 0.2)

    def found(**options):
        f = np.asarray(fit(frf, refine=False, **options).model.frequency_hz)
        return sum(np.abs(f - true).min() < 0.1 for true in frequency), len(f)

    few, some = found(order=40)
    assert few == some <= 10
    more, all_of_them = found()
    assert more >= few + 4
    assert all_of_them == more


def test_half_of_a_mode_is_graded_as_such():
    """A second pole put in beside one mode of blocks cut short: the data tell neither half from the other."""
    rng = np.random.default_rng(2)
    freq, shapes = np.arange(40.0, 121.0), rng.normal(size=(2, 3))
    H = np.zeros((len(freq), 3, 1), complex)
    for pole, shape in zip(poles_from([60.0, 100.0], [0.004, 0.01]), shapes, strict=True):
        pole = complex(pole)
        near = record_kernel(2j * np.pi * freq, pole, 1.0, "hann") - record_kernel(
            2j * np.pi * freq, pole.conjugate(), 1.0, "hann"
        )
        H[:, :, 0] += near[:, None] * shape / (2j * pole.imag)
    noise = 1e-3 * np.abs(H).mean() * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    found = fit(FRF(freq, H + noise), add=[60.3], order=12)
    f, grade = np.asarray(found.model.frequency_hz), np.asarray(found.grade)
    halves = np.abs(f - 60) < 1
    assert halves.sum() == 2
    assert 0.3 < grade[halves].min() <= grade[halves].max() < 0.6 < grade[~halves & np.asarray(found.inside)].min()
    assert all(any("one mode explains" in flag for flag in found.flags[r]) for r in np.flatnonzero(halves))
