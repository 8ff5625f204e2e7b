"""Style losses: feature networks, statistics of features, content, one loss per picture."""
