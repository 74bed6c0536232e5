"""Timing and the plan file."""
