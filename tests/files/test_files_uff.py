"""Universal files: what pyuff writes is read here, what is written here pyuff reads, with the same numbers."""

import warnings

import numpy as np
import pytest

import modalax
from modalax import Measurement, ModalModel
from modalax.data import Geometry
from modalax.files import load_geometry, load_modes
from modalax.files.record_kinds import kind_of
from modalax.files.sniff import sniff
from modalax.model.examples import five_dof

pyuff = pytest.importorskip("pyuff")
pytestmark = pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # pyuff leaves binary files open

FREQ = np.linspace(20.0, 70.0, 51)
# 12 digits of text: 11 after the point, so half a unit of the last is 5e-12 of a number between 1 and 10.
TEXT_DIGITS = 5e-12
# Shapes are written with 6 digits.
SHAPE_DIGITS = 5e-6
# Frequencies are written with 6 digits, in text and in the first line and the step of an even axis.
AXIS_DIGITS = 1e-5


def measurement(freq: np.ndarray = FREQ) -> Measurement:
    """Accelerances of three modes, 5 outputs over 2 inputs, along Z, X and rotations with mixed signs, noise of 3 %."""
    rng = np.random.default_rng(0)
    w = 2 * np.pi * freq[:, None]
    wn = 2 * np.pi * np.array([26.0, 37.0, 51.0])
    shapes = rng.normal(size=(3, 5))
    H = np.einsum("fn,no,ni->foi", -(w**2) / (wn**2 - w**2 + 0.04j * wn * w), shapes, shapes[:, [0, 2]])
    H = H * (1 + 0.03 * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)))
    outputs = ["1:+Z", "2:-Z", "3:+X", "4:+RY", "5:-RX"]
    return Measurement(freq, H[None], form="accelerance", outputs=outputs, inputs=["1:+Z", "3:+X"])


def by_pyuff(path, m: Measurement, binary: int = 0, **changes) -> str:
    """A file made by pyuff alone, set by set."""
    codes = {"X": 1, "Y": 2, "Z": 3, "RX": 4, "RY": 5, "RZ": 6}
    file = pyuff.UFF(str(path))
    for o, out in enumerate(m.outputs):
        for i, into in enumerate(m.inputs):
            ends = {}
            for side, name in (("rsp", out), ("ref", into)):
                node, direction = name.split(":")
                ends[f"{side}_node"] = int(node)
                ends[f"{side}_dir"] = codes[direction[1:]] * (-1 if direction[0] == "-" else 1)
            data = {
                "type": 58, "binary": binary, "func_type": 4, "data": np.array(m.H[0, :, o, i]), "x": np.array(m.freq),
                "abscissa_spacing": 1, "abscissa_spec_data_type": 18, "ordinate_spec_data_type": 12,
                "orddenom_spec_data_type": 13, **ends, **changes,
            }  # fmt: skip
            file.write_sets(data, "add")
    return str(path)


def units(path, length: float, force: float) -> None:
    pyuff.UFF(str(path)).write_sets(
        {"type": 164, "units_code": 9, "length": length, "force": force, "temp": 1.0, "temp_offset": 273.15}, "add"
    )


@pytest.mark.parametrize(("binary", "rtol"), [(0, TEXT_DIGITS), (1, 0.0)])
@pytest.mark.parametrize("spacing", [0, 1])
def test_file_of_pyuff_is_read(tmp_path, binary, rtol, spacing):
    m = measurement()
    loaded = modalax.load(by_pyuff(tmp_path / "a.unv", m, binary, abscissa_spacing=spacing))
    np.testing.assert_allclose(np.real(loaded.H), np.real(m.H), rtol=rtol, atol=0)
    np.testing.assert_allclose(np.imag(loaded.H), np.imag(m.H), rtol=rtol, atol=0)
    np.testing.assert_array_equal(loaded.freq, FREQ)
    assert (loaded.outputs, loaded.inputs, loaded.form) == (m.outputs, m.inputs, "accelerance")
    assert np.isnan(loaded.level).all()


@pytest.mark.parametrize("binary", [True, False])
def test_text_above_the_first_data_set_is_passed_over(tmp_path, binary):
    m = measurement()
    modalax.save(m, tmp_path / "a.uff", binary=binary)
    text = b"Laboratory of vibrations, hall 3\n\n  12 channels; -1 is no answer\n"
    (tmp_path / "b.uff").write_bytes(text + (tmp_path / "a.uff").read_bytes())
    assert kind_of(tmp_path / "b.uff") == "uff"
    found = modalax.load(tmp_path / "b.uff")
    np.testing.assert_allclose(found.H, m.H, rtol=1e-9)
    assert found.outputs == m.outputs
    (tmp_path / "c.csv").write_text("freq,re\n    -1\n1,2\n")
    assert sniff(tmp_path / "c.csv") == "table"


@pytest.mark.parametrize("binary", [True, False])
def test_file_of_ours_is_read_by_pyuff(tmp_path, binary):
    m = measurement()
    modalax.save(m, tmp_path / "a.uff", binary=binary)
    sets = [s for s in pyuff.UFF(str(tmp_path / "a.uff")).read_sets() if s["type"] == 58]
    assert len(sets) == 10 and {s["binary"] for s in sets} == {int(binary)}
    for s in sets:
        o = [n.startswith(f"{s['rsp_node']}:") for n in m.outputs].index(True)
        i = [n.startswith(f"{s['ref_node']}:") for n in m.inputs].index(True)
        np.testing.assert_allclose(s["data"].real, np.real(m.H[0, :, o, i]), rtol=0 if binary else TEXT_DIGITS, atol=0)
        np.testing.assert_allclose(s["data"].imag, np.imag(m.H[0, :, o, i]), rtol=0 if binary else TEXT_DIGITS, atol=0)
        np.testing.assert_array_equal(s["x"], FREQ)
        assert (s["func_type"], s["ordinate_spec_data_type"], s["orddenom_spec_data_type"]) == (4, 12, 13)
        assert s["ordinate_axis_units_lab"] == "m/s^2"
    assert {(s["rsp_node"], s["rsp_dir"]) for s in sets} == {(1, 3), (2, -3), (3, 1), (4, 5), (5, -4)}


@pytest.mark.parametrize("binary", [True, False])
def test_text_and_binary_come_back(tmp_path, binary):
    m = measurement()
    modalax.save(m, tmp_path / "a.uff", binary=binary)
    np.testing.assert_allclose(modalax.load(tmp_path / "a.uff").H, m.H, rtol=0 if binary else 2 * TEXT_DIGITS)


def test_binary_header_announces_the_bytes_that_follow(tmp_path):
    """Other readers skip by this number; pyuff itself writes 8 bytes a line, though a complex value has 16."""
    modalax.save(measurement(), tmp_path / "a.uff")
    content = (tmp_path / "a.uff").read_bytes()
    line = content[content.index(b"    58b") :].split(b"\n")[0]
    announced = int(line[31:43])
    header = content[content.index(b"    58b") :].split(b"\n")[:12]
    start = content.index(b"    58b") + sum(len(h) + 1 for h in header)
    assert content[start + announced :].startswith(b"    -1\n")
    assert announced == 16 * len(FREQ)


def test_frequencies_off_the_grid_of_six_digits(tmp_path):
    freq = np.sqrt(np.linspace(400.0, 4900.0, 40))
    third = 20 + np.arange(40) / 3
    for axis in (freq, third):
        m = measurement(axis)
        modalax.save(m, tmp_path / "a.uff", overwrite=True)
        np.testing.assert_array_equal(modalax.load(tmp_path / "a.uff").freq, axis)
        with pytest.warns(UserWarning, match="text UFF keeps 6 digits of these frequencies"):
            modalax.save(m, tmp_path / "b.uff", overwrite=True, binary=False)
        np.testing.assert_allclose(modalax.load(tmp_path / "b.uff").freq, axis, rtol=5e-6)


@pytest.mark.parametrize("names", [("tip", "root of wing"), ("007:+Z", "8:z"), ("wing:12:-Z", "tail:12:-Z")])
def test_names_that_are_no_node_numbers_come_back(tmp_path, names):
    m = measurement()
    m = Measurement.from_frfs([m.run(0).pick(m.outputs[:2], m.inputs).replace(outputs=names, inputs=names)])
    modalax.save(m, tmp_path / "a.uff")
    loaded = modalax.load(tmp_path / "a.uff")
    assert (loaded.outputs, loaded.inputs) == (names, names)
    np.testing.assert_array_equal(loaded.H, m.H)


@pytest.mark.parametrize(("length", "force"), [(1000.0, 1000.0), (39.37007874015748, 0.22480894387096)])
def test_units_of_set_164(tmp_path, length, force):
    """Factors divide values of the file to give SI, so an FRF is scaled by force over length."""
    m = measurement()
    units(tmp_path / "a.uff", length, force)
    by_pyuff(tmp_path / "a.uff", m, binary=1)
    np.testing.assert_allclose(modalax.load(tmp_path / "a.uff").H, m.H * force / length, rtol=1e-15)


@pytest.mark.parametrize(
    ("label", "force_label", "factor"),
    [
        ("g", "N", 9.80665), ("g/N", "", 9.80665), ("mm/s^2", "N", 1e-3), ("m/s^2", "kN", 1e-3),
        ("in/s^2", "lbf", 0.0254 / 4.4482216152605),
    ],
)  # fmt: skip
def test_units_of_the_labels_where_there_is_no_set_164(tmp_path, label, force_label, factor):
    m = measurement()
    by_pyuff(tmp_path / "a.uff", m, 1, ordinate_axis_units_lab=label, orddenom_axis_units_lab=force_label)
    np.testing.assert_allclose(modalax.load(tmp_path / "a.uff").H, m.H * factor, rtol=1e-15)


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("spacing", [0, 1])
@pytest.mark.parametrize(
    ("label", "size"), [("rad/s", 2 * np.pi), ("kHz", 1e-3), ("Hertz", 1.0), ("(rpm)", 60.0), ("CPM", 60.0)]
)
def test_frequencies_in_the_unit_of_their_label(tmp_path, label, size, binary, spacing):
    m = measurement()
    path = tmp_path / "a.uff"
    units(path, 1000.0, 1.0)  # data set 164 has no unit of time, so the label counts beside it too
    by_pyuff(path, m, binary, x=size * FREQ, abscissa_axis_units_lab=label, abscissa_spacing=spacing)
    found = modalax.load(path)
    np.testing.assert_allclose(found.freq, FREQ, rtol=AXIS_DIGITS)
    np.testing.assert_allclose(found.H, 1e-3 * m.H, rtol=1e-10)


def test_a_unit_of_frequency_that_is_not_known_is_told_and_can_be_given(tmp_path):
    path = by_pyuff(tmp_path / "a.uff", measurement(), x=2 * np.pi * FREQ, abscissa_axis_units_lab="1/turn")
    with pytest.warns(UserWarning, match=r"a\.uff: its frequencies are in 1/turn, which is not known: taken as Hz"):
        modalax.load(path, conjugate=False)
    found = modalax.load(path, frequency_unit="rad/s")
    np.testing.assert_allclose(found.freq, FREQ, rtol=AXIS_DIGITS)
    with pytest.raises(ValueError, match="the unit of frequencies is '1/turn'; known are Hz, kHz, rad/s, rpm"):
        modalax.load(path, frequency_unit="1/turn")
    with pytest.raises(ValueError, match="option outputs is for files that do not say it themselves"):
        modalax.load(path, frequency_unit="rad/s", outputs=["1"])
    path = by_pyuff(tmp_path / "b.uff", measurement(), abscissa_spec_data_type=20)
    with pytest.warns(UserWarning, match="its frequencies are in orders, which is not known"):
        modalax.load(path, conjugate=False)


@pytest.mark.parametrize(("code", "form"), [(8, "receptance"), (11, "mobility"), (12, "accelerance")])
def test_form_from_the_ordinate_type(tmp_path, code, form):
    assert modalax.load(by_pyuff(tmp_path / "a.uff", measurement(), 1, ordinate_spec_data_type=code)).form == form


def test_form_that_the_file_does_not_tell(tmp_path):
    path = by_pyuff(tmp_path / "a.uff", measurement(), 1, ordinate_spec_data_type=0)
    with pytest.raises(ValueError, match=r"a\.uff: its FRFs do not say whether .* pass form='accelerance'"):
        modalax.load(path)
    assert modalax.load(path, form="mobility").form == "mobility"
    by_label = by_pyuff(
        tmp_path / "b.uff", measurement(), 1, ordinate_spec_data_type=1, ordinate_axis_units_lab="(m/s^2)/N"
    )
    assert modalax.load(by_label).form == "accelerance"


def test_mixed_forms_are_turned_to_the_highest_derivative(tmp_path):
    m = measurement()
    by_pyuff(tmp_path / "a.uff", m.replace(H=m.H[:, :, :1], outputs=m.outputs[:1]), 1)
    by_pyuff(tmp_path / "a.uff", m.replace(H=m.H[:, :, 1:], outputs=m.outputs[1:]), 1, ordinate_spec_data_type=8)
    with pytest.warns(UserWarning, match=r"its FRFs are accelerance, receptance; all are turned to accelerance"):
        found = modalax.load(tmp_path / "a.uff")
    assert found.form == "accelerance"
    np.testing.assert_allclose(found.H[:, :, 0], m.H[:, :, 0], rtol=1e-12)
    omega = 2 * np.pi * np.asarray(m.freq)[:, None, None]
    np.testing.assert_allclose(found.H[0, :, 1:], -(omega**2) * m.H[0, :, 1:], rtol=1e-12)


def test_force_over_motion_is_named(tmp_path):
    kinds = {"ordinate_spec_data_type": 13, "orddenom_spec_data_type": 12}
    path = by_pyuff(tmp_path / "a.uff", measurement(), 1, **kinds)
    with pytest.raises(ValueError, match="force over motion, dynamic stiffness or mass; .* invert them"):
        modalax.load(path)


def test_missing_cells_are_named_and_can_be_left_out(tmp_path):
    m = measurement()
    whole, row = (
        m.replace(H=m.H[:, :, :3], outputs=m.outputs[:3]),
        m.replace(H=m.H[:, :, 3:, :1], outputs=m.outputs[3:], inputs=m.inputs[:1]),
    )
    by_pyuff(tmp_path / "a.uff", whole, 1)
    by_pyuff(tmp_path / "a.uff", row, 1)
    with pytest.raises(ValueError, match=r"2 of 10 FRFs .* missing: 4:.RY/3:.X, 5:-RX/3:.X; complete=True"):
        modalax.load(tmp_path / "a.uff")
    with pytest.warns(UserWarning, match="left out, because some of their FRFs are missing"):
        part = modalax.load(tmp_path / "a.uff", complete=True)
    o, i = [m.outputs.index(n) for n in part.outputs], [m.inputs.index(n) for n in part.inputs]
    assert len(o) * len(i) >= 5
    np.testing.assert_array_equal(part.H, m.H[:, :, o][..., i])


def test_axes_that_differ_are_refused(tmp_path):
    m = measurement()
    one = m.replace(H=m.H[:, :, :1], outputs=m.outputs[:1])
    by_pyuff(tmp_path / "a.uff", one, 1)
    by_pyuff(tmp_path / "a.uff", one.replace(outputs=["9:+Z"], freq=FREQ + 0.5), 1)
    with pytest.raises(ValueError, match=r"9:.Z/1:.Z and 1:.Z/1:.Z have different frequencies"):
        modalax.load(tmp_path / "a.uff")
    by_pyuff(tmp_path / "b.uff", one, 1)
    by_pyuff(tmp_path / "b.uff", one.replace(outputs=["9:+Z"]).band(20.0, 60.0), 1)
    with pytest.raises(ValueError, match=r"9:.Z/1:.Z has 41 lines, 1:.Z/1:.Z has 51"):
        modalax.load(tmp_path / "b.uff")


def test_repeated_pairs_are_runs_if_all_are_repeated(tmp_path):
    m = measurement()
    by_pyuff(tmp_path / "a.uff", m, 1)
    by_pyuff(tmp_path / "a.uff", m.replace(H=2 * m.H), 1)
    loaded = modalax.load(tmp_path / "a.uff")
    np.testing.assert_array_equal(loaded.H, np.concatenate([m.H, 2 * m.H]))
    by_pyuff(tmp_path / "a.uff", m.replace(H=m.H[:, :, :1], outputs=m.outputs[:1]), 1)
    with pytest.raises(ValueError, match=r"1:.Z/1:.Z stands 3 times, 2:-Z/1:.Z 2 times"):
        modalax.load(tmp_path / "a.uff")


def test_coherence_is_taken_along_and_other_functions_are_named(tmp_path):
    m = measurement()
    by_pyuff(tmp_path / "a.uff", m, 1)
    by_pyuff(tmp_path / "a.uff", m.replace(H=np.full(m.H.shape, 0.9 + 0j)), 1, func_type=6, data=np.full(51, 0.9))
    by_pyuff(tmp_path / "a.uff", m, 1, func_type=2, data=np.ones(51))
    with pytest.warns(UserWarning, match=r"a\.uff: beside the FRFs it holds 10 autospectra, which were left out"):
        loaded = modalax.load(tmp_path / "a.uff")
    np.testing.assert_array_equal(loaded.coherence, np.full(m.H.shape, 0.9))


def test_file_without_frfs_says_what_it_holds(tmp_path):
    by_pyuff(tmp_path / "a.uff", measurement(), 1, func_type=1, data=np.ones(51))
    said = r"a\.uff: holds time responses but neither FRFs nor mode shapes; time records become FRFs by modalax frf$"
    with pytest.raises(ValueError, match=said):
        modalax.load(tmp_path / "a.uff")


def test_names_of_components_where_there_are_several(tmp_path):
    m = measurement()
    one = m.replace(H=m.H[:, :, :1, :1], outputs=m.outputs[:1], inputs=m.inputs[:1])
    by_pyuff(tmp_path / "a.uff", one, 1, rsp_ent_name="wing", ref_ent_name="wing")
    assert modalax.load(tmp_path / "a.uff").outputs == ("1:+Z",)
    by_pyuff(tmp_path / "a.uff", one, 1, rsp_ent_name="tail", ref_ent_name="wing")
    assert modalax.load(tmp_path / "a.uff").outputs == ("wing:1:+Z", "tail:1:+Z")


@pytest.mark.parametrize("cut", [0.3, 0.6, 0.95])
@pytest.mark.parametrize("binary", [0, 1])
def test_a_set_that_is_cut_short_is_not_read_as_shorter(tmp_path, cut, binary):
    """Bytes taken from the middle of the last set, its closing line left in place."""
    m = measurement()
    path = tmp_path / "a.uff"
    by_pyuff(path, m.replace(H=m.H[:, :, :1, :1], outputs=m.outputs[:1], inputs=m.inputs[:1]), binary)
    content = path.read_bytes()
    body = content.rindex(b"    -1")
    path.write_bytes(content[: int(1200 + cut * (body - 1200))] + b"\n    -1\n")
    with pytest.raises(ValueError, match=r"a\.uff: (function 1 is cut short|data set 1, of type 58, is damaged|holds)"):
        modalax.load(path)


@pytest.mark.parametrize("ending", [b"    -1\n", b"\n    -1\n", b"\r\n    -1\r\n"])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("code", "letter"), [(5, "f"), (6, "d")])
def test_binary_sets_as_measuring_systems_write_them(tmp_path, ending, order, code, letter):
    """Single precision, either order of bytes, the closing line right after the data or on a line of its own."""
    rng = np.random.default_rng(0)
    pairs = rng.normal(size=(33, 2)).astype(letter)
    direction = "".join(f"{v:{w}}" for v, w in ((4, 5), (0, 10), (1, 5), (0, 10)))
    header = [
        f"{-1:6d}",
        f"{58:6d}b{1 if order == '<' else 2:6d}{2:6d}{11:12d}{pairs.nbytes:12d}{0:6d}{0:6d}{0:12d}{0:12d}",
        *["NONE"] * 5,
        f"{direction} {'NONE':10s}{7:10d}{3:4d} {'NONE':10s}{9:10d}{-1:4d}",
        f"{code:10d}{33:10d}{1:10d}{20.0:13.5e}{0.25:13.5e}{0.0:13.5e}",
        *[f"{kind:10d}{0:5d}{0:5d}{0:5d} {'NONE':20s} {'NONE':20s}" for kind in (18, 12, 13, 0)],
    ]
    body = pairs.astype(order + letter).tobytes()
    (tmp_path / "a.uff").write_bytes("\n".join([*header, ""]).encode() + body + ending)
    loaded = modalax.load(tmp_path / "a.uff", conjugate=False)
    np.testing.assert_array_equal(loaded.H[0, :, 0, 0], pairs[:, 0].astype(float) + 1j * pairs[:, 1].astype(float))
    np.testing.assert_array_equal(loaded.freq, 20 + 0.25 * np.arange(33))
    assert (loaded.outputs, loaded.inputs, loaded.form) == (("7:+Z",), ("9:-X",), "accelerance")


def geometry() -> Geometry:
    rng = np.random.default_rng(1)
    return Geometry(["1", "2", "3", "4", "5"], rng.normal(size=(5, 3)), [("1", "2", "3", "1"), ("4", "5")])


def test_geometry_comes_back_beside_frfs_and_shapes(tmp_path):
    g = geometry()
    modalax.save(measurement(), tmp_path / "a.uff", geometry=g)
    modalax.save(model(), tmp_path / "b.uff", geometry=g)
    for name in ("a.uff", "b.uff"):
        loaded = load_geometry(tmp_path / name)
        np.testing.assert_array_equal(loaded.xyz, g.xyz)
        assert (loaded.nodes, loaded.lines) == (g.nodes, g.lines)


@pytest.mark.parametrize("kind", [15, 2411])
def test_geometry_of_pyuff_in_millimetres(tmp_path, kind):
    path = str(tmp_path / "a.uff")
    xyz = np.array([[0.0, 0.0, 0.0], [1530.0, 0.0, 0.0], [1530.0, 384.0, 0.0], [0.0, 384.0, 25.0]])
    units(path, 1000.0, 1000.0)
    places = {
        "type": kind, "node_nums": [16, 17, 18, 20], "def_cs": [0] * 4, "disp_cs": [0] * 4, "color": [0] * 4,
        "x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2],
    }  # fmt: skip
    quad = {
        "element_nums": 1, "fe_descriptor": 44, "phys_table": 1, "mat_table": 1, "color": 1, "num_nodes": 4,
        "nodes_nums": [16, 17, 18, 20],
    }  # fmt: skip
    trace = {"type": 82, "trace_num": 1, "id": "NONE", "nodes": np.array([16, 17, 0, 18, 20, 16])}
    pyuff.UFF(path).write_sets([places, trace, {"type": 2412, 44: [quad]}], "add")
    g = load_geometry(path)
    np.testing.assert_allclose(g.xyz, xyz / 1000, rtol=1e-15)
    assert g.lines == (("16", "17"), ("18", "20", "16"), ("16", "17", "18", "20", "16"))


def test_long_polyline_is_cut_into_data_sets_and_draws_the_same(tmp_path):
    names = [str(k) for k in range(1, 601)]
    g = Geometry(names, np.random.default_rng(0).normal(size=(600, 3)), [names])
    modalax.save(measurement(), tmp_path / "a.uff", geometry=g)
    np.testing.assert_array_equal(load_geometry(tmp_path / "a.uff").segments, g.segments)


def test_no_nodes_and_no_shapes_are_said(tmp_path):
    modalax.save(measurement(), tmp_path / "a.uff")
    with pytest.raises(ValueError, match=r"a\.uff: holds no nodes"):
        load_geometry(tmp_path / "a.uff")
    modalax.save(measurement(), tmp_path / "a.npz")
    with pytest.raises(ValueError, match=r"a\.npz: is a file of kind npz"):
        load_geometry(tmp_path / "a.npz")
    with pytest.raises(FileNotFoundError, match=r"b\.uff: no such file"):
        load_modes(tmp_path / "b.uff")
    with pytest.raises(ValueError, match=r"a\.uff: holds no mode shapes"):
        load_modes(tmp_path / "a.uff")


def model() -> ModalModel:
    """Complex shapes, all along Y, counted against it at node 2, all scaled by reciprocity."""
    m = five_dof().modal()
    dofs = ["1:+Y", "2:-Y", "3:+Y", "4:+Y", "5:+Y"]
    turn = np.exp(1j * np.array([0.0, 0.1, -0.2, 0.3, 0.4]))
    shapes = m.shapes * turn
    return ModalModel(m.poles, shapes, shapes / m.modal_a()[:, None], outputs=dofs, inputs=dofs)


def test_modal_model_through_data_set_55(tmp_path):
    m = model()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        modalax.save(m, tmp_path / "a.uff")
    loaded = modalax.load(tmp_path / "a.uff")
    assert isinstance(loaded, ModalModel) and loaded.outputs == ("1:+Y", "2:+Y", "3:+Y", "4:+Y", "5:+Y")
    np.testing.assert_allclose(loaded.frequency_hz, m.frequency_hz, rtol=SHAPE_DIGITS)
    sign = np.array([1, -1, 1, 1, 1])
    # Two shape components and modal a, six digits each, against the largest residue of the mode.
    size = np.abs(m.residues).max(axis=(1, 2), keepdims=True)
    assert np.abs((loaded.residues * sign[:, None] * sign - m.residues) / size).max() < 4 * SHAPE_DIGITS
    sets = [s for s in pyuff.UFF(str(tmp_path / "a.uff")).read_sets() if s["type"] == 55]
    assert [s["mode_n"] for s in sets] == [1, 2, 3, 4, 5]
    shapes = np.array([s["r2"] for s in sets]) * sign
    np.testing.assert_allclose(shapes.real, np.real(m.shapes), rtol=SHAPE_DIGITS)
    np.testing.assert_allclose(shapes.imag, np.imag(m.shapes), rtol=SHAPE_DIGITS)


def test_shapes_beside_frfs_are_said_and_can_be_read(tmp_path):
    modalax.save(model(), tmp_path / "a.uff")
    with (tmp_path / "a.uff").open("ab") as file:
        modalax.save(measurement(), tmp_path / "b.uff")
        file.write((tmp_path / "b.uff").read_bytes())
    with pytest.warns(UserWarning, match=r"a\.uff: beside the FRFs it holds 5 data sets of shapes"):
        loaded = modalax.load(tmp_path / "a.uff")
    np.testing.assert_array_equal(loaded.H, measurement().H)
    assert load_modes(tmp_path / "a.uff").shapes.shape == (5, 5)


def test_what_data_set_55_cannot_hold_is_said(tmp_path):
    m = model().replace(upper=1e-9, damping_std=0.1)
    with pytest.warns(UserWarning, match="does not hold residual terms, the claimed standard deviations; .npz keeps"):
        modalax.save(m, tmp_path / "a.uff")
    m = model()
    with pytest.raises(ValueError, match=r"DoFs 9:.RX are rotations"):
        modalax.save(m.replace(outputs=[*m.outputs[:4], "9:+RX"]), tmp_path / "b.uff")


def test_normal_modes_of_pyuff_in_millimetres(tmp_path):
    """Mass in a file of mm and mN is mN s^2/mm = kg, so it does not change; with mm and N it is t."""
    path = str(tmp_path / "a.uff")
    units(path, 1000.0, 1.0)
    for k, (f, mass) in enumerate([(10.0, 0.002), (25.0, 0.003)]):
        pyuff.UFF(path).write_sets({
            "type": 55, "analysis_type": 2, "data_ch": 2, "spec_data_type": 8, "load_case": 0, "mode_n": k + 1,
            "freq": f, "modal_m": mass, "modal_damp_vis": 0.01, "modal_damp_his": 0.0, "node_nums": [3, 7],
            "r1": np.zeros(2), "r2": np.zeros(2), "r3": np.array([1.0, 0.5 - k]),
        }, "add")  # fmt: skip
    loaded = modalax.load(path)
    assert loaded.outputs == ("3:+Z", "7:+Z")
    np.testing.assert_allclose(loaded.frequency_hz, [10.0, 25.0], rtol=1e-14)
    np.testing.assert_allclose(loaded.damping_ratio, [0.01, 0.01], rtol=1e-12)
    np.testing.assert_allclose(np.real(loaded.modal_mass()), [2.0, 3.0], rtol=1e-14)


def test_shapes_without_scale_are_shapes_and_no_model(tmp_path):
    path = str(tmp_path / "a.uff")
    pyuff.UFF(path).write_sets({
        "type": 55, "analysis_type": 2, "data_ch": 2, "spec_data_type": 8, "load_case": 0, "mode_n": 1, "freq": 5.0,
        "node_nums": [3, 7], "r1": np.zeros(2), "r2": np.zeros(2), "r3": np.array([1.0, 0.5]),
    }, "add")  # fmt: skip
    with pytest.raises(ValueError, match=r"a\.uff: mode 1 has no modal mass or modal a.*load_modes"):
        modalax.load(path)
    modes = load_modes(path)
    np.testing.assert_array_equal(modes.shapes, [[1.0, 0.5]])
    assert modes.dofs == ("3:+Z", "7:+Z")


@pytest.mark.parametrize(("code", "derivatives"), [(8, 0), (11, 1), (12, 2)])
@pytest.mark.parametrize("upper", [True, False])
def test_complex_shapes_of_velocity_and_acceleration_and_lower_poles(tmp_path, code, derivatives, upper):
    path = str(tmp_path / "a.uff")
    pole, a, shape = -1.0 + 20.0j, 3.0 + 4.0j, np.array([1.0 + 0.5j, -0.25j])
    turn = (lambda z: z) if upper else np.conj
    given = turn(shape * pole**derivatives)
    pyuff.UFF(path).write_sets({
        "type": 55, "analysis_type": 3, "data_ch": 2, "spec_data_type": code, "load_case": 0, "mode_n": 1,
        "eig": turn(pole), "modal_a": turn(a), "node_nums": [3, 7], "r1": 0 * given, "r2": 0 * given, "r3": given,
    }, "add")  # fmt: skip
    modes = load_modes(path)
    assert modes.poles[0] == pole and modes.modal_a[0] == (a if derivatives == 0 else 0)
    np.testing.assert_allclose(modes.shapes[0], shape, rtol=0, atol=2 * SHAPE_DIGITS)


def test_shapes_of_data_set_2414(tmp_path):
    """Written by hand after the format's description: normal modes at nodes, three real values a node."""
    shape = [(3, 0.0, 0.25, 1.0), (7, 0.0, 0.0, -0.5)]
    lines = [f"{-1:6d}", f"{2414:6d}", f"{1:10d}", "Mode 1", f"{1:10d}", *["NONE"] * 5]
    lines += ["".join(f"{v:10d}" for v in (1, 2, 2, 8, 2, 3)), "".join(f"{v:10d}" for v in (1, 0, 1, 0, 0, 1, 0, 0))]
    lines += ["".join(f"{v:10d}" for v in (0, 0)), "".join(f"{v:13.5e}" for v in (0.0, 12.5, 0.0, 2.0, 0.02, 0.0))]
    lines += ["".join(f"{0.0:13.5e}" for _ in range(6))]
    for node, *values in shape:
        lines += [f"{node:10d}", "".join(f"{v:13.5e}" for v in values)]
    (tmp_path / "a.unv").write_text("\n".join([*lines, f"{-1:6d}", ""]))
    m = modalax.load(tmp_path / "a.unv")
    assert m.outputs == ("3:+Y", "3:+Z", "7:+Z")
    np.testing.assert_array_equal(m.shapes, [[0.25, 1.0, -0.5]])
    np.testing.assert_allclose(m.frequency_hz, [12.5], rtol=1e-14)
    np.testing.assert_allclose(m.damping_ratio, [0.02], rtol=1e-12)
    np.testing.assert_allclose(np.real(m.modal_mass("3:+Z")), [2.0], rtol=1e-14)


def test_complex_shapes_of_data_set_2414(tmp_path):
    """By hand again: the pole and modal a stand in the last line of numbers, real and imaginary parts side by side."""
    pole, a = complex(-1.25, 78.5), complex(-0.004, 350.0)
    shape = {3: [0, 0.25 - 0.125j, 1.0], 7: [0, 0, -0.5 + 0.0625j]}
    lines = [f"{-1:6d}", f"{2414:6d}", f"{1:10d}", "Mode 1", f"{1:10d}", *["NONE"] * 5]
    lines += ["".join(f"{v:10d}" for v in (1, 3, 2, 8, 5, 3)), "".join(f"{v:10d}" for v in (1, 0, 1, 0, 0, 1, 0, 0))]
    lines += ["".join(f"{v:10d}" for v in (0, 0)), "".join(f"{0.0:13.5e}" for _ in range(6))]
    lines += ["".join(f"{v:13.5e}" for v in (pole.real, pole.imag, a.real, a.imag, 0.0, 0.0))]
    for node, values in shape.items():
        parts = [part for v in values for part in (complex(v).real, complex(v).imag)]
        lines += [f"{node:10d}", "".join(f"{v:13.5e}" for v in parts)]
    (tmp_path / "a.unv").write_text("\n".join([*lines, f"{-1:6d}", ""]))
    m = modalax.load(tmp_path / "a.unv")
    assert m.outputs == ("3:+Y", "3:+Z", "7:+Z")
    np.testing.assert_array_equal(m.shapes, [[0.25 - 0.125j, 1.0, -0.5 + 0.0625j]])
    assert complex(m.poles[0]) == pole
    np.testing.assert_allclose(np.asarray(m.modal_a("3:+Z"))[0], a, rtol=1e-12)


@pytest.mark.slow
def test_large_file_is_written_and_read_in_linear_time(tmp_path):
    """458 sensors, 3000 lines: adding set by set through pyuff would read 11 MB 458 times."""
    freq = np.arange(3000) * 0.01
    H = np.random.default_rng(0).normal(size=(2, 1, 3000, 458, 1))
    m = Measurement(
        freq, H[0] + 1j * H[1], form="accelerance", outputs=[f"{k}:+Z" for k in range(1, 459)], inputs=["1:+Z"]
    )
    modalax.save(m, tmp_path / "a.uff")
    np.testing.assert_array_equal(modalax.load(tmp_path / "a.uff").H, m.H)
