"""Compiled kernels of the search: every row is a hand and an object of its own, on a path of its own."""
