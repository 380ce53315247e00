"""From screened trials to fitted hypotheses of one cause and of several."""
