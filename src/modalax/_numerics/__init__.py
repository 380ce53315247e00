"""Mathematics with no idea of modes, and what it runs on."""
