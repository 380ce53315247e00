"""What is told of explanations: small causes that the modes cannot do without, and couplings that are none."""

from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from modalax.diagnose.modal_domain import judged
from modalax.diagnose.modal_domain.causes import Change
from modalax.diagnose.modal_domain.channel_faults import Sign
from modalax.diagnose.modal_domain.explanation import Explanation
from modalax.diagnose.modal_domain.judged import _without_one_sided, standing_out
from modalax.diagnose.modal_domain.line_forces import SkewCoupling

SIGN, SPRING = Sign("channel_sign", ("3",), channel=(0, 2)), Change("joint_stiffness", ("1", "2"))
DAMPER, ABSENT = Change("local_damper", ("1", "2")), Change("joint_stiffness", ("1", "5"), absent=True)
SKEW = SkewCoupling("gyroscopic", ("1", "4"), 1.0)


@dataclass(frozen=True)
class Few:
    """The part of a stage that counts here."""

    explanations: list


def explained(*causes, posterior=0.0, probability=0.5, misfit=1.0):
    return Explanation(SimpleNamespace(causes=causes), posterior, probability, misfit)


def couple(misfit=1.1):
    """A sign with a skew coupling beside it, and without, at this misfit."""
    return Few([
        explained(SIGN, SKEW, posterior=20.0, probability=0.9), explained(SIGN, misfit=misfit, probability=0.06),
        explained(SPRING, posterior=-1.0, probability=0.04, misfit=9.0),
    ])  # fmt: skip


@pytest.mark.parametrize("needed", [True, False])
def test_losses_stand_out_where_the_modes_need_them_as_no_inaccuracy_has_them(monkeypatch, needed):
    monkeypatch.setattr(judged, "told_by_size", lambda stage, e: ((SIGN,), (SPRING, DAMPER, ABSENT)))
    monkeypatch.setattr(judged, "needs", lambda stage, e, small: needed)
    found = standing_out(None, explained(SIGN, SPRING, DAMPER, ABSENT))
    assert found == ((SIGN, DAMPER, ABSENT) if needed else (SIGN,))


@pytest.mark.parametrize(
    ("one_sided", "misfit", "left_out"), [(True, 1.1, True), (False, 1.1, False), (True, 2.5, False)]
)
def test_a_coupling_that_is_none_does_not_hide_what_explains_the_modes(monkeypatch, one_sided, misfit, left_out):
    monkeypatch.setattr(judged, "standing_out", lambda stage, e: e.causes)
    monkeypatch.setattr(judged, "_one_sided", lambda stage, e: (SKEW.where,) if one_sided else ())
    found = _without_one_sided(couple(misfit)).explanations
    if not left_out:
        assert len(found) == 3
        return
    assert [e.causes for e in found] == [(SIGN,), (SPRING,)]
    assert sum(e.probability for e in found) == pytest.approx(1.0) and found[0].probability > 0.7


def test_a_coupling_alone_stays(monkeypatch):
    monkeypatch.setattr(judged, "standing_out", lambda stage, e: e.causes)
    monkeypatch.setattr(judged, "_one_sided", lambda stage, e: (SKEW.where,))
    alone = Few([explained(SKEW), explained(misfit=5.0)])
    assert _without_one_sided(alone) is alone
