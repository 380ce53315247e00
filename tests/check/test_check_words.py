"""Every word of a check, put into one small sound test made in NumPy: found, at its place, with its size."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from modalax.check import WORDS, Findings, Records, check
from modalax.check.finding import sureness
from modalax.data import Measurement

NAMES = tuple(f"{k + 1}:+Z" for k in range(5))
FREQ = np.arange(1.0, 96.0, 0.125)
NOISE = 0.003
FEW = [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]  # draws of the noise


def chain():
    """Poles and shapes of five masses on springs between two walls, 1 % modal damping."""
    k = np.array([1.0, 1.3, 0.8, 1.1, 0.9, 1.2]) * 6e4
    m = np.array([1.0, 0.8, 1.2, 0.9, 1.1])
    K = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    w2, q = np.linalg.eigh(K / np.sqrt(np.outer(m, m)))
    return np.sqrt(w2), q.T / np.sqrt(m)


def accelerance(freq=FREQ, stretch=1.0, zeta=0.01):
    """FRFs ``(f, o, i)`` of all five places to forces at the first and third."""
    w, shapes = chain()
    w = w * stretch
    s = 2j * np.pi * freq[:, None]
    modes = s**2 / (s**2 + 2 * zeta * w * s + w**2)
    return np.einsum("fr,ro,ri->foi", modes, shapes, shapes[:, [0, 2]])


@dataclass(frozen=True)
class Bench:
    """A measurement being made: noise comes last."""

    H: np.ndarray
    freq: np.ndarray = field(default_factory=lambda: FREQ)
    form: str = "accelerance"
    level: float | np.ndarray = np.nan
    noise: np.ndarray | float = 1.0

    def measured(self, seed=0, spoil=None) -> Findings:
        rng = np.random.default_rng(seed)
        H = self.H if self.H.ndim == 4 else self.H[None]
        sigma = NOISE * np.sqrt(np.mean(np.abs(accelerance()) ** 2)) * self.noise * np.ones(H.shape)
        H = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)
        H = H if spoil is None else spoil(H)
        level = np.broadcast_to(self.level, len(H))
        return check(
            Measurement(
                self.freq, H, form=self.form, outputs=NAMES, inputs=(NAMES[0], NAMES[2]), variance=sigma**2, level=level
            )
        )


def row(o, factor):
    H = accelerance()
    H[:, o] *= factor if np.ndim(factor) == 0 else factor[:, None]
    return H


def shifted():
    H = accelerance()
    H[..., 1] = accelerance(stretch=1 - 1.5e-3)[..., 1]
    return H


def swapped(H):
    return H[:, [2, 1, 0, 3, 4]]


def uneven():
    """Both ways between places 1 and 3 differ, mode by mode."""
    H = accelerance()
    w, shapes = chain()
    s = 2j * np.pi * FREQ[:, None]
    modes = s**2 / (s**2 + 0.02 * w * s + w**2)
    gains = np.array([1.3, 0.75, 1.25, 0.8, 1.2])
    H[:, 2, 0] = modes @ (gains * shapes[:, 0] * shapes[:, 2])
    return H


def clipped():
    low = accelerance()
    high = low.copy()
    size = np.abs(high[:, 1])
    over = np.maximum(size / (0.6 * size.max()), 1.0)
    high[:, 1] *= 2 / np.pi * (np.arcsin(1 / over) + np.sqrt(1 - over**-2.0) / over)
    return np.stack([low, high])


def humming(mains=50.0):
    H = accelerance()
    at = int(np.argmin(np.abs(FREQ - mains)))
    H[at] += 0.6 * np.abs(H[at]) * np.exp(1j * np.arange(10).reshape(5, 2))
    return H


def drifting():
    H = accelerance()
    H[:, 3] += 2 * np.abs(H[40, 3]).max() * ((6 / FREQ) ** 1.3 * 1j)[:, None]
    return H


def cut_off(left):
    """FRFs of hits whose records end when ``left`` of the slowest mode is left, by the integral over the record."""
    w, shapes = chain()
    poles = w * (-0.002 + 1j * np.sqrt(1 - 0.002**2))
    step = 0.002 * w[0] / -np.log(left)
    freq = step * np.arange(np.ceil(1 / step), 90 / step)
    s = 2j * np.pi * freq[:, None]
    H = np.zeros((len(freq), 5, 2), complex)
    for p in (poles, poles.conj()):
        residues = p**2 / (1j * np.sign(p.imag) * 2 * w)
        H += np.einsum(
            "fr,r,ro,ri->foi",
            (1 - np.exp((p - s) / step)) / (s - p),
            residues,
            shapes,
            shapes[:, [0, 2]],
            optimize=True,
        )
    return freq, H + (shapes.T @ shapes[:, [0, 2]])[None]


TAU = 2.5e-4
COARSE = np.arange(1.0, 96.0, 0.9)
RIPPLE = np.abs(1 + 0.5 * np.exp(-2j * np.pi * FREQ * 0.25))[:, None, None]
STEEP = 10 ** (np.clip(FREQ - 55, 0, None) / 40 * 60 / 20)[:, None, None]
COLUMN = np.array([0.0, 1.0])
FAULTS = {
    "reversed": (Bench(row(2, -1.0)), {NAMES[2]}, None),
    "swapped": (Bench(swapped(accelerance())), {NAMES[0], NAMES[2]}, None),
    "not_reciprocal": (Bench(uneven()), {NAMES[0], NAMES[2]}, None),
    "calibration": (Bench(row(2, 1.08)), {NAMES[0], NAMES[2]}, 1.08),
    "frequency_shift": (Bench(shifted()), {NAMES[0], NAMES[2]}, 0.15),
    "conjugated": (Bench(accelerance().conj()), set(), None),
    "wrong_form": (Bench(accelerance(), form="mobility"), set(), 1.0),
    "delay": (Bench(row(1, np.exp(-2j * np.pi * FREQ * TAU))), {NAMES[1]}, TAU),
    "too_few_lines": (Bench(accelerance(COARSE, zeta=0.002), freq=COARSE), set(), None),
    "hum": (Bench(humming()), set(), None),
    "drift": (Bench(drifting()), {NAMES[3]}, None),
    "clipped": (Bench(clipped(), level=np.array([1.0, 2.0])), {NAMES[1]}, None),
    "double_hit": (Bench(accelerance(), noise=1 + (1 / RIPPLE - 1) * COLUMN), {NAMES[2]}, 0.25),
    "force_rolloff": (Bench(accelerance(), noise=1 + (STEEP - 1) * COLUMN), {NAMES[2]}, None),
    "record_too_short": (Bench(cut_off(0.3)[1], freq=cut_off(0.3)[0]), set(), None),
}


@pytest.mark.parametrize("what", FAULTS)
def test_a_fault_is_named_at_its_place_with_its_size(what):
    bench, where, size = FAULTS[what]
    found = bench.measured()
    right = [f for f in found if f.what == what]
    assert right, [(f.what, f.where) for f in found]
    named = {name for f in right for name in f.where}
    assert where & named == where if len(where) < 2 or what in ("swapped", "not_reciprocal") else where & named
    if size is not None:
        f = right[0]
        low, high = f.interval or (f.size, f.size)
        assert any(low - 1e-9 <= s <= high + 1e-9 for s in (size, -size, 1 / size)), (f.size, f.interval)


@pytest.mark.parametrize("seed", FEW[:2])
def test_force_over_motion_is_told_to_be_upside_down(seed):
    (found,) = Bench(accelerance()).measured(seed, lambda H: 1 / H)
    assert found.what == "wrong_form" and found.size is None and "force over motion" in found.evidence


@pytest.mark.parametrize("times", [-1, 1])
def test_a_sensor_of_another_form_than_the_others_is_named(times):
    H = accelerance()
    H[:, 1] *= (2j * np.pi * FREQ[:, None] / 300) ** times
    (found,) = Bench(H).measured()
    assert (found.what, found.where) == ("wrong_form", (NAMES[1],)) and "turned by 90 degrees" in found.evidence


def test_hum_of_one_output_is_told_there_and_that_of_all_everywhere():
    H, at = accelerance(), int(np.argmin(np.abs(FREQ - 50)))
    H[at, 3] += 0.6 * np.abs(H[at]).mean()
    (found,) = Bench(H).measured()
    assert (found.what, found.where) == ("hum", (NAMES[3],))
    (found,) = Bench(humming()).measured()
    assert (found.what, found.where) == ("hum", ())


def test_a_mains_a_line_off_is_as_large_a_hum():
    (found,) = Bench(humming(49.875)).measured()
    assert found.what == "hum" and found.size == pytest.approx(0.6, rel=0.2)


def test_far_above_the_mains_no_line_is_hum():
    """Multiples of 50 Hz that wander by 0.4 % cover every line there."""
    rng, freq = np.random.default_rng(0), np.arange(5.0, 105.0, 0.25)
    s = 2j * np.pi * freq[:, None]
    w, zeta = 2 * np.pi * np.array([22.0, 47.0, 71.0]), np.array([0.01, 0.012, 0.008])
    H = (s**2 / (s**2 + 2 * zeta * w * s + w**2)) @ rng.normal(size=(3, 3))
    H = H + 0.01 * np.sqrt(np.mean(np.abs(H) ** 2)) * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    m = Measurement(1e6 + freq, H[None, :, :, None], form="accelerance", outputs=["1", "2", "3"], inputs=["1"])
    assert "hum" not in {f.what for f in check(m)}


@pytest.mark.parametrize("mode", [2, 3])
def test_a_mode_too_narrow_for_the_lines_is_no_hum(mode):
    """At 50 Hz, between lines that are wider apart than it is wide."""
    freq = np.arange(1.0, 96.0, 1.6)
    found = Bench(accelerance(freq, 2 * np.pi * 50 / chain()[0][mode], zeta=0.002), freq=freq).measured()
    assert [f.what for f in found] == ["too_few_lines"]


@pytest.mark.parametrize("pair", [(0, 2), (1, 2)])
def test_exchanged_channels_are_told_by_reciprocity_of_a_single_mode(pair):
    """Both move alike in the one mode of the band; only the curves between two drive points tell."""
    freq = np.linspace(1.0, 30.0, 600)
    H = accelerance(freq)
    H[:, list(pair)] = H[:, list(pair[::-1])]
    (found,) = Bench(H, freq=freq).measured()
    assert (found.what, set(found.where)) == ("swapped", {NAMES[k] for k in pair})


@pytest.mark.parametrize("seed", FEW)
def test_a_reversed_sensor_is_not_told_as_exchanged_with_one_in_opposite_phase(seed):
    freq = np.arange(30.0, 46.5, 0.03)
    H = accelerance(freq)
    H[:, 0] *= -1
    (found,) = Bench(H, freq=freq).measured(seed)
    assert (found.what, found.where) == ("reversed", (NAMES[0],))


@pytest.mark.parametrize("gain", [1.0, -0.5])
def test_two_channels_of_the_same_data_are_told(gain):
    def copied(H):
        H[:, :, 4] = gain * H[:, :, 1]
        return H

    found = [f for f in Bench(accelerance()).measured(spoil=copied) if f.what == "duplicated"]
    assert found and set(found[0].where) == {NAMES[1], NAMES[4]}
    assert found[0].size == pytest.approx(1 / gain, rel=0.02) or found[0].size == pytest.approx(gain, rel=0.02)


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_a_dead_channel_is_told(noise):
    def died(H):
        H[:, :, 3] = noise * (H[:, :, 3] - accelerance()[:, 3])
        return H

    found = Bench(accelerance()).measured(spoil=died)
    assert [(f.what, f.where) for f in found if f.what == "dead"] == [("dead", (NAMES[3],))]


def test_a_channel_of_zeros_without_any_noise_is_told():
    died = np.where(np.arange(5) == 3, 0.0, 1.0)[:, None]
    found = Bench(accelerance() * died, noise=died).measured()
    assert [(f.what, f.where) for f in found] == [("dead", (NAMES[3],))]


@pytest.mark.parametrize(
    ("seed", "form"),
    [
        pytest.param(seed, form, marks=() if seed == k else pytest.mark.slow)  # each form with noise of its own
        for k, form in enumerate(("receptance", "mobility", "accelerance"))
        for seed in range(3)
    ],
)
def test_a_sound_measurement_says_nothing(seed, form):
    times = {"receptance": -2, "mobility": -1, "accelerance": 0}[form]
    s = (2j * np.pi * FREQ[:, None, None]) ** times
    bench = Bench(accelerance() * s, form=form, noise=np.abs(s))
    assert [f.evidence for f in bench.measured(seed)] == []


def test_runs_of_rising_force_say_nothing():
    low, high = accelerance(), accelerance(stretch=0.998, zeta=0.011)
    assert [f.evidence for f in Bench(np.stack([low, high]), level=np.array([1.0, 2.0])).measured()] == []


# Records ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Hits:
    """Hammer hits at the first place of the chain, and what five accelerometers record."""

    fs: float = 512.0
    samples: int = 4096
    zeta: float = 0.01
    pulse: int = 5
    count: int = 4

    def made(self, seed=1) -> Records:
        rng = np.random.default_rng(seed)
        w, shapes = chain()
        time = np.arange(self.samples) / self.fs
        begin = 60
        force = np.zeros((self.count, self.samples))
        height = rng.uniform(60, 120, (self.count, 1))
        force[:, begin : begin + self.pulse] = height * np.sin(np.pi * np.arange(1, self.pulse + 1) / (self.pulse + 1))
        wd = w * np.sqrt(1 - self.zeta**2)
        # Acceleration of each mode for a unit impulse, and the impulse itself.
        swing = np.exp(-self.zeta * w[:, None] * time) * np.sin(wd[:, None] * time) * (-(w**2) / wd)[:, None]
        response = np.einsum("ro,r,rt->ot", shapes, shapes[:, 0], swing) / self.fs
        response[:, 0] += shapes.T @ shapes[:, 0]
        spectrum = np.fft.rfft(force, 2 * self.samples)[:, None] * np.fft.rfft(response, 2 * self.samples)
        x = np.fft.irfft(spectrum)[..., : self.samples].transpose(0, 2, 1)
        x = x + NOISE * x.std() * rng.normal(size=x.shape)
        return Records(force + 0.01 * rng.normal(size=force.shape), x, self.fs, NAMES, input=NAMES[0])


def words(records: Records) -> set[str]:
    return {f.what for f in check(records)}


@pytest.mark.parametrize("seed", FEW)
def test_sound_hits_say_nothing(seed):
    assert words(Hits().made(seed)) == set()


def spoilt(what: str) -> tuple[Records, set[str], float | None]:
    """Hits with a fault, the channels at fault, and its size."""
    other = {
        "short_pulse": (Hits(pulse=1), 1.0), "record_too_short": (Hits(samples=512), None),
        "force_rolloff": (Hits(fs=1024.0, samples=8192, pulse=48), None),
    }  # fmt: skip
    if what in other:
        return other[what][0].made(), set() if what == "record_too_short" else {NAMES[0]}, other[what][1]
    r = Hits().made()
    force, x = r.force.copy(), r.response.copy()
    if what == "double_hit":
        force[2, 100:105] += 0.3 * force[2, 60:65]
        return replace(r, force=force), {NAMES[0]}, 40 / r.fs
    if what == "reversed":
        x[:, :, 0] *= -1
        return replace(r, response=x), {NAMES[0]}, None
    time, own = np.arange(force.shape[1]) / r.fs, x[:, :, 1]
    x[:, :, 1] = {
        "clipped": np.clip(own, -0.5 * own.max(), 0.5 * own.max()), "dead": 0 * own, "duplicated": x[:, :, 3],
        "drift": own + 0.6 * own.std() * (np.linspace(-1, 1, len(time)) + 0.3),
        "hum": own + 0.1 * own.std() * np.sin(2 * np.pi * 50.02 * time + 1),
    }[what]  # fmt: skip
    return replace(r, response=x), {NAMES[1]}, None


@pytest.mark.parametrize(
    "what",
    ["double_hit", "short_pulse", "force_rolloff", "record_too_short", "clipped", "dead", "duplicated", "drift", "hum",
     "reversed"],
)  # fmt: skip
def test_a_fault_of_hits_is_named_at_its_place_with_its_size(what):
    records, where, size = spoilt(what)
    right = [f for f in check(records) if f.what == what]
    assert right, words(records)
    assert where <= {name for f in right for name in f.where}
    if size is not None:
        assert right[0].size == pytest.approx(size, rel=0.05)


@pytest.mark.parametrize("what", ["", "hum"])
def test_what_the_force_does_not_explain_of_random_records_is_looked_at(what, tmp_path):
    rng = np.random.default_rng(5)
    w, shapes = chain()
    fs, time = 512.0, np.arange(2048) / 512.0
    swing = np.exp(-0.02 * w[:, None] * time) * np.sin(w[:, None] * time) * -w[:, None] / fs
    force = rng.normal(size=32768)
    x = np.stack(
        [np.convolve(force, h)[: len(force)] for h in np.einsum("ro,r,rt->ot", shapes, shapes[:, 0], swing)], 1
    )
    x = (x + force[:, None] * (shapes.T @ shapes[:, 0]))[:, :2] + 0.01 * rng.normal(size=(len(force), 2))
    if what:
        x[:, 1] += 0.3 * x[:, 1].std() * np.sin(2 * np.pi * 50 * np.arange(len(force)) / fs)
    np.savez(tmp_path / "random.npz", force=force, acceleration=x, fs=fs)
    assert {f.what for f in check(tmp_path / "random.npz")} == ({what} if what else set())


def test_every_word_of_a_check_is_guarded():
    assert set(WORDS) == {*FAULTS, "dead", "duplicated", "short_pulse"}


def test_a_score_at_its_threshold_is_as_likely_chance_as_a_fault():
    assert sureness(4.0, 4.0) == sureness(3.0, 4.0) == 0.5
    assert 0.5 < sureness(5.0, 4.0) < 0.9 < sureness(8.0, 4.0) < sureness(16.0, 4.0) < 1
