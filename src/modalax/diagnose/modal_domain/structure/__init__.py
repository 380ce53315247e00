"""The simulation in its modal coordinates: its nodes, its elements, and how its modes move with its matrices."""
