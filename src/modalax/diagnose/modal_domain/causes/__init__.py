"""What may be wrong: changes of the structure and of its channels, at every place that they may have."""
