"""Predictions of a simulation with causes added."""
