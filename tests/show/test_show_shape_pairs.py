"""Measured shapes over those of a model: the model's is scaled and turned to lie on the measured one."""

import numpy as np

from modalax.data import Geometry
from modalax.show.shape_pairs import plot_shape_pairs


def test_pairs_that_are_alike_but_for_a_factor_lie_on_each_other():
    nodes = ["1", "2", "3"]
    places = Geometry(nodes, np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), [nodes])
    shapes = np.array([[0.0, 0.5, 1.0], [1.0, 0.0, -1.0]])
    fig = plot_shape_pairs(places, [f"{n}:+Z" for n in nodes], shapes, -7.0 * shapes, titles=["one", "two"])
    assert [ax.get_title() for ax in fig.axes] == ["one", "two"]
    for ax in fig.axes:
        _, line, dots = ax.collections
        ends = np.array(line._segments3d).reshape(-1, 3)
        points = np.array(dots._offsets3d).T
        assert all(np.abs(points - end).sum(axis=1).min() < 1e-9 for end in ends)
        assert np.ptp(points[:, 2]) > 0.1
