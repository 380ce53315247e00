"""Measurement and simulation as arrays on common lines and channels."""
