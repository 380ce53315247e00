"""A model to predicted FRFs: joints, harmonic balance, continuation, time marching."""

from modalax.simulate.backbone import Backbone, backbone
from modalax.simulate.continuation import Branch, follow_branch
from modalax.simulate.control import constant_response
from modalax.simulate.harmonic import Response, harmonic_balance, simulate
from modalax.simulate.stability import floquet_exponents

__all__ = [
    "Backbone",
    "Branch",
    "Response",
    "backbone",
    "constant_response",
    "floquet_exponents",
    "follow_branch",
    "harmonic_balance",
    "simulate",
]
