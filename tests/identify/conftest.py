import jax.numpy as jnp
import numpy as np
import pytest

from modalax.data import FRF
from modalax.model import ModalModel
from modalax.model.examples import five_dof


@pytest.fixture(scope="session")
def paper():
    """The five-DoF system's modes: frequencies 26 to 63 Hz, all damping ratios 2 %."""
    return five_dof().modal()


@pytest.fixture(scope="session")
def paper_frf(paper):
    """Its first FRF column in the review's band, without noise."""
    return paper.frf(np.arange(200, 701) * 0.1, inputs=["1"])


@pytest.fixture(scope="session")
def forty():
    """Forty modes seen at five outputs, with spacings and dampings drawn at random."""
    rng = np.random.default_rng(3)
    frequency = 8 + np.cumsum(rng.uniform(1.5, 6.0, 40))
    return ModalModel.from_real_modes(
        frequency, rng.uniform(0.003, 0.02, 40), rng.normal(size=(40, 5)), rng.uniform(0.5, 2, 40), list("abcde")
    )


def worst(poles, model, which=slice(None)):
    """Largest relative error in frequency and in damping of the poles nearest the model's."""
    poles = np.asarray(poles)
    errors = [(0.0, 0.0)]
    for true in np.asarray(model.poles)[which]:
        near = poles[np.argmin(abs(poles - true))]
        zeta, exact = -near.real / abs(near), -true.real / abs(true)
        errors.append((abs(abs(near) / abs(true) - 1), abs(zeta / exact - 1)))
    return tuple(np.max(errors, axis=0))


@pytest.fixture(scope="session")
def errors():
    return worst


def of_order(table, order):
    row = table.orders.index(order)
    return np.asarray(table.poles)[row][np.asarray(table.valid)[row]]


@pytest.fixture(scope="session")
def poles_of():
    return of_order


@pytest.fixture
def one_mode():
    """One mode at 10 Hz with 1 % damping, drive point only."""
    model = ModalModel.from_real_modes([10.0], [0.01], [[1.0]], [2.0], ["p"])
    return model, FRF(jnp.linspace(5, 15, 201), model.frf(jnp.linspace(5, 15, 201)).H, outputs=["p"], inputs=["p"])
