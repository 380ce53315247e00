"""Modes into files and geometry out of them."""

import csv
import struct

import numpy as np
import pytest

import modalax
from modalax.data import Geometry
from modalax.files import load_geometry, load_modes, save_modes
from modalax.model import ModalModel
from modalax.model.examples import five_dof


def model() -> ModalModel:
    """Five modes at nodes 1 to 5 along X."""
    names = [f"{n}:+X" for n in range(1, 6)]
    return five_dof().modal().replace(outputs=names, inputs=names)


def test_csv_of_modes_has_a_row_a_mode(tmp_path):
    m, std = model(), np.array([0.01, 0.02, np.nan, 0.04, 0.05])
    save_modes(m, tmp_path / "m.csv", frequency_std_hz=std)
    with (tmp_path / "m.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 5 and rows[2]["frequency_std_hz"] == "" and rows[0]["damping_ratio_std"] == ""
    np.testing.assert_allclose([float(r["frequency_hz"]) for r in rows], m.frequency_hz, rtol=1e-9)
    np.testing.assert_allclose([float(r["damping_ratio"]) for r in rows], m.damping_ratio, rtol=1e-9)
    shapes = [[float(r[f"re {n}"]) + 1j * float(r[f"im {n}"]) for n in m.outputs] for r in rows]
    np.testing.assert_allclose(shapes, m.normalised().shapes, atol=1e-9)


def test_names_with_commas_stay_whole(tmp_path):
    m = model().replace(outputs=["a,b", 'c"d', "e", "f", "g"], inputs=["a,b", 'c"d', "e", "f", "g"])
    save_modes(m, tmp_path / "m.csv")
    with (tmp_path / "m.csv").open(newline="") as file:
        head = next(csv.reader(file))
    assert head[5] == "re a,b" and head[7] == 're c"d' and len(head) == 15


@pytest.mark.filterwarnings("ignore:.*universal files number:UserWarning")
def test_universal_file_of_modes_with_its_nodes(tmp_path):
    pytest.importorskip("pyuff")
    xyz = np.arange(15.0).reshape(5, 3)
    geometry = Geometry([str(n) for n in range(1, 6)], xyz, [("1", "2", "3")])
    save_modes(model(), tmp_path / "m.uff", geometry=geometry)
    modes = load_modes(tmp_path / "m.uff")
    np.testing.assert_allclose(np.abs(modes.poles) / 2 / np.pi, model().frequency_hz, rtol=1e-5)
    np.testing.assert_allclose(modes.shapes, model().normalised().shapes, atol=1e-5)
    np.testing.assert_allclose(load_geometry(tmp_path / "m.uff").xyz, xyz)


def test_a_roving_hammer_has_its_shapes_along_the_inputs(tmp_path):
    m = model()
    one = m.replace(shapes=m.shapes[:, :1], outputs=["1:+X"], upper=None, lower=None)
    save_modes(one, tmp_path / "m.csv")
    head = (tmp_path / "m.csv").read_text().splitlines()[0]
    assert "re 5:+X" in head


def test_modes_are_not_written_over_a_file_or_to_an_unknown_kind(tmp_path):
    (tmp_path / "m.csv").write_text("precious")
    with pytest.raises(ValueError, match=r"m\.csv exists already"):
        save_modes(model(), tmp_path / "m.csv")
    with pytest.raises(ValueError, match=r"modes are written to \.csv, \.uff, \.unv, \.npz, not to '\.xlsx'"):
        save_modes(model(), tmp_path / "m.xlsx")
    save_modes(model(), tmp_path / "m.npz")
    assert isinstance(modalax.load(tmp_path / "m.npz"), ModalModel)


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_points_from_a_table(tmp_path, mark):
    rows = [["node", "x", "y [m]", "z"], ["7", "0", "1.5", "2"], ["wing", "3", "4", "5e-1"]]
    (tmp_path / "p.csv").write_text("\n".join(mark.join(r) for r in rows))
    geometry = load_geometry(tmp_path / "p.csv")
    assert geometry.nodes == ("7", "wing")
    np.testing.assert_array_equal(geometry.xyz, [[0, 1.5, 2], [3, 4, 0.5]])


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("", "holds no rows"),
        ("name,x,y,z\n1,2,3,4\n", "needs node, x, y, z"),
        ("node,x,y,z\n1,2,3\n", "line 2 has 3 columns"),
        ("node,x,y,z\n1,2,3,here\n", "line 2 holds what is no number"),
        ("node,x,y,z\n1,2,3,4\n1,2,3,4\n", "stand more than once"),
        ("node,x,y,z\n1,2,3,nan\n", "not finite"),
    ],
)
def test_tables_of_points_that_cannot_be_used(tmp_path, text, pattern):
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(ValueError, match=pattern) as caught:
        load_geometry(tmp_path / "p.csv")
    assert "p.csv" in str(caught.value)


CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)


def stl(path, text: bool) -> None:
    if text:
        facets = [
            "facet normal 0 0 1\nouter loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in t) + "endloop\nendfacet"
            for t in CORNERS.reshape(2, 3, 3)
        ]
        path.write_text("\n".join(["solid a", *facets, "endsolid a"]))
        return
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *t.ravel(), 0) for t in CORNERS.reshape(2, 3, 3))
    path.write_bytes(bytes(80) + struct.pack("<I", 2) + body)


@pytest.mark.parametrize("text", [True, False])
def test_corners_of_triangles_are_nodes_in_their_order(tmp_path, text):
    stl(tmp_path / "p.stl", text)
    geometry = load_geometry(tmp_path / "p.stl")
    assert geometry.nodes == ("1", "2", "3", "4")
    np.testing.assert_array_equal(geometry.xyz, CORNERS[[0, 1, 2, 4]])
    assert len(geometry.lines) == 5 and ("1", "4") not in geometry.lines


def test_triangles_that_are_not_there(tmp_path):
    path = tmp_path / "p.stl"
    path.write_bytes(bytes(80) + struct.pack("<I", 2**31) + bytes(50))
    with pytest.raises(ValueError, match="declares"):
        load_geometry(path)
    stl(path, text=False)
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(ValueError, match="announces 2 triangles"):
        load_geometry(path)
    path.write_bytes(b"solid a\nfacet\nendsolid")
    with pytest.raises(ValueError, match="holds no triangle"):
        load_geometry(path)
