"""Signs of hits and places of sensors from data: on made-up tests with known truth, then on the measured ones."""

import hashlib

import numpy as np
import pytest

from modalax import Measurement, load
from modalax.data import datasets, looks_conjugated
from modalax.data.roving import copied_hits, hit_signs, reciprocal_places


def plate(hits: int, modes: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies [Hz], shapes and accelerances between all points of a made-up structure, damping 1 %."""
    rng = np.random.default_rng(seed)
    shapes = rng.normal(size=(modes, hits))
    omega = 2 * np.pi * np.linspace(20, 80, modes)
    freq = np.linspace(10, 90, 400)
    w = 2 * np.pi * freq[:, None]
    modal = -(w**2) / (omega**2 - w**2 + 2j * 0.01 * omega * w)
    return freq, shapes, np.einsum("fn,no,ni->foi", modal, shapes, shapes)


def noisy(H: np.ndarray, relative: float, rng: np.random.Generator) -> np.ndarray:
    size = relative * np.sqrt(np.mean(np.abs(H) ** 2))
    return H + size / np.sqrt(2) * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))


@pytest.mark.parametrize("seed", range(6))
def test_signs_of_hits_are_found_through_noise(seed):
    """40 hits, a third of them from the other side, 3 sensors, 5 shapes known to 10 %, noise 20 %."""
    rng = np.random.default_rng(100 + seed)
    _, shapes, full = plate(40, 5, seed)
    truth = np.where(rng.uniform(size=40) < 0.33, -1.0, 1.0)
    H = noisy(full[:, :3] * truth, 0.2, rng)
    known = shapes + 0.1 * rng.normal(size=shapes.shape)
    signs, outside, agreement = hit_signs(H, known)
    np.testing.assert_array_equal(signs, truth * np.sign(truth.sum()))
    # Noise of 20 % alone puts 0.04 * 35/40 of the energy outside five of forty directions, the shapes about 0.01.
    assert 0.02 < outside < 0.06
    assert agreement.min() > 0


def test_agreement_is_the_correlation_with_the_prediction_from_the_other_hits():
    rng = np.random.default_rng(0)
    _, shapes, full = plate(12, 4, 0)
    H = noisy(full[:, :2], 0.3, rng)
    signs, _, agreement = hit_signs(H, shapes)
    np.testing.assert_array_equal(signs, np.ones(12))
    rows = H.reshape(-1, 12)
    P = np.eye(12) - np.linalg.pinv(shapes) @ shapes
    k = 7
    others = np.delete(np.arange(12), k)
    predicted = -rows[:, others] @ P[others, k] / P[k, k]
    correlation = np.real(np.vdot(predicted, rows[:, k])) / np.linalg.norm(predicted) / np.linalg.norm(rows[:, k])
    assert agreement[k] == pytest.approx(correlation, abs=1e-12)


def test_more_shapes_than_hits_tell_nothing():
    with pytest.raises(ValueError, match="12 shapes at 12 points for 12 hits"):
        hit_signs(np.ones((5, 1, 12), complex), np.ones((12, 12)))


@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, -1, -1), (1, -1, 1), (-1, 1, 1)])
def test_places_and_directions_of_sensors_are_found(signs):
    _, _, full = plate(25, 6, 3)
    places = (4, 17, 20)
    H = full[:, places] * np.array(signs)[:, None]
    found, found_signs, mismatch = reciprocal_places(noisy(H, 0.1, np.random.default_rng(0)))
    assert found == places
    np.testing.assert_array_equal(found_signs, signs)
    # Every line weighs the same, so between resonances noise adds to it: measured 0.32, where 1 is unrelated.
    assert 0 < mismatch.max() < 0.4
    two, _, exact = reciprocal_places(H[:, :2])
    assert two == places[:2] and exact.max() < 1e-12


def test_number_of_sensors_for_reciprocity():
    for count in (1, 4):
        with pytest.raises(ValueError, match=f"{count} sensors; reciprocity is searched for 2 or 3"):
            reciprocal_places(np.ones((5, count, 6), complex))


def test_copied_records_are_seen_and_similar_ones_are_not():
    records = np.random.default_rng(0).normal(size=(6, 2, 50))
    records[4] = records[1]
    records[5] = np.nextafter(records[0], 2)
    assert copied_hits(records) == [(1, 4)]


def test_absent_file_says_where_to_get_it_and_where_to_put_it(tmp_path, monkeypatch):
    monkeypatch.setenv("MODALAX_DATA", str(tmp_path))
    with pytest.raises(FileNotFoundError, match="steel_beam/frf.npz: no such file; get it from github.*MODALAX_DATA"):
        datasets.steel_beam()


def test_another_version_of_a_file_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("MODALAX_DATA", str(tmp_path))
    (tmp_path / "silverbox").mkdir()
    (tmp_path / "silverbox" / "SNLS80mV.mat").write_bytes(b"something else")
    with pytest.raises(ValueError, match="sha256 is .* known is 5c7413a5"):
        datasets.silverbox()


def test_a_file_in_the_cache_is_found_where_the_named_folder_lacks_it(tmp_path, monkeypatch):
    pooch = pytest.importorskip("pooch")
    cache = tmp_path / "cache"
    monkeypatch.setattr(pooch, "os_cache", lambda name: str(cache))
    content = b"five hits"
    monkeypatch.setitem(datasets.HASHES, "hammer_hits/measurements_1.npy", hashlib.sha256(content).hexdigest())
    name = "hammer_hits/measurements_1.npy"
    for folder in (None, tmp_path / "empty"):
        monkeypatch.delenv("MODALAX_DATA", raising=False)
        if folder is not None:
            monkeypatch.setenv("MODALAX_DATA", str(folder))
        (cache / "hammer_hits").mkdir(parents=True, exist_ok=True)
        (cache / name).write_bytes(content)
        assert datasets.data_file(name) == cache / name
        (cache / name).unlink()
        with pytest.raises(FileNotFoundError) as caught:
            datasets.data_file(name)
        assert str(cache) in str(caught.value) and "MODALAX_DATA" in str(caught.value)
        assert folder is None or str(caught.value).startswith(str(folder / name))
    # One folder given is the only one.
    with pytest.raises(FileNotFoundError, match="other"):
        datasets.data_file(name, tmp_path / "other")


def test_every_file_has_an_origin():
    assert {name.split("/")[0] for name in datasets.HASHES} == set(datasets.ORIGIN)


@pytest.fixture(scope="module")
def plane(measured):
    return datasets.uliege_plane()


@pytest.mark.measured
class TestPlane:
    def test_signs_fit_and_are_sure(self, plane):
        from_above = [f"{k}:-Z" for k in range(2, 69) if k != 17]
        assert plane.hits == ("1:+Z", *from_above, *(f"{k}:+X" for k in range(69, 75)))
        # Measured: 0.0173 of the energy outside, the least correlation 0.763.
        assert plane.outside_fe < 0.02
        assert plane.sign_agreement.min() > 0.7

    def test_signs_do_not_hang_on_the_band_or_the_number_of_shapes(self, plane, measured):
        raw = np.load(measured / "uliege_plane" / "frf.npz")
        fe = np.load(measured / "uliege_plane" / "fe_modes.npz")["shape"]
        H = raw["H"][list(datasets.RECORDS)].transpose(2, 1, 0)
        shapes = fe[:, np.arange(74), np.where(np.arange(74) < 68, 2, 0)]
        truth = np.ones(74)
        truth[[0, *range(68, 74)]] = -1
        for low, high, count in ((10, 60, 2), (10, 95, 4), (10, 100, 5), (5, 115, 6), (10, 110, 8)):
            band = (raw["freq"] >= low) & (raw["freq"] <= high)
            np.testing.assert_array_equal(hit_signs(H[band], shapes[:count])[0], truth)

    def test_accelerometers_sit_at_wing_tip_tail_tip_and_fin_top(self, plane):
        places = plane.geometry.places(plane.frf.outputs)
        np.testing.assert_allclose(places, [[0.7, 0.85, 0], [0.2, 0.0, 0.075], [0, 0, 0.3]], atol=1e-12)
        # Measured 0.005, 0.007, 0.063.
        assert plane.sensor_mismatch.max() < 0.08

    def test_at_a_resonance_the_shape_is_smooth_along_the_wing(self, plane):
        """First bending at 18.9 Hz: with a wrong sign neighbours would differ by twice the shape."""
        at = int(np.argmin(np.abs(np.asarray(plane.frf.freq) - 18.875)))
        edge = [plane.frf.inputs.index(f"{k}:+Z") for k in range(1, 28, 2) if k != 17]
        shape = np.imag(plane.frf.H[at, 0, np.array(edge)])
        # Measured 0.21; a wrong sign at the tip would make it 1.8.
        assert np.abs(np.diff(shape)).max() < 0.3 * np.abs(shape).max()

    def test_units_and_drive_point(self, plane, measured):
        raw = np.load(measured / "uliege_plane" / "frf.npz")
        H = np.asarray(plane.frf.H[:, 0, plane.frf.inputs.index("3:+Z")])
        np.testing.assert_allclose(np.abs(H), 9.80665 * np.abs(raw["H"][3, 0]), rtol=1e-12)
        np.testing.assert_allclose(
            np.abs(plane.blocks[2, 1]), 9.80665 * np.abs(raw["x"][3, 1].astype(float)), rtol=1e-12
        )
        band = slice(80, 900)
        # A drive-point accelerance has no negative imaginary part; measured 0.98 of the energy on the right side.
        assert H[band].imag.sum() > 0.9 * np.abs(H[band].imag).sum()
        assert not looks_conjugated(plane.frf)

    def test_copy_is_left_out_unless_wanted(self, plane, measured):
        assert plane.copied == ("17",) and plane.frf.shape == (1601, 3, 73) == (1601, 3, plane.fe_shapes.shape[1])
        whole = datasets.uliege_plane(averages=5, at_hits=True, copies=True)
        assert whole.frf.shape == (1601, 3, 74) and whole.frf.outputs == ("3:+Z", "58:+Z", "70:+X")
        np.testing.assert_array_equal(whole.blocks[16], whole.blocks[15])
        expected = np.abs(whole.frf.H) ** 2 * (1 - whole.frf.coherence) / (5 * whole.frf.coherence)
        np.testing.assert_allclose(whole.frf.variance, expected, rtol=1e-12)

    def test_outline_is_drawn_through_every_node_but_the_sensors(self, plane):
        drawn = {n for line in plane.geometry.lines for n in line}
        assert set(plane.geometry.nodes) - drawn == {"101", "102", "103"}
        xyz = np.asarray(plane.geometry.xyz)
        ends = xyz[plane.geometry.segments]
        # Nodes are 50 mm apart along, 100 mm across; between the left and right roots as well.
        assert np.abs(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) - 0.075).max() < 0.0251


@pytest.mark.measured
@pytest.mark.parametrize("name", datasets.SETS)
def test_files_of_published_frfs_load_by_themselves(name, measured, tmp_path):
    """By name and hash; a file that only has the name is refused as any other, with what it would need."""
    with pytest.warns(UserWarning, match=f"{name}: the published measurement .* names, signs and units are from there"):
        loaded = load(measured / name)
    expected = datasets.known_measurement(measured / name)
    expected = expected if isinstance(expected, Measurement) else Measurement.from_frfs([expected])
    places = datasets.known_geometry(measured / name)
    assert (places is None) == name.startswith("brake") and (places is None or len(places.nodes) > 8)
    np.testing.assert_array_equal(loaded.H, expected.H)
    assert (loaded.outputs, loaded.inputs, loaded.form) == (expected.outputs, expected.inputs, "accelerance")
    other = tmp_path / name
    other.parent.mkdir()
    np.savez(other, freq=np.arange(3.0), H=np.ones((2, 3), complex))
    with pytest.raises(ValueError, match="no form in it; a measurement file needs"):
        load(other)


@pytest.mark.measured
def test_brake_reuss_beam(measured):
    beam = datasets.brake_reuss_beam()
    assert beam.H.shape == (4, 41, 1, 1) and beam.form == "accelerance"
    assert np.all(np.diff(beam.level) > 0)
    assert not looks_conjugated(beam)
    assert looks_conjugated(beam.replace(H=beam.H.conj()))
    assert beam.force.shape == (4, 41)
    np.testing.assert_allclose(beam.level, beam.force.mean(axis=1))
    turned = datasets.brake_reuss_beam(drive_point=True)
    assert turned.outputs == turned.inputs == ("beam",)
    # at a drive point the imaginary part of the accelerance is positive all through the resonance
    assert (np.asarray(turned.H).imag > 0).all()


@pytest.mark.measured
def test_steel_beam_has_a_drive_point(measured):
    beam = datasets.steel_beam()
    assert beam.frf.shape == (51201, 1, 9) and beam.frf.outputs == ("4:+X",)
    drive = np.asarray(beam.frf.pick(inputs=["4:+X"]).H[:, 0, 0])
    for peak in (111.99, 306.86, 596.37, 974.14):
        at = int(np.argmin(np.abs(np.asarray(beam.frf.freq) - peak)))
        assert drive[at - 3 : at + 4].imag.min() > 0
    np.testing.assert_allclose(beam.geometry.places(["4:+X"]), [[0, 0, 0.5]], atol=1e-12)


@pytest.mark.measured
def test_records(measured):
    hits = datasets.hammer_hits()
    assert hits.input.shape == hits.output.shape == (5, 25600)
    np.testing.assert_allclose(np.diff(hits.time), 1 / hits.sample_rate, rtol=1e-9)
    box = datasets.silverbox()
    assert box.input.shape == (1, 131072) and box.sample_rate == pytest.approx(610.35, abs=0.01)
