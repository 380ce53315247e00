"""What every cause at every place would explain."""
