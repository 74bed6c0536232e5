"""The problem and its solution, as data: task, path, plan, trajectory. Needs no Drake."""
