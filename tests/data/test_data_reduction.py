"""Records of every kind of excitation become the FRF of the filter that made the response."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from modalax.data import Recording, frf_from_recording, from_sep005
from modalax.data.excitation import excitation_of, excited, period_of
from modalax.data.recording import channels_of, joined, rate_of, unit_of
from modalax.data.reduction import common_lines
from modalax.data.steps import steps_of

FS = 512.0
# two resonances, at 40 and 110 Hz, that die away within half a second
POLES = np.exp((-12 + 2j * np.pi * np.array([40, 110])) / FS)
A = np.real(np.poly(np.concatenate([POLES, POLES.conj()])))
B = np.array([0.0, 1e-3, 2e-3])


def response(force):
    return scipy.signal.lfilter(B, A, force, axis=-1)


def exact(freq):
    return scipy.signal.freqz(B, A, freq, fs=FS)[1]


def recording(force, *responses, units=("N", "m/s^2")) -> Recording:
    force = np.atleast_2d(force)
    data = np.stack([force, *(np.atleast_2d(r) for r in responses or (response(force),))], axis=-1)
    names = ["hammer", *(f"a{k + 1}" for k in range(data.shape[2] - 1))]
    units = [units[0], *[units[1]] * (len(names) - 1)]
    return Recording(data, FS, tuple(names), tuple(units), tuple(range(1, len(names) + 1)))


def hits(count=5, every=1.1, double=None):
    t = np.arange(int(count * every * FS)) / FS
    force = np.zeros(len(t))
    for k in range(count):
        for late in (0.0, 0.1) if k == double else (0.0,):
            at = 0.2 + k * every + late
            force += (50 + 5 * k) * np.exp(-(((t - at) / 0.003) ** 2))
    return force


def multisine(periods=4, samples=1024, first=20, last=300, seed=0, step=1):
    rng = np.random.default_rng(seed)
    lines = np.arange(first, last, step)
    t = np.arange(samples)
    phase = rng.uniform(0, 2 * np.pi, len(lines))
    one = np.cos(2 * np.pi * np.outer(t, lines) / samples + phase).sum(axis=1)
    return np.tile(one, periods), lines


def sweep(seconds=20.0):
    t = np.arange(int(seconds * FS)) / FS
    return 3.0 * scipy.signal.chirp(t, 10, seconds, 180) * scipy.signal.windows.tukey(len(t), 0.05)


def told(call, *args, **kwargs):
    """What a call gives, and its warnings."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        return call(*args, **kwargs), [str(w.message) for w in heard]


@pytest.mark.parametrize(
    ("kind", "force"),
    [
        ("hits", hits()[None]),
        ("multisine", multisine()[0][None]),
        ("sweep", sweep()[None]),
        ("random", np.random.default_rng(1).normal(size=(1, 8192))),
        ("blocks", np.random.default_rng(1).normal(size=(4, 4096)) * scipy.signal.windows.tukey(4096, 0.2)),
        ("random", np.random.default_rng(2).normal(size=(3, 4096))),
    ],
)
def test_the_force_tells_its_kind(kind, force):
    noise = 1e-4 * np.abs(force).max() * np.random.default_rng(5).normal(size=force.shape)
    assert excitation_of(force + noise).kind == kind


def test_a_period_is_found_and_a_sine_is_none():
    force, lines = multisine(samples=1000)
    assert period_of(force) == 1000
    assert np.array_equal(excited(force[:1000, None]), lines)
    odd, lines = multisine(samples=1000, first=21, step=2)
    assert np.array_equal(excited(odd[:1000, None]), lines)
    assert period_of(np.sin(np.arange(4000) / 7)) == 0


def test_hits_of_a_long_record_with_one_double():
    force = hits(double=2)
    frf, notes = told(frf_from_recording, recording(force), contact=0.02, band=(10.0, 200.0))
    assert any("hits 3 of 5 left out: double" in n for n in notes), notes
    assert any("force by its unit: hammer" in n for n in notes)
    assert frf.averages == 4 and frf.form == "accelerance"
    H = exact(np.asarray(frf.freq))
    # the responses have fallen to exp(-12) at the end of a block
    assert np.abs(np.asarray(frf.H[:, 0, 0]) - H).max() < 1e-3 * np.abs(H).max()
    assert np.asarray(frf.coherence).min() > 0.999


def clipping_hits():
    """Hits, the last two far stronger, the response cut at a level that the third touches for one sample."""
    force = hits()
    force[int(3.4 * FS) :] *= 3
    x = response(force)
    peaks = [x[int((0.1 + 1.1 * k) * FS) : int((1.1 + 1.1 * k) * FS)].max() for k in range(5)]
    return force, np.minimum(x, peaks[2])


def test_a_hit_that_reaches_the_level_at_which_others_clip_is_left_out():
    force, x = clipping_hits()
    _, notes = told(frf_from_recording, recording(force, x))
    assert any("hits 3, 4, 5 of 5 left out: overloaded" in n for n in notes), notes
    every = int(1.1 * FS)
    apart = recording(*(np.stack([a[k * every :][:every] for k in range(5)]) for a in (force, x)))
    _, notes = told(frf_from_recording, apart)
    assert any("hits 3, 4, 5 of 5 left out: overloaded" in n for n in notes), notes
    _, notes = told(frf_from_recording, apart, block=0.9)
    assert any("hits 3, 4, 5 of 5 left out: overloaded" in n for n in notes), notes


def test_an_exponential_window_is_recorded_and_only_then_silent():
    x = recording(hits(every=0.5))
    frf, notes = told(frf_from_recording, x, remainder=0.01, band=(10.0, 200.0))
    assert not any("end of the block" in n for n in notes)
    duration = np.log(100) / float(frf.added_decay)
    assert 0.4 < duration < 0.5
    _, notes = told(frf_from_recording, recording(hits(every=0.25)), band=(10.0, 200.0))
    assert any("end of the block" in n for n in notes)


def test_one_hit_a_record_and_a_roving_hammer():
    force = np.stack([np.roll(hits(1, 2.0), 3 * k) * (1 + k) for k in range(4)])
    gains = np.array([1.0, 2.0, -0.5, 3.0])[:, None]
    x = recording(force, gains * response(force))
    frf, _ = told(frf_from_recording, x, roving=1, inputs=["p", "q", "r", "s"], band=(10.0, 200.0))
    H = exact(np.asarray(frf.freq))
    assert frf.inputs == ("p", "q", "r", "s") and frf.variance is None
    assert np.allclose(np.asarray(frf.H[:, 0]), H[:, None] * gains[:, 0], rtol=1e-4, atol=1e-6)
    both, _ = told(frf_from_recording, x, roving=2, band=(10.0, 200.0))
    assert both.H.shape[2] == 2 and both.variance is not None
    with pytest.raises(ValueError, match="4 hits; with 3 at each point"):
        told(frf_from_recording, x, roving=3)


def test_periods_of_a_multisine():
    force, lines = multisine(periods=6)
    frf, notes = told(frf_from_recording, recording(force))
    assert np.allclose(np.asarray(frf.freq), lines * FS / 1024)
    assert np.allclose(np.asarray(frf.H[:, 0, 0]), exact(np.asarray(frf.freq)), rtol=1e-6)
    assert frf.averages == 5 and any("6 periods of 1024 samples, the first 1 left out" in n for n in notes)
    assert np.isnan(float(frf.level))


def test_realisations_of_a_multisine_give_the_best_linear_approximation():
    forces = np.stack([multisine(periods=4, seed=s)[0] for s in range(3)])
    frf, _ = told(frf_from_recording, recording(forces))
    assert frf.averages == 3
    assert np.allclose(np.asarray(frf.H[:, 0, 0]), exact(np.asarray(frf.freq)), rtol=1e-6)


def test_a_sweep_has_its_level_and_its_band():
    force = np.pad(sweep(), (0, 1024))
    frf, notes = told(frf_from_recording, recording(force))
    freq = np.asarray(frf.freq)
    assert 8 < freq[0] < 13 and 170 < freq[-1] < 185 and any("band of the sweep" in n for n in notes)
    assert float(frf.level) == pytest.approx(3.0, rel=0.05)
    H = exact(freq)
    assert np.abs(np.asarray(frf.H[:, 0, 0]) - H).max() < 1e-3 * np.abs(H).max()


def stepped(freqs, seconds=4.0, gap=0):
    parts = [np.sin(2 * np.pi * f * np.arange(int(seconds * FS)) / FS) for f in freqs]
    return 3 * np.concatenate([np.append(part, np.zeros(gap)) for part in parts])


@pytest.mark.parametrize(("freqs", "gap"), [(np.arange(20, 41), 0), (np.geomspace(15, 200, 12), 200)])
def test_a_stepped_sine_has_a_line_for_each_frequency(freqs, gap):
    force, rng = stepped(freqs, gap=gap), np.random.default_rng(0)
    noisy = response(force) + 1e-4 * rng.normal(size=len(force))
    frf, notes = told(frf_from_recording, recording(force, noisy))
    assert any("taken as stepped" in n for n in notes)
    assert np.allclose(np.asarray(frf.freq), freqs, rtol=0, atol=6e-4) and frf.averages == 8
    wrong = np.abs(np.asarray(frf.H[:, 0, 0]) - exact(np.asarray(frf.freq)))
    assert wrong.max() < 1e-5
    assert np.mean(wrong**2 / np.asarray(frf.variance)[:, 0, 0]) == pytest.approx(1, abs=0.8)
    assert float(frf.level) == pytest.approx(3, rel=1e-3)


def test_steps_may_come_back_and_sweeps_or_noise_have_none():
    up = np.arange(20.0, 30.0)
    frf, notes = told(frf_from_recording, recording(stepped([*up, *up[-2::-1]], 3.0)))
    assert np.allclose(np.asarray(frf.freq), up) and any("19 steps at 10 frequencies" in n for n in notes)
    rng = np.random.default_rng(0)
    slow = scipy.signal.chirp(np.arange(30 * int(FS)) / FS, 30, 30, 34)
    noise = rng.normal(size=len(slow))
    for force in (sweep(), slow, slow + 0.1 * noise, noise, np.sin(np.arange(8192))):
        assert steps_of(force) == []
    with pytest.raises(ValueError, match="does not stand at one frequency"):
        told(frf_from_recording, recording(sweep()), kind="stepped")


def test_steps_too_short_for_the_responses_are_told():
    ringing = scipy.signal.lfilter([1e-3], np.poly(0.9997 * np.exp(np.array([1j, -1j]) * 2 * np.pi * 25 / FS)).real,
                                   stepped(np.arange(20, 30), 1.0))  # fmt: skip
    _, notes = told(frf_from_recording, recording(stepped(np.arange(20, 30), 1.0), ringing))
    assert any("the responses still change" in n for n in notes), notes


@pytest.mark.parametrize(
    ("force", "choices", "words"),
    [
        (hits(), {"window": "hamming", "overlap": 0.2}, "--overlap, --window do nothing for excitation by hits"),
        (sweep(), {"kind": "blocks", "block": 2.0}, "--block does nothing for excitation by blocks"),
        (multisine()[0], {"remainder": 0.1}, "--exponential does nothing for excitation by multisine"),
        (np.random.default_rng(1).normal(size=8192), {"period": 512}, "--period does nothing for excitation by random"),
    ],
)
def test_choices_that_do_nothing_are_told(force, choices, words):
    _, notes = told(frf_from_recording, recording(force), **choices)
    assert words in notes
    fitting = {key: value for key, value in choices.items() if key == "kind"}
    _, notes = told(frf_from_recording, recording(force), **fitting)
    assert not any("nothing for" in n for n in notes)


def test_a_roving_hammer_needs_hits():
    with pytest.raises(ValueError, match="--roving is for hits; the excitation asked for is random"):
        told(frf_from_recording, recording(hits()), kind="random", roving=2)


def test_runs_keep_the_lines_that_all_have():
    frf, _ = told(frf_from_recording, recording(multisine()[0]))
    upper, lower = frf.band(20.0, 120.0), frf.band(15.0, 90.0)
    kept, notes = told(common_lines, [upper, lower])
    wanted = frf.band(20.0, 90.0)
    assert all(np.array_equal(np.asarray(f.H), np.asarray(wanted.H)) for f in kept) and len(notes) == 1
    with pytest.raises(ValueError, match="no frequency line in common"):
        common_lines([frf.band(20.0, 40.0), frf.band(60.0, 90.0)])


def test_random_records_are_averaged_and_pooled():
    rng = np.random.default_rng(3)
    force = rng.normal(size=(3, 32768))
    noisy = response(force) + 0.002 * rng.normal(size=force.shape)
    parts = [told(frf_from_recording, recording(force[k], noisy[k]), kind="random", block=4.0)[0] for k in range(3)]
    whole, _ = told(frf_from_recording, recording(force, noisy), kind="random", block=4.0)
    H = exact(np.asarray(whole.freq))[:, None, None]
    errors = [float(np.mean(np.abs(np.asarray(f.H) - H) ** 2)) for f in (parts[0], whole)]
    assert errors[1] < 0.6 * errors[0]
    # the stated variance is that of the errors, but for what leaks
    assert float(np.mean(np.abs(np.asarray(whole.H) - H) ** 2 / np.asarray(whole.variance))) == pytest.approx(
        1, abs=0.4
    )
    assert whole.averages == sum(p.averages for p in parts)


# channels and units ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("label", "kind", "factor"),
    [
        ("N", "force", 1.0), ("kN", "force", 1e3), ("lbf", "force", 4.4482216152605), ("g", "accelerance", 9.80665),
        ("m/s²", "accelerance", 1.0), ("m/s^2", "accelerance", 1.0), ("[mm/s]", "mobility", 1e-3),
        ("um", "receptance", 1e-6), ("in/s**2", "accelerance", 0.0254), ("MM/S", "mobility", 1e-3),
        ("mg", "accelerance", 9.80665e-3), ("mN", "force", 1e-3), ("MN", "force", 1e6), ("KN", "force", 1e3),
        ("kgf", "force", 9.80665), ("lb", "force", 4.4482216152605), ("nm/s", "mobility", 1e-9),
        ("m s⁻²", "accelerance", 1.0), ("µm/s²", "accelerance", 1e-6),
    ],
)  # fmt: skip
def test_units_are_known_by_their_labels(label, kind, factor):
    assert unit_of(label) == (kind, factor)
    assert not any(unit_of(label) for label in ("V", "Pa", "", "Nm", "NM", "mn", "MG", "kg"))


def record_of(names, units):
    data = np.random.default_rng(0).normal(size=(1, 64, len(names)))
    return Recording(data, FS, tuple(names), tuple(units), tuple(range(1, len(names) + 1)))


def test_force_is_told_by_unit_then_name_and_never_guessed():
    mixed = record_of(["u", "left", "right", "drive"], ["V", "lbf", "g", ""])
    found, notes = told(channels_of, mixed)
    assert found.inputs == ["left"] and found.outputs == ["right"] and found.unit == "m/s^2"
    assert np.allclose(found.force[..., 0], 4.4482216152605 * mixed.data[..., 1])
    assert np.allclose(found.response[..., 0], 9.80665 * mixed.data[..., 2])
    assert any("left out: u, drive" in n for n in notes)
    by_name, notes = told(channels_of, record_of(["Force", "Acceleration 1"], ["", ""]))
    assert by_name.inputs == ["Force"] and by_name.unit == "m/s^2"
    assert {n.split(":")[0] for n in notes} >= {"force by its name", "Acceleration 1 without a unit"}
    with pytest.raises(ValueError, match="which channel is the force is not known.*1 x .m., 2 y .m."):
        channels_of(record_of(["x", "y"], ["m", "m"]))


def test_channels_that_do_not_fit_are_refused():
    two = record_of(["f", "x", "v"], ["N", "m", "m/s"])
    with pytest.raises(ValueError, match="mobility and receptance"):
        told(channels_of, two)
    with pytest.raises(ValueError, match="no channel 'q'; there are 1 f"):
        channels_of(two, ["q"])
    with pytest.raises(ValueError, match="as force and as response"):
        channels_of(two, ["f"], [1])
    with pytest.raises(ValueError, match="the unit of x is not known"):
        told(channels_of, record_of(["f", "x"], ["N", ""]), response=["x"])
    with pytest.raises(ValueError, match="unit is 'N'"):
        told(channels_of, record_of(["f", "x"], ["N", ""]), unit="N")
    with pytest.raises(ValueError, match="one name"):
        two.renamed({"f": "x"})
    assert np.array_equal(two.between(10 / FS, 20 / FS).data, two.data[:, 10:20])
    with pytest.raises(ValueError, match="records of 0.125 s"):
        two.between(0.1, 0.2)
    assert told(channels_of, two.scaled({"f": 2.0}), ["f"], ["x"])[0].force[0, 0, 0] == 2 * two.data[0, 0, 0]


def test_a_label_that_cannot_be_read_is_never_replaced():
    found, _ = told(channels_of, record_of(["f", "a"], ["mN", "mg"]), unit="g")
    raw = record_of(["f", "a"], ["", ""]).data
    assert np.allclose(found.force[..., 0], 1e-3 * raw[..., 0])
    assert np.allclose(found.response[..., 0], 9.80665e-3 * raw[..., 1])
    with pytest.raises(ValueError, match="unit 'mV' of channel a cannot be read.*--units a=g"):
        told(channels_of, record_of(["f", "a"], ["N", "mV"]), unit="g")
    with pytest.raises(ValueError, match="unit 'V' of force hammer is none of force"):
        told(channels_of, record_of(["hammer", "a"], ["V", "g"]))
    with pytest.raises(ValueError, match="the responses is not known .'mV' of a cannot be read"):
        told(channels_of, record_of(["f", "a"], ["N", "mV"]))
    as_given, _ = told(channels_of, record_of(["hammer", "a"], ["V", "mV"]).with_units({1: "N", "a": "g"}))
    assert as_given.inputs == ["hammer"] and as_given.unit == "m/s^2"


def test_records_are_joined_where_they_agree():
    a, b = record_of(["f", "x"], ["N", "m"]), record_of(["f", "y"], ["N", "m"])
    short = Recording(a.data[:, :50], FS, a.channels, a.units, a.numbers)
    both, notes = told(joined, [a, short])
    assert both.data.shape == (2, 50, 2) and "cut to the first 50" in notes[0]
    with pytest.raises(ValueError, match="recording 2 has 1 f"):
        joined([a, b])


def test_sep005_dictionaries():
    t = np.arange(100) / 250.0
    series = [
        {"name": "F1", "unit_str": "N", "data": np.sin(t), "fs": 250},
        {"name": "acc_z", "unit_str": "g", "data": np.cos(t), "time": t},
    ]
    made = from_sep005(series)
    assert made.fs == 250 and made.channels == ("F1", "acc_z") and made.units == ("N", "g")
    assert np.array_equal(made.data[0, :, 1], np.cos(t))
    with pytest.raises(ValueError, match="time series 1 has no unit_str, fs or time"):
        from_sep005({"name": "a", "data": t})
    with pytest.raises(ValueError, match="one length"):
        from_sep005([series[0], {**series[1], "data": t[:50]}])


@pytest.mark.parametrize("rate", [51200 / 7, 51200 / 9, 25600 / 3, 44100.3])
def test_rates_are_whole_numbers_only_where_the_digits_allow_it(rate):
    t = np.arange(50_000) / rate
    assert rate_of(t) == pytest.approx(rate, rel=1e-12)
    assert rate_of(np.round(t, 7)) == pytest.approx(rate, rel=1e-7)
    assert rate_of(np.arange(50_000) / 16384.0) == 16384
    assert rate_of(np.round(np.arange(50_000) / 8192.0, 6)) == 8192
    assert rate_of(np.cumsum(np.full(50_000, 1 / 51200))) == 51200
    assert rate_of((np.arange(50_000) / 6000).astype(np.float32).astype(float)) == 6000


def test_records_whose_rates_are_rounded_differently_are_of_one_rate():
    a, b = (replace(record_of(["f", "x"], ["N", "m"]), fs=fs) for fs in (7314.2857, 7314.2864))
    assert joined([a, b]).fs == 7314.2857
    with pytest.raises(ValueError, match="same channels, units and rate"):
        joined([a, replace(b, fs=7315.0)])


def test_rate_of_instants():
    assert rate_of(np.arange(1000) * 0.0005) == 2000
    assert rate_of(np.round(np.arange(1000) / 51200, 6)) == pytest.approx(51200, rel=1e-3)
    with pytest.raises(ValueError, match="not evenly spaced"):
        rate_of(np.array([0.0, 1, 2, 4, 5]))


# measured data --------------------------------------------------------------------------------------------------------


@pytest.mark.measured
def test_the_last_block_of_a_roving_hammer_is_near_the_published_average(measured):
    from modalax.files import load_records

    path = measured / "uliege_plane" / "frf.npz"
    records, _ = told(load_records, path, fs=512.0, array="x")
    frf, _ = told(frf_from_recording, records, force=[1], unit="g", roving=1, band=(12.0, 180.0))
    raw = np.load(path)
    at = np.flatnonzero((raw["freq"] >= 12) & (raw["freq"] <= 180))
    good = raw["coh"][1:29][..., at] > 0.99
    ours = np.moveaxis(np.asarray(frf.H), 0, -1).transpose(1, 0, 2)[1:29]  # (hit, sensor, f)
    theirs = 9.80665 * raw["H"][1:29][..., at]
    assert np.allclose(np.asarray(frf.freq), raw["freq"][at])
    assert np.median(np.abs(ours - theirs)[good] / np.abs(theirs)[good]) < 0.1
