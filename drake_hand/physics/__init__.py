"""Plans tried: commands played into a simulated hand and a free object, and what became of it."""
