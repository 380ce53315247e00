"""What is wrong with a measurement, before any model."""

from modalax.check.checking import check
from modalax.check.finding import WORDS, Finding, Findings, Picture

__all__ = ["WORDS", "Finding", "Findings", "Picture", "check"]
