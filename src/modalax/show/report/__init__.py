"""Reports, each a self-contained HTML file that opens without a network."""

from modalax.show.report.check import check_report
from modalax.show.report.diagnosis import diagnosis_report
from modalax.show.report.fit import fit_report
from modalax.show.report.page import Page, Plot, Section, Table

__all__ = ["Page", "Plot", "Section", "Table", "check_report", "diagnosis_report", "fit_report"]
