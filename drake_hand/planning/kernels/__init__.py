"""Compiled kernels of the search: every row is a hand and an object of its own, on a path of its own.

A search asks millions of times, and the object of each row is somewhere else: numpy's batches would follow one path at
a time. Arrays go in and out, and rows do not depend on one another, so that they can be split over cores with one
result.
"""
