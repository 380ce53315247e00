"""Predicted FRFs of models with joints: harmonic balance, continuation, time marching, a virtual test bench."""

from modalax.simulate.backbone import Backbone, backbone
from modalax.simulate.bench import Bench, Records, Sensor
from modalax.simulate.continuation import Branch, follow_branch
from modalax.simulate.control import constant_response
from modalax.simulate.excitation import burst, hammer, random, stepped, swept_sine
from modalax.simulate.harmonic import Response, harmonic_balance, simulate
from modalax.simulate.march import Record, respond
from modalax.simulate.procedures import hammer_test, multisine_test, random_test, stepped_test, sweep_test
from modalax.simulate.stability import floquet_exponents
from modalax.simulate.stepped import SteppedSine, stepped_sine

__all__ = [
    "Backbone",
    "Bench",
    "Branch",
    "Record",
    "Records",
    "Response",
    "Sensor",
    "SteppedSine",
    "backbone",
    "burst",
    "constant_response",
    "floquet_exponents",
    "follow_branch",
    "hammer",
    "hammer_test",
    "harmonic_balance",
    "multisine_test",
    "random",
    "random_test",
    "respond",
    "simulate",
    "stepped",
    "stepped_sine",
    "stepped_test",
    "sweep_test",
    "swept_sine",
]
