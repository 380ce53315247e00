"""Diagnosis of simulations that are off everywhere, by the modes of the measurement.

The way through is ``diagnosis`` over ``stage``: what the measurement's own ``modes`` and the simulation's ``structure``
are, which ``causes`` may be missing, how they are fitted beside the general inaccuracy (``fitting``), which of them are
tried (``search``), what all lines say of the leading ones (``on_lines``), what the force ``levels`` tell of a joint,
which ``odd_channels`` no cause explains, and what ``records`` show that is no sum of modes.
"""
