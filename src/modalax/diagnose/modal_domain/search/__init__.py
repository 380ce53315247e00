"""Which causes at which places: screened by finite sizes, fitted, and added one to another."""
