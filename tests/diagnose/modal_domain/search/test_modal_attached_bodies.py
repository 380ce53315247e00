"""Bodies whose centre of mass is off their node, as a motor on a bracket."""

import numpy as np
from frames import DAMPING, DOFS, ELEMENTS, FLIP, cantilever, modal_damping, simulation
from test_modal_uneven import measured

from modalax.diagnose.modal_domain.causes.rigid_bodies import RigidBody
from modalax.diagnose.modal_domain.diagnosis import diagnose_modes


def test_the_mass_of_a_body_is_that_of_its_energy():
    rng = np.random.default_rng(0)
    moves = rng.standard_normal((6, 4))
    body = RigidBody("added_mass", ("1:+X",), 2.0, moves=moves, axes=(0, 1, 2), turns=(0, 1, 2), reach=0.7)
    u, step = np.array([1.3, 0.4, -0.2, 0.6, 0.9, 0.3, -1.1]), 1e-6
    mass, offset, radii = 2.0 * u[0], 0.7 * u[1:4], 0.7 * np.abs(u[4:])
    M = body.changes(u)["M"]
    for q in rng.standard_normal((5, 4)):
        v, turn = np.split(body.moves @ q, 2)
        centre = v + np.cross(turn, offset)
        np.testing.assert_allclose(q @ M @ q, mass * (centre @ centre + (radii * turn) @ (radii * turn)))
    for e, slope in zip(np.eye(7), body.slopes(u), strict=True):
        by = (body.changes(u + step * e)["M"] - body.changes(u - step * e)["M"]) / (2 * step)
        np.testing.assert_allclose(slope["M"], by, atol=1e-7 * np.abs(by).max())
    told = body.told(u, np.eye(7))
    assert [told[f"offset_{axis}"]["value"] for axis in "xyz"] == offset.tolist()
    assert [told[f"radius_of_gyration_{axis}"]["value"] for axis in "xyz"] == radii.tolist()
    assert told["mass"] == {"value": mass, "std": 2.0, "unit": "kg"}
    assert {v["unit"] for name, v in told.items() if name != "mass"} == {"m"}
    assert body.round(2.0, offset, 0.5).tolist() == [2.0, *offset, 0.5, 0.5, 0.5]


def test_a_body_beside_its_node_is_named_with_its_offset_and_radius():
    """A beam along x bends in one plane: of the offset only what is along it shows."""
    rng = np.random.default_rng(4)
    off = [1 + size * rng.standard_normal(ELEMENTS) for size in (0.02, 0.007)]
    K, M = (FLIP[:, None] * A * FLIP for A in cantilever(*off))
    C = modal_damping(M, K, DAMPING * np.exp(0.2 * rng.standard_normal(len(K))))
    mass, offset, radius, at = 0.25, 0.12, 0.08, DOFS.index("5:+Z")
    lever = np.array([1.0, -offset])
    M[at : at + 2, at : at + 2] += mass * np.outer(lever, lever) + np.diag([0.0, mass * radius**2])
    freq = np.linspace(4.0, 230.0, 240)
    every = measured(K, M, C, rng, freq, (4, 14), DOFS)
    x = diagnose_modes(every, simulation())
    assert x.verdict == "named", x.reasons
    (cause,) = x.causes
    assert (cause["name"], list(cause["where"])) == ("added_mass", ["5:+Z"])
    told = cause["parameters"]
    assert set(told) == {"mass", "offset_x", "radius_of_gyration"}
    for name, value in {"mass": mass, "offset_x": offset, "radius_of_gyration": radius}.items():
        assert abs(told[name]["value"] - value) < 3 * told[name]["std"], (name, told[name])
        assert told[name]["std"] < 0.15 * value
    assert any("a body that turns with the node" in reason for reason in x.reasons)


def test_over_degrees_of_freedom_a_body_is_what_it_is_over_modes():
    """The second of the node's motions counts the other way, and one degree of freedom is another node's."""
    rng = np.random.default_rng(1)
    which = np.zeros((4, 6))
    which[[0, 1, 3], [0, 5, 1]] = 1.0, -1.0, 1.0
    shapes, u = rng.standard_normal((4, 7)), np.array([0.8, 0.5, -0.3, 1.2])
    body = RigidBody(
        "added_mass", ("1:+X",), 2.0, factor=which, moves=which.T @ shapes, axes=(0, 1), turns=(2,), reach=0.4
    )
    np.testing.assert_allclose(shapes.T @ body.over_dofs(u) @ shapes, body.changes(u)["M"], atol=1e-12)
    assert not body.over_dofs(u)[2].any() and np.isclose(body.over_dofs(u)[0, 0], 1.6)
