"""Diagnosis of simulations that are off everywhere, in the modal domain; ``stage`` is the way through."""
