"""Explanations taken on from the modes to the lines of the FRFs."""
