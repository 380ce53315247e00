"""What shows in FRFs and not in modes alone: short records, fast sweeps, hum, and forces on single lines."""
