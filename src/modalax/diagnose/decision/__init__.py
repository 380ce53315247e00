"""Chances, probabilities and the verdict: the only place where anything is decided."""
