"""Example structures."""

import numpy as np

from modalax.model.structure import Structure


def five_dof() -> Structure:
    """The five-degree-of-freedom system of the aircraft modal-analysis review, made from its tables 1 and 2.

    Frequencies 26.06 to 62.60 Hz, every damping ratio 2 %; DoFs ``1`` to ``5``, driven at ``1`` in the review.
    """
    shapes = np.array(
        [
            [0.7147, 1.0000, -0.0911, -0.9230, -0.6083],
            [0.7166, 0.9999, -0.1493, 1.0000, -0.1937],
            [0.7981, 0.2257, 0.1554, -0.1518, 1.0000],
            [0.8518, -0.5166, 1.0000, 0.1231, -0.3936],
            [1.0000, -0.8590, -0.5860, 0.0196, -0.2041],
        ]
    )
    return Structure.from_modes(
        frequency_hz=np.array([26.06, 36.84, 51.47, 56.21, 62.60]),
        damping_ratio=np.full(5, 0.02),
        shapes=shapes.T,
        modal_mass=np.array([2.52, 1.97, 0.90, 1.09, 1.05]),
        dofs=[str(k) for k in range(1, 6)],
    )
