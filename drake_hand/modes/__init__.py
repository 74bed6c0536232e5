"""Mode codes, the hybrid automaton and constraint sets."""
