"""Plans in simulation: commands replayed on a simulated hand with a free object, and the outcome."""
