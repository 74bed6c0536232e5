"""Timing: from a path to a plan."""
