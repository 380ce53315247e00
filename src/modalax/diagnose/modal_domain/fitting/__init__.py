"""The general inaccuracy and causes fitted to the features of the modes, and what each explanation is worth."""
