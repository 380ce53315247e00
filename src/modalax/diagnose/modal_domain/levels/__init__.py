"""What force levels tell: joints by their force against amplitude, and drifts from run to run."""
