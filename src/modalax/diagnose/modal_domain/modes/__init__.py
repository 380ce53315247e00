"""The measurement as its own modes: how many, where, and the features by which they are compared."""
