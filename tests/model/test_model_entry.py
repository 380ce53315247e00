"""What is refused before anything is concluded: data that say nothing, matrices of no passive structure."""

from types import SimpleNamespace

import numpy as np
import pytest

from modalax.data import FRF, Measurement
from modalax.diagnose import diagnose
from modalax.identify import fit
from modalax.model import ModalModel, Structure
from modalax.model.entry import check_comparable, check_measured, check_order
from modalax.model.examples import five_dof

FREQ = np.linspace(20.0, 70.0, 101)


def measured(lines: int = 101, **changes) -> FRF:
    frf = five_dof().frf(np.linspace(20.0, 70.0, lines), inputs=["1"])
    return frf.replace(**changes)


def changed(**matrices) -> Structure:
    return five_dof().replace(**matrices)


@pytest.mark.parametrize("lines", [1, 3])
def test_too_few_lines_to_tell(lines):
    with pytest.raises(ValueError, match=f"{lines} frequency lines are too few to conclude anything; at least 8"):
        diagnose(measured(lines), changed(M=1.1 * five_dof().M))


def test_zero_measurements_are_not_diagnosed():
    frf = measured()
    with pytest.raises(ValueError, match="zero throughout"):
        diagnose(frf.replace(H=0 * frf.H), five_dof())


def test_a_variance_of_zero_is_not_believed():
    variance = np.ones(measured().H.shape)
    variance[5, 2, 0] = 0.0
    with pytest.raises(ValueError, match="variance is 0 at 1 of 505 samples"):
        diagnose(measured(variance=variance), five_dof())


@pytest.mark.parametrize("call", [fit, lambda frf: diagnose(frf, five_dof())], ids=["fit", "diagnose"])
def test_conjugated_frfs_are_refused_with_the_remedy(call):
    frf = measured()
    with pytest.raises(ValueError, match=r"look conjugated .* complex conjugate: .replace"):
        call(frf.replace(H=frf.H.conj()))
    check_measured(frf)
    check_measured(Measurement.from_frfs([frf]))


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        (lambda s: {"K": -s.K}, "K has the eigenvalue -.*positive or zero"),
        (lambda s: {"C": -s.C}, "C has the eigenvalue -.*positive or zero"),
        (lambda s: {"M": -s.M}, "M has the eigenvalue -.*positive or zero"),
        (lambda s: {"M": 0 * s.M}, "M has the eigenvalue 0.*not zero throughout"),
        (lambda s: {"K": s.K.at[0, 1].set(0.0)}, "K is not symmetric"),
        (lambda s: {"M": s.M.at[0, 1].add(0.1)}, "M is not symmetric"),
        (lambda s: {"C": s.C.at[0, 4].add(5.0)}, "C is not symmetric"),
    ],
)
def test_matrices_of_no_passive_structure_are_refused(change, pattern):
    with pytest.raises(ValueError, match=pattern):
        diagnose(measured(), changed(**change(five_dof())))


def test_matrices_with_rounding_and_rigid_body_motion_are_taken():
    s = five_dof()
    free = np.array([[1.0, -1.0], [-1.0, 1.0]])
    check_comparable(measured(), s.replace(K=s.K * (1 + 1e-8 * np.triu(np.ones((5, 5))))))
    check_comparable(measured(), Structure(np.eye(2), 0 * free, 1e6 * free))


def test_a_mode_that_grows_is_refused():
    model = ModalModel([0.1 + 200j], [[1.0]], [[1.0]], outputs=["1"], inputs=["1"])
    with pytest.raises(ValueError, match="mode 1 of the simulation has a negative damping ratio"):
        check_comparable(measured(), model)


@pytest.mark.parametrize("order", [2.5, 0, -3])
def test_an_order_that_is_no_number_of_poles(order):
    with pytest.raises(ValueError, match=f"order is {order}; it needs a whole number, at least 1"):
        check_order(order)


def test_what_is_no_measurement():
    with pytest.raises(ValueError, match="a measurement is a Measurement or an FRF, not a SimpleNamespace"):
        check_comparable(SimpleNamespace(), five_dof())
