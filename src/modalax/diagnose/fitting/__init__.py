"""Hypotheses, their residuals and the search for their unknowns."""
