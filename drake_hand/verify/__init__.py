"""Certificate and physics replay."""
