"""Mathematics that knows nothing of modes, and checks and settings of the machine that it runs on."""
