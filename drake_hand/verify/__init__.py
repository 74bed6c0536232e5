"""Certificate: a plan proved from its file."""
