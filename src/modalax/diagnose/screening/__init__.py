"""Screening of every cause at every place by what it would explain."""
