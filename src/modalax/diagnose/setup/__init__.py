"""Measurement and simulation brought to common arrays."""
