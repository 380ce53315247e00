"""Modes picked by hand: a :class:`Session` keeps the state, a :class:`Server` or a notebook's :class:`Widget` shows it.

The page is carried by Plotly, which reports embed already, and served by Python's standard library: the poles of a
diagram, the curves and the table are small messages, and a click needs one of each. Panel, Bokeh or Dash would bring
some thirty packages and a second way to draw, and none of them draws a moving wire frame by itself. A click on a set of
458 channels is answered in well under 200 ms, because the residues of all channels come from one factorisation
(:mod:`modalax.view.quick`) and only the curves that are seen are sent.
"""

from modalax.view.beside import read_beside
from modalax.view.server import Server
from modalax.view.session import Session
from modalax.view.widget import Widget

__all__ = ["Server", "Session", "Widget", "read_beside"]
