"""Channels that differ from all others as no cause explains."""
