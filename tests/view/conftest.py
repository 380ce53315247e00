import jax
import jax.numpy as jnp
import pytest

from modalax.check.finding import Finding, Findings
from modalax.model.examples import five_dof
from modalax.view import Session


@pytest.fixture(scope="session")
def opened():
    """A session of noisy FRFs as it opens; tests work on copies of its state."""
    frf = five_dof().frf(jnp.linspace(20, 70, 401), inputs=["1"]).add_noise(jax.random.key(0), 0.02)
    return Session(frf, order=14)


@pytest.fixture
def session(opened):
    first = opened.state
    yield opened
    opened.state, opened.past, opened.future = first, [], []


@pytest.fixture
def findings():
    """What a check might find, with a text that must not be taken for HTML."""
    return Findings((Finding("hum", ("1",), "a <line> at 50 Hz", "ground the cable", 0.97),), ("two runs",))
