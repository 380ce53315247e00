import jax.numpy as jnp
import numpy as np

from modalax.diagnose import Explained, ExtendedSimulation, Place
from modalax.diagnose.causes.channels import ChannelSign
from modalax.diagnose.causes.joints import CoulombFriction
from modalax.model import Structure


def extended():
    base = Structure(np.eye(2), np.zeros((2, 2)), np.eye(2), ["a", "b"])
    return ExtendedSimulation(
        base, (jnp.array([2.0]),), (jnp.array([0.1]),), jnp.zeros((2, 2)), (None,), (CoulombFriction(),),
        (Place(("a", "b"), (0, 1, 0)),), ("a", "b"), ("a",), 1.0,
    )  # fmt: skip


def test_a_cause_prints_its_name_meaning_and_unknowns():
    assert str(CoulombFriction()) == "coulomb_friction: dry friction (slip_force [N])"
    assert str(ChannelSign()).startswith("channel_sign: ")


def test_an_extended_simulation_prints_what_was_added_where():
    assert str(extended()).splitlines() == [
        "Simulation with 1 cause",
        "  coulomb_friction at a - b: slip_force = 2.00 ± 0.10 N",
        "Structure of 2 degrees of freedom: a, b",
        "  no damping",
    ]


def test_laws_that_were_compared_print_their_probability():
    law = Explained(extended(), 98.5, 120, 21, 0.875, np.zeros(0), np.zeros(0), np.zeros(0))
    assert str(law).splitlines() == [
        "coulomb_friction: probability 0.875, chi-square 98.5 of 120 real samples with 21 unknowns",
        "  coulomb_friction at a - b: slip_force = 2.00 ± 0.10 N",
    ]
