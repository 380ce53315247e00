"""What is saved is loaded again: same numbers, same names, for every kind of file that can hold it."""

from functools import cache

import jax
import numpy as np
import pytest

import modalax
from modalax import Measurement, ModalModel, Structure
from modalax.files.labelled import from_xarray, to_xarray
from modalax.model.examples import five_dof


@cache
def measurement(form: str = "receptance", runs: int = 2, inputs: tuple[str, ...] = ("1", "3")) -> Measurement:
    """Noisy FRFs of the five-DoF system with everything a measurement may carry."""
    freq = np.linspace(20.0, 70.0, 101)
    clean = five_dof().frf(freq, form=form, inputs=inputs)
    noisy = [clean.add_noise(jax.random.key(r), 0.03).replace(level=np.pi * (r + 1)) for r in range(runs)]
    coherence = np.random.default_rng(0).uniform(0.5, 1.0, (runs, *clean.shape))
    return Measurement.from_frfs(noisy).replace(averages=7, coherence=coherence, added_decay=0.25)


def same(a: Measurement, b: Measurement, rtol: float = 0.0) -> None:
    for name in ("freq", "H", "variance", "coherence", "level", "added_decay"):
        first, second = getattr(a, name), getattr(b, name)
        assert (first is None) == (second is None), name
        if first is not None:
            np.testing.assert_allclose(second, first, rtol=rtol, atol=0, err_msg=name)
    assert (a.form, a.outputs, a.inputs, a.averages) == (b.form, b.outputs, b.inputs, b.averages)


@pytest.mark.parametrize("form", ["receptance", "mobility", "accelerance"])
@pytest.mark.parametrize("ending", ["npz", "uff", "mat", "nc", "zarr"])
def test_measurement_comes_back_exactly(tmp_path, ending, form):
    path = tmp_path / f"data.{ending}"
    saved = measurement(form)
    modalax.save(saved, path)
    same(saved, modalax.load(path))


@pytest.mark.parametrize("ending", ["npz", "uff", "mat", "nc", "zarr"])
def test_one_run_of_one_channel_with_unknown_level_keeps_its_axes(tmp_path, ending):
    path = tmp_path / f"data.{ending}"
    frf = measurement(inputs=("1",)).run(0).pick(["4"]).replace(level=float("nan"), variance=None, averages=None)
    modalax.save(frf, path)
    loaded = modalax.load(path)
    assert loaded.H.shape == (1, 101, 1, 1)
    same(Measurement.from_frfs([frf]), loaded)


@pytest.mark.parametrize("ending", ["npz", "mat"])
def test_claimed_inaccuracy_and_pairs_of_a_structure_come_back(tmp_path, ending):
    saved = five_dof().replace(stiffness_std=0.03, mass_std=0.01, pairs=[("1", "2"), ("3", "5")])
    modalax.save(saved, tmp_path / f"model.{ending}")
    loaded = modalax.load(tmp_path / f"model.{ending}")
    assert loaded.pairs == (("1", "2"), ("3", "5"))
    assert (float(loaded.stiffness_std), float(loaded.mass_std)) == (0.03, 0.01)
    modalax.save(five_dof(), tmp_path / f"plain.{ending}")
    plain = modalax.load(tmp_path / f"plain.{ending}")
    assert plain.stiffness_std is None and plain.mass_std is None and plain.pairs is None


@pytest.mark.parametrize("pairs", [[("1", "1")], [("1", "9")], [("1",)]])
def test_pairs_need_two_dofs_of_the_structure(pairs):
    with pytest.raises(ValueError, match="a pair is two different DoFs|no DoF named '9'"):
        five_dof().replace(pairs=pairs)


@pytest.mark.parametrize("ending", ["npz", "mat", "nc"])
def test_the_force_at_every_line_comes_back(tmp_path, ending):
    saved = measurement()
    force = np.random.default_rng(1).uniform(1.0, 2.0, (2, 101))
    saved = saved.replace(force=force, level=force.mean(axis=1))
    modalax.save(saved, tmp_path / f"data.{ending}")
    loaded = modalax.load(tmp_path / f"data.{ending}")
    same(saved, loaded)
    np.testing.assert_array_equal(np.asarray(loaded.force), force)
    assert loaded.band(30.0, 40.0).force.shape == (2, loaded.band(30.0, 40.0).freq.shape[0])
    np.testing.assert_array_equal(np.asarray(loaded.to_form("mobility").force), force)
    with pytest.raises(ValueError, match="one amplitude for each run and line"):
        saved.replace(force=force[:, :-1])


@pytest.mark.parametrize("ending", ["npz", "mat"])
def test_structure_comes_back_exactly(tmp_path, ending):
    s = five_dof()
    s = Structure(s.M, s.C, s.K, s.dofs, frequency_std=0.01, damping_std=np.full(5, 0.3), D=0.01 * s.K)
    modalax.save(s, tmp_path / f"s.{ending}")
    loaded = modalax.load(tmp_path / f"s.{ending}")
    assert isinstance(loaded, Structure) and loaded.dofs == s.dofs
    for name in ("M", "C", "K", "D", "frequency_std", "damping_std"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(s, name))


@pytest.mark.parametrize("ending", ["npz", "mat"])
def test_modal_model_comes_back_exactly(tmp_path, ending):
    model = five_dof().modal()
    model = model.replace(upper=np.ones((5, 5)) * 1e-9j, lower=2.0, frequency_std=0.01, damping_std=0.1)
    modalax.save(model, tmp_path / f"m.{ending}")
    loaded = modalax.load(tmp_path / f"m.{ending}")
    assert isinstance(loaded, ModalModel) and (loaded.outputs, loaded.inputs) == (model.outputs, model.inputs)
    for name in ("poles", "shapes", "participation", "upper", "lower", "frequency_std", "damping_std"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(model, name))


@pytest.mark.parametrize("scaling", ["modal_a", "modal_mass"])
def test_model_file_may_give_modal_a_or_modal_mass(tmp_path, scaling):
    model = five_dof().modal()
    np.savez(
        tmp_path / "m.npz", frequency_hz=model.frequency_hz, damping_ratio=model.damping_ratio, shapes=model.shapes,
        outputs=np.array(model.outputs), inputs=np.array(["1"]), **{scaling: np.asarray(getattr(model, scaling)())},
    )  # fmt: skip
    loaded = modalax.load(tmp_path / "m.npz")
    freq = np.linspace(0, 80, 17)
    # Poles pass through frequency and damping, 1e-15 relative; near a resonance of 2 % damping that is 1e-13.
    np.testing.assert_allclose(loaded.frf(freq).H, model.frf(freq, inputs=["1"]).H, rtol=1e-11)


def test_a_shape_that_stands_for_the_participation_is_scaled_by_the_modal_mass(tmp_path):
    model = five_dof().modal()
    names, path = np.array(model.outputs), tmp_path / "m.npz"
    given = {
        "frequency_hz": model.frequency_hz, "damping_ratio": model.damping_ratio, "shapes": model.shapes,
        "modal_mass": np.asarray(model.modal_mass()), "outputs": names, "inputs": names,
    }  # fmt: skip
    freq, expected = np.linspace(0, 80, 17), model.frf(np.linspace(0, 80, 17)).H
    for participation in (model.shapes, model.participation, np.asarray(model.participation) * 1.1):
        np.savez(path, participation=participation, **given)
        found = np.asarray(modalax.load(path).frf(freq).H)
        factor = 1.1 if participation is not model.shapes and participation is not model.participation else 1.0
        np.testing.assert_allclose(found, factor * np.asarray(expected), rtol=1e-9)
    np.savez(path, participation=3.0 * np.asarray(model.participation), **given)
    with pytest.raises(ValueError, match=r"m\.npz.*participation and modal_mass contradict each other: mode 1 has"):
        modalax.load(path)


def test_xarray_both_ways_and_in_any_order_of_axes():
    saved = measurement("mobility")
    dataset = to_xarray(saved)
    assert dataset["H"].attrs["units"] == "(m/s)/N" and dataset["freq"].attrs["units"] == "Hz"
    same(saved, from_xarray(dataset.transpose("input", "run", "output", "freq")))
    one = from_xarray(dataset.isel(run=0, drop=True).drop_vars(["level"], errors="ignore"))
    np.testing.assert_array_equal(one.H[0], saved.H[0])


def test_saving_does_not_overwrite_unless_told(tmp_path):
    path = tmp_path / "data.npz"
    modalax.save(measurement(), path)
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r"data\.npz exists already.*overwrite=True"):
        modalax.save(five_dof(), path)
    assert path.read_bytes() == before
    modalax.save(five_dof(), path, overwrite=True)
    assert isinstance(modalax.load(path), Structure)


@pytest.mark.parametrize("ending", ["npz", "zarr"])
def test_a_failed_save_leaves_the_old_file_and_nothing_else(tmp_path, ending):
    path = tmp_path / f"data.{ending}"
    modalax.save(measurement(), path)
    with pytest.raises(ValueError, match="str cannot be saved|str has no labelled form"):
        modalax.save("not a measurement", path, overwrite=True)
    same(measurement(), modalax.load(path))
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_structure_has_no_place_in_uff_or_netcdf(tmp_path):
    with pytest.raises(ValueError, match="Structure .* universal file"):
        modalax.save(five_dof(), tmp_path / "s.uff")
    with pytest.raises(ValueError, match="Structure has no labelled form"):
        modalax.save(five_dof(), tmp_path / "s.nc")


def test_unknown_ending_and_missing_folder_are_said(tmp_path):
    with pytest.raises(ValueError, match=r"ending '.xlsx' is not one that can be written; use .npz"):
        modalax.save(measurement(), tmp_path / "data.xlsx")
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        modalax.save(measurement(), tmp_path / "nowhere" / "data.npz")


def test_content_counts_not_the_ending(tmp_path):
    modalax.save(measurement(), tmp_path / "data.npz")
    (tmp_path / "data.npz").rename(tmp_path / "data.uff")
    same(measurement(), modalax.load(str(tmp_path / "data.uff")))
