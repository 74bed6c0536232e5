"""What the planner asks millions of times of fingers and surfaces, compiled."""
