"""Mode shapes on a geometry, still and moving."""

import numpy as np
import pytest
from PIL import Image

from modalax.data.geometry import Geometry
from modalax.show import animate_shape, plot_shape, plot_shapes
from modalax.show.shapes import LARGEST


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
    assert [ax.get_title() for ax in fig.axes] == list("abcde")


def test_animation_is_a_gif_that_repeats(beam, tmp_path):
    path = animate_shape(beam, [f"{k}:+Z" for k in range(5)], [0, 1, 0, -1, 0], tmp_path / "a.gif", frames=4)
    with Image.open(path) as gif:
        assert gif.format == "GIF" and gif.n_frames == 4 and gif.info["loop"] == 0
        first = np.asarray(gif.convert("RGB"), float)
        gif.seek(2)
        assert np.abs(np.asarray(gif.convert("RGB"), float) - first).max() > 50
    with pytest.raises(ValueError, match="gif"):
        animate_shape(beam, ["1:+Z"], [1.0], tmp_path / "a.mp4")
