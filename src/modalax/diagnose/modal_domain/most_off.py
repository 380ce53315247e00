"""Where the general inaccuracy sits, in a sentence: the elements that are off by far more than the others."""

from modalax._numerics.text import percent
from modalax.diagnose.modal_domain.fitting.fit import Fit
from modalax.diagnose.modal_domain.fitting.outlying import outlying
from modalax.diagnose.modal_domain.fitting.state import Setting

MOST = 4  # elements that are told


def most_off(setting: Setting, f: Fit) -> list[str]:
    """A sentence on the elements that stand out of a fit's inaccuracy of stiffness or mass; none if none do."""
    told = [
        f"{name} at {' - '.join(setting.inaccuracy.places[name][o.number])} by {'-' if o.size < 0 else '+'}"
        f"{percent(abs(o.size))} (± {percent(o.std)})"
        for name in ("stiffness", "mass") for o in outlying(setting, f, name)[:MOST]
    ]  # fmt: skip
    who = "a few elements are" if len(told) > 1 else "one element is"
    return [f"{who} off by far more than the others: {'; '.join(told)}"] if told else []
