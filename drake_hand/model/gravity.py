"""The strength of gravity, named once."""

STANDARD_GRAVITY = 9.81
"""m/s^2; an object's weight on earth is the scale of its forces, however the palm is turned."""
