"""What is asked and what is found, as data: task, path, plan, trajectory. Needs no Drake."""
