"""Mode shapes on a geometry, still and moving."""

import base64
import json

import numpy as np
import pytest
from PIL import Image

from modalax.data.geometry import Geometry
from modalax.model import ModalModel
from modalax.show import animate_shape, plot_shape, plot_shapes
from modalax.show.shapes import LARGEST, along


@pytest.fixture
def beam():
    names = [str(k) for k in range(5)]
    xyz = np.stack([np.linspace(0, 2, 5), np.zeros(5), np.zeros(5)], axis=1)
    return Geometry(names, xyz, [names])


def drawn_points(ax):
    """Positions of the nodes as drawn."""
    return np.stack(ax.collections[-1]._offsets3d, axis=1)


def test_nodes_stand_where_the_shape_moves_them(beam):
    """A shape of any phase is turned to its instant of largest displacement; signs of the channels count."""
    shape = np.array([0.0, 1.0, 2.0, -1.0, 0.0]) * np.exp(0.7j)
    fig = plot_shape(beam, [f"{k}:+Z" for k in range(3)] + ["3:-Z", "4:+Z"], shape, title="1: 12 Hz")
    moved = drawn_points(fig.axes[0]) - np.asarray(beam.xyz)
    expected = LARGEST * 2.0 * np.array([0, 1, 2, 1, 0]) / 2
    # The turn leaves the sign open.
    np.testing.assert_allclose(moved[:, 2] * np.sign(moved[2, 2]), expected, atol=1e-12)
    np.testing.assert_allclose(moved[:, :2], 0, atol=1e-12)
    assert fig.axes[0].get_title() == "1: 12 Hz" and fig.axes[0].get_zlabel() == "z [m]"


def test_a_node_that_was_not_measured_follows_its_neighbours(beam):
    fig = plot_shape(beam, ["0:+Z", "1:+Z", "3:+Z", "4:+Z"], [1.0, 1.0, 1.0, 1.0])
    moved = drawn_points(fig.axes[0])[:, 2]
    np.testing.assert_allclose(np.abs(moved), LARGEST * 2.0, rtol=1e-12)


def test_a_quarter_cycle_later_a_real_shape_passes_rest(beam):
    fig = plot_shape(beam, [f"{k}:+Y" for k in range(5)], [1.0, 0.5, 0, -0.5, -1], phase=np.pi / 2)
    np.testing.assert_allclose(drawn_points(fig.axes[0]), np.asarray(beam.xyz), atol=1e-12)


def test_names_without_direction_cannot_move(beam):
    with pytest.raises(ValueError, match="no direction|has a direction"):
        plot_shape(beam, ["0", "1"], [1.0, 2.0])


def test_several_shapes_side_by_side(beam):
    fig = plot_shapes(beam, [f"{k}:+Z" for k in range(5)], np.eye(5), titles=list("abcde"))
    *drawn, scale = fig.axes
    assert [ax.get_title() for ax in drawn] == list("abcde")
    assert scale.get_ylabel() == "Displacement [-]" and scale.get_ylim() == (0, 1)


def test_shapes_of_a_report_move_as_those_of_a_picture_do(beam):
    """Displacements in phase, the largest 1, as single-precision pairs; and nothing that ends the script."""
    from modalax.show.report.moving import shapes_on

    dofs, shape = [f"{k}:+Z" for k in range(5)], np.array([0, 1.0, 2.0, 1.0, 0]) * np.exp(0.4j)
    part = shapes_on(beam, dofs, [shape, 2j * shape], [12.0, 30.0])
    drawn = json.loads(part.json())
    assert [m["label"] for m in drawn["modes"]] == ["1: 12 Hz", "2: 30 Hz"] and "<" not in part.json()
    np.testing.assert_allclose(drawn["xyz"], beam.xyz, atol=1e-6)
    assert len(drawn["pieces"]) == 4
    for mode in drawn["modes"]:
        u = np.frombuffer(base64.b64decode(mode["u"]), "<f4").reshape(5, 3, 2)
        np.testing.assert_allclose(np.abs(u[:, 2, 0]), [0, 0.5, 1, 0.5, 0], atol=1e-6)
        np.testing.assert_allclose(u[:, :2], 0, atol=1e-12)
        np.testing.assert_allclose(u[:, 2, 1], 0, atol=1e-6)


def test_shapes_run_along_the_side_with_more_dofs_that_move_nodes(beam):
    model = ModalModel.from_real_modes(
        [10.0, 20.0], [0.01, 0.01], np.arange(1.0, 11.0).reshape(2, 5), [1.0, 1.0],
        ["0:+Z", "1:-Z", "2:+RY", "4", "9:+Z"],
    )  # fmt: skip
    for one in (model.replace(participation=model.participation[:, :1], inputs=["0:+Z"],
                              upper=np.zeros((5, 1)), lower=np.zeros((5, 1))),
                model.replace(shapes=model.shapes[:, :1], outputs=["0:+Z"],
                              upper=np.zeros((1, 5)), lower=np.zeros((1, 5)))):  # fmt: skip
        dofs, shapes = along(beam, one)
        assert dofs == ["0:+Z", "1:-Z"]
        np.testing.assert_allclose(shapes[:, 1] / shapes[:, 0], [2.0, 7 / 6], rtol=1e-12)


def test_animation_is_a_gif_that_repeats(beam, tmp_path):
    path = animate_shape(beam, [f"{k}:+Z" for k in range(5)], [0, 1, 0, -1, 0], tmp_path / "a.gif", frames=4)
    with Image.open(path) as gif:
        assert gif.format == "GIF" and gif.n_frames == 4 and gif.info["loop"] == 0
        first = np.asarray(gif.convert("RGB"), float)
        gif.seek(2)
        assert np.abs(np.asarray(gif.convert("RGB"), float) - first).max() > 50
    with pytest.raises(ValueError, match="gif"):
        animate_shape(beam, ["1:+Z"], [1.0], tmp_path / "a.mp4")
