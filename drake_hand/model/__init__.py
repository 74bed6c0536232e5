"""Hand, object and scene. Knows nothing of contacts."""
