"""Hand, object and scene: what the world is made of. Knows nothing of contacts."""
