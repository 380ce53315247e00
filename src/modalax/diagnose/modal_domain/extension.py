"""What the modal domain has found, as an ordinary simulation."""

import jax.numpy as jnp

from modalax.diagnose.causes import Cause, catalogue, imitators
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.extend import ExtendedSimulation
from modalax.diagnose.modal_domain.causes import own_sizes, with_sizes
from modalax.diagnose.modal_domain.corrected import corrected
from modalax.diagnose.modal_domain.fit import Fit
from modalax.diagnose.modal_domain.forced import Forced
from modalax.diagnose.modal_domain.levels.laws import NAMED
from modalax.diagnose.modal_domain.stage import Stage


def extension_of(stage: Stage, f: Fit, forced: Forced | None = None) -> ExtendedSimulation:
    """The corrected simulation with the causes, as an ordinary simulation."""
    known: dict[str, Cause] = {}
    for cause in (*catalogue(), *imitators()):
        known.setdefault(cause.slug, cause)
    base, causes, places, params, spread, extras = corrected(stage, f), [], [], [], [], []
    spring = stage.whole.spring if stage.whole is not None and stage.whole.alone else None
    own = [own_sizes(f.causes, k) for k in range(len(f.causes))]
    every = [(c, u, f.covariance[at, at]) for (c, u), at in zip(with_sizes(f.causes, f.u), own, strict=True)]
    every += [] if forced is None else [(forced.cause, forced.u, forced.covariance)]
    for c, u, covariance in every:
        if c.in_structure or c.slug not in known or c == spring:
            continue
        m = stage.measurement
        names = base.dofs if c.at_dofs else (m.inputs if c.at_inputs else m.outputs)
        index = [names.index(str(w)) for w in c.where] + [-1, -1]
        index[0] = index[0] if c.first_index is None else c.first_index
        values, errors, extra = c.as_catalogue(u, covariance)
        causes.append(c.in_catalogue or known[c.slug])
        places.append(Place(tuple(c.where), (index[0], index[1], c.variant)))
        params.append(jnp.asarray(values))
        spread.append(jnp.asarray(errors))
        extras.append(None if extra is None else jnp.asarray(extra))
    joint = None if stage.seen is None else stage.seen.joint
    if joint is not None and joint.fit.law in NAMED:
        index = [base.dofs.index(w) for w in joint.spot.where] + [-1]
        law = joint.fit if stage.whole is None else stage.whole.fit
        causes.append(law.law)
        places.append(Place(joint.spot.where, (index[0], index[1], 0)))
        params.append(jnp.asarray(law.p))
        spread.append(jnp.asarray(law.std))
        extras.append(None)
    return ExtendedSimulation(
        base, tuple(params), tuple(spread), jnp.zeros((2, len(base.dofs))), tuple(extras), tuple(causes),
        tuple(places), stage.measurement.outputs, stage.measurement.inputs, float(stage.measured.freq[0]),
    )  # fmt: skip
