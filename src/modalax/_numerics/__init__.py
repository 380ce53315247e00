"""Mathematics with no idea of modes."""
