"""Every unusable file is refused by one line that names the file, what was seen and what would be right."""

import subprocess
import sys

import numpy as np
import pytest
import scipy.io

import modalax

N = 12


def good() -> dict[str, np.ndarray]:
    """Arrays of a sound measurement: 2 runs, 12 lines, 3 outputs, 2 inputs."""
    rng = np.random.default_rng(0)
    freq = np.linspace(10.0, 21.0, N)
    modes = 1 / ((2 * np.pi * 15) ** 2 - (2 * np.pi * freq) ** 2 + 2j * 0.05 * 2 * np.pi * 15 * 2 * np.pi * freq)
    H = modes[None, :, None, None] * rng.uniform(0.5, 1.0, (2, 1, 3, 2))
    return {
        "freq": freq, "H": H, "level": np.array([1.0, 2.0]), "form": np.array("receptance"),
        "outputs": np.array(["1:+Z", "2:+Z", "3:+Z"]), "inputs": np.array(["1:+Z", "2:+Z"]),
    }  # fmt: skip


def refused(path, pattern: str, error: type[Exception] = ValueError) -> str:
    with pytest.raises(error, match=pattern) as caught:
        modalax.load(path)
    message = str(caught.value)
    assert path.name in message, "the message does not name the file"
    assert "\n" not in message
    return message


def with_npz(tmp_path, **changes) -> object:
    arrays = {k: v for k, v in {**good(), **changes}.items() if v is not None}
    np.savez(tmp_path / "data.npz", **arrays)
    return tmp_path / "data.npz"


def test_the_sound_file_loads(tmp_path):
    assert modalax.load(with_npz(tmp_path)).H.shape == (2, N, 3, 2)


def test_missing_file(tmp_path):
    refused(tmp_path / "nowhere.npz", "no such file", FileNotFoundError)


@pytest.mark.parametrize(
    ("content", "pattern"),
    [
        (b"", "empty"),
        (b"freq;magnitude\n1;2\n", "begins with 'freq;magnitude'"),
        (b"\x93NUMPY\x01\x00", "names neither its axes"),
        (b"%PDF-1.4 ...", "begins with '%PDF"),
    ],
)
@pytest.mark.parametrize("ending", ["npz", "uff", "mat", "nc"])
def test_content_that_is_no_measurement_at_all(tmp_path, content, pattern, ending):
    path = tmp_path / f"data.{ending}"
    path.write_bytes(content)
    refused(path, pattern)


def test_folder_that_is_no_store(tmp_path):
    folder = tmp_path / "data.zarr"
    folder.mkdir()
    refused(folder, "not a Zarr store")


@pytest.mark.parametrize("ending", ["npz", "mat", "nc", "uff"])
@pytest.mark.parametrize("share", [0.3, 0.7, 0.98])
def test_file_cut_short(tmp_path, ending, share):
    whole, path = tmp_path / f"whole.{ending}", tmp_path / f"cut.{ending}"
    modalax.save(modalax.load(with_npz(tmp_path)), whole)
    content = whole.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    refused(path, "cut short|damaged|cannot be read")


@pytest.mark.parametrize("name", ["freq", "H", "form"])
def test_missing_key_is_named(tmp_path, name):
    refused(with_npz(tmp_path, **{name: None}), f"no {name} in it; a measurement file needs freq, H, form[^,]")


@pytest.mark.parametrize("name", ["outputs", "inputs"])
def test_names_of_one_side_only_are_refused(tmp_path, name):
    refused(with_npz(tmp_path, **{name: None}), f"no {name} in it; .* needs the names of both outputs and inputs, or")


def test_file_of_none_of_the_three_kinds(tmp_path):
    np.savez(tmp_path / "x.npz", a=1, b=2)
    refused(tmp_path / "x.npz", "holds a, b; a measurement needs freq")


@pytest.mark.parametrize("name", ["M", "K", "C"])
def test_structure_with_a_missing_matrix(tmp_path, name):
    arrays = {"M": np.eye(2), "C": np.eye(2), "K": np.eye(2), "dofs": np.array(["1", "2"])}
    del arrays[name]
    np.savez(tmp_path / "s.npz", **arrays)
    refused(tmp_path / "s.npz", f"no {name} .*structure file needs M, C, K [(]here")


@pytest.mark.parametrize("value", [-0.1, np.nan])
def test_claimed_deviation_that_is_none(tmp_path, value):
    np.savez(tmp_path / "s.npz", M=np.eye(2), C=np.eye(2), K=np.eye(2), dofs=np.array(["1", "2"]), damping_std=value)
    refused(tmp_path / "s.npz", "damping_std is .*0 or positive")


def test_matrix_of_wrong_shape(tmp_path):
    np.savez(tmp_path / "s.npz", M=np.eye(2), C=np.eye(2), K=np.eye(3), dofs=np.array(["1", "2"]))
    refused(tmp_path / "s.npz", r"K has shape \(3, 3\).*\(2, 2\)")


def test_model_without_scale(tmp_path):
    np.savez(tmp_path / "m.npz", poles=[-1 + 10j], shapes=[[1.0, 2.0]], outputs=["1", "2"])
    refused(tmp_path / "m.npz", "needs participation, modal_a or modal_mass")


def test_model_with_lower_pole(tmp_path):
    np.savez(tmp_path / "m.npz", poles=[-1 - 10j], shapes=[[1.0]], modal_mass=[1.0], outputs=["1"])
    refused(tmp_path / "m.npz", "positive imaginary part")


def test_axes_in_another_order(tmp_path):
    message = refused(with_npz(tmp_path, H=good()["H"].transpose(0, 2, 3, 1)), "axis 1 holds 3 for 12 frequency lines")
    assert "(run, f, o, i) = (run, 12, 3, 2)" in message and "axis 3 has that length" in message


def test_outputs_and_inputs_exchanged(tmp_path):
    refused(with_npz(tmp_path, H=good()["H"].swapaxes(2, 3)), "axis 2 holds 2 for 3 outputs")


def test_single_run_without_run_axis_is_taken_where_the_names_tell_every_axis(tmp_path):
    H = good()["H"][0]
    np.testing.assert_array_equal(modalax.load(with_npz(tmp_path, H=H, level=None)).H, H[None])
    turned = with_npz(tmp_path, H=H.swapaxes(1, 2), level=None)
    refused(turned, r"H has 3 axes.*save H\[None\], or add axes = 'f o i'")
    declared = modalax.load(with_npz(tmp_path, H=H, level=None, axes=np.array("f o i")))
    np.testing.assert_array_equal(declared.H, H[None])
    refused(with_npz(tmp_path, axes=np.array("o i f")), "axes says 'o i f'")


def test_negative_frequency(tmp_path):
    refused(with_npz(tmp_path, freq=good()["freq"] - 20), "freq starts at -10 Hz")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_frequency_that_is_not_finite(tmp_path, value):
    freq = np.array(good()["freq"])
    freq[5] = value
    refused(with_npz(tmp_path, freq=freq), "freq holds 1 value that is not finite, the first at index")


def test_negative_variance(tmp_path):
    refused(with_npz(tmp_path, variance=np.full((2, N, 3, 2), -1.0)), "variance holds negative values")


def test_variance_of_another_shape(tmp_path):
    refused(with_npz(tmp_path, variance=np.ones((N, 3, 2))), r"variance has shape \(12, 3, 2\) and H \(2, 12, 3, 2\)")


def test_magnitudes_are_not_frfs(tmp_path):
    refused(with_npz(tmp_path, H=np.abs(good()["H"])), "H has type float64; FRFs are complex")


def test_unknown_form(tmp_path):
    refused(with_npz(tmp_path, form=np.array("inertance")), "form is 'inertance'; it must be one of receptance")


def test_name_that_stands_twice(tmp_path):
    refused(with_npz(tmp_path, inputs=np.array(["1:+Z", "1:+Z"])), "inputs names 1:.Z stand more than once")


def test_levels_that_do_not_fit_the_runs(tmp_path):
    refused(with_npz(tmp_path, level=np.ones(3)), r"level has shape \(3,\) for 2 runs")


@pytest.mark.parametrize("value", [0, 2.5])
def test_averages_that_are_no_count(tmp_path, value):
    refused(with_npz(tmp_path, averages=np.array(value)), "averages is")


def test_names_saved_as_python_objects(tmp_path):
    refused(with_npz(tmp_path, outputs=np.array(["a", "b", "c"], dtype=object)), "Python objects.*dtype=str")


def test_slip_in_the_name_of_an_optional_array_is_said(tmp_path):
    path = with_npz(tmp_path, Variance=np.ones((2, N, 3, 2)))
    with pytest.warns(UserWarning, match=r"data\.npz: array 'Variance' is not read; should it be named 'variance'"):
        modalax.load(path)


def test_single_precision_in_a_file_is_converted(tmp_path):
    H = good()["H"].astype(np.complex64)
    loaded = modalax.load(with_npz(tmp_path, H=H, freq=good()["freq"].astype(np.float32)))
    np.testing.assert_array_equal(loaded.H, H.astype(complex))


def test_matrices_in_single_precision_are_said(tmp_path):
    K = np.eye(2, dtype=np.float32)
    np.savez(tmp_path / "s.npz", M=np.eye(2), C=np.eye(2), K=K, dofs=np.array(["1", "2"]))
    with pytest.warns(UserWarning, match=r"s\.npz: K is stored in single precision"):
        modalax.load(tmp_path / "s.npz")


def test_option_for_another_kind_of_file(tmp_path):
    path = with_npz(tmp_path)
    with pytest.raises(ValueError, match="option complete is for UFF files, this one is npz"):
        modalax.load(path, complete=True)


def test_mat_file_written_by_matlab_loses_short_axes_and_gets_them_back(tmp_path):
    arrays = good()
    H = arrays["H"][:, :, :, :1]
    names = np.empty(3, dtype=object)
    names[:] = arrays["outputs"].tolist()
    content = {**arrays, "H": H[..., 0], "outputs": names, "inputs": "1:+Z"}
    scipy.io.savemat(tmp_path / "data.mat", content)
    loaded = modalax.load(tmp_path / "data.mat")
    np.testing.assert_array_equal(loaded.H, H)
    assert loaded.outputs == tuple(arrays["outputs"]) and loaded.inputs == ("1:+Z",)


def test_mat_file_of_version_7_3(tmp_path):
    """Written as MATLAB does: a block of 512 bytes, then HDF5 with reversed axes and text as numbers."""
    h5py = pytest.importorskip("h5py")
    arrays = good()
    with h5py.File(tmp_path / "data.mat", "w", userblock_size=512) as file:
        compound = np.zeros(arrays["H"].shape[::-1], dtype=[("real", "f8"), ("imag", "f8")])
        compound["real"], compound["imag"] = arrays["H"].T.real, arrays["H"].T.imag
        file["H"] = compound
        for name in ("freq", "level"):
            file[name] = arrays[name][:, None]
        file["form"] = np.array([[ord(c)] for c in "receptance"], dtype=np.uint16)
        file["form"].attrs["MATLAB_class"] = np.bytes_("char")
        for name in ("outputs", "inputs"):
            refs = []
            for k, text in enumerate(arrays[name]):
                file[f"#refs#/{name}{k}"] = np.array([[ord(c)] for c in text], dtype=np.uint16)
                refs.append(file[f"#refs#/{name}{k}"].ref)
            file.create_dataset(name, data=np.array([refs], dtype=object), dtype=h5py.ref_dtype)
            file[name].attrs["MATLAB_class"] = np.bytes_("cell")
    content = bytearray((tmp_path / "data.mat").read_bytes())
    content[:19] = b"MATLAB 7.3 MAT-file"
    (tmp_path / "data.mat").write_bytes(bytes(content))
    loaded = modalax.load(tmp_path / "data.mat")
    np.testing.assert_array_equal(loaded.H, arrays["H"])
    assert loaded.outputs == tuple(arrays["outputs"]) and loaded.form == "receptance"


def test_conjugated_frfs_are_turned_back_and_said(tmp_path):
    H = good()["H"]
    path = with_npz(tmp_path, H=H.conj())
    with pytest.warns(UserWarning, match=r"data\.npz: the FRFs look conjugated .* conjugate=False keeps them"):
        turned = modalax.load(path)
    np.testing.assert_array_equal(turned.H, H)
    np.testing.assert_array_equal(modalax.load(path, conjugate=True).H, H)
    np.testing.assert_array_equal(modalax.load(path, conjugate=False).H, H.conj())
    with pytest.raises(ValueError, match=r"data\.npz: conjugate is 'yes'; it must be True, False or 'detect'"):
        modalax.load(path, conjugate="yes")


def test_single_precision_of_jax_is_refused_with_the_line_to_add(tmp_path):
    """In an interpreter of its own, as the tests run in double precision."""
    path = with_npz(tmp_path)
    code = f"import modalax\ntry:\n    modalax.load({str(path)!r})\nexcept ValueError as error:\n    print(error)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == (
        "load needs double precision; add this line before the first use of JAX: "
        'jax.config.update("jax_enable_x64", True)'
    )


def test_text_in_place_of_numbers(tmp_path):
    refused(with_npz(tmp_path, freq=np.array(["a"] * N)), "freq has type <U1; it needs real numbers")


@pytest.mark.parametrize(
    ("scaling", "pattern"),
    [
        ({"modal_a": np.array([1j, 0j])}, "2 modal scalings, 1 of them zero, for 2 poles"),
        ({"modal_mass": np.ones(3)}, "shapes|modal scalings|broadcast"),
        ({}, "needs participation, modal_a or modal_mass"),
    ],
)
def test_scalings_of_a_modal_model_that_fit_no_modes(tmp_path, scaling, pattern):
    poles = np.array([-1 + 60j, -2 + 90j])
    path = tmp_path / "model.npz"
    np.savez(path, poles=poles, shapes=np.ones((2, 3)), outputs=np.array(["1", "2", "3"]), **scaling)
    refused(path, pattern)


def test_a_dataset_without_its_axes(tmp_path):
    from modalax.files.labelled import from_xarray, to_xarray

    dataset = to_xarray(modalax.load(with_npz(tmp_path)))
    with pytest.raises(ValueError, match="no output in the dataset, which holds"):
        from_xarray(dataset.drop_vars("output"))
    with pytest.raises(ValueError, match=r"H has the axes run, line, output, input; it needs run, freq, output, input"):
        from_xarray(dataset.assign(H=(("run", "line", "output", "input"), dataset["H"].to_numpy())))
