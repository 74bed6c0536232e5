"""The planner: from a task to a path without time.

Read in this order: `planner`, `run` (steps of a task), `searches` (starts, gaits, hand-overs), `search` (which state
next), `moves`, `strokes`, `switches` (what can be done from a state), `legs`, `finish` and `force_plan` (from states to
legs with forces). Everything that is evaluated in bulk is in `kernels`.
"""
