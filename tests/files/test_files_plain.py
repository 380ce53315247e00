"""Plain files as laboratories hand them over: what they say is read, what is guessed is said, the rest is asked for."""

import warnings

import numpy as np
import pytest
import scipy.io

import modalax
from modalax import Measurement, Structure
from modalax.files.labelled import from_xarray, to_xarray

F = np.linspace(10.0, 21.0, 12)
H = (1 / (225 - F**2 + 3j))[:, None, None] * np.array([[1.0, 0.5], [0.3, -0.2], [0.7, 0.1]])  # 3 outputs, 2 inputs


def read(path, *notes: str, **told) -> Measurement:
    """Load a file; the notes are all that is said."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        found = modalax.load(path, conjugate=False, **told)
    texts = [str(w.message) for w in heard]
    assert len(texts) == len(notes) and all(any(n in t for t in texts) for n in notes), texts
    assert all(str(path) in t for t in texts)
    return found


def saved(path, **arrays):
    (scipy.io.savemat(path, arrays) if path.suffix == ".mat" else np.savez(path, **arrays))
    return path


@pytest.mark.parametrize("ending", ["npz", "mat"])
def test_frequencies_and_one_frf_alone(tmp_path, ending):
    path = saved(tmp_path / f"a.{ending}", freq=F, H=H[:, 0, 0])
    with pytest.raises(ValueError, match=r"a\.\w+: no form in it.*form='accelerance' \(--form accelerance\)"):
        modalax.load(path)
    found = read(path, "outputs have no names and are called o1;", "inputs have no names", form="accelerance")
    assert (found.form, found.outputs, found.inputs) == ("accelerance", ("o1",), ("i1",))
    np.testing.assert_array_equal(found.H[0, :, 0, 0], H[:, 0, 0])


def test_several_columns_are_outputs_or_inputs_only_if_that_is_said(tmp_path):
    path = saved(tmp_path / "a.npz", freq=F, H=H[:, :, 0])
    with pytest.raises(ValueError, match=r"does not tell outputs from inputs; .*--outputs, --inputs.*--axes 'f o i'"):
        modalax.load(path, form="mobility")
    by_names = read(path, "inputs have no names", form="mobility", outputs=["a", "b", "c"])
    by_axes = read(path, "o1 to o3", "called i1", form="mobility", axes="f o")
    roving = read(path, "called o1;", "i1 to i3", form="mobility", axes="f i")
    np.testing.assert_array_equal(by_names.H[0], H[:, :, :1])
    np.testing.assert_array_equal(by_axes.H, by_names.H)
    np.testing.assert_array_equal(roving.H[0], H[:, :, :1].transpose(0, 2, 1))
    with pytest.raises(ValueError, match="fits no order of axes"):
        modalax.load(path, form="mobility", outputs=["a", "b"])


def test_three_axes_in_any_order_by_names_or_as_told(tmp_path):
    path = saved(tmp_path / "a.npz", freq=F, H=H.transpose(2, 1, 0))
    with pytest.raises(ValueError, match="does not tell outputs from inputs"):
        modalax.load(path, form="receptance")
    named = read(path, form="receptance", outputs=["1", "2", "3"], inputs=["1", "2"])
    np.testing.assert_array_equal(named.H[0], H)
    np.testing.assert_array_equal(read(path, "outputs", "inputs", form="receptance", axes="i o f").H[0], H)
    for axes, pattern in (("f o i", "axes says 'f o i', but H has shape"), ("o i", "names each axis once")):
        with pytest.raises(ValueError, match=pattern):
            modalax.load(path, form="receptance", axes=axes)


@pytest.mark.parametrize("kept", [True, False])
def test_three_axes_told_of_a_matlab_file_of_one_input(tmp_path, kept):
    """With or without its last axis of length one, which MATLAB drops; a native file beside it has four axes."""
    names = {"outputs": ["1", "2", "3"], "inputs": ["1"]}
    path = saved(tmp_path / "a.mat", freq=F, H=H[:, :, :1] if kept else H[:, :, 0], form="receptance", **names)
    np.testing.assert_array_equal(modalax.load(path, axes="f o i").H[0], H[:, :, :1])


def test_as_many_lines_as_outputs_are_not_told_apart_by_length(tmp_path):
    square = saved(tmp_path / "a.npz", freq=F, H=np.ones((12, 12)) + 0j)
    with pytest.raises(ValueError, match="does not tell outputs from inputs"):
        modalax.load(square, form="receptance", outputs=[str(k) for k in range(12)])


@pytest.mark.parametrize("ending", ["npz", "mat"])
@pytest.mark.parametrize("name", ["f", "frequency"])
def test_usual_names(tmp_path, ending, name):
    path = saved(tmp_path / f"a.{ending}", **{name: F, "FRF": H})
    told = {"outputs": ["1", "2", "3"], "inputs": ["1", "2"], "unit": "g/N"}
    found = read(path, f"{name} is taken as freq", "FRF is taken as H", **told)
    assert found.form == "accelerance"
    np.testing.assert_allclose(found.H[0], 9.80665 * H, rtol=1e-14)


def test_parts_and_circular_frequency(tmp_path):
    path = saved(tmp_path / "a.npz", omega=2 * np.pi * F, H_re=H.real, H_im=H.imag)
    found = read(path, "circular frequency", "imaginary part", "o1 to o3", "i1 to i2", form="receptance", axes="f o i")
    np.testing.assert_allclose(found.freq, F, rtol=1e-14)
    np.testing.assert_array_equal(found.H[0], H)


def test_units_that_are_told(tmp_path):
    path = saved(tmp_path / "a.npz", freq=F / 1e3, H=H[:, 0, 0])
    found = read(path, "outputs", "inputs", unit="mm/N", frequency_unit="kHz")
    np.testing.assert_allclose(found.freq, F, rtol=1e-14)
    np.testing.assert_allclose(found.H[0, :, 0, 0], 1e-3 * H[:, 0, 0], rtol=1e-14)
    with pytest.raises(ValueError, match="mm/N is the unit of receptance, and form says 'mobility'"):
        modalax.load(path, unit="mm/N", form="mobility")


def test_a_file_of_the_contract_that_lacks_one_list_of_names_is_still_incomplete(tmp_path):
    path = saved(tmp_path / "a.npz", freq=F, H=H[None], form="receptance", outputs=["1", "2", "3"])
    with pytest.raises(ValueError, match="no inputs in it"):
        modalax.load(path)
    assert read(path, inputs=["1", "2"]).inputs == ("1", "2")


def test_matrices_without_names(tmp_path):
    path = saved(tmp_path / "s.npz", M=np.eye(2), C=np.zeros((2, 2)), K=np.eye(2))
    with pytest.warns(UserWarning, match=r"s\.npz: its DoFs have no names and are called 1, 2"):
        found = modalax.load(path)
    assert isinstance(found, Structure) and found.dofs == ("1", "2")
    with pytest.raises(ValueError, match="option form is for measured FRFs"):
        modalax.load(path, form="receptance")


def table(path, titles, columns, mark=",", decimal="."):
    rows = [mark.join(f"{v:.17g}".replace(".", decimal) for v in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([mark.join(titles), *rows]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(("mark", "decimal"), [(",", "."), (";", ","), ("\t", "."), ("\t", ",")])
def test_table_of_named_pairs(tmp_path, mark, decimal):
    names = [f"{o}:+Z/{i}:+Z" for o in (1, 2, 3) for i in (1, 2)]
    titles = ["freq [Hz]", *(f"{part} {name}" for name in names for part in ("re", "im"))]
    values = [part for column in H.reshape(12, 6).T for part in (column.real, column.imag)]
    found = read(table(tmp_path / "a.csv", titles, [F, *values], mark, decimal), form="receptance")
    assert found.outputs == ("1:+Z", "2:+Z", "3:+Z") and found.inputs == ("1:+Z", "2:+Z")
    np.testing.assert_array_equal(found.H[0], H)
    np.testing.assert_array_equal(found.freq, F)


def test_table_of_magnitudes_and_phases(tmp_path):
    one = H[:, 0, 0]
    titles = ["f", "H11 mag", "H11 phase [deg]"]
    path = table(tmp_path / "a.csv", titles, [F, np.abs(one), np.degrees(np.angle(one))])
    found = read(path, "outputs", "inputs", form="accelerance")
    np.testing.assert_allclose(found.H[0, :, 0, 0], one, rtol=1e-13)


def test_table_whose_columns_are_outputs_of_one_input(tmp_path):
    titles = ["freq", "Re(a)", "Im(a)", "Re(b)", "Im(b)"]
    path = table(tmp_path / "a.csv", titles, [F, H[:, 0, 0].real, H[:, 0, 0].imag, H[:, 1, 0].real, H[:, 1, 0].imag])
    with pytest.raises(ValueError, match="columns are named a, b, which does not tell outputs from inputs"):
        modalax.load(path, form="receptance")
    found = read(path, form="receptance", inputs=["hammer"])
    assert found.outputs == ("a", "b") and found.inputs == ("hammer",)
    np.testing.assert_array_equal(found.H[0], H[:, :2, :1])


PARTS = [F, H[:, 0, 0].real, H[:, 0, 0].imag]
NAMELESS = ("outputs", "inputs")


@pytest.mark.parametrize(
    ("above", "below", "mark", "encoding"),
    [
        ("Project;Beam\nDate;3.4.2020\n\n", "", ";", "utf-8"),
        ("% of last spring\n# channel 1\n", "", ",", "utf-8"),
        ("", "Hz;m/N;m/N\n", ";", "utf-8"),
        ("", "", "\t", "utf-16"),
    ],
)
def test_text_above_a_header_units_below_it_and_encodings(tmp_path, above, below, mark, encoding):
    text = table(tmp_path / "a.csv", ["Frequency", "Real", "Imag"], PARTS, mark).read_text()
    head, rest = text.split("\n", 1)
    (tmp_path / "a.csv").write_text(f"{above}{head}\n{below}{rest}", encoding=encoding)
    found = read(tmp_path / "a.csv", *NAMELESS, **({} if below else {"form": "receptance"}))
    assert found.form == "receptance"
    np.testing.assert_array_equal(found.H[0, :, 0, 0], H[:, 0, 0])


def test_units_in_titles_give_form_and_size(tmp_path):
    path = table(tmp_path / "a.csv", ["Frequency (kHz)", "Real (g/N)", "Imaginary (g/N)"], PARTS)
    found = read(path, *NAMELESS)
    assert found.form == "accelerance" and found.freq[-1] == 21_000.0
    np.testing.assert_allclose(found.H[0, :, 0, 0], 9.80665 * H[:, 0, 0], rtol=1e-14)
    with pytest.raises(ValueError, match="its titles say g/N and unit says m/N"):
        modalax.load(path, unit="m/N")
    path = table(
        tmp_path / "b.csv", ["freq", "re a [g/N]", "im a [g/N]", "re b [m/N]", "im b [m/N]"], [*PARTS, *PARTS[1:]]
    )
    with pytest.raises(ValueError, match="columns are in g/N, m/N; FRFs of one file need one unit"):
        modalax.load(path)


def test_decibels_and_phases_of_more_than_a_few_radians_are_told_from_their_numbers(tmp_path):
    one = H[:, 0, 0]
    columns = [F, 20 * np.log10(np.abs(one)), np.degrees(np.angle(one)) - 180]
    path = table(tmp_path / "a.csv", ["f", "Magnitude (dB)", "Phase"], columns)
    found = read(path, "20 log10", "taken as degrees", *NAMELESS, form="receptance")
    np.testing.assert_allclose(found.H[0, :, 0, 0], -one, rtol=1e-12)


def test_lines_with_empty_cells_are_left_out_where_they_are_few(tmp_path):
    f = np.linspace(10, 20, 41)
    path = table(tmp_path / "a.csv", ["freq", "re", "im"], [f, f, f])
    rows = path.read_text().split("\n")
    rows[5], rows[8] = "11,,11", ",3,3"
    path.write_text("\n".join(rows))
    said = ("no finite number at line 11 Hz; left out", "1 of 41 lines have no frequency")
    found = read(path, *said, *NAMELESS, form="receptance")
    np.testing.assert_array_equal(found.freq, np.delete(f, [4, 7]))


@pytest.mark.parametrize(
    ("name", "content", "pattern"),
    [
        ("a.csv", b"5,0.6,0.1\n6,0.7,0.2\n7,0.6,0.1\n", "columns of numbers; a header above them names"),
        (
            "a.xlsx",
            b"PK\x03\x04..[Content_Types].xml...",
            "an Excel workbook, which is not read; save its sheet as CSV",
        ),
    ],
)
def test_what_is_no_table_of_frfs_is_named(tmp_path, name, content, pattern):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=pattern):
        modalax.load(tmp_path / name, form="receptance")


@pytest.mark.parametrize(
    ("titles", "said"),
    [
        (lambda o, i: (f"H({o}Z;{i}Z) real", f"H({o}Z;{i}Z) imag"), ()),
        (lambda o, i: (f"Real({o}Z,{i}Z)", f"Imag({o}Z,{i}Z)"), ()),
        (lambda o, i: (f"FRF point {o}Z, ref {i}Z (real)", f"FRF point {o}Z, ref {i}Z (imag)"), ()),
        (lambda o, i: (f"Re H{o}{i}", f"Im H{o}{i}"), ("H11 is taken as output 1 by input 1, H32 as output 3 by",)),
        (lambda o, i: (f"H_{o}_{i}_re", f"H_{o}_{i}_im"), ("H_1_1 is taken as output 1 by input 1",)),
    ],
)
@pytest.mark.parametrize("mark", [",", ";"])
def test_names_that_tell_output_and_input(tmp_path, titles, said, mark):
    named = [title for o in (1, 2, 3) for i in (1, 2) for title in titles(o, i)]
    values = [part for column in H.reshape(12, 6).T for part in (column.real, column.imag)]
    if mark == "," and "," in named[0] and "(" not in named[0].split(",")[0]:
        named = [f'"{name}"' for name in named]
    found = read(table(tmp_path / "a.csv", ["freq", *named], [F, *values], mark), *said, form="receptance")
    unit = "" if said else "Z"
    assert found.outputs == tuple(f"{k}{unit}" for k in "123") and found.inputs == tuple(f"{k}{unit}" for k in "12")
    np.testing.assert_array_equal(found.H[0], H)


def test_names_that_hold_commas_or_indices_that_fill_no_grid_stay_names(tmp_path):
    for names in (("wing, left", "wing, right"), ("H11", "H22"), ("s1", "s2")):
        titles = [f'"{part} {name}"' for name in names for part in ("re", "im")]
        path = table(tmp_path / "a.csv", ["freq", *titles], [F, *PARTS[1:], *PARTS[1:]])
        found = read(path, form="receptance", inputs=["hammer"])
        assert found.outputs == names and found.inputs == ("hammer",)


@pytest.mark.parametrize("shape", ["{:.17g}{:+.17g}i", "({:.17g}{:+.17g}j)", "{:.17g} + {:.17g}i"])
def test_columns_of_complex_numbers(tmp_path, shape):
    rows = [
        ",".join([f"{f}", *(shape.format(v.real, v.imag) for v in row)]) for f, row in zip(F, H[:, :2, 0], strict=True)
    ]
    (tmp_path / "a.csv").write_text("\n".join(["freq,a/x [g/N],b/x [g/N]", *rows]).replace("+ -", "- "))
    found = read(tmp_path / "a.csv")
    assert (found.form, found.outputs, found.inputs) == ("accelerance", ("a", "b"), ("x",))
    np.testing.assert_allclose(found.H[0], 9.80665 * H[:, :2, :1], rtol=1e-14)


def test_the_fields_of_one_struct_are_read(tmp_path):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"run3": {"f": F, "FRF": H, "note": {"by": "hand"}}, "scale": 1.0})
    found = read(path, "fields of run3 are read", "f is taken as freq", "FRF is taken as H", *NAMELESS,
                 form="receptance", axes="f o i")  # fmt: skip
    np.testing.assert_array_equal(found.H[0], H)
    for content, pattern in (
        ({"a": {"f": F}, "b": {"f": F}}, r"structs a, b, of which none is read.*save\('FILE', '-struct', 'a'\)"),
        ({"a": {"left": 1.0, "right": 2.0}}, "a is a struct of left, right, none of which is read"),
        ({"a": np.array([(1.0,), (2.0,)], dtype=[("f", "O")])}, "a is an array of 2 structs"),
    ):
        scipy.io.savemat(path, content)
        with pytest.raises(ValueError, match=pattern):
            modalax.load(path, form="receptance")


def test_numbers_that_no_structure_has_are_named(tmp_path):
    path = saved(tmp_path / "a.npz", freq=F, H=1e-200 * H[None], outputs=["1", "2", "3"], inputs=["1", "2"])
    with pytest.raises(ValueError, match="at most; no structure has such FRFs"):
        modalax.load(path, form="receptance")


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("freq;magnitude\n1;2\n", "magnitude|begins with 'freq;magnitude'"),
        ("freq,re a,im a\n1,2\n", "line 2 has 2 columns, the header 3"),
        ("freq,re a,im a\n1,2,x\n", "line 2 holds what is no number"),
        ("freq,mag a,phase a\n1,2,3\n", "phase is in deg or rad"),
        ("freq,re a\n1,2\n", "of FRF a there is real only"),
        ("freq,re a,re a\n1,2,3\n", "stands twice"),
        ("freq [furlong],re a,im a\n1,2,3\n", "unit of frequencies is 'furlong'"),
        ("freq,re 1/2,im 1/2,re 2/1,im 2/1\n1,2,3,4,5\n", "FRF 1/1 is missing"),
        ("freq\n1\n", "the table has the columns freq"),
        ("freq,re a,im a\n", "shape|lines"),
    ],
)
def test_tables_that_cannot_be_used(tmp_path, text, pattern):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=pattern) as caught:
        modalax.load(path, form="receptance")
    assert str(path) in str(caught.value) and "unexpected" not in str(caught.value)


def test_datasets_with_real_and_imaginary_parts():
    xarray = pytest.importorskip("xarray")
    m = Measurement(F, H[None], outputs=["1", "2", "3"], inputs=["1", "2"])
    whole = to_xarray(m)
    apart = whole.drop_vars("H").assign(H_re=whole["H"].real, H_im=whole["H"].imag).rename(output="o", input="i")
    np.testing.assert_array_equal(from_xarray(apart).H, m.H)
    stacked = xarray.concat([whole["H"].real, whole["H"].imag], dim="part").assign_coords(part=["re", "im"])
    stacked.attrs["units"] = "m/N"
    dataset = stacked.to_dataset(name="FRF").rename(freq="f")
    found = from_xarray(dataset)
    assert found.form == "receptance"
    np.testing.assert_array_equal(found.H, m.H)


@pytest.mark.parametrize("ending", ["npz", "mat", "nc", "uff"])
def test_a_form_that_differs_from_the_stated_one(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    pytest.importorskip({"nc": "h5netcdf", "uff": "pyuff"}.get(ending, "numpy"))
    modalax.save(Measurement(F, H[None], form="mobility", outputs=["1", "2", "3"], inputs=["1", "2"]), path)
    assert read(path, form="mobility").form == "mobility"
    if ending == "uff":
        note = "it states that its FRFs are mobility; they are taken as receptance"
        assert read(path, note, form="receptance").form == "receptance"
        return
    words = r"its FRFs are mobility, and form='receptance' \(--form receptance\) says receptance"
    with pytest.raises(ValueError, match=rf"a\.{ending}: it states that {words}"):
        modalax.load(path, form="receptance")
    with pytest.raises(ValueError, match=r"its FRFs are mobility, and unit='mm/N' \(--unit mm/N\) says receptance"):
        modalax.load(path, unit="mm/N")


def test_a_unit_that_differs_from_the_stated_one(tmp_path):
    pytest.importorskip("h5netcdf")
    path = tmp_path / "a.nc"
    modalax.save(Measurement(F, H[None], form="mobility", outputs=["1", "2", "3"], inputs=["1", "2"]), path)
    assert read(path, unit="m/s/N", frequency_unit="Hz").form == "mobility"
    words = r"a\.nc: it states that its FRFs are in '\(m/s\)/N', and unit='mm/s/N' \(--unit mm/s/N\) says another"
    with pytest.raises(ValueError, match=words):
        modalax.load(path, unit="mm/s/N")
    words = r"its lines are in 'Hz', and frequency_unit='kHz' \(--frequency-unit kHz\) says another"
    with pytest.raises(ValueError, match=words):
        modalax.load(path, frequency_unit="kHz")
