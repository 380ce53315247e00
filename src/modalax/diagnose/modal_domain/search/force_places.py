"""Forces at one place that are no change of a matrix, at every place where one may be."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modalax.diagnose.modal_domain.causes.change import Change, own_sizes, with_sizes
from modalax.diagnose.modal_domain.causes.joint_forces import Between, LossyJoint, PowerLawJoint, RelaxingJoint
from modalax.diagnose.modal_domain.causes.line_forces import LineForce, RovingMass, SkewCoupling
from modalax.diagnose.modal_domain.fitting.fit import Fit, without_causes
from modalax.diagnose.modal_domain.structure.coordinates import Coordinates
from modalax.diagnose.modal_domain.structure.nodes import nodes_of

FEW = 40  # DoFs up to which any two may be coupled; of more, measured ones only, of still as many those of one node
COUPLED = 0.1  # usual skew coupling, relative to what would hold both DoFs as much as they hold themselves
MASS = 0.1  # usual mass of a sensor, relative to the modal mass seen from its place
APART, TIMES = math.log(4), (-1, 0, 1)  # of its logarithm, the distance of times about which modes are asked for one
KINDS: dict[str, type[LineForce]] = {
    "gyroscopic": SkewCoupling, "hysteretic_joint": LossyJoint, "maxwell_joint": RelaxingJoint,
    "fractional_joint": PowerLawJoint,
    "sensor_mass": RovingMass,
}  # fmt: skip
JOINTS = ("hysteretic_joint", "maxwell_joint", "fractional_joint")


def losses_at(spring: Change, candidates: Sequence[Change], c: Coordinates) -> list[LineForce]:
    """Losses of a joint at the place of a spring, one of each law that is looked for, of times about mid-band."""
    assert spring.direction is not None
    b, inside, out = spring.direction, np.flatnonzero(c.frequencies[:-1] < c.frequencies[-2]), []
    for slug in JOINTS:
        alike = [f for f in candidates if isinstance(f, LineForce) and f.slug == slug]
        here = [f for f in alike if f.where == spring.where]
        if alike:
            like = min(here or alike, key=lambda f: abs(f.about) if isinstance(f, RelaxingJoint) else 0.0)
            new = replace(
                like, where=spring.where, scale=spring.scale, weight=spring.weight, basis=b[:, None],
                reference=like.middle * _doubling(c, b, inside),
            )  # fmt: skip
            out.append(like if here else new)
    return out


def as_limits(
    fits: Sequence[Fit], candidates: Sequence[Change]
) -> list[tuple[tuple[Change, ...], np.ndarray, Fit | None]]:  # fmt: skip
    """Explanations with a spring or damper in place of a joint between these, from the size that its force has.

    A damper that holds two points together is far from all sizes that others start from, and so is a spring that such a
    damper is taken for. Alone it is fitted too: other causes may be what the joint had of the wrong kind.
    """
    out: list[tuple[tuple[Change, ...], np.ndarray, Fit | None]] = []
    for f in fits:
        middle = float(np.exp(np.log(np.abs(f.state.modes.poles[f.state.pairs])).mean()))
        for k, (c, u) in enumerate(with_sizes(f.causes, f.u)):
            others, kept = f.causes[:k] + f.causes[k + 1 :], np.delete(f.u, own_sizes(f.causes, k))
            holds = c.kind == "C" and c.direction is not None and abs(u[0]) > 1
            slugs = c.limits[0] if isinstance(c, Between) else ("joint_stiffness",) if holds else ()
            simple = [x for x in candidates if x.slug in slugs and x.where == c.where and x.direction is not None]
            for x in simple:
                size = c.as_limit(u, x) if isinstance(c, Between) else middle * c.scale * float(u[0]) / x.scale
                out += [((*others, x), np.append(kept, size), without_causes(f))] if x not in others else []
                out += [((x,), np.array([size]), None)] if others else []
    return out


def line_forces(
    c: Coordinates, dofs: Sequence[str], outputs: Sequence[str], inputs: Sequence[str],
    springs: Sequence[tuple[tuple[str, ...], np.ndarray, float, float, bool]], low: float, high: float,
) -> list[LineForce]:  # fmt: skip
    """Each such force of which modes tell, at each place.

    A joint that relaxes is one about each of several times, so that all are of one size. ``springs`` are places of
    joints, ``low`` and ``high`` the band's ends [rad/s].
    """
    middle = math.sqrt(low * high)
    found: list[LineForce] = []
    inside = np.flatnonzero(c.frequencies[:-1] < 1.5 * high)
    mobile = (c.shapes[:, inside] ** 2).mean(axis=1)
    for slug in JOINTS:
        for where, b, k, w, held in springs:
            if not held:
                continue
            reference = middle * _doubling(c, b, inside)
            joint = KINDS[slug](slug, where, k, weight=w, basis=b[:, None], middle=middle, reference=reference)
            if isinstance(joint, RelaxingJoint):
                found += [replace(joint, weight=w / len(TIMES), about=n * APART, width=APART) for n in TIMES]
            else:
                found.append(joint)
    some = [k for k, name in enumerate(dofs) if mobile[k] > 1e-6 * mobile.max()]
    if len(some) > FEW:
        some = [k for k in some if dofs[k] in {*outputs, *inputs}]
    node, many = nodes_of(tuple(dofs)).of_dofs, len(some) > FEW
    for j, a in enumerate(some):
        for b in (k for k in some[:j] if not many or node[k] == node[a]):
            size = COUPLED * middle / math.sqrt(mobile[a] * mobile[b])
            pair = c.shapes[[b, a]].T
            own = middle * math.sqrt(_doubling(c, pair[:, 0], inside) * _doubling(c, pair[:, 1], inside))
            where = dofs[b], dofs[a]
            found.append(SkewCoupling("gyroscopic", where, size, basis=pair, middle=middle, reference=own))
    return found


def roving_masses(c: Coordinates, outputs: Sequence[str], low: float, high: float) -> list[LineForce]:
    """The mass of a sensor at each output, the only such force that is no matter of the structure's modes."""
    masses = (roving_mass(c, name, k, c.outputs[k], low, high) for k, name in enumerate(outputs))
    return [mass for mass in masses if mass is not None]


def _doubling(c: Coordinates, b: np.ndarray, inside: np.ndarray) -> float:
    """Damper across a place that doubles the damping of one mode [N s/m]."""
    return float((np.diag(c.damping)[inside] / np.maximum(b[inside] ** 2, 1e-300)).min())


def roving_mass(
    c: Coordinates, name: str, number: int, row: np.ndarray, low: float, high: float
) -> RovingMass | None:  # fmt: skip
    """The mass of a sensor at the output of a number and a row of shapes; None where that does not move in the band."""
    seen = float((row[c.frequencies < 1.5 * high] ** 2).mean())
    if not seen:
        return None
    middle = math.sqrt(low * high)
    return RovingMass("sensor_mass", (name,), MASS / seen, basis=row[:, None], middle=middle, row=number)
