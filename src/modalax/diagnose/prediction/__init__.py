"""What a simulation with causes in place predicts."""
