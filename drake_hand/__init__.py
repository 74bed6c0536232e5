"""Dexterous-hand manipulation planning: certified finger gaits, from a URDF to motor drives."""

__version__ = "0.1.0"
